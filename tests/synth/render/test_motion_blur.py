"""Blur of moving arms."""

import numpy as np

from twohands.synth.render.motion_blur import blurred
from twohands.synth.scene.spec import ArmMotion
from twohands.types import PinholeCamera, RenderedFrame


def frame() -> RenderedFrame:
    """A white bar of 8 pixels, a left hand at depth 1, in front of a grey person."""
    labels = np.zeros((60, 80), np.uint8)
    labels[20:50, 36:44] = 2
    rgb = np.where(labels[..., None] > 0, 250, 60).astype(np.uint8) * np.ones(3, np.uint8)
    joints = np.full((2, 22, 3), np.nan)
    joints[0] = [0.0, 0.2, 1.0]
    joints[0, 1:] = [0.0, 0.0, 1.0]
    alpha, depth = np.full((60, 80), 255, np.uint8), (labels > 0).astype(np.float32)
    return RenderedFrame(
        rgb, alpha, depth, labels, joints, np.array([True, False]), PinholeCamera(100, 100, 40, 30, 80, 60)
    )


def test_what_stands_still_stays_as_it_is():
    still = frame()
    assert blurred(still, (None, None)) is still
    slow = ArmMotion(np.array([0.0, 1.0, 1.0]), np.array([0, 0, 1e-4]), np.zeros(3))
    assert blurred(still, (slow, None)) is still


def test_a_swing_smears_along_its_way_and_keeps_the_light():
    """About a shoulder 1 m below, 0.1 radians sweep 10 pixels across at the height of the axis."""
    still = frame()
    swing = ArmMotion(np.array([0.0, 1.0, 1.0]), np.array([0.0, 0.0, 0.1]), np.zeros(3))
    moved = blurred(still, (swing, None))
    row = moved.rgb[30, :, 0].astype(float)
    assert row[32:35].min() > 80 and row[45:48].min() > 80, "beside the bar it is brighter"
    assert row[40] < 250, "and the bar is thinner"
    assert abs((row - 60).sum() / (190 * 8) - 1) < 0.15
    assert (moved.rgb[5] == 60).all() and (moved.alpha == 255).all()
    np.testing.assert_array_equal(moved.part_labels, still.part_labels)


def test_motion_of_the_absent_arm_does_nothing():
    still = frame()
    swing = ArmMotion(np.zeros(3), np.array([0.0, 0.0, 0.5]), np.zeros(3))
    assert blurred(still, (None, swing)) is still
