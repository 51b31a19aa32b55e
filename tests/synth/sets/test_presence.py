"""Hidden hands are absent."""

import numpy as np

from twohands.synth.sets.presence import seen_hands
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
