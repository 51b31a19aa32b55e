"""Other systems' predictions: what is given is kept, what follows is filled in, what is wrong is named."""

import contextlib
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.evaluation.test_protocols import SAMPLES, perfect_pose, predictions_for

from twohands.errors import DataFormatError, InputError
from twohands.evaluation.completion import complete_hand, hand_lengths_m, unit_pose
from twohands.evaluation.importing import import_predictions, read_foreign
from twohands.evaluation.predictions import check_predictions, load_predictions, save_predictions
from twohands.evaluation.protocols import evaluate
from twohands.geometry.canonical import canonical_from_camera
from twohands.skeleton import LEFT, ROOT, SIDES, WRIST


def truth_as_json(*fields: str) -> dict[str, Any]:
    images = []
    for sample in SAMPLES:
        image: dict[str, Any] = {"source": sample.source}
        for side, name in enumerate(SIDES):
            values = {
                "joints_m": sample.joints_m[side],
                "joints_px": sample.joints_px[side],
                "canonical": 0.07 * np.asarray(canonical_from_camera(sample.joints_m[side]).joints) + 3,
            }
            said = {key: values[key].tolist() for key in fields}
            image[name] = said if sample.present[side] else None
        images.append(image)
    return {"version": 1, "system": "theirs", "images": images}


def write(path: Path, content: Any) -> Path:
    path.write_text(json.dumps(content))
    return path


def imported(path: Path):
    return import_predictions(read_foreign(path), SAMPLES, dataset="made")


@pytest.mark.parametrize("fields", [("joints_m",), ("joints_px", "canonical"), ("joints_m", "joints_px", "canonical")])
def test_the_truth_scores_perfectly(tmp_path: Path, fields: tuple[str, ...]) -> None:
    """From metres alone, or from pixels and a pose in any unit about any origin; the order of images is free."""
    content = truth_as_json(*fields)
    content["images"].reverse()
    predictions = imported(write(tmp_path / "p.json", content))
    save_predictions(tmp_path / "p.npz", predictions)
    report = evaluate(load_predictions(tmp_path / "p.npz"), SAMPLES)
    for key in ("cs_mpjpe", "error_2d_mean", "error_3d_spherical_mean", "missed", "false", "mrrpe"):
        assert report[key].value == pytest.approx(0, abs=1e-6), key
    assert report["box_accuracy"].value == 1 and report.weights == "theirs"


def test_npz(tmp_path: Path) -> None:
    present = np.array([sample.present for sample in SAMPLES])
    arrays = {
        "version": 1,
        "system": "theirs",
        "sources": [sample.source for sample in SAMPLES],
        "present": present,
        "joints_m": np.array([sample.joints_m for sample in SAMPLES]),
        "joints_px": np.full((4, 2, 21, 2), np.nan),  # not predicted
        "score": np.full((4, 2), 0.5),
    }
    np.savez(tmp_path / "p.npz", **arrays)
    predictions = imported(tmp_path / "p.npz")
    assert evaluate(predictions, SAMPLES)["cs_mpjpe"].value == pytest.approx(0, abs=1e-9)
    np.testing.assert_array_equal(predictions.score[present], 0.5)
    np.savez(tmp_path / "p.npz", **arrays | {"joints_m": arrays["joints_m"][:3]})
    with pytest.raises(DataFormatError, match=r"joints_m must hold numbers of shape \(4, 2, 21, 3\)"):
        imported(tmp_path / "p.npz")
    for name, values, message in (
        ("present", present.astype(float), "present must hold true or false"),
        ("present", np.stack([present, present], axis=-1), "present must hold true or false"),
        ("score", np.full((4, 2), "high"), "score must hold numbers"),
        ("score", np.full((4, 2, 2), 0.5), "score must hold numbers"),
        ("version", "one", "version 1, got 'one'"),
    ):
        np.savez(tmp_path / "p.npz", **arrays | {name: values})
        with pytest.raises(DataFormatError, match=message):
            imported(tmp_path / "p.npz")
    np.savez(tmp_path / "p.npz", **arrays | {"version": np.array([1]), "present": present.astype(np.uint8)})
    assert imported(tmp_path / "p.npz").present.tolist() == present.tolist()
    np.savez(tmp_path / "p.npz", **arrays | {"version": 7})
    with pytest.raises(DataFormatError, match="version 1, got 7"):
        imported(tmp_path / "p.npz")
    np.savez(tmp_path / "p.npz", version=1, sources=arrays["sources"])
    with pytest.raises(DataFormatError, match="lacks the array 'present'"):
        imported(tmp_path / "p.npz")
    save_predictions(tmp_path / "ours.npz", predictions_for())
    with pytest.raises(InputError, match="is a predictions file of twohands already"):
        read_foreign(tmp_path / "ours.npz")


def test_only_joints_in_the_picture(tmp_path: Path) -> None:
    """Scored in 2D; nothing else is made up."""
    report = evaluate(imported(write(tmp_path / "p.json", truth_as_json("joints_px"))), SAMPLES)
    assert report["error_2d_mean"].value == pytest.approx(0, abs=1e-9)
    assert report["error_3d_spherical_mean"].count == 0 and report["cs_mpjpe"].count == 0
    assert report["invalid"].value == 5 and report["range_7cm"].value == 0


def broken(change) -> dict[str, Any]:
    content = truth_as_json("joints_m")
    change(content)
    return content


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c.update(version=2), "version 1, got 2"),
        (lambda c: c.pop("version"), "version 1, got None"),
        (lambda c: c.update(images=[]), "holds no predictions"),
        (lambda c: c.pop("images"), "expected an object"),
        (lambda c: c["images"].pop(1), "image '00001' is missing"),
        (lambda c: c["images"].append(c["images"][0]), "image '00000' is there twice"),
        (lambda c: c["images"].append({"source": "zz", "left": None, "right": None}), "'zz': not in the dataset"),
        (lambda c: c["images"][0].pop("source"), "entry 0 of images has no 'source'"),
        (lambda c: c["images"][2].pop("right"), "image '00002' says nothing about the right hand"),
        (lambda c: c["images"][0]["left"].update(joint=1), "unknown 'joint'"),
        (lambda c: c["images"][0]["left"].update(joints_m=[[0, 0, 1]] * 20), r"'00000', left hand: joints_m: shape"),
        (
            lambda c: c["images"][0]["left"]["joints_m"][3].__setitem__(0, float("nan")),
            "1 of 63 numbers are not finite",
        ),
        (
            lambda c: c["images"][0]["left"]["joints_m"][3].__setitem__(0, 10**400),
            r"left hand: joints_m: numbers of shape \(21, 3\) expected",
        ),
        (lambda c: c["images"][0]["left"].update(joints_m="far"), "left hand: joints_m: numbers of shape"),
        *(
            (lambda c, score=score: c["images"][0]["left"].update(score=score), "score: a number from 0 to 1 expected")
            for score in (float("nan"), 5, -0.1, "0.5", "abc", True, [0.5], {"a": 1})
        ),
        (lambda c: c["images"][0]["left"].update(box_px=[10, 10, 0, 20]), "box_px: u0 <= u1 and v0 <= v1 expected"),
        (lambda c: c["images"][0].update(left={}), "needs at least one of"),
        (lambda c: c["images"][0].update(left=3), "an object or null expected"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, change, message: str) -> None:
    path = write(tmp_path / "p.json", broken(change))
    with pytest.raises(DataFormatError, match=message) as caught:
        imported(path)
    assert "p.json" in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("value", [-1e308, 1e9, 1e-308, 0.0])
@pytest.mark.parametrize("field", ["joints_m", "joints_px", "canonical"])
def test_extreme_numbers_are_refused_or_taken_without_numpys_warnings(tmp_path: Path, field: str, value: float) -> None:
    """So far from the root joint: the wrist, a fingertip, the whole hand."""
    for joint in (WRIST, 20, slice(None)):
        content = truth_as_json(field, *["joints_px"] * (field == "canonical"))
        joints = np.array(content["images"][0]["left"][field])
        joints[joint] = joints[ROOT] + value
        content["images"][0]["left"][field] = joints.tolist()
        with contextlib.suppress(DataFormatError):
            imported(write(tmp_path / "p.json", content))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("depth_m", [1e-300, 1e-150, 5e-324])
def test_a_joint_next_to_the_pinhole_is_far_outside_the_picture(tmp_path: Path, depth_m: float) -> None:
    content = truth_as_json("joints_m")
    content["images"][0]["left"]["joints_m"][20][2] = depth_m
    assert imported(write(tmp_path / "p.json", content)).present[0, LEFT]


def test_absurd_numbers_are_named(tmp_path: Path) -> None:
    content = truth_as_json("joints_px")
    content["images"][0]["left"]["joints_px"][7][0] = -1e308
    with pytest.raises(DataFormatError, match=r"'00000', left hand: joints_px: a number of 1e\+308; at most 1e\+09"):
        imported(write(tmp_path / "p.json", content))


def test_files_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_foreign(tmp_path / "p.json")
    for name, content in (("p.json", "{"), ("p.json", "[" * 200_000), ("p.npz", "PK")):
        (tmp_path / name).write_text(content)
        with pytest.raises(DataFormatError, match="not a"):
            read_foreign(tmp_path / name)
    (tmp_path / "p.csv").write_text("")
    with pytest.raises(InputError, match=r"must be .json or .npz"):
        read_foreign(tmp_path / "p.csv")


@pytest.mark.parametrize("read", [read_foreign, load_predictions])
def test_a_damaged_npz_is_named_whatever_is_damaged(tmp_path: Path, read) -> None:
    """Named case: damage within a compressed array came out as zlib's own error."""
    save_predictions(tmp_path / "whole.npz", predictions_for())
    data = (tmp_path / "whole.npz").read_bytes()
    if read is read_foreign:
        arrays = {name: np.tile(np.arange(500.0), 4) for name in ("version", "sources", "present")}
        np.savez_compressed(tmp_path / "whole.npz", **arrays)
        data = (tmp_path / "whole.npz").read_bytes()
    rng = np.random.default_rng(0)
    for _ in range(60):
        damaged = bytearray(data)
        for at in rng.integers(0, len(data), 8):
            damaged[at] ^= int(rng.integers(1, 256))
        (tmp_path / "p.npz").write_bytes(damaged)
        with contextlib.suppress(DataFormatError):
            read(tmp_path / "p.npz")


class TestChecks:
    """What a predictions file must not hold, whoever wrote it."""

    def test_empty(self) -> None:
        with pytest.raises(DataFormatError, match="holds no predictions"):
            predictions_for(samples=[])

    def test_an_image_twice(self) -> None:
        with pytest.raises(DataFormatError, match="image '00000' is there twice"):
            predictions_for(samples=[SAMPLES[0], SAMPLES[0]])

    @pytest.mark.parametrize("value", [np.nan, np.inf])
    def test_half_a_hand(self, tmp_path: Path, value: float) -> None:
        predictions = predictions_for()
        joints_px = predictions.joints_px.copy()
        joints_px[2, LEFT, 4] = value
        save_predictions(tmp_path / "p.npz", replace(predictions, joints_px=joints_px))
        with pytest.raises(DataFormatError, match="'00002', left hand: joints_px that are not all finite"):
            load_predictions(tmp_path / "p.npz")

    def test_valid_without_joints(self) -> None:
        predictions = predictions_for()
        with pytest.raises(DataFormatError, match=r"'00000', left hand: no joints_m though it is valid \(4 more\)"):
            check_predictions(replace(predictions, joints_m=np.full_like(predictions.joints_m, np.nan)), "p")

    def test_numbers_of_an_absent_hand_do_not_matter(self) -> None:
        predictions = predictions_for()
        joints_px = predictions.joints_px.copy()
        joints_px[3, LEFT, 4] = 1.0
        check_predictions(replace(predictions, joints_px=joints_px), "p")


def test_completion_uses_the_hand_length_it_is_given() -> None:
    """Twice the length, twice the distance; the length of the pose itself is nobody's business."""
    sample = SAMPLES[0]
    pose = np.asarray(canonical_from_camera(sample.joints_m[LEFT]).joints)
    for factor in (1.0, 2.0):
        hand = complete_hand(sample.camera, factor * 0.10, joints_px=sample.joints_px[LEFT], canonical=5 * pose)
        assert hand.joints_m is not None
        np.testing.assert_allclose(hand.joints_m, factor * sample.joints_m[LEFT], atol=1e-9)
    with pytest.raises(DataFormatError, match="no scale"):
        unit_pose(np.zeros((21, 3)))


def test_behind_the_camera_is_not_in_the_picture() -> None:
    hand = complete_hand(SAMPLES[0].camera, 0.1, joints_m=-SAMPLES[0].joints_m[LEFT])
    assert hand.joints_px is None and hand.box_px is None and hand.valid


def test_hand_lengths() -> None:
    """10 and 8 cm; a hand without labels takes the other's, a picture without hands the fallback."""
    np.testing.assert_allclose(hand_lengths_m(SAMPLES[0]), [0.10, 0.08])
    np.testing.assert_allclose(hand_lengths_m(SAMPLES[1]), [0.10, 0.10])
    np.testing.assert_allclose(hand_lengths_m(SAMPLES[3], fallback=0.09), [0.09, 0.09])
    assert np.linalg.norm(SAMPLES[0].joints_m[LEFT, WRIST] - SAMPLES[0].joints_m[LEFT, ROOT]) == pytest.approx(0.1)


def test_a_pose_can_be_had_back() -> None:
    pose = predictions_for().pose(0, SAMPLES[0].camera)
    np.testing.assert_array_equal(pose.left.joints_m, perfect_pose(SAMPLES[0]).left.joints_m)
    assert pose.left.range_m == pytest.approx(np.linalg.norm(SAMPLES[0].joints_m[LEFT, ROOT]))
    assert pose.masks is not None and not predictions_for().pose(3, SAMPLES[3].camera).left.present


def moved(content: dict[str, Any], change: Any, key: str = "joints_m") -> dict[str, Any]:
    """The same file in another frame."""
    for image in content["images"]:
        for name in SIDES:
            if image[name] is not None:
                image[name][key] = change(np.array(image[name][key])).tolist()
    return content


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda joints: joints * [1, -1, -1], "behind the camera"),
        (lambda joints: -joints, "behind the camera"),
        (lambda joints: joints - joints[ROOT], "relative to the root joint"),
        (lambda joints: joints - joints[WRIST], "relative to the wrist"),
        (lambda joints: joints * 1000, "looks like millimetres"),
        (lambda joints: joints * 100, "looks like centimetres"),
        (lambda joints: joints * [1, -1, 1], "y points up"),
        (lambda joints: joints * [-1, 1, 1], "x points left"),
        (lambda joints: joints * [1, 1, -1], "behind the camera"),
        (lambda joints: joints - joints.mean(axis=0), "or relative to a joint"),
        (lambda joints: joints / 0.0254, "looks like centimetres"),
        (lambda joints: joints * 10, "in another unit|looks like another unit"),
        (lambda joints: joints[:, [1, 0, 2]], "x and y are exchanged"),
    ],
)
def test_metres_in_another_frame_are_refused_and_the_frame_is_named(tmp_path: Path, change: Any, message: str) -> None:
    """Behind the camera they would score the best ranges of all."""
    with pytest.raises(DataFormatError, match=message):
        imported(write(tmp_path / "p.json", moved(truth_as_json("joints_m"), change)))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda joints: joints / [SAMPLES[0].camera.width, SAMPLES[0].camera.height], "fractions of the picture"),
        (lambda joints: joints[:, ::-1], "rows and columns are exchanged"),
        (lambda joints: joints * [1, -1] + [0, SAMPLES[0].camera.height], "lower edge"),
        (lambda joints: joints * [-1, 1] + [SAMPLES[0].camera.width, 0], "mirrored"),
        (lambda joints: 2 * joints / [SAMPLES[0].camera.width, SAMPLES[0].camera.height] - 1, "from -1 to 1"),
        (lambda joints: joints * 2, "another size, 2 times as wide and 2 times as high"),
        (lambda joints: joints * [256 / SAMPLES[0].camera.width, 256 / SAMPLES[0].camera.height], "another size"),
    ],
)
def test_pixels_in_another_order_or_unit_are_refused(tmp_path: Path, change: Any, message: str) -> None:
    content = moved(truth_as_json("joints_px", "canonical"), change, "joints_px")
    with pytest.raises(DataFormatError, match=message):
        imported(write(tmp_path / "p.json", content))


def test_bad_predictions_in_the_right_frame_are_no_other_frame(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    content = moved(truth_as_json("joints_m"), lambda joints: joints + rng.normal(0, 0.05, 3) * [1, 1, 0])
    assert len(imported(write(tmp_path / "p.json", content))) == len(SAMPLES)


@pytest.mark.parametrize(("score", "expected"), [(1.0000001, 1.0), (-1e-7, 0.0), (float(np.float32(0.3)), 0.3)])
def test_a_score_of_float32_is_taken_as_what_it_was_rounded_from(tmp_path: Path, score: float, expected: float) -> None:
    content = truth_as_json("joints_m")
    for image in content["images"]:
        for name in SIDES:
            if image[name] is not None:
                image[name]["score"] = score
    found = imported(write(tmp_path / "p.json", content))
    np.testing.assert_allclose(found.score[found.present], expected, atol=1e-7)
    assert ((found.score[found.present] >= 0) & (found.score[found.present] <= 1)).all()


@pytest.mark.parametrize("place", ["file", "image", "twice"])
def test_no_key_is_ignored(tmp_path: Path, place: str) -> None:
    content = truth_as_json("joints_m")
    if place == "file":
        content["units"] = "mm"
    elif place == "image":
        content["images"][0]["camera"] = {}
    text = json.dumps(content)
    if place == "twice":
        text = text.replace('"version": 1', '"version": 1, "version": 1')
    (tmp_path / "p.json").write_text(text)
    with pytest.raises(DataFormatError, match={"file": "'units'", "image": "'camera'", "twice": "twice"}[place]):
        imported(tmp_path / "p.json")


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_byte_order_marks_of_predictions_are_read(tmp_path: Path, encoding: str) -> None:
    (tmp_path / "p.json").write_bytes(json.dumps(truth_as_json("joints_m")).encode(encoding))
    assert len(imported(tmp_path / "p.json")) == len(SAMPLES)
