"""`twohands track` and `twohands demo` from the outside: files, table, JSON, assumptions, every kind of bad input."""

import json
import os
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from tests.oracles import write_tiny_weights

from twohands.cli import demo, track
from twohands.cli.main import main
from twohands.errors import InputError
from twohands.inference.known import assumed_camera
from twohands.inference.records import from_dict
from twohands.inference.weights import preset_names, read_card

pytest.importorskip("matplotlib")
SIZE = (160, 96)


@pytest.fixture(scope="session")
def weights(tmp_path_factory) -> str:
    return str(write_tiny_weights(tmp_path_factory.mktemp("weights") / "tiny"))


@pytest.fixture
def picture(tmp_path) -> Path:
    return write_picture(tmp_path / "hands.png")


def write_picture(path: Path, size=SIZE) -> Path:
    pixels = np.random.default_rng(0).integers(0, 256, (size[1], size[0], 3), dtype=np.uint8)
    assert cv2.imwrite(str(path), pixels)
    return path


def run_track(*arguments: object) -> int:
    return main(["track", *map(str, arguments)])


def files_below(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


def test_one_image(picture, weights, tmp_path, capsys):
    out = tmp_path / "out"
    assert run_track(picture, "--out", out, "--weights", weights, "--fov", 90, "--hand-length", 9) == 0
    assert files_below(out) == ["hands.json", "hands_overlay.png", "hands_views.png"]
    captured = capsys.readouterr()
    assert captured.err == "", "nothing was assumed"
    record = json.loads((out / "hands.json").read_text())
    assert (record["version"], record["source"], record["weights"]) == (1, str(picture), "tiny")
    assert (record["hand_length_m"], record["frames"][0]["file"]) == (0.09, "hands.png")
    assert record["config"] == json.loads(json.dumps(read_card(Path(weights)).settings()))
    camera = record["frames"][0]["camera"]
    assert camera == {"fx": 80.0, "fy": 80.0, "cx": 80.0, "cy": 48.0, "width": 160, "height": 96}
    left = record["frames"][0]["hands"]["left"]
    rows = [line.split("│") for line in captured.out.splitlines() if "left" in line]
    cells = [cell.strip() for cell in rows[0]]
    assert cells[1:] == [
        "hands.png", "left", "yes", f"{100 * left['range_m']:.1f}", f"{left['theta_deg']:.1f}",
        f"{left['phi_deg']:.1f}", f"{left['score']:.2f}", "",
    ]  # fmt: skip
    assert f"written to {out}" in captured.out
    overlay = cv2.imread(str(out / "hands_overlay.png"))
    assert overlay.shape == (96, 160, 3) and (overlay != cv2.imread(str(picture))).any()
    assert cv2.imread(str(out / "hands_views.png")).shape[1] > 1500


def test_json_prints_the_file_and_nothing_else(picture, weights, tmp_path, capsys):
    assert run_track(picture, "--out", tmp_path / "out", "--weights", weights, "--json") == 0
    printed = capsys.readouterr().out
    assert json.loads(printed) == json.loads((tmp_path / "out" / "hands.json").read_text())
    poses = from_dict(json.loads(printed))
    assert poses[0].left.valid and poses[0].right.valid


def test_assumptions_are_printed_on_stderr(picture, weights, tmp_path, capsys):
    assert run_track(picture, "--out", tmp_path / "out", "--weights", weights, "--json") == 0
    messages = capsys.readouterr().err
    assert "assuming a field of view of 60 degrees along the longer side" in messages
    assert "assuming 10 cm from wrist to middle knuckle" in messages
    focal = json.loads((tmp_path / "out" / "hands.json").read_text())["frames"][0]["camera"]["fx"]
    assert focal == pytest.approx(80 / np.tan(np.radians(30)), abs=1e-6)


def test_ranges_scale_with_the_hand_length_given_in_cm(picture, weights, tmp_path):
    ranges = {}
    for length in (8, 10):
        out = tmp_path / str(length)
        assert run_track(picture, "--out", out, "--weights", weights, "--fov", 80, "--hand-length", length) == 0
        frame = json.loads((out / "hands.json").read_text())["frames"][0]
        left = frame["hands"]["left"]
        ranges[length] = left["range_m"]
        wrist, root = np.array(left["joints_m"])[[0, 9]]
        assert np.linalg.norm(wrist - root) == pytest.approx(length / 100, abs=2e-6)
    assert ranges[8] / ranges[10] == pytest.approx(0.8, rel=1e-4)


@pytest.mark.parametrize(
    ("options", "likely"),
    [
        (("--fov", 60, "--hand-length", 4.3), "inches"),
        (("--fov", 60, "--hand-length", 110), "millimetres"),
        (("--fov", 1.2, "--hand-length", 10), "radians"),
        (("--fov", 179.9, "--hand-length", 10), "fisheye"),
        (("--fov", 60, "--hand-length", 10), None),
    ],
)
def test_what_is_hard_to_believe_is_one_line_that_names_the_likely_unit(
    picture, weights, tmp_path, capsys, options, likely
):
    assert run_track(picture, "--out", tmp_path / "o", "--weights", weights, *options) == 0
    lines = capsys.readouterr().err.splitlines()
    said = [line for line in lines if "a hand farther" not in line and "a hand nearer" not in line]  # also of the range
    assert all(line.startswith("twohands: warning: ") for line in said)
    assert len(said) == (likely is not None) and (likely or "") in "".join(said)


def test_an_assumed_camera_has_one_focal_length_however_it_is_held():
    lying, standing = assumed_camera(640, 480), assumed_camera(480, 640)
    assert lying.fx == lying.fy == standing.fx == standing.fy == pytest.approx(320 * 3**0.5)
    assert (standing.cx, standing.cy, standing.width, standing.height) == (240, 320, 480, 640)


def test_a_camera_file_at_another_size_is_scaled(picture, weights, tmp_path):
    (tmp_path / "c.json").write_text('{"fx": 400, "fy": 410, "cx": 330, "cy": 200, "width": 640, "height": 384}')
    assert run_track(picture, "--out", tmp_path / "o", "--weights", weights, "--camera", tmp_path / "c.json") == 0
    camera = json.loads((tmp_path / "o" / "hands.json").read_text())["frames"][0]["camera"]
    assert camera == {"fx": 100.0, "fy": 102.5, "cx": 82.5, "cy": 50.0, "width": 160, "height": 96}


def test_no_hand_is_a_result(picture, tmp_path, capsys):
    weights = write_tiny_weights(tmp_path / "blind", energy_bias=-3.0)
    assert run_track(picture, "--out", tmp_path / "out", "--weights", weights) == 0
    hands = json.loads((tmp_path / "out" / "hands.json").read_text())["frames"][0]["hands"]
    assert [hands[side]["present"] for side in ("left", "right")] == [False, False]
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "out" / "hands_views.png"))[0, 0], 255)
    assert capsys.readouterr().out.count(" no ") == 2


def test_a_folder(weights, tmp_path, capsys):
    folder = tmp_path / "in"
    folder.mkdir()
    for name in ("f10.png", "f9.png", "same.png", "same.jpg"):
        write_picture(folder / name)
    (folder / "f2.png").write_bytes((folder / "f9.png").read_bytes()[:500])
    (folder / "notes.txt").touch()
    (folder / "100APPLE").mkdir()
    out = tmp_path / "out"
    assert run_track(folder, "--out", out, "--weights", weights, "--fov", 60, "--hand-length", 10) == 0
    captured = capsys.readouterr()
    assert "1 left out, no pictures that can be read: notes.txt" in captured.err
    assert "1 left out, folders are not looked into: 100APPLE" in captured.err
    assert "skipped" in captured.err and "f2.png" in captured.err and "1 of 5 images skipped" in captured.err
    names = ["f9", "f10", "same_jpg", "same_png"]
    assert files_below(out) == sorted(["hands.json", *(f"{n}_{k}.png" for n in names for k in ("overlay", "views"))])
    record = json.loads((out / "hands.json").read_text())
    assert [frame["index"] for frame in record["frames"]] == [1, 2, 3, 4], "positions among all files of the folder"


def test_a_pattern_names_pictures_in_natural_order(weights, tmp_path, capsys):
    for name in ("f10.png", "f9.png", "other.png"):
        write_picture(tmp_path / name)
    assert run_track(tmp_path / "f*.png", "--out", tmp_path / "out", "--weights", weights) == 0
    frames = json.loads((tmp_path / "out" / "hands.json").read_text())["frames"]
    assert [frame["file"] for frame in frames] == ["f9.png", "f10.png"]
    assert run_track(tmp_path / "g*.png", "--weights", weights) == 2
    assert "no file matches" in capsys.readouterr().err


@pytest.mark.parametrize("words", [["--estimator", "mediapipe"], ["--mirrored"], ["--stride", "2"], ["--no-smooth"]])
def test_what_is_for_videos_is_refused_for_pictures(words, picture, tmp_path, capsys):
    assert run_track(picture, "--out", tmp_path / "out", *words) == 2
    assert f"{words[0]} is for videos" in capsys.readouterr().err


def test_an_empty_input_is_not_this_folder(weights, tmp_path, monkeypatch, capsys):
    """As `twohands track "$PICTURE"` gives it where the variable is not set."""
    monkeypatch.chdir(tmp_path)
    assert run_track("", "--weights", weights) == 2
    assert capsys.readouterr().err.startswith("twohands: error: INPUT is empty")
    assert not list(tmp_path.iterdir())


def test_a_folder_of_broken_images_is_an_error(weights, tmp_path, capsys):
    folder = tmp_path / "in"
    folder.mkdir()
    for name in ("a.png", "b.jpg"):
        (folder / name).write_bytes(b"nothing")
    assert run_track(folder, "--out", tmp_path / "out", "--weights", weights) == 2
    assert "none of its 2 images can be used" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_an_interrupted_folder_keeps_what_is_done(weights, tmp_path, monkeypatch):
    folder, out = tmp_path / "pictures", tmp_path / "out"
    folder.mkdir()
    for name in ("1.png", "2.png", "3.png"):
        write_picture(folder / name)
    estimate = track.HandEstimator.estimate

    def interrupted(self, *args, index, **more):
        if index == 2:
            raise KeyboardInterrupt
        return estimate(self, *args, index=index, **more)

    monkeypatch.setattr(track.HandEstimator, "estimate", interrupted)
    assert run_track(folder, "--out", out, "--weights", weights) != 0
    record = json.loads((out / "hands.json").read_text())
    assert [frame["file"] for frame in record["frames"]] == ["1.png", "2.png"]


def test_a_picture_that_the_pipeline_refuses_is_left_out_of_a_folder(weights, tmp_path, monkeypatch, capsys):
    folder, out = tmp_path / "pictures", tmp_path / "out"
    folder.mkdir()
    for name in ("1.png", "2.png"):
        write_picture(folder / name)
    estimate = track.HandEstimator.estimate

    def strict(self, *args, index, **more):
        if index == 0:
            raise InputError("a box that spans half of all directions")
        return estimate(self, *args, index=index, **more)

    monkeypatch.setattr(track.HandEstimator, "estimate", strict)
    assert run_track(folder, "--out", out, "--weights", weights) == 0
    frames = json.loads((out / "hands.json").read_text())["frames"]
    assert [(frame["index"], frame["file"]) for frame in frames] == [(1, "2.png")]
    errors = capsys.readouterr().err
    assert "1.png: a box that spans half" in errors and "1 of 2 images skipped" in errors
    assert run_track(folder / "1.png", "--out", tmp_path / "one", "--weights", weights) == 2


def test_names_with_markup_formulas_and_foreign_bytes_are_just_names(weights, tmp_path, capsys):
    folder, out = tmp_path / "pictures", tmp_path / "out"
    folder.mkdir()
    names = ["cost $5_$ and.png", "photo[copy].png", os.fsdecode(b"caf\xe9.png")]
    written = write_picture(tmp_path / "p.png").read_bytes()
    for name in names:
        (folder / name).write_bytes(written)
    assert run_track(folder, "--out", out, "--weights", weights) == 0
    assert len(files_below(out)) == 7
    assert "photo[copy].png" in capsys.readouterr().out


def test_a_name_too_long_for_a_file_is_one_line(weights, capsys):
    assert run_track("a" * 300 + ".png", "--weights", weights) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_results_are_not_overwritten_unasked(picture, weights, tmp_path, capsys):
    out = tmp_path / "out"
    out.mkdir()
    (out / "thesis.txt").write_text("precious")
    assert run_track(picture, "--out", out, "--weights", weights) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert files_below(out) == ["thesis.txt"]
    assert run_track(picture, "--out", out, "--weights", weights, "--overwrite") == 0
    assert (out / "thesis.txt").read_text() == "precious"
    assert "hands.json" in files_below(out)


@pytest.mark.parametrize("spelling", ["in", "in/../in", "link"])
def test_results_do_not_go_among_the_images(spelling, weights, tmp_path, capsys):
    """a_overlay.png may be an image of the user's own."""
    folder = tmp_path / "in"
    folder.mkdir()
    (tmp_path / "link").symlink_to(folder)
    before = [write_picture(folder / name).read_bytes() for name in ("a.png", "a_overlay.png")]
    for more in ([], ["--overwrite"]):
        assert run_track(folder, "--out", tmp_path / spelling, "--weights", weights, *more) == 2
        error = capsys.readouterr().err
        assert error.count("\n") == 1 and "folder of the images" in error and "--overwrite" not in error
    assert files_below(folder) == ["a.png", "a_overlay.png"]
    assert [(folder / name).read_bytes() for name in files_below(folder)] == before
    assert run_track(folder, "--out", folder / "results", "--weights", weights) == 0


def test_the_default_folder_is_named_after_the_input(picture, weights, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run_track(picture, "--weights", weights) == 0
    assert (tmp_path / "out" / "track" / "hands" / "hands.json").is_file()
    assert run_track(picture, "--weights", weights) == 2, "a second run does not overwrite the first"


def damaged(kind: str, folder: Path) -> Path:
    """A file that is no usable picture."""
    good = write_picture(folder / "good.png").read_bytes()
    jpeg = cv2.imencode(".jpg", cv2.imread(str(folder / "good.png")))[1].tobytes()
    path = folder / f"{kind}.png"
    if kind == "1x1":
        return write_picture(path, (1, 1))
    if kind != "missing":
        contents = {"empty": b"", "text": b"this is not an image", "cut-png": good[:-20], "cut-jpeg": jpeg[:-20]}
        path.write_bytes(contents[kind])
    return path


@pytest.mark.parametrize("kind", ["missing", "empty", "text", "cut-png", "cut-jpeg", "1x1"])
def test_a_bad_image_is_one_line_exit_2_and_nothing_written(kind, weights, tmp_path, capfd):
    out = tmp_path / "out"
    assert run_track(damaged(kind, tmp_path), "--out", out, "--weights", weights) == 2
    captured = capfd.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("twohands: error: ") and captured.err.count("\n") == 1
    assert f"{kind}.png" in captured.err
    assert not out.exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--fov", "0"], "field of view"),
        (["--fov", "180"], "field of view"),
        (["--fov", "nan"], "field of view"),
        (["--hand-length", "0"], "--hand-length must be a positive number"),
        (["--hand-length", "nan"], "--hand-length must be a positive number"),
        (["--hand-length", "-9"], "--hand-length must be a positive number"),
        (["--camera", "missing.json"], "no such camera file"),
        (["--camera", "nan.json"], "fx must be a finite number"),
        (["--camera", "negative.json"], "fx must be positive"),
        (["--camera", "square.json"], "another aspect ratio"),
        (["--camera", "negative.json", "--fov", "60"], "not both"),
        (["--weights", "nowhere"], "'nowhere' not found"),
        (["--out", "file/below/it"], "is a file, not a folder"),
        (["--out", "file"], "is a file, not a folder"),
    ],
)
def test_a_bad_option_is_one_line_exit_2_and_nothing_written(
    arguments, message, picture, weights, tmp_path, monkeypatch, capfd
):
    monkeypatch.chdir(tmp_path)
    camera = '"fy": 80, "cx": 80, "cy": 48, "width": 160, "height": {}}}'
    (tmp_path / "nan.json").write_text('{"fx": NaN, ' + camera.format(96))
    (tmp_path / "negative.json").write_text('{"fx": -80, ' + camera.format(96))
    (tmp_path / "square.json").write_text('{"fx": 80, ' + camera.format(160))
    (tmp_path / "file").write_text("in the way")
    before = files_below(tmp_path)
    defaults = [] if "--weights" in arguments else ["--weights", weights]
    assert run_track(picture, *defaults, *arguments) == 2
    captured = capfd.readouterr()
    assert captured.out == ""
    assert message in captured.err and captured.err.count("\n") == 1
    assert files_below(tmp_path) == before


def test_a_folder_that_cannot_be_written_is_refused(picture, weights, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("twohands.cli.output.os.access", lambda *_: False)
    assert run_track(picture, "--out", tmp_path / "out", "--weights", weights) == 2
    assert "no permission" in capsys.readouterr().err


def test_a_folder_that_cannot_be_listed_is_refused(picture, weights, tmp_path, monkeypatch, capsys):
    def forbidden(path):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "iterdir", forbidden)
    assert run_track(picture, "--out", tmp_path, "--weights", weights) == 2
    assert "cannot be read" in capsys.readouterr().err


def test_a_failed_write_leaves_no_part_of_a_file(picture, weights, tmp_path, monkeypatch, capsys):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("twohands.cli.output.os.replace", full)
    assert run_track(picture, "--out", tmp_path / "out", "--weights", weights, "--fov", 60) == 2
    assert "No space left on device" in capsys.readouterr().err
    assert files_below(tmp_path / "out") == []


@pytest.mark.parametrize("kind", ["grey", "16 bit", "rgba"])
def test_other_kinds_of_pixels_are_converted(kind, weights, tmp_path):
    pixels = np.random.default_rng(0).integers(0, 256, (96, 160, 4), dtype=np.uint8)
    stored = {"grey": pixels[..., 0], "16 bit": pixels[..., :3].astype(np.uint16) * 257, "rgba": pixels}[kind]
    assert cv2.imwrite(str(tmp_path / "p.png"), stored)
    assert run_track(tmp_path / "p.png", "--out", tmp_path / "out", "--weights", weights) == 0
    assert cv2.imread(str(tmp_path / "out" / "p_overlay.png")).shape == (96, 160, 3)


def test_without_matplotlib_the_rest_is_written_and_the_extra_named(picture, weights, tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    out = tmp_path / "out"
    assert run_track(picture, "--out", out, "--weights", weights, "--fov", 60, "--hand-length", 10) == 0
    assert files_below(out) == ["hands.json", "hands_overlay.png"]
    captured = capsys.readouterr().err
    assert "twohands[view]" in captured and captured.count("\n") == 1


def test_without_a_place_for_matplotlibs_cache_the_rest_is_written(picture, weights, tmp_path, monkeypatch, capsys):
    """A read-only file system and a user without a home: matplotlib refuses to be imported."""

    def nowhere(*args, **more):
        raise OSError("Matplotlib requires access to a writable cache directory")

    monkeypatch.setattr("twohands.visualization.views.render_views", nowhere)
    out = tmp_path / "out"
    assert run_track(picture, "--out", out, "--weights", weights, "--fov", 60, "--hand-length", 10) == 0
    assert files_below(out) == ["hands.json", "hands_overlay.png"]
    assert "no three-view figure: Matplotlib requires" in capsys.readouterr().err


def test_demo_writes_results_of_every_example_and_says_where(weights, tmp_path, monkeypatch, capsys):
    examples = tmp_path / "examples"
    examples.mkdir()
    for name in ("one.png", "two.png"):
        write_picture(examples / name)
    (examples / "camera.json").write_text('{"fx":80,"fy":80,"cx":80,"cy":48,"width":160,"height":96}')
    monkeypatch.setattr(demo, "examples_folder", lambda: examples)
    out = tmp_path / "out"
    for _ in range(2):  # its own folder may be overwritten
        assert main(["demo", "--out", str(out), "--weights", weights]) == 0
        assert str(out) in capsys.readouterr().out.replace("\n", "")
    expected = [f"{n}_{k}.png" for n in ("one", "two") for k in ("overlay", "views")]
    assert files_below(out) == sorted(["hands.json", *expected])


def test_demo_of_the_package(tmp_path, capsys):
    """The packaged examples with the shipped weights: every picture shows at least one hand."""
    if not preset_names() or not demo.examples_folder().is_dir():
        pytest.skip("no weights or examples are packaged yet")
    assert main(["demo", "--out", str(tmp_path / "out")]) == 0
    frames = json.loads((tmp_path / "out" / "hands.json").read_text())["frames"]
    assert len(frames) >= 3
    assert all(frame["hands"]["left"]["present"] or frame["hands"]["right"]["present"] for frame in frames)


def test_names_of_results_do_not_collide():
    files = [Path("a/x.png"), Path("a/x.jpg"), Path("a/y.png")]
    assert track._result_names(files) == ["x_png", "x_jpg", "y"]
    # Named case: of a.png, a.jpg and a_png.png only two results were left.
    clash = [Path("a.png"), Path("a.jpg"), Path("a_png.png")]
    assert track._result_names(clash) == ["0000_a_png", "0001_a_jpg", "0002_a_png"]
    assert track._result_names([Path("A.png"), Path("a.png")]) == ["0000_A_png", "0001_a_png"]


def test_a_long_name_of_a_picture_is_shortened_for_its_results():
    """Named case: names of 236 letters ended a whole folder's run, for no file system takes the results'."""
    assert track._result_names([Path(236 * "a" + ".png"), Path("b.png")]) == [200 * "a", "b"]
    alike = track._result_names([Path(236 * "a" + "1.png"), Path(236 * "a" + "2.png")])
    assert alike == ["0000_" + 200 * "a", "0001_" + 200 * "a"]
