"""hands.jsonl as arrays: what is absent is a mask, and nothing that is no place is taken for one."""

import json

import numpy as np
import pytest
from tests.motion.moving import moving_hands, write_jsonl

from twohands.errors import DataFormatError, InputError
from twohands.motion.clip import UPRIGHT_FROM_CAMERA, read_motion


def changed(path, number, change):
    """Line `number` of a file, counted from 1, after `change` of its record."""
    lines = path.read_text().splitlines()
    record = json.loads(lines[number - 1])
    change(record)
    lines[number - 1] = json.dumps(record)
    path.write_text("\n".join(lines) + "\n")
    return path


def test_a_clip_comes_back_to_a_micrometre(tmp_path):
    valid = np.array([[True, False], [True, True], [False, False], [False, True]])
    made = moving_hands(4, valid=valid, times=np.array([10.0, 10.5, 12.0, 12.25]))
    read = read_motion(write_jsonl(made, tmp_path / "hands.jsonl"))
    np.testing.assert_array_equal(read.valid, valid)
    np.testing.assert_allclose(read.joints_m, made.joints_m, atol=5.1e-7, equal_nan=True)
    np.testing.assert_array_equal(read.time_s, made.time_s)
    assert read.sides == (0, 1) and read.camera == made.camera and read.index.tolist() == [0, 1, 2, 3]


def test_a_hand_that_never_comes_is_none(tmp_path):
    made = moving_hands(3, valid=np.array([[False, True]] * 3))
    assert read_motion(write_jsonl(made, tmp_path / "hands.jsonl")).sides == (1,)


def test_upright_is_a_rotation():
    assert np.linalg.det(UPRIGHT_FROM_CAMERA) == 1
    np.testing.assert_array_equal(UPRIGHT_FROM_CAMERA @ [1, 2, 3], [1, -2, -3])


def test_no_hands_and_no_frames(tmp_path):
    made = moving_hands(3, valid=np.zeros((3, 2), bool))
    path = write_jsonl(made, tmp_path / "hands.jsonl")
    with pytest.raises(InputError, match=r"no hand has metres in any of its 3 frames"):
        read_motion(path)
    path.write_text(path.read_text().splitlines()[0] + "\n")
    with pytest.raises(InputError, match=r"hands\.jsonl: no frame in it"):
        read_motion(path)
    with pytest.raises(DataFormatError, match="cannot be read"):
        read_motion(tmp_path / "none.jsonl")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda r: r.update(time_s=None), "frame 1: time_s must be a number of seconds, found None"),
        (lambda r: r.update(time_s="1"), "frame 1: time_s must be a number of seconds, found '1'"),
        (lambda r: r.update(time_s=True), "frame 1: time_s must be a number"),
        (lambda r: r.update(time_s=1e300), "frame 1: time_s must be a number"),
        (lambda r: r.update(time_s=0.0), "frame 1: time_s 0 does not come after 0"),
        (lambda r: r["hands"]["left"].update(joints_m=None), "frame 1: left joints_m must be 21 places within 1000 m"),
        (lambda r: r["hands"]["left"]["joints_m"].pop(), "joints_m must have shape"),
        (lambda r: r["hands"]["right"]["joints_m"].__setitem__(3, [0, None, 0]), "frame 1: right joints_m must be 21"),
        (lambda r: r["hands"]["right"]["joints_m"].__setitem__(3, [0, 2e3, 0]), "frame 1: right joints_m must be 21"),
    ],
)
def test_what_is_no_clip_is_named(tmp_path, change, said):
    path = changed(write_jsonl(moving_hands(3), tmp_path / "hands.jsonl"), 3, change)
    with pytest.raises(DataFormatError, match=said):
        read_motion(path)


def test_hands_without_metres_are_left_out(tmp_path):
    path = write_jsonl(moving_hands(2), tmp_path / "hands.jsonl")
    changed(path, 2, lambda r: r["hands"]["left"].update(valid=False, joints_m=None, range_m=None))
    np.testing.assert_array_equal(read_motion(path).valid, [[False, True], [True, True]])


def test_two_clips_in_one_file_are_refused(tmp_path):
    """As a stream that was kept while a new clip began: times would begin again."""
    path = write_jsonl(moving_hands(2), tmp_path / "hands.jsonl")
    path.write_text(2 * path.read_text())
    with pytest.raises(DataFormatError, match="a second header, where another clip begins"):
        read_motion(path)
