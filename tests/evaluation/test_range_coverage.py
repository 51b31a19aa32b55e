"""How often ranges lie within what is said of them: what is counted, on perfect networks."""

import numpy as np
import pytest
from benchmarks.range_coverage import COLUMNS, Adults, Row, main, measured
from tests.oracles import Oracle, drawn_hands, make_card

from twohands.inference.range_sigma import ASSUMED_LENGTH_SPREAD, TYPED_LENGTH_SPREAD
from twohands.skeleton import ROOT, WRIST

CARD = make_card(range_sigma=(0.05, 0.0, 0.0, 0.0))


def test_shares_are_those_of_errors_within_so_many_sigmas():
    row = Row("set", "given", np.array([[0.4], [0.9], [1.9], [4.0]]), np.ones((4, 1)), np.full((4, 1), 10.0))
    assert row.cells() == ["set", "given", "4", "0.25", "0.50", "0.50", "0.75", "0.75", "10.0 %", "14.0 %"]
    assert len(row.cells()) == len(COLUMNS)


def test_with_its_own_length_a_hand_is_where_it_is_and_with_another_as_much_off():
    sample = drawn_hands(1)
    estimator = Oracle(sample, CARD).estimator
    lengths = np.linalg.norm(sample.joints_m[:, ROOT] - sample.joints_m[:, WRIST], axis=-1)
    true = np.linalg.norm(sample.joints_m[:, ROOT], axis=-1)
    people = Adults(np.array([0.1, 0.12]), np.array([0.95, 1.0, 1.1]))
    given = measured(estimator, [sample], [lengths], "set", "board", people)
    assert given.length == "given" and given.errors.shape == (2, 1) and (given.errors[:, 0] / true < 0.02).all()
    np.testing.assert_allclose(given.sigmas[:, 0] / true, 0.05, rtol=0.02)
    typed = measured(estimator, [sample], [lengths], "set", "typed", people)
    np.testing.assert_allclose(typed.ranges, true[:, None] * people.palm_shares)
    np.testing.assert_allclose(typed.errors / true[:, None], np.tile([0.05, 0, 0.1], (2, 1)), atol=0.02)
    np.testing.assert_allclose(typed.sigmas[:, 0] / true, np.hypot(0.05, TYPED_LENGTH_SPREAD), rtol=0.02)
    assumed = measured(estimator, [sample], [lengths], "set", "assumed", people)  # rightly of the first adult
    np.testing.assert_allclose(assumed.errors[:, 0] / assumed.ranges[:, 0], 0, atol=0.02)
    np.testing.assert_allclose(assumed.errors[:, 1] / assumed.ranges[:, 1], 1 - 0.1 / 0.12, atol=0.02)
    np.testing.assert_allclose(
        assumed.sigmas[:, 0] / assumed.ranges[:, 0], np.hypot(0.05, ASSUMED_LENGTH_SPREAD), rtol=0.02
    )


@pytest.mark.parametrize(
    ("arguments", "message"), [([], "no pictures: give --data"), (["--data", "folder"], "NAME=FOLDER expected")]
)
def test_what_cannot_be_measured_is_one_line_and_exit_2(arguments, message, run_program):
    code, errors = run_program(main, *arguments)
    assert code == 2 and message in errors and errors.count("\n") == 1
