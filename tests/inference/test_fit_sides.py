"""`scripts/fit_sides.py`: sums by hand, and hands that are matched with true ones."""

import numpy as np
import pytest
from scripts.fit_sides import added_up, loss, streams_in, true_side_logit
from tests.oracles import Oracle, drawn_hands, make_card, restaged

from twohands.inference.side_keeping import KEPT_SHARE, NOTHING_KNOWN, SIGNS, TRUST
from twohands.types import HandPose, TwoHandPose

SAMPLE = drawn_hands(1)


def found(logits, joints_px=SAMPLE.joints_px) -> TwoHandPose:
    """The true hands, whose sides were said with these log-odds."""
    left, right = (
        HandPose(True, 0.9, joints_px=joints, side_logit=said) for joints, said in zip(joints_px, logits, strict=True)
    )
    return TwoHandPose(left, right, SAMPLE.camera)


def test_what_is_said_adds_up_as_in_the_pipeline():
    said = np.array([2.0, -1.0, 9.0, 0.5])
    np.testing.assert_allclose(added_up(said, 0.5, 0.25), [0.5, 0.0, 1.0, 0.625])
    assert loss([np.zeros(3)], 0.9, 0.3) == pytest.approx(np.log(2))
    memory = NOTHING_KNOWN
    for logit in said:
        memory = memory.after(found((logit, logit)))
    for side, track in enumerate(memory.tracks):
        assert track is not None and SIGNS[side] in (1.0, -1.0)
        assert track.logit == pytest.approx(added_up(said, KEPT_SHARE, TRUST)[-1], rel=0.05)


def test_a_hand_that_was_taken_for_the_other_one_counts_against_its_side():
    assert true_side_logit(found((3.0, 2.0)), SAMPLE, 0) == [3.0]
    exchanged = found((3.0, 2.0), SAMPLE.joints_px[::-1])
    assert true_side_logit(exchanged, SAMPLE, 0) == [-2.0]
    assert true_side_logit(found((3.0, 2.0), SAMPLE.joints_px + 500), SAMPLE, 0) == []


def test_streams_of_a_sequence():
    oracle = Oracle(SAMPLE, make_card(hand_logit=True))
    estimator = restaged(
        oracle.estimator,
        locate=lambda crops: (oracle.true_maps(crops), np.full(len(crops), 4.0)),
        lift=lambda keypoints: oracle.canonical[keypoints.sides],
    )
    streams = streams_in(estimator, [SAMPLE] * 3)
    assert [len(stream) for stream in streams] == [3, 3]
    assert all((stream > 0).all() for stream in streams)
