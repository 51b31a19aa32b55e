"""Every tracker's words for true hands give their true place; what is no such file is one line."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.lifting import formats
from tests.oracles import drawn_hands

from twohands.errors import DataFormatError, InputError
from twohands.formats.camera_files import read_camera
from twohands.geometry.anatomy import HAND_LENGTH, anatomical_joints
from twohands.geometry.canonical import canonical_from_camera
from twohands.inference.records import from_dict, to_dict
from twohands.inference.tables import csv_text, npz_bytes, to_arrays
from twohands.lifting.foreign import ForeignHands
from twohands.lifting.placing import lift_hands, place_hands, surplus
from twohands.lifting.reading import Hints, from_record, read_hands
from twohands.skeleton import LEFT, RIGHT, ROOT, WRIST
from twohands.types import HandPose, HandSample, PinholeCamera, TwoHandPose

FILES = Path(__file__).parent / "files"
LENGTH_M = 0.1

WITH_SHAPES = {
    **{
        f"MediaPipe {style}": (lambda s, style=style: formats.mediapipe(s, style)) for style in formats.MEDIAPIPE_STYLES
    },
    "WiLoR-mini": formats.wilor_mini,
    "HaMeR": formats.hamer_batch,
}
IN_THE_PICTURE = {
    "OpenPose": formats.openpose,
    "MMPose": formats.mmpose_whole_body,
    "rtmlib": formats.rtmlib,
}


def plain(record):
    """As JSON would hold it."""
    if isinstance(record, dict):
        return {key: plain(value) for key, value in record.items()}
    if isinstance(record, list):
        return [plain(value) for value in record]
    return record.tolist() if isinstance(record, np.ndarray) else record


def placed(foreign: ForeignHands, sample: HandSample, **options) -> TwoHandPose:
    (pose,) = place_hands(foreign, sample.camera, LENGTH_M, **options)
    return pose


def assert_true(pose: TwoHandPose, sample: HandSample, atol: float = 1e-9) -> None:
    for side, hand in enumerate(pose.hands):
        assert hand.present == bool(sample.present[side])
        if hand.present:
            assert hand.valid and hand.joints_m is not None and hand.range_m is not None
            np.testing.assert_allclose(hand.joints_m, sample.joints_m[side], atol=atol)
            assert hand.range_m == pytest.approx(np.linalg.norm(sample.joints_m[side, ROOT]), abs=atol)


def with_anatomy(sample: HandSample) -> HandSample:
    """The same hands in metres, wrist and knuckles where other data sets put them."""
    joints_m = anatomical_joints(sample.joints_m)
    pixels = np.stack([_project(hand, sample.camera) for hand in joints_m])
    return HandSample(sample.image, sample.camera, sample.present, pixels, joints_m, sample.valid)


def _project(joints_m, camera: PinholeCamera):
    return joints_m[:, :2] / joints_m[:, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy]


def our_pose(sample: HandSample) -> TwoHandPose:
    """What `track` would say of the picture if it saw everything right."""
    canonical = np.asarray(canonical_from_camera(sample.joints_m).joints)
    hands = [
        HandPose(True, 1.0, canonical=canonical[side], joints_m=sample.joints_m[side], valid=True) for side in range(2)
    ]
    return TwoHandPose(hands[LEFT], hands[RIGHT], sample.camera)


@pytest.mark.parametrize("words", WITH_SHAPES.values(), ids=WITH_SHAPES)
@pytest.mark.parametrize("present", [(True, True), (False, True)])
def test_true_results_give_the_true_place(words, present):
    sample = drawn_hands(3, present=present)
    assert_true(placed(from_record(words(sample), sample.camera), sample), sample)


@pytest.mark.parametrize("words", WITH_SHAPES.values(), ids=WITH_SHAPES)
def test_through_a_json_file_of_many_frames(words, tmp_path):
    samples = [drawn_hands(i) for i in range(3)]
    abouts = [{"frame": 2 * i, "time_s": i / 10, "file": f"a/{i}.png"} for i in range(3)]
    frames = [about | {"result": plain(words(s))} for about, s in zip(abouts, samples, strict=True)]
    (tmp_path / "r.json").write_text(json.dumps({"frames": [*frames, {"frame": 9, "result": []}]}))
    (tmp_path / "r.jsonl").write_text("\n".join(json.dumps(plain(words(s))) for s in samples))
    foreign = read_hands(tmp_path / "r.json", samples[0].camera)
    assert [(f.index, f.time_s, f.file) for f in foreign.frames] == [
        (0, 0.0, "0.png"), (2, 0.1, "1.png"), (4, 0.2, "2.png"), (9, None, None),
    ]  # fmt: skip
    poses = place_hands(foreign, samples[0].camera, LENGTH_M)
    assert [pose.index for pose in poses] == [0, 2, 4, 9] and not poses[3].left.present
    lines = place_hands(read_hands(tmp_path / "r.jsonl", samples[0].camera), samples[0].camera, LENGTH_M)
    for pose, line, sample in zip(poses, lines, samples, strict=False):
        assert_true(pose, sample)
        assert_true(line, sample)


def test_objects_of_mediapipes_python_api():
    sample = drawn_hands(3)

    def objects(value):
        if isinstance(value, dict):
            return SimpleNamespace(**{key: objects(one) for key, one in value.items()})
        return [objects(one) for one in value] if isinstance(value, list) else value

    for style in ("legacy", "tasks"):
        assert_true(placed(from_record(objects(formats.mediapipe(sample, style)), sample.camera), sample), sample)
    nothing = SimpleNamespace(multi_hand_landmarks=None, multi_hand_world_landmarks=None, multi_handedness=None)
    assert from_record(nothing, sample.camera).frames[0].hands == ()


def test_tensors_of_hamer():
    torch = pytest.importorskip("torch")
    sample = drawn_hands(4)
    batch = {name: torch.from_numpy(array) for name, array in formats.hamer_batch(sample).items()}
    assert_true(placed(from_record(batch, sample.camera), sample), sample)


def test_an_npz_of_hamer_with_hands_of_many_pictures(tmp_path):
    samples = [drawn_hands(i) for i in range(2)]
    batches = [formats.hamer_batch(s) for s in samples]
    joined = {name: np.concatenate([b[name] for b in batches]) for name in batches[0]}
    np.savez(tmp_path / "h.npz", allow_pickle=False, **joined, frame=np.repeat([3, 7], 2))
    foreign = read_hands(tmp_path / "h.npz", samples[0].camera)
    assert [frame.index for frame in foreign.frames] == [3, 7]
    for pose, sample in zip(place_hands(foreign, samples[0].camera, LENGTH_M), samples, strict=True):
        assert_true(pose, sample)


@pytest.mark.parametrize("words", IN_THE_PICTURE.values(), ids=IN_THE_PICTURE)
def test_a_tracker_of_the_picture_needs_our_pose(words):
    """The shape is ours with anatomical wrist and knuckles; the length is that of this skeleton."""
    ours = drawn_hands(5)
    seen = with_anatomy(ours)
    foreign = from_record(words(seen), seen.camera)
    assert foreign.bone_ratio == HAND_LENGTH
    with pytest.raises(InputError, match=r"knows the picture alone.*--pose"):
        placed(foreign, seen)
    (pose,) = place_hands(foreign, seen.camera, LENGTH_M * foreign.bone_ratio, poses=[our_pose(ours)])
    assert_true(pose, seen)
    (absent,) = place_hands(foreign, seen.camera, LENGTH_M, poses=[])
    assert absent.left.present and not absent.left.valid and absent.left.joints_m is None


def test_a_single_hand_of_mmpose_needs_its_side():
    sample = drawn_hands(6)
    record = [{"frame_id": 4, "instances": formats.mmpose_hand(sample, RIGHT)}]
    with pytest.raises(DataFormatError, match=r"frame 0: keypoints: 21 joints of one hand.*--side"):
        from_record(record, sample.camera)
    (frame,) = from_record(record, sample.camera, Hints(side=RIGHT)).frames
    assert frame.index == 4 and frame.hands[0].side == RIGHT
    np.testing.assert_allclose(frame.hands[0].joints_px, sample.joints_px[RIGHT], atol=1e-9)


def test_a_folder_has_a_file_for_each_picture(tmp_path):
    samples = [drawn_hands(i) for i in range(3)]
    for name, sample in zip((10, 9, 2), samples, strict=True):
        (tmp_path / f"clip_{name}_keypoints.json").write_text(json.dumps(formats.openpose(sample)))
    frames = read_hands(tmp_path, samples[0].camera).frames
    assert [frame.file for frame in frames] == ["clip_2_keypoints", "clip_9_keypoints", "clip_10_keypoints"]
    np.testing.assert_allclose(frames[2].hands[0].joints_px, samples[0].joints_px[LEFT], atol=1e-9)


def test_our_own_results_and_tables_go_round(tmp_path):
    """hands.json, npz and csv of one lift are read back to the same place."""
    samples = [drawn_hands(0), drawn_hands(1, present=(False, True))]
    camera = samples[0].camera
    foreign = from_record([formats.mediapipe(s) for s in samples], camera)
    poses = place_hands(foreign, camera, LENGTH_M)
    names = ["a.png", "b.png"]
    record = to_dict(poses, source="s", weights="w", hand_length_m=LENGTH_M, files=names)
    (tmp_path / "h.json").write_text(json.dumps(record))
    arrays = to_arrays(poses, camera, source="s", weights="w", hand_length_m=LENGTH_M, files=names)
    (tmp_path / "h.npz").write_bytes(npz_bytes(arrays))
    (tmp_path / "h.csv").write_text(csv_text(poses, names))
    for name, atol in (("h.json", 2e-5), ("h.npz", 1e-9), ("h.csv", 1e-9)):
        again = read_hands(tmp_path / name, camera)
        assert [frame.file for frame in again.frames] == names
        for pose, sample in zip(place_hands(again, camera, LENGTH_M), samples, strict=True):
            assert_true(pose, sample, atol)
    assert from_dict(record)[1].left.present is False
    assert arrays["present"].tolist() == [[True, True], [False, True]] and np.isnan(arrays["joints_m"][1, 0]).all()


def test_a_mirrored_picture_is_turned_back():
    """A tracker of its own names, shown the mirror image, calls the left hand right."""
    sample = drawn_hands(2)
    width = sample.camera.width
    mirror = HandSample(
        sample.image,
        sample.camera,
        sample.present,
        np.stack([width - sample.joints_px[::-1, :, 0], sample.joints_px[::-1, :, 1]], axis=-1),
        sample.joints_m[::-1] * [-1, 1, 1],
        sample.valid,
    )
    assert_true(placed(from_record(formats.mediapipe(mirror), sample.camera), sample, mirrored=True), sample)


def test_the_most_certain_of_each_side():
    sample = drawn_hands(2)
    record = formats.wilor_mini(sample)
    twice = from_record([*record, *record], sample.camera)
    assert surplus(twice) == 2
    assert_true(placed(twice, sample), sample)


def test_two_hands_of_one_name_are_one_of_each():
    """MediaPipe looks at each hand alone; the less certain of two "Left" is the right one."""
    sample = drawn_hands(2)
    record = formats.mediapipe(sample)
    for score, says in zip((0.6, 0.9), record["handedness"], strict=True):
        says[0] |= {"category_name": "Left", "score": score}
    assert_true(placed(from_record(record, sample.camera), sample), sample)


def test_names_can_be_said():
    sample = drawn_hands(2)
    exchanged = from_record(formats.mediapipe(sample, "tasks"), sample.camera, Hints(names="mirrored"))
    assert [hand.side for hand in exchanged.frames[0].hands] == [LEFT, RIGHT]


def test_lift_hands_allows_for_the_trackers_skeleton():
    sample = drawn_hands(3)
    (pose,) = lift_hands(formats.mediapipe(sample), sample.camera, LENGTH_M / 0.9)
    assert_true(pose, sample)


def test_files_as_mediapipe_wrote_them():
    """One packaged picture, by the legacy solution and the Tasks API of 0.10.21 and by 1.2.2: the same sides. The
    legacy solution sees another shape of this rendered left hand; the others agree."""
    import twohands

    camera = read_camera(Path(twohands.__file__).parent / "examples_data" / "camera.json")
    ranges = {}
    for name in ("legacy", "tasks", "tasks_0.10.21", "tasks_vision"):
        foreign = read_hands(FILES / f"mediapipe_{name}.json", camera)
        (pose,) = place_hands(foreign, camera, 0.09)
        assert foreign.system == "MediaPipe Hands" and pose.left.valid and pose.right.valid
        assert pose.left.joints_px is not None and 550 < pose.left.joints_px[ROOT, 0] < 600
        ranges[name] = [pose.left.range_m, pose.right.range_m]
    assert ranges["tasks"] == pytest.approx(ranges["tasks_0.10.21"], rel=0.02)
    assert ranges["tasks"] == pytest.approx(ranges["tasks_vision"], abs=1e-12)
    assert ranges["legacy"] == pytest.approx(ranges["tasks"], rel=0.25)


@pytest.mark.parametrize(
    "name", ["wilor_mini.json", "hamer.npz", "openpose_keypoints.json", "mmpose_whole_body.json", "rtmlib.json"]
)
def test_files_that_are_kept(name):
    """Files of the drawn hands as each tracker would write them: a reader that changes is seen here."""
    sample = drawn_hands(1)
    foreign = read_hands(FILES / name, sample.camera)
    ours = None if foreign.frames[0].hands[0].joints_3d is not None else [our_pose(sample)]
    if ours is None:
        assert_true(placed(foreign, sample), sample)
        return
    (pose,) = place_hands(foreign, sample.camera, LENGTH_M * foreign.bone_ratio, poses=ours)
    for side, hand in enumerate(pose.hands):
        np.testing.assert_allclose(hand.joints_px, sample.joints_px[side], atol=1e-9)


def rtmlib_frames(count: int, **about: Any) -> list[dict[str, Any]]:
    record = json.loads((FILES / "rtmlib.json").read_text())
    return [record | {name: value(number) for name, value in about.items()} for number in range(count)]


@pytest.mark.parametrize("about", [{}, {"frame": lambda number: number}, {"file": "{}.jpg".format}])
def test_a_list_of_rtmlibs_results_is_one_of_pictures(about):
    """It was taken for people of one picture: of three frames, one was left."""
    foreign = from_record(rtmlib_frames(3, **about), drawn_hands(1).camera)
    assert [(frame.index, len(frame.hands)) for frame in foreign.frames] == [(0, 2), (1, 2), (2, 2)]


def test_mmposes_instances_that_name_their_frame_are_of_many_pictures():
    (instance,) = formats.mmpose_whole_body(SAMPLE)
    foreign = from_record([instance | {"frame": 4}, instance | {"frame": 5}], SAMPLE.camera)
    assert [frame.index for frame in foreign.frames] == [4, 5]
    assert len(from_record([instance, instance], SAMPLE.camera).frames) == 1


def test_a_picture_that_is_there_twice_is_refused():
    """One record for each person, say: the second one's hands were lost."""
    with pytest.raises(DataFormatError, match="frame 7 is there twice; one record with all hands"):
        from_record(rtmlib_frames(2, frame=lambda number: 7), SAMPLE.camera)


SAMPLE = drawn_hands(1)
HEADER = b"frame,hand,joint,u_px,v_px,x_m,y_m,z_m\n"


def broken(record, path, value):
    """The record with one value replaced, or taken out (None)."""
    record = json.loads(json.dumps(plain(record)))
    at = record
    for key in path[:-1]:
        at = at[key]
    if value is None:
        del at[path[-1]]
    else:
        at[path[-1]] = value
    return record


@pytest.mark.parametrize(
    ("record", "message"),
    [
        ({"a": 1, "b": 2}, "no known tracker's results; found an object with a, b"),
        ([], "no known tracker's results; found a list of 0"),
        ("text", "no known tracker's results; found str"),
        (broken(formats.mediapipe(SAMPLE), ["hand_landmarks", 0], [{"x": 0, "y": 0, "z": 0}] * 20),
         "frame 0: landmarks: 21 joints expected, got 20"),
        (broken(formats.mediapipe(SAMPLE), ["hand_landmarks", 0, 3, "x"], float("nan")), "landmarks: 1 of 42 numbers"),
        (broken(formats.mediapipe(SAMPLE), ["hand_landmarks", 0, 3, "x"], "a"), "landmarks: numbers of shape"),
        (broken(formats.mediapipe(SAMPLE), ["hand_world_landmarks"], None), "worldLandmarks: missing"),
        (broken(formats.mediapipe(SAMPLE), ["handedness", 0, 0, "category_name"], "left hand"),
         "handedness: 'Left' or 'Right' expected, got 'left hand'"),
        (broken(formats.mediapipe(SAMPLE), ["handedness"], []), "handedness: 2 hands expected, as of landmarks, got 0"),
        (formats.mediapipe(SAMPLE) | {"width": 640, "height": 480}, "of 640x480, but the camera is for 240x135"),
        (broken(formats.wilor_mini(SAMPLE), [0, "is_right"], 7), "is_right: 0 (left) or 1 (right) expected, got 7"),
        (broken(formats.wilor_mini(SAMPLE), [1, "wilor_preds", "pred_keypoints_2d"], None), "keypoints_2d: missing"),
        (broken(formats.wilor_mini(SAMPLE), [0, "wilor_preds", "scaled_focal_length"], 12500.0),
         "pictures 640 px along the longer side, but the camera is for 240x135"),
        (formats.hamer_batch(SAMPLE) | {"img_size": [[640, 480]] * 2}, "img_size: pictures of 640x480"),
        ({k: v for k, v in formats.hamer_batch(SAMPLE).items() if k != "box_center"}, "fractions of the crop"),
        (broken(formats.openpose(SAMPLE), ["people", 0, "hand_left_keypoints_2d"], [0.0] * 60),
         "hand_left_keypoints_2d: 21 joints of u, v, score expected, got 20"),
        (broken(formats.openpose(SAMPLE), ["people", 0, "hand_left_keypoints_2d"], None), "writes it with --hand"),
        ([{"keypoints": [[0.0, 0.0, 1.0]] * 21, "keypoint_scores": [1.0] * 21}], "expected for each joint, got 3"),
        ([{"keypoints": [[0.0, 9.0 * i] for i in range(17)], "keypoint_scores": [1.0] * 17}], "joints (a hand) or 133"),
        (broken(formats.mmpose_whole_body(SAMPLE), [0, "keypoint_scores"], [1.0]), "keypoint_scores: shape (1, 133)"),
        (formats.openpose(drawn_hands(1, width=2400, height=1350)), "but the camera is for 240x135; give the camera"),
        ([formats.openpose(SAMPLE), {"b": 2}], "frame 1: no result of OpenPose; found an object with b"),
    ],
)  # fmt: skip
def test_what_is_no_such_file_is_one_line_with_file_and_key(record, message, tmp_path):
    (tmp_path / "r.json").write_text(json.dumps(plain(record)))
    with pytest.raises(DataFormatError) as error:
        read_hands(tmp_path / "r.json", SAMPLE.camera)
    assert str(error.value).startswith(f"{tmp_path / 'r.json'}: ") and message in str(error.value)


@pytest.mark.parametrize(
    ("name", "content", "error", "message"),
    [
        ("missing.json", None, InputError, "no such file"),
        ("a.pkl", b"", InputError, r"ends in \.json"),
        ("a.json", b"{", DataFormatError, "not JSON"),
        ("a.json", b"\xff\xfe\x00", DataFormatError, "not text in UTF-16"),
        ("a.json", b"[" * 100000, DataFormatError, "not JSON"),
        ("a.jsonl", b"{}\n{", DataFormatError, "line 2: not JSON"),
        ("a.npz", b"PK", DataFormatError, "not a complete npz"),
        ("a.csv", b"frame,hand\n", DataFormatError, "column joint is missing"),
        ("a.csv", HEADER + b"0,up,0,1,1,1,1,1\n", DataFormatError, "line 2: hand: left or"),
        ("a.csv", HEADER + b"0,left,0,1,1,1,1,1\n", DataFormatError, "21 joints expected, got 1"),
        ("a.csv", HEADER + b"0,left,21,1,1,1,1,1\n", DataFormatError, "0 to 20 expected"),
    ],
)  # fmt: skip
def test_unreadable_files(name, content, error, message, tmp_path):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(error, match=message):
        read_hands(tmp_path / name, SAMPLE.camera)


def test_arrays_of_another_kind(tmp_path):
    np.savez(tmp_path / "a.npz", allow_pickle=False, x=np.zeros(3))
    with pytest.raises(DataFormatError, match="found an object with x; expected joints_px"):
        read_hands(tmp_path / "a.npz", SAMPLE.camera)
    np.savez(
        tmp_path / "b.npz", allow_pickle=False, joints_px=np.zeros((3, 2, 20, 2)), canonical=np.zeros((3, 2, 20, 3))
    )
    with pytest.raises(DataFormatError, match=r"joints_px: shape \(N, 2, 21, 2\) expected, got \(3, 2, 20, 2\)"):
        read_hands(tmp_path / "b.npz", SAMPLE.camera)


def test_a_bone_length_must_be_a_length():
    foreign = from_record(formats.mediapipe(SAMPLE), SAMPLE.camera)
    with pytest.raises(InputError, match="hand length must be a positive"):
        place_hands(foreign, SAMPLE.camera, 0.0)


def test_the_wrist_keeps_its_distance():
    foreign = from_record(formats.mediapipe(SAMPLE), SAMPLE.camera)
    (pose,) = place_hands(foreign, SAMPLE.camera, 0.0734)
    assert pose.left.joints_m is not None
    assert np.linalg.norm(pose.left.joints_m[WRIST] - pose.left.joints_m[ROOT]) == pytest.approx(0.0734, abs=1e-12)


@pytest.mark.parametrize(
    "words", [*WITH_SHAPES.values(), *IN_THE_PICTURE.values()], ids=[*WITH_SHAPES, *IN_THE_PICTURE]
)
def test_mutations_end_in_one_line_or_a_result(words, tmp_path):
    """Any value of a result replaced by any other: read, or refused by name; never another error."""
    rng = np.random.default_rng(0)
    record = plain(words(SAMPLE))
    others = [None, True, -1, 1e308, float("nan"), "x", [], {}, [[]], [1, [2]], {"x": None}, 10**30]
    for _ in range(50):
        changed = json.loads(json.dumps(record))
        at, key = changed, None
        while isinstance(at, dict | list) and len(at) and (key is None or rng.random() < 0.8):
            parent = at
            key = rng.choice(list(at)) if isinstance(at, dict) else int(rng.integers(len(at)))
            at = at[key]
        parent[key] = others[rng.integers(len(others))]
        (tmp_path / "r.json").write_text(json.dumps(changed))
        try:
            place_hands(
                read_hands(tmp_path / "r.json", SAMPLE.camera), SAMPLE.camera, LENGTH_M, poses=[our_pose(SAMPLE)]
            )
        except (DataFormatError, InputError) as error:
            assert "\n" not in str(error)
