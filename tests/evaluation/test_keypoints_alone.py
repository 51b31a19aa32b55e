"""PoseNet2D by itself in crops cut by true boxes."""

import numpy as np
import pytest
import torch
from benchmarks.keypoints_alone import Answers, KnownCrop, answers, crops_of, line
from tests.builders import make_samples
from tests.oracles import make_card

from twohands.geometry.boxes import apply_homography, upright_roll_deg
from twohands.inference.engine import Networks
from twohands.inference.estimator import HandEstimator
from twohands.models.pose_net_2d import PoseNet2DConfig
from twohands.skeleton import LEFT, N_JOINTS
from twohands.types import HandCrop

CONFIG = PoseNet2DConfig("encoder-decoder", crop_size=64, stages=1, activation="softmax", judge=True)
SCALE = np.diag([2.0, 2.0, 1.0])
"""A pixel of the crop is two of the picture."""


class Answering:
    """Sees every joint in the middle of cell (row 3, column 5), and a hand wherever the crop's corner is white."""

    config, judge = CONFIG, torch.nn.Identity()

    def judged(self, images):
        maps = torch.full((len(images), N_JOINTS, 16, 16), -1e4)
        maps[:, :, 3, 5] = 0
        return [maps], torch.where(images[:, :1, 0, 0] > 0, 1.0, -1.0)

    def heatmaps(self, outputs):
        return outputs[-1].flatten(2).softmax(dim=2).view(outputs[-1].shape)


def test_errors_are_shares_of_the_hands_size_and_the_classifier_is_asked_twice():
    """The cell's middle is (5.5, 3.5) cells, (22, 14) pixels of the crop, (44, 28) of the picture."""
    corner = np.zeros((64, 64, 3), np.uint8)
    corner[0, 0] = 255
    joints = np.full((N_JOINTS, 2), [44.0, 28.0])
    joints[1], joints[2] = [44 + 30, 28], [44, 28 + 40]  # the box is 30 by 40
    found = answers(Answering(), [KnownCrop(HandCrop(corner, SCALE, LEFT, False), joints)])  # type: ignore[arg-type]
    expected = np.zeros(N_JOINTS)
    expected[1], expected[2] = 30 / 40, 1
    np.testing.assert_allclose(found.errors[0], expected, atol=1e-6)
    assert found.hand is not None and found.mirrored is not None
    assert found.hand.tolist() == [True] and found.mirrored.tolist() == [True]


def test_a_line_by_hand():
    errors = np.full((2, N_JOINTS), 0.05)
    errors[1, :11] = 0.5  # more than half of the joints: 31 of 42 are close
    assert line("x", Answers(errors, np.array([True, False]), None)) == "| x | 2 | 50 % | 74 % | 0.050 | 50 % | - |"


@pytest.fixture
def nothing() -> Networks:
    """HandSegNet sees nothing; the pose networks are not asked."""
    return Networks(
        lambda batch: (np.zeros((1, 3, 48, 80)), np.full((1, 2, 48, 80), -9.0)),
        lambda batch: pytest.fail("not asked"),
        lambda batch: pytest.fail("not asked"),
    )


def in_crop(known: KnownCrop) -> np.ndarray:
    """(21, 2) pixels of the crop."""
    return np.asarray(apply_homography(np.linalg.inv(known.crop.image_from_crop), known.joints_px))


@pytest.mark.parametrize("known", [(True, True), (False, True), (False, False)])
def test_every_known_hand_has_a_crop_that_holds_it(known, nothing):
    (sample,) = make_samples(1)
    hands = [sample.joints_px[side] if known[side] else None for side in (0, 1)]
    crops = list(crops_of(sample, hands, HandEstimator(nothing, make_card())))
    assert [one.crop.side for one in crops] == [side for side in (0, 1) if known[side]]
    for one in crops:
        crop_px = in_crop(one)
        assert (crop_px > 0).all() and (crop_px < one.crop.image.shape[0]).all()


def test_upright_crops_show_every_hand_with_its_fingers_up(nothing):
    (sample,) = make_samples(1)
    estimator = HandEstimator(nothing, make_card(upright_within_deg=0.0))
    for one in crops_of(sample, list(sample.joints_px), estimator):
        crop_px = in_crop(one)
        assert abs(upright_roll_deg(crop_px)) < 15  # not 0: the crop's camera looks at the hand
        assert (crop_px > 0).all() and (crop_px < one.crop.image.shape[0]).all()
