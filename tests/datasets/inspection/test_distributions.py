"""Measures of hands: values computed by hand, and laws that hold for every hand."""

import numpy as np
import pytest
from tests.builders import make_hand, random_rotations
from tests.datasets import fakes

from twohands.datasets.ego3dhands import Ego3DHands
from twohands.datasets.inspection.distributions import (
    Measurements,
    box_overlap,
    finger_flexion_deg,
    hand_values,
    heat_map,
    palm_normal,
    skin_tone_deg,
)
from twohands.skeleton import LEFT, RIGHT, part_label


def flat_right_hand() -> np.ndarray:
    """(21, 3) in metres: palm towards the camera, fingers up and straight, thumb to the right, root 0.4 m ahead."""
    hand = np.zeros((21, 3))
    for finger in range(5):
        for bone in range(4):
            hand[1 + 4 * finger + bone] = (0.04 - 0.02 * finger, -0.02 * bone, 0.0)
    hand += [0.0, 0.0, 0.4]
    hand[0] = (0.0, 0.1, 0.4)
    return hand


def test_a_palm_towards_the_camera():
    values = hand_values(flat_right_hand(), RIGHT)
    assert values["palm_deg"] == pytest.approx(0, abs=1e-6)
    assert values["pointing_deg"] == pytest.approx(0)
    assert values["range_m"] == pytest.approx(0.4) and values["hand_length_m"] == pytest.approx(0.1)
    assert values["theta_deg"] == pytest.approx(0) and values["phi_deg"] == pytest.approx(0)


def test_a_mirrored_hand_is_the_other_hand():
    hand = flat_right_hand()
    assert hand_values(hand * [-1, 1, 1], LEFT)["palm_deg"] == pytest.approx(0, abs=1e-6)
    assert hand_values(hand, LEFT)["palm_deg"] == pytest.approx(180)


def test_direction_is_that_of_the_paper():
    """45 degrees below the axis; then 45 degrees to the right of the plane that this makes with the columns."""
    down = flat_right_hand() - [0, 0, 0.4] + [0, 0.3, 0.3]
    assert hand_values(down, RIGHT)["theta_deg"] == pytest.approx(45)
    right = flat_right_hand() - [0, 0, 0.4] + [0.5, 0.3, 0.4]
    assert hand_values(right, RIGHT)["phi_deg"] == pytest.approx(45)  # hypot(0.3, 0.4) = 0.5


def test_flexion_of_straight_and_bent_fingers():
    hand = flat_right_hand()
    # Middle finger: its four bones and the wrist lie on one line.
    assert finger_flexion_deg(hand)[2] == pytest.approx(0, abs=1e-6)
    hand[11] = hand[10] + [0, 0, -0.02]  # a right angle at the second joint, towards the palm
    hand[12] = hand[11] + [0, 0.02, 0]  # and another one
    assert finger_flexion_deg(hand)[2] == pytest.approx(180)


def test_flexion_length_and_range_do_not_depend_on_rotation():
    rng = np.random.default_rng(0)
    for rotation in random_rotations(5, rng):
        hand = make_hand(rng) * 0.1 + [0.1, 0.0, 0.4]
        turned = hand @ rotation.T
        one, two = hand_values(hand, LEFT), hand_values(turned, LEFT)
        for name in ("range_m", "hand_length_m", "palm_deg", "flexion_deg"):
            np.testing.assert_allclose(one[name], two[name], atol=1e-6)
        np.testing.assert_allclose(palm_normal(turned, LEFT), rotation @ palm_normal(hand, LEFT), atol=1e-9)


def test_overlap_of_boxes():
    box = np.array([[0.0, 0.0], [4.0, 2.0]])
    assert box_overlap(box, box) == 1
    assert box_overlap(box, box + np.array([2.0, 0.0])) == pytest.approx(4 / 12)
    assert box_overlap(box, box + np.array([4.0, 0.0])) == 0
    assert box_overlap(box, box + np.array([9.0, 9.0])) == 0


def test_skin_tone_orders_light_before_dark():
    labels = np.full((4, 4), part_label(LEFT, 1), np.uint8)
    tones = [
        skin_tone_deg(np.full((4, 4, 3), colour, np.uint8), labels, LEFT)
        for colour in ((246, 220, 200), (215, 180, 140), (130, 92, 67), (58, 45, 38))
    ]
    assert tones == sorted(tones, reverse=True)
    # sRGB (215, 180, 140): Y = 0.4898, Z / Zn = 0.2909, so L = 75.44 and b = 25.14 (CIE 15, D65)
    assert tones[1] == pytest.approx(np.degrees(np.arctan2(25.44, 25.14)), abs=0.1)
    arm = np.full((4, 4), part_label(LEFT, 0), np.uint8)
    assert np.isnan(skin_tone_deg(np.zeros((4, 4, 3), np.uint8), arm, LEFT))


def test_heat_map_counts_joints_inside():
    heat = heat_map(np.array([[0.0, 0.0], [0.999, 0.999], [0.5, 1.2], [-0.1, 0.5]]))
    assert heat.shape == (27, 48) and heat.sum() == 2 and heat[0, 0] == 1 and heat[26, 47] == 1


def test_measurements_count_hands_and_pictures(tmp_path):
    fakes.write_instance(tmp_path / "0")
    fakes.write_instance(tmp_path / "1", left=False)
    dataset = Ego3DHands(tmp_path)
    measurements = Measurements()
    for index in range(2):
        measurements.add(dataset.instance(index))
    found = measurements.distributions("x")
    assert found.instances == 2 and found.hands == (1, 2) and len(found.overlap) == 1
    assert found.flexion_deg.shape == (3, 5) and found.heat.sum() == 63
    np.testing.assert_allclose(found.hand_length_m, 0.1)
    near, far = np.linalg.norm([0.1, 0.02, 0.30]), np.linalg.norm([0.08, 0.0, 0.35])
    np.testing.assert_allclose(found.range_m, [near, far, far])
    empty = Measurements().distributions("none")
    assert empty.flexion_deg.shape == (0, 5) and empty.range_m.shape == (0,)


def test_fingers_of_the_official_hands_bend_towards_the_palm(shared_data):
    sample = Ego3DHands(shared_data / "official" / "ego3dhands")[0]
    for side in (LEFT, RIGHT):
        normal = palm_normal(sample.joints_m[side], side)
        bent = [f for f in range(1, 5) if finger_flexion_deg(sample.joints_m[side])[f] > 80]
        assert bent
        for finger in bent:
            assert (sample.joints_m[side, 4 + 4 * finger] - sample.joints_m[side, 1 + 4 * finger]) @ normal > 0
