"""`scripts/fit_range_errors.py`: what it finds where it is known, and what it cannot begin with."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scripts.fit_range_errors import Ranges, fitted, fitted_sigma, loss, ranges_in
from tests.oracles import Oracle, drawn_hands, make_card

from twohands.errors import InputError
from twohands.inference.decision import PlacementConfig
from twohands.inference.placement import posterior

ROOT = Path(__file__).parents[2]
PRIOR = PlacementConfig()


def pictures(count, errors, rng):
    """Both hands' ranges and estimates, drawn as `posterior_ranges` supposes they are."""
    alike = np.array([[1.0, PRIOR.correlation], [PRIOR.correlation, 1.0]])
    true = PRIOR.usual_range_m * np.exp(rng.multivariate_normal(np.zeros(2), PRIOR.usual_spread**2 * alike, count))
    mean = rng.uniform(0.4, 1.0, (count, 2))
    error = errors[0] * (errors[1] / errors[0]) ** ((1 - mean) / (1 - PRIOR.lower_score))
    estimated = true * np.exp(error * rng.normal(size=true.shape))
    misfit = np.full(2, PRIOR.sigma_misfit)
    return [Ranges(e, np.tile(m[:, None], (1, 21)), t, misfit) for e, m, t in zip(estimated, mean, true, strict=True)]


def test_the_errors_with_which_estimates_were_made_are_found_again():
    errors = (0.12, 0.25)
    found = pictures(250, errors, np.random.default_rng(4))
    best = fitted(found)
    np.testing.assert_allclose(best, errors, rtol=0.3)
    assert loss(found, best) <= loss(found, errors) < loss(found, (1e-6, 1e-6))


def test_a_hand_that_is_not_there_has_no_say():
    one = Ranges(np.array([0.5, 0.9]), np.full((2, 21), 0.7), np.array([0.45, np.nan]), np.full(2, 0.02))
    assert np.isfinite(loss([one], (0.05, 0.1)))


@pytest.mark.parametrize("present", [(True, True), (False, True), (False, False)])
def test_what_is_found_in_a_picture_stands_beside_what_is_true(present):
    sample = drawn_hands(1, present=present)
    found = ranges_in(Oracle(sample, make_card()).estimator, sample)
    assert found.scores.shape == (sum(present), 21)
    np.testing.assert_allclose(found.estimated, found.true, rtol=2e-2)
    assert found.misfit.shape == (sum(present),) and (found.misfit < 0.05).all()


def test_the_size_of_errors_is_found_again_and_how_it_goes_with_the_misfit():
    """Errors of 0.6 times the posterior's, times the misfit to the power of 0.5."""
    rng = np.random.default_rng(5)
    errors = (0.05, 0.15)
    found = []
    for _ in range(1500):
        scores, misfit = np.full((1, 21), rng.uniform(0.7, 1)), np.exp(rng.normal(0, 0.7, 1)) * PRIOR.sigma_misfit
        likely, spread = posterior(np.array([0.5]), scores, PlacementConfig(range_errors=errors))
        sigma = 0.6 * spread * (misfit / PRIOR.sigma_misfit) ** 0.5
        found.append(Ranges(np.array([0.5]), scores, likely * (1 + sigma * rng.normal(size=1)), misfit))
    scale, power = fitted_sigma(found, errors)
    assert scale == pytest.approx(0.6, rel=0.08) and power == pytest.approx(0.5, abs=0.1)


def test_without_hands_there_is_nothing_to_fit():
    with pytest.raises(InputError, match="no labelled hand"):
        fitted([])


def test_what_cannot_be_read_is_one_line_and_exit_2(tmp_path):
    script = [sys.executable, str(ROOT / "scripts" / "fit_range_errors.py"), str(tmp_path / "none"), "--data", "x"]
    done = subprocess.run(script, capture_output=True, text=True, check=False)
    assert done.returncode == 2 and done.stderr.startswith("error: weights ") and done.stderr.count("\n") == 1
