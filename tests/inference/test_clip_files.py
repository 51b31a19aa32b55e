"""Files that grow with a clip: whole lines at any moment, and at the end the arrays and table of all frames."""

import json
from pathlib import Path

import numpy as np
import pytest
from tests.inference.test_video import pose_of

from twohands.errors import DataFormatError
from twohands.inference.clip_files import CSV, JSONL, NPZ, ClipFiles, read_clip
from twohands.inference.tables import csv_text, to_arrays
from twohands.lifting.reading import read_hands

ABOUT = {"source": "c.mp4", "weights": "fast", "hand_length_m": 0.1}
POSES = [pose_of(i, present=(True, i % 2 == 0)) for i in range(7)]
CAMERA = POSES[0].camera


def write(folder: Path, poses=POSES) -> list[str]:
    with ClipFiles(folder, CAMERA, **ABOUT, more={"smoothed": True}) as files:
        return [files.write(pose) for pose in poses]


def test_the_lines_are_there_while_it_runs(tmp_path: Path):
    with ClipFiles(tmp_path, CAMERA, **ABOUT) as files:
        for count, pose in enumerate(POSES, 1):
            line = files.write(pose)
            text = (tmp_path / JSONL).read_text()
            assert text.endswith(line + "\n") and text.count("\n") == count + 1
        assert not (tmp_path / NPZ).exists() and not (tmp_path / CSV).exists()


def test_arrays_and_table_are_those_of_all_frames_at_once(tmp_path: Path):
    lines = write(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == [CSV, JSONL, NPZ]
    expected = to_arrays(POSES, CAMERA, **ABOUT)
    with np.load(tmp_path / NPZ, allow_pickle=False) as arrays:
        assert set(arrays.files) == set(expected)
        for name, array in expected.items():
            np.testing.assert_array_equal(arrays[name], array, err_msg=name)
    assert (tmp_path / CSV).read_text() == csv_text(POSES)
    assert json.loads(lines[3])["hands"]["right"]["present"] is False


def test_what_is_read_back_is_what_was_written(tmp_path: Path):
    write(tmp_path)
    header, poses = read_clip(tmp_path / JSONL)
    assert header["version"] == 2 and header["smoothed"] is True and header["hand_length_m"] == 0.1
    for pose, again in zip(POSES, poses, strict=True):
        assert (again.index, again.camera) == (pose.index, CAMERA)
        assert again.time_s == pytest.approx(pose.time_s, abs=1e-6)
        np.testing.assert_allclose(again.left.joints_m, pose.left.joints_m, atol=1e-6)
    assert len(read_hands(tmp_path / JSONL, CAMERA).frames) == 7, "lift reads it as well"


def test_a_killed_run_leaves_whole_lines(tmp_path: Path):
    write(tmp_path)
    content = (tmp_path / JSONL).read_bytes()
    (tmp_path / JSONL).write_bytes(content[:-100])
    _, poses = read_clip(tmp_path / JSONL)
    assert [pose.index for pose in poses] == list(range(6))


def test_an_interrupted_clip_has_complete_files(tmp_path: Path):
    with pytest.raises(KeyboardInterrupt), ClipFiles(tmp_path, CAMERA, **ABOUT) as files:
        files.write(POSES[0])
        raise KeyboardInterrupt
    with np.load(tmp_path / NPZ) as arrays:
        assert arrays["index"].tolist() == [0]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "version 2 expected, found None"),
        ('{"version": 1}\n', "version 2 expected, found 1"),
        ("[]\n", "an object expected"),
        ("{\n", "line 1: not JSON"),
        ('{"version": 2}\n{"index": 0}\n', "frame 0"),
    ],
)
def test_other_files_are_refused(content, message, tmp_path: Path):
    (tmp_path / JSONL).write_text(content)
    with pytest.raises(DataFormatError, match=message):
        list(read_clip(tmp_path / JSONL)[1])
