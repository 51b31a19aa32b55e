"""`twohands train --your-camera`: one command from a camera file to weights that `track` takes."""

import json

import pytest

from twohands.cli.demo import examples_folder
from twohands.cli.main import main
from twohands.export import onnx
from twohands.inference.weights import WeightsCard, preset_folder, read_card
from twohands.training import fine_tune

CAMERA = {"fx": 520, "fy": 520, "cx": 330, "cy": 235, "width": 640, "height": 480}


@pytest.fixture
def camera(tmp_path):
    path = tmp_path / "camera.json"
    path.write_text(json.dumps(CAMERA))
    return str(path)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["hand_seg_net"], "leave a STAGE out"),
        (["--data", "x"], "leave --data out"),
        (["--minutes", "0"], "--minutes must be a positive number, got 0"),
        (["--minutes", "inf"], "--minutes must be a positive number, got inf"),
        (["--resume"], "holds no fine-tuning to resume"),
        (["--set", "speed=3"], "unknown setting 'speed'"),
        (["--backgrounds", "no-such-folder"], "no-such-folder"),
        (["--backgrounds", "my,rooms"], "with a comma in its path"),
    ],
)
def test_mistakes_are_one_line_and_leave_nothing(words, message, camera, tmp_path, capsys):
    assert main(["train", "--your-camera", camera, "--out", str(tmp_path / "mine"), *words]) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1
    assert not (tmp_path / "mine").exists()


def test_an_output_folder_with_a_comma_is_refused_before_anything_is_rendered(camera, tmp_path, capsys):
    """Named case: it was refused, as two folders that do not exist, when the frames had been rendered."""
    assert main(["train", "--your-camera", camera, "--out", str(tmp_path / "my,weights")]) == 2
    error = capsys.readouterr().err
    assert "with a comma in its path" in error and error.count("\n") == 1
    assert not (tmp_path / "my,weights").exists()


def test_a_missing_camera_and_a_used_folder_are_refused(camera, tmp_path, capsys):
    assert main(["train", "--your-camera", str(tmp_path / "none.json"), "--out", str(tmp_path / "mine")]) == 2
    assert "no such camera file" in capsys.readouterr().err
    assert main(["train", "--your-camera", camera, "--out", str(tmp_path)]) == 2
    assert "is not an empty folder" in capsys.readouterr().err


def test_neither_stage_nor_camera(tmp_path, capsys):
    assert main(["train", "--out", str(tmp_path / "run")]) == 2
    assert "which network?" in capsys.readouterr().err


@pytest.mark.slow
def test_from_a_camera_file_to_tracked_pictures(camera, tmp_path, capsys, monkeypatch):
    """Ended by Ctrl-C after its steps, and resumed. Ten frames, and more minutes than a few steps take anywhere."""

    def interrupted(*arguments: object, **options: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(fine_tune, "FRAMES_PER_MINUTE", 1)
    monkeypatch.setattr(fine_tune, "LEAST_FRAMES", 1)
    out = tmp_path / "mine"
    words = ["train", "--your-camera", camera, "--out", str(out), "--minutes", "10", "--batch", "2"]
    words += ["--iterations", "2", "--workers", "0", "--set", "data.validation=4"]
    with monkeypatch.context() as patch:
        patch.setattr(onnx, "export_preset", interrupted)
        assert main(words) == 130
    assert main(words) == 2
    assert "go on with --resume" in capsys.readouterr().err
    assert main([*words, "--resume", "--iterations", "3"]) == 0
    assert "weights written to" in capsys.readouterr().out
    card = json.loads((out / "card.json").read_text())
    assert card["name"] == "mine" and card["fine_tuned_from"] == "fast"
    own, shipped = WeightsCard.from_dict(card), read_card(preset_folder("fast"))
    assert (own.views, own.placement, own.decision) == (shipped.views, shipped.placement, shipped.decision)
    assert own.second == shipped.second
    assert set(card["int8"]) == {"hand_seg_net", "pose_net_2d"}
    assert [card["training"][name]["iterations"] for name in ("pose_net_2d", "pose_net_3d")] == [3, 3]
    assert str(tmp_path) not in (out / "card.json").read_text()

    picture = next(examples_folder().glob("*.png"))
    assert main(["track", str(picture), "--weights", str(out), "--out", str(tmp_path / "tracked"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["weights"] == "mine"
