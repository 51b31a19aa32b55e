"""Hidden hands are absent."""

import dataclasses

import numpy as np
import pytest

from twohands.geometry.camera import project
from twohands.synth.backgrounds import behind
from twohands.synth.backgrounds.base import Background
from twohands.synth.scene.config import PEOPLE
from twohands.synth.sets.cache import FrameCache, build_cache
from twohands.synth.sets.presence import seen_hands
from twohands.synth.sets.stream import SyntheticStream
from twohands.types import PinholeCamera, RenderedFrame

CAMERA = PinholeCamera(100, 100, 50, 50, 100, 100)


def frame(labels: np.ndarray) -> RenderedFrame:
    """Both hands 20 pixels wide at depth 1, the left one about (25, 50), the right one about (75, 50)."""
    at = np.linspace(0, 2 * np.pi, 22)
    ring = np.stack([0.1 * np.cos(at), 0.1 * np.sin(at), np.ones(22)], -1)
    joints = ring + np.array([[[-0.25, 0, 0]], [[0.25, 0, 0]]])
    depth = (labels > 0).astype(np.float32)
    grey = np.full((100, 100, 3), 90, np.uint8)
    amodal = np.ones((2, 100, 100), bool)
    return RenderedFrame(
        grey, np.full((100, 100), 255, np.uint8), depth, labels, joints, np.ones(2, bool), CAMERA, amodal
    )


def test_a_hand_of_which_enough_is_seen_stays_and_a_hidden_one_goes():
    labels = np.zeros((100, 100), np.uint8)
    labels[45:55, 15:35] = 2  # 200 of about 300 pixels
    labels[40:60, 60:70] = 8  # only the forearm
    seen = seen_hands(frame(labels))
    assert seen.present.tolist() == [True, False]
    assert np.isnan(seen.joints_m[1]).all() and np.isfinite(seen.joints_m[0]).all()
    assert set(np.unique(seen.part_labels)) == {0, 2}
    assert not seen.depth_m[40:60, 60:70].any() and seen.depth_m[50, 20] == 1
    assert seen.amodal[0].all() and not seen.amodal[1].any()
    assert (seen.alpha == 255).all(), "the arm stays in the picture"


def test_a_few_pixels_are_not_a_hand():
    labels = np.zeros((100, 100), np.uint8)
    labels[50, 15:35] = 3  # 20 of 300
    assert not seen_hands(frame(labels)).present.any()


@pytest.fixture(scope="module")
def frames():
    config = dataclasses.replace(PEOPLE, width=240, height=136)
    stream = SyntheticStream(config, 12, 14)
    return [stream.frame(i) for i in range(14)]


def test_labels_belong_to_the_hands_that_are_present(frames):
    """Only arms of present hands have labels, and most joints in the picture lie on their own arm, or on what hides
    it: never is a hand's label far from its joints."""
    for frame in frames:
        for side, first in ((0, 1), (1, 8)):
            arm = (frame.part_labels >= first) & (frame.part_labels < first + 7)
            assert arm.any() == frame.present[side]
            if not frame.present[side]:
                assert np.isnan(frame.joints_m[side]).all()
                continue
            rows, columns = np.nonzero(arm & (frame.part_labels > first))
            px = project(frame.joints_m[side, 1:], frame.camera)
            flesh = 3 + 0.3 * np.ptp(px, axis=0).max()
            low, high = px.min(0) - flesh, px.max(0) + flesh
            assert (columns >= low[0]).all() and (columns <= high[0]).all()
            assert (rows >= low[1]).all() and (rows <= high[1]).all()
        labelled = frame.part_labels > 0
        assert (frame.alpha[labelled] > 0).all() and (frame.depth_m[labelled] > 0).all()
        assert frame.turns in range(4)


def test_frames_of_people_are_cached_with_their_turns_and_empty_ones_show_nobody(tmp_path, monkeypatch):
    class Wall:
        name, unreadable = "wall", ()

        def sample(self, rng, camera):
            return Background(np.full((camera.height, camera.width, 3), 90, np.uint8))

    monkeypatch.setattr(behind, "DRAWN", 0.0)
    build_cache(tmp_path / "c", dataclasses.replace(PEOPLE, width=160, height=90, sensor=0.0), 5, 4)
    full, empty = FrameCache(tmp_path / "c", Wall()), FrameCache(tmp_path / "c", Wall(), empty_rate=1.0)
    for shown, bare in zip((full[i] for i in range(4)), (empty[i] for i in range(4)), strict=True):
        assert (bare.image == 90).all() and not bare.present.any()
        assert (shown.image != 90).any()
