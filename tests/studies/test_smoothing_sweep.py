"""The sweep of the range smoothing: by hand where it can be, and the same as smoothing while predicting."""

from dataclasses import replace

import numpy as np
import pytest
from tests.builders import make_sample

from twohands.errors import InputError
from twohands.evaluation.comparison import compare
from twohands.evaluation.completion import complete_hand
from twohands.evaluation.predictions import Predictions, predict
from twohands.inference.tracker import DEFAULT_SMOOTHING, HandTracker, RangeSmoothing, moved_to_range
from twohands.skeleton import ROOT
from twohands.studies.smoothing_sweep import smoothing_sweep, with_smooth_ranges
from twohands.types import HandPose, HandSample, TwoHandPose

STEPS_M = (0.0, 0.03, 0.0, -0.03, 0.0, 0.03)
"""Range errors of the frames of one sequence; the labels stand still."""


def video(sequences: int = 2) -> list[HandSample]:
    sample = make_sample(np.random.default_rng(5))
    return [replace(sample, source=f"{s}/{f:05d}") for s in range(sequences) for f in range(len(STEPS_M))]


def said(sample: HandSample) -> TwoHandPose:
    """The truth, moved along the lines of sight."""
    error = STEPS_M[int(sample.source[-5:])]
    hands = [
        moved_to_range(hand, hand.range_m + error)
        for side in (0, 1)
        for hand in [complete_hand(sample.camera, 0.1, joints_m=sample.joints_m[side])]
        if hand.range_m is not None
    ]
    return TwoHandPose(hands[0], hands[1], sample.camera)


def predicted(samples: list[HandSample], estimate=said, **settings) -> Predictions:
    return predict(samples, estimate, dataset="still", weights="none", settings=settings)


def test_two_settings_by_hand() -> None:
    """Queue 2 is no smoothing: mean |error| 3/2 cm of 0, 3, 0, 3, 0, 3. Queue 3, degree 0: the mean of the last three
    from the third frame on: 0, 3, 1, 0, -1, 0, so 5/6 cm; both sequences start anew."""
    samples = video()
    sweep = smoothing_sweep(predicted(samples), iter(samples), fps=10, lengths=(2, 3), degrees=(0,)).to_dict()
    assert (sweep["frames"], sweep["sequences"]) == (12, 2)
    raw, off, mean, default = sweep["rows"]
    assert [row["length"] for row in sweep["rows"]] == [None, 2, 3, DEFAULT_SMOOTHING.length]
    assert [row["fade"] for row in sweep["rows"]] == [None, 1, 1, DEFAULT_SMOOTHING.fade]
    assert (raw["name"], mean["name"]) == ("no smoothing", "queue 3, degree 0")
    assert default["name"] == (
        f"queue {DEFAULT_SMOOTHING.length}, degree {DEFAULT_SMOOTHING.degree}, fade {DEFAULT_SMOOTHING.fade}"
    )
    assert raw["metrics"]["range_mean"] == pytest.approx((3 + 3 + 3) / 6)
    assert off["metrics"] == pytest.approx(raw["metrics"])
    assert mean["metrics"]["range_mean"] == pytest.approx((0 + 3 + 1 + 0 + 1 + 0) / 6)
    # second differences of the errors, cm, x 10 fps^2: -6, 0, 6, 0 and -5, 1, 0, 2
    assert raw["metrics"]["acceleration_radial"] == pytest.approx((6 + 0 + 6 + 0) / 4)
    assert mean["metrics"]["acceleration_radial"] == pytest.approx((5 + 1 + 0 + 2) / 4)


def test_the_same_as_smoothing_while_predicting() -> None:
    """Directions are rebuilt from the file, so that a hand without a valid range is placed at the prediction too."""

    def with_gap(sample: HandSample) -> TwoHandPose:
        pose = said(sample)
        if sample.source.endswith("4"):
            return replace(pose, left=replace(pose.left, joints_m=None, range_m=None, valid=False), right=ABSENT)
        return pose

    samples = video(1)
    smoothing = RangeSmoothing(5, 1)
    predictions = predicted(samples, with_gap)
    poses = [predictions.pose(index, sample.camera) for index, sample in enumerate(samples)]
    after = with_smooth_ranges(predictions, poses, smoothing)
    tracker = HandTracker(smoothing)
    for index, sample in enumerate(samples):
        truth = with_gap(sample)
        root = sample.joints_m[0, ROOT]
        theta, phi = np.degrees(np.arctan2(root[1], root[2])), np.degrees(np.arctan2(root[0], np.hypot(*root[1:])))
        live = tracker.update(replace(truth, left=replace(truth.left, theta_deg=theta, phi_deg=phi), index=index))
        for side, hand in enumerate(live.hands):
            assert after.valid[index, side] == (hand.present and bool(hand.valid))
            if hand.joints_m is not None:
                np.testing.assert_allclose(after.joints_m[index, side], hand.joints_m, atol=1e-9)
    assert after.valid[4].tolist() == [True, False] and not predictions.valid[4].any()
    assert not np.array_equal(compare(after, samples).root, compare(predictions, samples).root, equal_nan=True)


ABSENT = HandPose(present=False)


def test_refused() -> None:
    samples = video(1)
    with pytest.raises(InputError, match="smoothed already"):
        smoothing_sweep(predicted(samples, smoothed=True), samples, fps=30)
    with pytest.raises(InputError, match="three frames"):
        smoothing_sweep(predicted(samples[:2]), samples[:2], fps=30)
    others = [replace(sample, source=f"x{sample.source}") for sample in samples]
    with pytest.raises(InputError, match="other data"):
        smoothing_sweep(predicted(samples), others, fps=30)
    with pytest.raises(InputError, match="length must be at least 1"):
        smoothing_sweep(predicted(samples), samples, fps=30, lengths=(5, 0))
    with pytest.raises(InputError, match="no setting to try"):
        smoothing_sweep(predicted(samples), samples, fps=30, lengths=(2,), degrees=(2, 3))
