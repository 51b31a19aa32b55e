"""A clip that comes picture by picture says what `track` would."""

import json

import numpy as np
import pytest
from tests.live.fakes import IMAGE, camera_for, estimate, make_clip

from twohands.errors import InputError
from twohands.inference.clip_files import read_clip
from twohands.live.clip import LiveClip
from twohands.live.messages import Settings


def test_the_lines_are_a_hands_jsonl(tmp_path):
    clip = make_clip()
    clip.begin(Settings("webcam", 0.12, 90.0, True))
    told = [clip.frame(IMAGE, index, index / 10) for index in range(3)]
    assert told[0][0] is told[2][0]
    path = tmp_path / "hands.jsonl"
    path.write_text("\n".join([told[0][0], *(line for _, line in told)]) + "\n")
    header, poses = read_clip(path)
    assert (header["source"], header["hand_length_m"], header["mirrored"]) == ("webcam", 0.12, True)
    assert header["smoothed"] is True and header["camera"]["fx"] == 32
    np.testing.assert_allclose([pose.left.joints_m[0, 2] for pose in poses], 0.6, atol=1e-6)


def test_mirrored_pictures_are_turned_back():
    image = IMAGE.copy()
    image[:, -1] = 255
    clip = make_clip()
    clip.begin(Settings("a", 0.1, None, True))
    assert json.loads(clip.frame(image, 0, 0.0)[1])["hands"]["left"]["score"] == 1.0


def test_a_new_clip_may_have_another_size_and_an_earlier_time():
    clip = make_clip()
    clip.frame(IMAGE, 0, 5.0)
    with pytest.raises(InputError, match="the size changes from 64x48 to 32x48"):
        clip.frame(IMAGE[:, :32], 1, 6.0)
    with pytest.raises(InputError):
        clip.frame(IMAGE, 1, 4.0)
    clip.begin(Settings("b", 0.1))
    header, line = clip.frame(IMAGE[:, :32], 0, 0.0)
    assert json.loads(header)["camera"]["width"] == 32 and json.loads(line)["time_s"] == 0.0


class Told:
    """What a listener of a clip was told."""

    def __init__(self) -> None:
        self.said: list[object] = []

    def begin(self) -> None:
        self.said.append("begin")

    def send(self, pose) -> None:
        self.said.append((pose.index, pose.time_s, pose.left.valid, pose.right.valid))


def test_a_listener_gets_every_pose_and_every_beginning():
    told = Told()
    clip = LiveClip(estimate, camera_for, "fake", {}, Settings("a", 0.1), told)
    clip.frame(IMAGE, 0, 0.0)
    clip.frame(IMAGE, 1, 0.1)
    clip.begin(Settings("b", 0.1))
    clip.frame(IMAGE, 0, 0.0)
    assert told.said == ["begin", (0, 0.0, True, None), (1, 0.1, True, None), "begin", (0, 0.0, True, None)]
