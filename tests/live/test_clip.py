"""A clip that comes picture by picture says what `track` would."""

import json

import numpy as np
import pytest
from tests.live.fakes import IMAGE, camera_for, estimate, make_clip, seen_hand

from twohands.errors import InputError
from twohands.inference.clip_files import read_clip
from twohands.inference.range_sigma import (
    ASSUMED_FOCAL_SPREAD,
    ASSUMED_LENGTH_SPREAD,
    TAPED_SPREAD,
    TYPED_LENGTH_SPREAD,
)
from twohands.live.clip import LiveClip
from twohands.live.measuring import FRAMES, MOST_FRAMES
from twohands.live.messages import Settings


def test_the_lines_are_a_hands_jsonl(tmp_path):
    clip = make_clip()
    clip.begin(Settings("webcam", 0.12, 90.0, True))
    told = [clip.frame(IMAGE, index, index / 10) for index in range(3)]
    assert told[0].header is told[2].header
    path = tmp_path / "hands.jsonl"
    path.write_text("\n".join([told[0].header, *(each.line for each in told)]) + "\n")
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
    header, line, _ = clip.frame(IMAGE[:, :32], 0, 0.0)
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


def test_hands_say_what_their_ranges_rest_on():
    """The spread of an assumed length and camera is in the lines, as `track` has it."""
    clip = make_clip(seen_hand(0.5, sigma_m=0.01))
    for scale_source, fov_deg, shares in (
        ("assumed", None, (ASSUMED_LENGTH_SPREAD, ASSUMED_FOCAL_SPREAD)),
        ("typed", 70.0, (TYPED_LENGTH_SPREAD, 0)),
        ("distance", None, (TAPED_SPREAD, 0)),
    ):
        clip.begin(Settings("webcam", 0.1, fov_deg, scale_source=scale_source))
        hand = json.loads(clip.frame(IMAGE, 0, 0.0).line)["hands"]["left"]
        assert hand["scale_source"] == scale_source
        assert hand["intrinsics_source"] == ("fov" if fov_deg else "assumed")
        expected = np.hypot(0.01, hand["range_m"] * np.hypot(*shares))
        assert hand["range_sigma_m"] == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize("known", ["distance", "assumed"])
def test_a_hand_at_a_taped_distance_gives_the_length_of_the_clip_that_follows(known):
    """Estimates of a hand at 40 cm with 10 cm; the tape says 50. In one place the field of view stays as it is, but
    where what is usual of hand lengths speaks for another one."""
    clip = make_clip(seen_hand(0.4))
    clip.begin(Settings("webcam", 0.1, None, scale_source=known))
    assert clip.frame(IMAGE, 0, 0.0).note is None
    clip.measure(0.5)
    told = [clip.frame(IMAGE, index, index / 10) for index in range(1, FRAMES + 2)]
    notes = [json.loads(each.note)["measured"] for each in told[:FRAMES]]
    assert [note["frames"] for note in notes] == list(range(1, FRAMES + 1)) and told[FRAMES].note is None
    assert not any(note["over"] for note in notes[:-1]) and notes[-1]["over"] and notes[-1]["problem"] is None
    old, new = json.loads(told[0].header), json.loads(told[FRAMES].header)
    assert old["hand_length_m"] == 0.1 and new["hand_length_m"] == notes[-1]["hand_length_m"]
    zoom = new["camera"]["fx"] / old["camera"]["fx"]
    assert notes[-1]["hand_length_m"] * zoom == pytest.approx(0.125, rel=1e-3) and notes[-1]["sigma"] > 0
    if known == "distance":
        assert notes[-1]["hand_length_m"] == pytest.approx(0.125, rel=1e-3)
        assert notes[-1]["fov_deg"] is None and new["camera"] == old["camera"]
    else:
        assert notes[-1]["fov_deg"] < 60 and 1 < zoom < 1.25
    assert json.loads(told[FRAMES].line)["hands"]["left"]["scale_source"] == "distance"


def test_a_measuring_given_up_with_a_hand_in_its_last_frame_says_why():
    """Each twentieth frame shows a hand, the last one too: 8 of 150."""
    seen, nobody = seen_hand(0.4), seen_hand(None)
    asked = iter(range(MOST_FRAMES))

    def of(*arguments, **named):
        return (nobody if (next(asked) + 1 - MOST_FRAMES) % 20 else seen)(*arguments, **named)

    clip = make_clip(of)
    clip.measure(0.5)
    notes = [clip.frame(IMAGE, index, index / 10).note for index in range(MOST_FRAMES)]
    last = json.loads(notes[-1])["measured"]
    assert (last["over"], last["frames"], last["hand_length_m"]) == (True, 8, None)
    assert last["problem"] == "given up, one hand is seen too seldom"


def test_a_measuring_without_a_hand_is_given_up_and_one_that_is_not_wanted_ends():
    clip = make_clip(seen_hand(None))
    clip.measure(0.5)
    notes = [clip.frame(IMAGE, index, index / 10).note for index in range(MOST_FRAMES + 1)]
    last = json.loads(notes[MOST_FRAMES - 1])["measured"]
    assert last["over"] and last["problem"] == "given up, no hand is seen" and last["hand_length_m"] is None
    assert notes[MOST_FRAMES] is None
    clip.measure(0.5)
    clip.measure(None)
    assert clip.frame(IMAGE, MOST_FRAMES + 1, 1000.0).note is None
