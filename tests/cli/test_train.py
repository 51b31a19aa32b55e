"""`twohands train` and `twohands export`, from arguments to files."""

import dataclasses
import json
import shutil
import subprocess
import sys

import numpy as np
import pytest
from tests.builders import make_samples
from tests.training.tiny import tiny_run

from twohands.cli import export, train
from twohands.cli.demo import examples_folder
from twohands.cli.main import main
from twohands.errors import InputError
from twohands.formats.pictures import list_images, read_image
from twohands.inference.estimator import HandEstimator
from twohands.inference.weights import DEFAULT_PRESET, preset_folder
from twohands.training import sources

SETTINGS = ("networks.hand_seg_net.width=0.125", "networks.hand_seg_net.height=64", "networks.hand_seg_net.width_px=96")


@pytest.fixture
def hand_made_data(monkeypatch):
    """`--data` is answered with hand-made pictures: what is tested here is the command, not the readers."""
    monkeypatch.setattr(sources, "open_source", lambda spec: sources.split(make_samples(20), spec.validation))


def test_arguments_reach_the_run(tmp_path):
    args = train.TrainArgs(
        tmp_path, "pose_net_2d", data="d", max_minutes=2, iterations=5, batch=3, seed=7, workers=0, threads=1,
        set=("optim.learning_rate=5e-4",), segmentation=tmp_path / "seg.onnx",
    )  # fmt: skip
    config = train.resolve(args)
    assert (config.stage, config.recipe) == ("pose_net_2d", "ours")
    assert (config.max_minutes, config.iterations, config.batch_images, config.seed, config.threads) == (2, 5, 3, 7, 1)
    assert (config.data.source, config.data.workers, config.optim.learning_rate) == ("d", 0, 5e-4)
    assert config.data.segmentation == str(tmp_path / "seg.onnx")
    paper = train.resolve(train.TrainArgs(tmp_path, "pose_net_2d", recipe="paper"))
    assert paper.networks.pose_net_2d.variant == "cpm9"


def test_a_run_and_its_resume(hand_made_data, tmp_path, capsys):
    words = ["train", "hand_seg_net", "--out", str(tmp_path / "run"), "--data", "x", "--workers", "0", "--batch", "2"]
    assert main([*words, "--iterations", "2", "--max-minutes", "0", "--set", *SETTINGS]) == 0
    printed = capsys.readouterr().out
    assert "18 pictures, 2 held out" in printed and "miou" in printed
    assert (tmp_path / "run" / "hand_seg_net.safetensors").is_file()

    assert main([*words, "--iterations", "2", "--max-minutes", "0"]) == 2
    assert "already holds a training run" in capsys.readouterr().err

    assert main(["train", "hand_seg_net", "--out", str(tmp_path / "run"), "--resume", "--iterations", "4"]) == 0
    assert "4 iterations" in capsys.readouterr().out
    kept = json.loads((tmp_path / "run" / "config.json").read_text())
    assert kept["networks"]["hand_seg_net"]["height"] == 64 and kept["batch_images"] == 2


def test_synthetic_data_with_workers_and_validation(tmp_path):
    """Named case: with its default settings it waited for ever; `validation_batches` says why."""
    pytest.importorskip("moderngl")
    words = ["--data", "synthetic", "--workers", "2", "--batch", "2", "--iterations", "2", "--max-minutes", "0"]
    run = ["train", "hand_seg_net", "--out", str(tmp_path / "run"), *words, "--set", "data.validation=2", *SETTINGS]
    done = subprocess.run([sys.executable, "-m", "twohands", *run], capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    assert "2 held out" in done.stdout and "miou" in done.stdout


def test_mistakes_are_one_line(tmp_path, capsys):
    for words, message in [
        (["--data", str(tmp_path / "none")], "expected a folder or 'synthetic'"),
        ([], "expected a folder or 'synthetic'"),
        (["--resume"], "no training run to resume"),
        (["--data", "x", "--set", "speed=3"], "unknown setting 'speed'"),
        (["--data", "x", "frames, new"], "'frames, new': training cannot use a folder with a comma in its path"),
        (["--data", "x", "--backgrounds", "a,b"], "'a,b': training cannot use a folder with a comma in its path"),
    ]:
        assert main(["train", "hand_seg_net", "--out", str(tmp_path / "run"), *words]) == 2
        error = capsys.readouterr().err
        assert error.startswith("twohands: error: ") and message in error and error.count("\n") == 1
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("content", ['{"stage": "pose_net_2d",', "[]", '{"stage": "pose_net_2d", "optim": 3}'])
def test_damaged_settings_of_a_run_are_one_line(tmp_path, capsys, content):
    (tmp_path / "config.json").write_text(content)
    assert main(["train", "pose_net_2d", "--out", str(tmp_path), "--resume"]) == 2
    error = capsys.readouterr().err
    assert "config.json: not the settings of a training run" in error and error.count("\n") == 1


def test_a_folder_that_cannot_be_made_and_a_negative_number_of_threads_are_one_line(tmp_path, capsys):
    (tmp_path / "file").touch()
    words = ["train", "pose_net_2d", "--data", "synthetic", "--iterations", "1", "--workers", "0"]
    assert main([*words, "--out", str(tmp_path / "file" / "run")]) == 2
    assert "is a file, not a folder" in capsys.readouterr().err
    assert main([*words, "--out", str(tmp_path / "run"), "--threads", "-1"]) == 2
    assert "threads must not be negative, got -1" in capsys.readouterr().err


def test_an_empty_folder_is_no_data(tmp_path):
    config = tiny_run("hand_seg_net")
    with pytest.raises(InputError, match="location_2d"):
        sources.open_source(dataclasses.replace(config.data, source=str(tmp_path)))


def test_resuming_as_another_stage_is_refused(hand_made_data, tmp_path):
    words = ["train", "hand_seg_net", "--out", str(tmp_path / "run"), "--data", "x", "--workers", "0", "--batch", "2"]
    assert main([*words, "--iterations", "1", "--max-minutes", "0", "--set", *SETTINGS]) == 0
    with pytest.raises(InputError, match="a run of stage hand_seg_net, not pose_net_2d"):
        train.resolve(train.TrainArgs(tmp_path / "run", "pose_net_2d", resume=True))


def test_export_refuses_a_full_folder_and_missing_weights(tmp_path):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "file").touch()
    missing = tmp_path / "none.safetensors"
    with pytest.raises(InputError, match="not empty"):
        export.run(export.ExportArgs(missing, missing, missing, tmp_path / "full"))
    words = ["export", "--out", str(tmp_path / "new")]
    for name in ("hand-seg-net", "pose-net-2d", "pose-net-3d"):
        words += [f"--{name}", str(missing)]
    assert main(words) == 2
    assert not (tmp_path / "new").exists()


def test_the_segmentation_of_a_preset_is_that_of_the_pipeline(tmp_path):
    """A single view of it. The same file without its card is opened by torch and answers nearly alike."""
    preset = preset_folder(DEFAULT_PRESET)
    shipped = HandEstimator.from_preset(preset)
    one_view = dataclasses.replace(shipped.card.views, tta_views=())
    estimator = HandEstimator(shipped.networks, dataclasses.replace(shipped.card, views=one_view))
    shutil.copy(preset / "hand_seg_net.onnx", tmp_path)
    image = read_image(list_images(examples_folder())[1])  # with both hands
    masks, boxes = estimator.segment(image)
    (found,) = train.open_segmentation(preset / "hand_seg_net.onnx")([image])
    np.testing.assert_array_equal(found.classes, masks)
    np.testing.assert_array_equal(found.boxes_px, boxes.boxes_px)
    (alone,) = train.open_segmentation(tmp_path / "hand_seg_net.onnx")([image])
    assert (alone.classes != masks).mean() < 0.01
