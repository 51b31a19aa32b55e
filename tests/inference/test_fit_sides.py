"""`scripts/fit_sides.py`: sums by hand, and hands that are matched with true ones."""

from dataclasses import replace

import numpy as np
import pytest
from scripts.fit_sides import clips_in, loss, on_true_sides, spread, table, true_side_logits
from tests.oracles import Oracle, drawn_hands, make_card, restaged

from twohands.inference.decision import DecisionConfig
from twohands.types import HandPose, TwoHandPose

SAMPLE = drawn_hands(1)
CONFIG = DecisionConfig(side_trust=0.25)


def found(logits, joints_px=SAMPLE.joints_px) -> TwoHandPose:
    """The true hands, whose sides were said with these log-odds."""
    left, right = (
        HandPose(True, 0.9, joints_px=joints, side_logit=said) for joints, said in zip(joints_px, logits, strict=True)
    )
    return TwoHandPose(left, right, SAMPLE.camera)


def test_what_is_said_adds_up():
    """Hands that stand still and far apart; a frame says no more than the limit, a quarter of which counts."""
    clip = [found((said, said)) for said in (2.0, -1.0, 90.0, 0.5)]
    expected = np.cumsum([0.5, -0.25, 0.25 * 6, 0.125])
    np.testing.assert_allclose(true_side_logits(clip, CONFIG), np.repeat(expected, 2), atol=0.1)
    assert loss([[found((0.0, 0.0))]], CONFIG) == (pytest.approx(np.log(2)), 0)
    assert loss([[found((-1.0, 1.0))]], CONFIG)[1] == 1


def test_how_far_hands_are_from_where_they_were_expected():
    """The second frame is off by a tenth of a box's size along one axis; the third goes on at that speed."""
    size = max(np.ptp(SAMPLE.joints_px[0], axis=0))
    alone = replace(found((1.0, 1.0)), right=HandPose(present=False))

    def moved(share: float) -> TwoHandPose:
        return replace(alone, left=replace(alone.left, joints_px=SAMPLE.joints_px[0] + [share * size, 0]))

    assert spread([[alone, moved(0.1)]], CONFIG) == pytest.approx(0.1 / np.sqrt(2), rel=0.02)
    assert spread([[alone, moved(0.1), moved(0.2)]], CONFIG) == pytest.approx(0.1 / 2, rel=0.02)


def test_a_hand_that_was_taken_for_the_other_one_counts_against_its_side():
    assert [hand.side_logit for hand in on_true_sides(found((3.0, 2.0)), SAMPLE).hands] == [3.0, 2.0]
    exchanged = on_true_sides(found((3.0, 2.0), SAMPLE.joints_px[::-1]), SAMPLE)
    assert [hand.side_logit for hand in exchanged.hands] == [-2.0, -3.0]
    far = on_true_sides(found((3.0, 2.0), SAMPLE.joints_px + 500), SAMPLE)
    assert not any(hand.present for hand in far.hands)


def test_clips_of_a_sequence():
    oracle = Oracle(SAMPLE, make_card(hand_logit=True))
    estimator = restaged(
        oracle.estimator,
        locate=lambda crops: (oracle.true_maps(crops), np.full(len(crops), 4.0)),
        lift=lambda keypoints: oracle.canonical[keypoints.sides],
    )
    clips = clips_in(estimator, [SAMPLE] * 3)
    assert [len(clip) for clip in clips] == [3]
    assert all(hand.present and hand.side_logit > 0 for pose in clips[0] for hand in pose.hands)
    lines = table(clips, estimator.card.decision).splitlines()
    assert lines[0].startswith("1 sequences, 3 frames, 6 hands; by single frames 0 on the wrong side")
    assert sum(line.startswith("| side_trust") for line in lines) == 6
