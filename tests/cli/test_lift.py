"""`twohands lift` from the outside: every output, assumptions, and bad options."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from tests.lifting import formats
from tests.oracles import drawn_hands

from twohands.cli.main import main
from twohands.inference.records import from_dict

SAMPLE = drawn_hands(1)
ROOT_RANGES = np.linalg.norm(SAMPLE.joints_m[:, 9], axis=-1)
BONE_CM = 10.0


@pytest.fixture
def folder(tmp_path) -> Path:
    """A tracker's file of two frames, its camera, and nothing else."""
    camera = SAMPLE.camera
    values = {"fx": camera.fx, "fy": camera.fy, "cx": camera.cx, "cy": camera.cy}
    (tmp_path / "camera.json").write_text(json.dumps(values | {"width": camera.width, "height": camera.height}))
    frames = [{"time_s": i / 30, "file": f"{i}.png", "result": formats.mediapipe(SAMPLE)} for i in range(2)]
    (tmp_path / "hands_mp.json").write_text(json.dumps(frames))
    return tmp_path


def lift(folder: Path, *arguments: object, name: str = "hands_mp.json") -> int:
    return main(["lift", str(folder / name), "--camera", str(folder / "camera.json"), *map(str, arguments)])


def test_json_npz_and_csv_hold_the_same_metres(folder, capsys):
    for ending in ("json", "npz", "csv"):
        assert lift(folder, "--bone-length", BONE_CM, "--out", folder / f"out.{ending}") == 0
    captured = capsys.readouterr()
    assert captured.err == "" and captured.out.count("2 left, 2 right hands placed") == 3
    record = json.loads((folder / "out.json").read_text())
    assert record["weights"] == "MediaPipe Hands" and record["frames"][1]["file"] == "1.png"
    poses = from_dict(record)
    with np.load(folder / "out.npz") as arrays:
        np.testing.assert_allclose(arrays["range_m"], [ROOT_RANGES] * 2, atol=1e-9)
        np.testing.assert_allclose(arrays["joints_m"][1], SAMPLE.joints_m, atol=1e-9)
        assert arrays["files"].tolist() == ["0.png", "1.png"] and arrays["time_s"].tolist() == [0, 1 / 30]
        np.testing.assert_allclose(arrays["between_hands_m"][1], np.diff(SAMPLE.joints_m[:, 9], axis=0)[0], atol=1e-9)
        assert arrays["overlap"][1] == pytest.approx(poses[1].overlap, abs=1e-4)
        assert (arrays["scale_source"] == "typed").all() and (arrays["intrinsics_source"] == "file").all()
    np.testing.assert_allclose([hand.range_m for hand in poses[1].hands], ROOT_RANGES, atol=1e-6)
    rows = list(csv.DictReader((folder / "out.csv").read_text().splitlines()))
    assert len(rows) == 2 * 2 * 21 and rows[9]["name"] == "middle_1"
    np.testing.assert_allclose(
        [float(rows[9][axis]) for axis in ("x_m", "y_m", "z_m")], SAMPLE.joints_m[0, 9], atol=1e-9
    )
    assert (rows[0]["scale_source"], rows[0]["intrinsics_source"]) == ("typed", "file")
    between = [float(rows[0][f"between_hands_{axis}_m"]) for axis in "xyz"]
    np.testing.assert_allclose(between, SAMPLE.joints_m[1, 9] - SAMPLE.joints_m[0, 9], atol=1e-9)
    assert float(rows[0]["overlap"]) == pytest.approx(poses[0].overlap, abs=1e-4)


def test_the_hand_length_is_that_of_track(folder, capsys):
    """MediaPipe's own bone is 0.9 of it; what is assumed is said."""
    assert lift(folder, "--hand-length", BONE_CM / 0.9, "--out", folder / "a.npz") == 0
    assert "wrist and middle knuckle taken to be 10.0 cm apart, 0.90 of the hand length" in capsys.readouterr().err
    with np.load(folder / "a.npz") as arrays:
        np.testing.assert_allclose(arrays["range_m"], [ROOT_RANGES] * 2, atol=1e-9)
        assert float(arrays["hand_length_m"]) == pytest.approx(0.1)
    assert lift(folder, "--out", folder / "b.npz") == 0
    assert "assuming 10 cm" in capsys.readouterr().err


def test_a_result_is_lifted_again_with_another_camera(folder):
    assert lift(folder, "--bone-length", BONE_CM, "--out", folder / "out.json") == 0
    wide = ["--fov", "70", "--size", "240", "135"]
    arguments = ["lift", str(folder / "out.json"), *wide, "--bone-length", "10", "--out", str(folder / "wide.json")]
    assert main(arguments) == 0
    first, again = (from_dict(json.loads((folder / name).read_text()))[0] for name in ("out.json", "wide.json"))
    assert first.left.range_m is not None and again.left.range_m is not None
    assert again.camera.fx == pytest.approx(120 / np.tan(np.radians(35)), abs=1e-5)
    # Weak perspective says range ~ focal length; the hand's depth bends that a little.
    assert again.left.range_m / first.left.range_m == pytest.approx(again.camera.fx / first.camera.fx, rel=0.1)


def test_smoothing_takes_the_frames_for_a_video(folder):
    frames = [{"time_s": i / 30, "result": formats.mediapipe(drawn_hands(1))} for i in range(6)]
    frames[4]["result"] = {"hand_landmarks": [], "hand_world_landmarks": [], "handedness": []}
    (folder / "v.json").write_text(json.dumps(frames))
    assert lift(folder, "--bone-length", 10, "--smooth", "--out", folder / "v.npz", name="v.json") == 0
    with np.load(folder / "v.npz") as arrays:
        np.testing.assert_allclose(arrays["range_m"][:4], [ROOT_RANGES] * 4, atol=1e-9)


def test_openpose_takes_shapes_from_our_results(folder, capsys):
    (folder / "op.json").write_text(json.dumps(formats.openpose(SAMPLE)))
    assert lift(folder, "--hand-length", 10, "--out", folder / "o.json", name="op.json") == 2
    assert "knows the picture alone" in capsys.readouterr().err and not (folder / "o.json").exists()
    assert lift(folder, "--bone-length", 10, "--out", folder / "ours.json") == 0
    options = ["--pose", folder / "ours.json", "--out", folder / "o.json"]
    assert lift(folder, "--hand-length", 10, *options, name="op.json") == 0
    assert from_dict(json.loads((folder / "o.json").read_text()))[0].right.valid


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--out", "{}/x.txt"], "an ending .json, .npz, .csv expected"),
        (["--out", "{}/hands_mp.json"], "exists; choose another --out"),
        (["--out", "{}/x.json", "--hand-length", "0"], "--hand-length must be a positive"),
        (["--out", "{}/x.json", "--bone-length", "nan"], "--bone-length must be a positive"),
        (["--out", "{}/x.json", "--bone-length", "9", "--hand-length", "9"], "not both"),
        (["--out", "{}/x.json", "--fov", "60"], "give --camera or --fov, not both"),
        (["--out", "{}/x.json", "--kind", "mano"], "no mano's results; found a list of 2"),
        (["--out", "{}/x.json", "--pose", "{}/nothing.json"], "no such hands.json"),
        (["--out", "{}/x.json", "--pose", "{}/camera.json"], "version 1 expected"),
    ],
)
def test_a_bad_option_is_one_line_exit_2_and_nothing_written(folder, arguments, message, capfd):
    before = sorted(path.name for path in folder.iterdir())
    assert lift(folder, *[word.format(folder) for word in arguments]) == 2
    captured = capfd.readouterr()
    assert captured.err.splitlines()[-1].startswith("twohands: error: ") and message in captured.err
    assert captured.out == "" and sorted(path.name for path in folder.iterdir()) == before


def test_no_camera(folder, capsys):
    assert main(["lift", str(folder / "hands_mp.json"), "--out", str(folder / "x.json")]) == 2
    assert "give --camera FILE" in capsys.readouterr().err
    assert main(["lift", str(folder / "hands_mp.json"), "--out", str(folder / "x.json"), "--fov", "60"]) == 2
    assert "--size WIDTH HEIGHT" in capsys.readouterr().err
