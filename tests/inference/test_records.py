"""hands.json: the schema, the round trip, bad records."""

import copy
import json

import numpy as np
import pytest
from tests.oracles import UNUSED, drawn_hands, full_truth, make_card

from twohands.errors import DataFormatError, InputError
from twohands.inference.estimator import HandEstimator
from twohands.inference.records import from_dict, to_dict
from twohands.types import HandPose, PinholeCamera, TwoHandPose

HAND_KEYS = {
    "present", "score", "box_px", "joints_px", "joint_scores", "canonical", "joints_m", "range_m", "theta_deg",
    "phi_deg", "key_bone", "method", "valid", "range_sigma_m", "scale_source", "intrinsics_source",
}  # fmt: skip


def two_frames() -> list[TwoHandPose]:
    estimator = HandEstimator(UNUSED, make_card())
    poses = []
    for i, present in enumerate([(True, True), (False, True)]):
        sample = drawn_hands(i, present=present)
        poses.append(
            estimator.estimate(sample.image, sample.camera, 0.1, full_truth(sample), index=i, time_s=None if i else 0.5)
        )
    return poses


def test_the_schema_of_version_1():
    record = to_dict(two_frames(), source="pictures", weights="tiny")
    assert list(record) == ["version", "source", "weights", "config", "hand_length_m", "frames"]
    assert record["hand_length_m"] is None and record["config"] is None
    assert (record["version"], record["source"], record["weights"]) == (1, "pictures", "tiny")
    first, second = record["frames"]
    assert list(first) == ["index", "file", "time_s", "camera", "hands", "between_hands_m", "overlap"]
    assert first["file"] is None
    assert (first["index"], first["time_s"], second["index"], second["time_s"]) == (0, 0.5, 1, None)
    assert list(first["camera"]) == ["fx", "fy", "cx", "cy", "width", "height"]
    assert list(first["hands"]) == ["left", "right"]
    for hand in first["hands"].values():
        assert set(hand) == HAND_KEYS
        shapes = {name: np.shape(hand[name]) for name in HAND_KEYS if isinstance(hand[name], list)}
        assert shapes == {
            "box_px": (4,), "joints_px": (21, 2), "joint_scores": (21,), "canonical": (21, 3), "joints_m": (21, 3)
        }  # fmt: skip
        assert hand["present"] is True and hand["valid"] is True
        assert hand["key_bone"] in ("wrist", "little") and hand["method"] == "fitted"
    absent = second["hands"]["left"]
    assert absent == {name: None for name in HAND_KEYS} | {"present": False}


def test_results_from_before_ranges_said_how_far_they_may_be_off_are_read():
    record = json.loads(json.dumps(to_dict(two_frames(), source="s", weights="w")))
    for frame in record["frames"]:
        for hand in frame["hands"].values():
            for name in ("range_sigma_m", "scale_source", "intrinsics_source"):
                del hand[name]
        del frame["between_hands_m"], frame["overlap"]
    assert from_dict(record)[0].left.range_sigma_m is None


def test_round_trip_through_json_text_keeps_every_number_to_a_micrometre():
    poses = two_frames()
    again = from_dict(json.loads(json.dumps(to_dict(poses, source="s", weights="w"), allow_nan=False)))
    assert len(again) == 2
    for pose, twin in zip(poses, again, strict=True):
        assert (pose.camera.width, pose.index, pose.time_s) == (twin.camera.width, twin.index, twin.time_s)
        for hand, other in zip(pose.hands, twin.hands, strict=True):
            assert hand.present == other.present
            if not hand.present:
                assert other == HandPose(present=False)
                continue
            for name in ("box_px", "joints_px", "joint_scores", "canonical", "joints_m"):
                np.testing.assert_allclose(getattr(other, name), getattr(hand, name), atol=5.1e-7)
            for name in ("score", "range_m", "theta_deg", "phi_deg"):
                assert getattr(other, name) == pytest.approx(getattr(hand, name), abs=5.1e-7)
            assert (other.key_bone, other.method, other.valid) == (hand.key_bone, hand.method, hand.valid)


def test_unknown_numbers_are_null_and_come_back_as_nan():
    joints = np.ones((21, 2))
    joints[3, 0] = np.nan
    hand = HandPose(present=True, joints_px=joints, range_m=float("nan"), valid=False)
    pose = TwoHandPose(hand, HandPose(present=False), PinholeCamera.ego3dhands())
    record = to_dict([pose], source="s", weights="w")
    text = json.dumps(record, allow_nan=False)
    assert record["frames"][0]["hands"]["left"]["joints_px"][3] == [None, 1.0]
    back = from_dict(json.loads(text))[0].left
    assert back.joints_px is not None and np.isnan(back.joints_px[3, 0]) and back.range_m is None


def test_a_camera_with_distortion_keeps_it():
    camera = PinholeCamera(500, 501, 320, 240, 640, 480, (0.1, -0.05, 0.001, 0.002, 0.0))
    hands = (HandPose(present=False), HandPose(present=False))
    record = to_dict([TwoHandPose(*hands, camera)], source="s", weights="w")
    assert from_dict(record)[0].camera == camera


def test_a_camera_as_opencv_calibrates_it_is_kept_too():
    """Named case: (1, 5) arrays of coefficients and NumPy's integers were taken, and refused when written."""
    lens = np.array([[0.1, -0.05, 0.001, 0.002, 0.0]])
    camera = PinholeCamera(500, 501, 320, 240, np.int64(640), np.int64(480), lens)  # type: ignore[arg-type]
    assert camera == PinholeCamera(500, 501, 320, 240, 640, 480, (0.1, -0.05, 0.001, 0.002, 0.0))
    hands = (HandPose(present=False), HandPose(present=False))
    text = json.dumps(to_dict([TwoHandPose(*hands, camera)], source="s", weights="w"))
    assert from_dict(json.loads(text))[0].camera == camera
    with pytest.raises(InputError, match="0, 4, 5 or 8"):
        PinholeCamera(500, 501, 320, 240, 640, 480, np.zeros((3, 1)))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda r: r.update(version=2), "version 1 expected, found 2"),
        (lambda r: r.pop("frames"), "'frames' is missing"),
        (lambda r: r["frames"][0]["hands"].pop("left"), "'left' is missing"),
        (lambda r: r["frames"][0]["hands"]["left"].pop("score"), "'score' is missing"),
        (lambda r: r["frames"][0]["hands"]["left"]["joints_m"].pop(), r"joints_m must have shape \(21, 3\)"),
        (lambda r: r["frames"][0]["camera"].update(fx=-1.0), "fx must be positive"),
    ],
)
def test_a_damaged_record_is_refused(damage, message):
    record = copy.deepcopy(to_dict(two_frames(), source="s", weights="w"))
    damage(record)
    with pytest.raises(DataFormatError, match=message):
        from_dict(record)


def test_a_record_that_is_no_object_is_refused():
    with pytest.raises(DataFormatError, match="found 'list'"):
        from_dict([])  # type: ignore[arg-type]
