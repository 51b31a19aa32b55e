"""`twohands bench --video`: every stage has its time, and the sums agree."""

import importlib.util
import json
import sys

import numpy as np
import pytest

pytest.importorskip("av")
from tests.inference.clips import write_clip
from tests.oracles import write_tiny_weights

from twohands.cli import bench_clip
from twohands.cli.bench_clip import CLIP_ROWS, ClipTimes
from twohands.cli.main import main


@pytest.fixture
def clip(tmp_path):
    return write_clip(tmp_path / "clip.mp4", size=(160, 96))


@pytest.fixture
def weights(tmp_path):
    return str(write_tiny_weights(tmp_path / "tiny"))


def test_a_clip_from_file_to_files(clip, weights, capsys):
    assert main(["bench", "--video", str(clip), "--weights", weights, "--threads", "1", "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert list(record["ms"]) == list(CLIP_ROWS)
    assert (record["frames"], record["picture"], record["weights"], record["mediapipe"]) == (10, "160x96", "tiny", None)
    assert all(record["ms"][name]["mean"] > 0 for name in ("decoding", "overlay, two views", "H.264"))
    assert record["end_to_end"]["frames_per_second"] > 0 and record["peak_memory_mb"] > 10
    bench_clip.print_clip_table(record)
    printed = capsys.readouterr().out
    assert "MediaPipe is not installed here" in printed and "HandSegNet rested in" in printed


def test_the_first_frames_alone(clip, weights, capsys):
    assert main(["bench", "--video", str(clip), "--weights", weights, "--count", "4", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["frames"] == 4


def test_sums_of_known_times():
    stages_ms = {name: np.full(4, 2.0) for name in CLIP_ROWS}
    times = ClipTimes(stages_ms, np.array([5.0, 5.0, 5.0, 5.0]), both=3, rested=1, together_s=0.1, end_s=1.0)
    alone = 2.0 * len(bench_clip.ESTIMATES)
    np.testing.assert_allclose(times.estimates_ms, alone)
    assert times.together_over_estimates == pytest.approx(100 / (4 * alone))
    record = bench_clip.clip_record(times)
    assert record["estimates"]["frames_per_second"] == pytest.approx(1e3 / alone, abs=0.01)
    assert record["mediapipe"] == {"mean": 5.0, "median": 5.0, "p90": 5.0, "frames_per_second": 200.0}
    assert record["end_to_end"]["frames_per_second"] == 40.0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--video", "none.mp4"], "none.mp4: no such file"),
        (["picture.png", "--video", "none.mp4"], "give a picture (picture.png) or --video, not both"),
    ],
)
def test_mistakes_are_one_line(words, message, capsys):
    assert main(["bench", *words]) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1


def test_an_interpreter_that_has_no_mediapipe_is_named(clip, weights, capsys):
    if importlib.util.find_spec("mediapipe"):
        pytest.skip("this one has")
    assert main(["bench", "--video", str(clip), "--weights", weights, "--peer-python", sys.executable]) == 2
    assert "has no MediaPipe Hands" in capsys.readouterr().err
