"""Times are exclusive, and timing changes no result."""

import numpy as np
import pytest
from tests.oracles import Oracle, drawn_hands, make_card

from twohands.studies.stage_times import ROWS, StageClock, timed_estimate


class Ticks:
    """A clock that the timed functions themselves move on."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now

    def work(self, seconds: float) -> None:
        self.now += seconds


def test_a_function_counts_without_its_timed_callees():
    ticks = Ticks()
    clock = StageClock(ticks)
    inner = clock.timed("inner", lambda: ticks.work(3.0))

    def body() -> str:
        ticks.work(1.0)
        inner()
        inner()
        ticks.work(0.5)
        return "result"

    outer = clock.timed("outer", body)
    assert outer() == "result"
    assert clock.seconds == {"inner": 6.0, "outer": 1.5}
    clock.reset()
    inner()
    assert clock.seconds == {"inner": 3.0}


def test_a_function_that_raises_is_counted_and_leaves_the_clock_usable():
    ticks = Ticks()
    clock = StageClock(ticks)

    def fail() -> None:
        ticks.work(2.0)
        raise ValueError

    outer = clock.timed("outer", clock.timed("inner", fail))
    for _ in range(2):
        with pytest.raises(ValueError):
            outer()
    assert clock.seconds == {"inner": 4.0, "outer": 0.0}


def test_every_stage_is_timed_and_no_result_changes():
    sample = drawn_hands(0)
    oracle = Oracle(sample, make_card())
    plain = oracle.estimator.estimate(sample.image, sample.camera)
    clock = StageClock()
    pose = timed_estimate(oracle.estimator, clock)(sample.image, sample.camera)
    assert set(clock.seconds) == set(ROWS) - {"body", "palms", "HandCheck"}, "networks that these weights lack"
    assert min(clock.seconds.values()) > 0
    for a, b in zip(plain.hands, pose.hands, strict=True):
        np.testing.assert_array_equal(a.joints_m, b.joints_m)
    before = dict(clock.seconds)
    oracle.estimator.estimate(sample.image, sample.camera)
    assert clock.seconds == before, "the estimator itself is not timed"
