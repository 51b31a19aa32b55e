"""`scripts/fit_range_errors.py`: what it finds where it is known, and what it cannot begin with."""

import dataclasses
import json

import numpy as np
import pytest
from scripts.fit_range_errors import (
    Off,
    Ranges,
    fitted,
    fitted_bodies,
    fitted_sigma,
    loss,
    main,
    ranges_in,
    share_within,
    usual_ranges,
    write_to_card,
)
from tests.inference.test_body import at_a_wrist, known_hands
from tests.inference.test_second_look import SAMPLE, Two
from tests.oracles import Oracle, drawn_hands, make_card

from twohands.errors import InputError
from twohands.geometry.body import BODY_TERMS
from twohands.inference.decision import PlacementConfig
from twohands.inference.estimator import HandEstimator
from twohands.inference.placement import range_sigma
from twohands.skeleton import ROOT, WRIST

PRIOR = PlacementConfig()
NOBODY = np.full((2, 6), np.nan)
ALWAYS = {"second": {"second": 1.0}}


def pictures(count, errors, rng):
    """Both hands' ranges and estimates, drawn as `posterior_ranges` supposes they are."""
    alike = np.array([[1.0, PRIOR.correlation], [PRIOR.correlation, 1.0]])
    true = PRIOR.usual_range_m * np.exp(rng.multivariate_normal(np.zeros(2), PRIOR.usual_spread**2 * alike, count))
    mean = rng.uniform(0.4, 1.0, (count, 2))
    error = errors[0] * (errors[1] / errors[0]) ** ((1 - mean) / (1 - PRIOR.lower_score))
    estimated = true * np.exp(error * rng.normal(size=true.shape))
    usual = np.full(2, PRIOR.sigma_misfit), np.full(2, PRIOR.sigma_span), NOBODY
    return [Ranges(e, np.tile(m[:, None], (1, 21)), t, *usual) for e, m, t in zip(estimated, mean, true, strict=True)]


def test_the_errors_with_which_estimates_were_made_are_found_again():
    errors = (0.12, 0.25)
    found = pictures(250, errors, np.random.default_rng(4))
    best = fitted(found, PRIOR)
    np.testing.assert_allclose(best, errors, rtol=0.3)
    losses = [loss(found, dataclasses.replace(PRIOR, range_errors=each)) for each in (best, errors, (1e-6, 1e-6))]
    assert losses[0] <= losses[1] < losses[2]


def test_usual_ranges_are_found_again_and_a_set_counts_as_much_as_a_larger_one():
    rng = np.random.default_rng(6)
    near, far = (
        [scaled(one, factor) for one in pictures(count, (0.1, 0.2), rng)] for factor, count in ((0.5, 4000), (2.0, 500))
    )
    usual = usual_ranges([near, far])
    assert usual.usual_range_m == pytest.approx(PRIOR.usual_range_m, rel=0.05)
    apart = np.log(2) ** 2  # variance of the sets' means
    variance = PRIOR.usual_spread**2 + apart
    assert usual.usual_spread == pytest.approx(np.sqrt(variance), rel=0.05)
    shared = PRIOR.correlation * PRIOR.usual_spread**2 + apart
    assert usual.correlation == pytest.approx(shared / variance, rel=0.05)


def test_of_single_hands_the_correlation_is_left_as_it_was():
    single = Ranges(
        np.array([0.5]), np.full((1, 21), 0.7), np.array([0.45]), np.full(1, 0.02), np.full(1, 0.4), NOBODY[:1]
    )
    assert usual_ranges([[single], []]).correlation == PRIOR.correlation


def scaled(one: Ranges, factor: float) -> Ranges:
    """The same hands, farther by a factor."""
    return one._replace(estimated=factor * one.estimated, true=factor * one.true)


def test_a_hand_that_is_not_there_has_no_say():
    one = Ranges(
        np.array([0.5, 0.9]), np.full((2, 21), 0.7), np.array([0.45, np.nan]), np.full(2, 0.02), np.full(2, 0.4), NOBODY
    )
    assert np.isfinite(loss([one], PlacementConfig(range_errors=(0.05, 0.1))))


@pytest.mark.parametrize("present", [(True, True), (False, True), (False, False)])
def test_what_is_found_in_a_picture_stands_beside_what_is_true(present):
    sample = drawn_hands(1, present=present)
    found = ranges_in(Oracle(sample, make_card()).estimator, sample)
    assert found.scores.shape == (sum(present), 21)
    np.testing.assert_allclose(found.estimated, found.true, rtol=2e-2)
    assert found.misfit.shape == (sum(present),) and (found.misfit < 0.05).all()
    assert found.span.shape == (sum(present),) and (found.span > 0.1).all()


def test_what_tells_of_a_range_is_of_the_pair_whose_range_it_is():
    """Named case: of a hand whose joints are the second pair's, its scores were fitted, and the first one's used."""
    two = Two(scores=(0.5, 0.9), decision=ALWAYS)
    pose, found = two.estimate(), ranges_in(two.estimator, SAMPLE)
    assert [hand.pair for hand in pose.hands] == [1, 1]
    np.testing.assert_allclose(found.scores.mean(axis=-1), [0.5, 0.9])
    np.testing.assert_allclose(found.estimated, [hand.range_m for hand in pose.hands])


def test_how_far_hands_are_by_their_body_is_found_again():
    """600 people, as far as their bodies' sizes say but for what both hands have in common and each by itself."""
    rng, weights = np.random.default_rng(8), np.array([-2.0, -0.7, -0.2, 0.3, -0.8, 0.6])
    people = []
    for one in pictures(600, (0.1, 0.2), rng):
        off = rng.multivariate_normal(np.zeros(2), 0.15**2 * np.array([[1, 0.6], [0.6, 1]]))
        terms = np.column_stack([np.ones(2), rng.normal(0, 0.3, (2, BODY_TERMS - 1))])
        beside = np.log(one.true) - terms @ weights - off
        people.append(one._replace(body=np.column_stack([terms, beside])))
    config = fitted_bodies(people, dataclasses.replace(PRIOR, range_errors=(0.1, 0.2)))
    np.testing.assert_allclose(config.body_weights, weights, atol=0.05)
    assert config.body_spread == pytest.approx(0.15, rel=0.3)
    assert config.body_correlation == pytest.approx(0.6, abs=0.25)
    assert loss(people, config) < 0.9 * loss(people, dataclasses.replace(config, body_weights=()))
    assert fitted_bodies(pictures(3, (0.1, 0.2), rng), PRIOR) == PRIOR, "where there is nobody"


def test_what_a_body_says_stands_beside_its_hands():
    estimator, sample = known_hands()
    placement = dataclasses.replace(estimator.card.placement, body_weights=(0.0,) * BODY_TERMS)
    card, body = dataclasses.replace(estimator.card, placement=placement), at_a_wrist(sample)
    for seen in (body, None):
        stages = dataclasses.replace(estimator.stages, body=lambda *_, seen=seen: seen)
        found = ranges_in(HandEstimator(estimator.networks, card, stages), sample)
        if seen is None:
            assert np.isnan(found.body).all() and found.body.shape == (2, BODY_TERMS + 1)
        else:
            lengths_m = np.linalg.norm(sample.joints_m[:, ROOT] - sample.joints_m[:, WRIST], axis=-1)
            terms, beside = body.distance_terms(sample.camera.fx, lengths_m)
            np.testing.assert_allclose(found.body, np.column_stack([terms, [beside] * 2]))


def test_the_size_of_errors_is_found_again_and_how_it_goes_with_score_and_misfit():
    """Two sets of different difficulty, with errors as one rule makes them."""
    rng = np.random.default_rng(5)
    true = (0.04, 0.8, 0.3, 1.0)
    sets = []
    for low, high, count in ((0.6, 0.95, 3000), (0.95, 1.0, 1000)):
        scores = np.tile(rng.uniform(low, high, count)[:, None], (1, 21))
        misfit = np.exp(rng.normal(0, 0.7, count)) * PRIOR.sigma_misfit
        span = rng.uniform(0.2, 0.45, count)
        sigma = range_sigma(scores, misfit, span, PlacementConfig(range_sigma=true))
        sets.append(Off(np.abs(sigma * rng.normal(size=count)), scores, misfit, span))
    found = fitted_sigma(sets)
    np.testing.assert_allclose(found, true, rtol=0.15, atol=0.11)
    config = PlacementConfig(range_sigma=found)
    assert all(share_within(one, config) == pytest.approx(0.683, abs=0.04) for one in sets)


def test_the_card_keeps_all_else(tmp_path):
    card = tmp_path / "card.json"
    card.write_text(json.dumps({"name": "x", "placement": {"ray_share": 0.4, "range_errors": [1, 2]}}))
    write_to_card(card, {"range_errors": [0.1, 0.2], "range_sigma": [0.03, 0.8, 0.2, 1]})
    kept = {"ray_share": 0.4, "range_errors": [0.1, 0.2], "range_sigma": [0.03, 0.8, 0.2, 1]}
    assert json.loads(card.read_text()) == {"name": "x", "placement": kept}
    assert list(tmp_path.iterdir()) == [card]


def test_without_hands_there_is_nothing_to_fit():
    with pytest.raises(InputError, match="no labelled hand"):
        usual_ranges([[]])


def test_what_cannot_be_read_is_one_line_and_exit_2(tmp_path, run_program):
    code, errors = run_program(main, tmp_path / "none", "--data", "x")
    assert code == 2 and errors.startswith("error: weights ") and errors.count("\n") == 1
