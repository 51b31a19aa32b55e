"""`scripts/fit_handedness.py`: what is right, how it counts, and that known weights are found again."""

import dataclasses

import numpy as np
import pytest
from scripts.fit_handedness import (
    COLUMNS,
    FEATURES,
    INVENTED,
    RIGHTLY,
    TRUST,
    WRONG_SIDE,
    Choices,
    Seen,
    answered,
    counted,
    cross_validated,
    fit,
    fit_only,
    judged_by,
    likeliest,
    load,
    main,
    moved,
    near,
    outcome_of,
    outcomes,
    renumbered,
    right_answers,
    save,
    seen,
    side_changed,
    write_decision,
)
from tests.oracles import Oracle, drawn_hands, hand_masks, make_card, write_tiny_weights

from twohands.errors import InputError
from twohands.geometry.body import Body
from twohands.geometry.segmentation import BoxEvidence, HandBoxes
from twohands.inference.decision import DecisionConfig
from twohands.inference.detection import Detection
from twohands.inference.estimator import HandEstimator
from twohands.inference.handedness import ANSWERS, Before, Evidence, answer_scores, first_features, probabilities
from twohands.inference.keypoints import Keypoints
from twohands.inference.weights import read_card
from twohands.skeleton import LEFT, RIGHT
from twohands.types import HandCrop

NO = np.nan


def judged_picture(rng, scene: int, earlier: int = -1) -> Seen:
    """A LEFT candidate alone, which is a left hand, a right one or none as PoseNet2D's log-odds say."""
    kind = rng.choice([RIGHTLY, WRONG_SIDE, INVENTED], p=[0.5, 0.3, 0.2])
    pose = np.array([[4.0, NO], [-4.0, NO]]) if kind == RIGHTLY else np.array([[-4.0, NO], [4.0, NO]])
    pose = np.where(kind == INVENTED, -np.abs(pose), pose) + rng.normal(0, 2, (2, 1))
    boxes_px = np.array([[20.0, 10, 60, 50], [NO] * 4])
    maps = BoxEvidence(*np.zeros((4, 2, 2)))
    evidence = Evidence((100, 200), boxes_px, maps, pose, np.where(np.isnan(pose), NO, 0.8))
    last, boxes, outcome = np.full((7, 2, 3), NO), np.full((7, 2, 4), NO), np.zeros((7, 2), int)
    for answer, side in ((1, 0), (3, 1)):
        last[answer, side], boxes[answer, side] = [pose[side, 0], 0.8, 0.2], boxes_px[0]
        outcome[answer, side] = kind if kind == INVENTED or side == 0 else WRONG_SIDE + RIGHTLY - kind
    present = np.array([kind == RIGHTLY, kind == WRONG_SIDE])
    return Seen("made", scene, present, evidence, last, np.full(7, np.inf), boxes, outcome, earlier)


def test_right_answers_have_only_right_hands_and_as_many_as_can_be():
    outcome = np.zeros((7, 2), int)
    outcome[1, 0], outcome[4, 1], outcome[5] = RIGHTLY, INVENTED, [RIGHTLY, INVENTED]
    everything = np.ones(7, bool)
    assert [ANSWERS[i] for i in np.flatnonzero(right_answers(outcome, everything))] == [(0, -1)]
    outcome[2, 0] = RIGHTLY  # the same hand twice
    assert [ANSWERS[i] for i in np.flatnonzero(right_answers(outcome, everything))] == [(0, -1), (1, -1)]
    outcome[5] = RIGHTLY
    assert [ANSWERS[i] for i in np.flatnonzero(right_answers(outcome, everything))] == [(0, 1)]
    assert np.flatnonzero(right_answers(np.zeros((7, 2), int), everything)).tolist() == [0]


@pytest.mark.parametrize(
    ("outcome", "present", "expected"),
    [
        ([RIGHTLY, RIGHTLY], [True, True], [1, 2, 2, 0, 0, 0]),
        ([WRONG_SIDE, WRONG_SIDE], [True, True], [1, 2, 0, 2, 0, 0]),
        ([RIGHTLY, WRONG_SIDE], [True, False], [1, 1, 1, 0, 0, 1]),  # the same hand twice
        ([0, WRONG_SIDE], [True, False], [1, 1, 0, 1, 0, 0]),
        ([INVENTED, 0], [False, True], [1, 1, 0, 0, 1, 1]),
    ],
)
def test_errors_by_kind(outcome, present, expected):
    assert counted(np.array(outcome), np.array(present)).tolist() == expected
    assert len(COLUMNS) == 6


def test_what_a_reported_hand_is():
    sample = drawn_hands(0)
    left, right = sample.joints_px
    assert outcome_of(left, 0, sample) == RIGHTLY and outcome_of(right, 0, sample) == WRONG_SIDE
    assert outcome_of(left + 200, 0, sample) == INVENTED
    alone = drawn_hands(0, present=(False, True))
    assert outcome_of(left, 0, alone) in (WRONG_SIDE, INVENTED)


def test_likelihood_finds_the_weights_that_made_the_answers():
    rng = np.random.default_rng(0)
    weights = np.array([1.5, -0.7, 0.4])
    features = rng.normal(0, 1, (4000, 4, 3))
    features[:, 0] = 0.0
    features[rng.random(4000) < 0.3, 3] = NO
    chances = probabilities(answer_scores(features, weights))
    chosen = (rng.random((4000, 1)) > chances.cumsum(axis=1)).sum(axis=1)
    right = np.arange(4) == chosen[:, None]
    np.testing.assert_allclose(likeliest(Choices(features, right)), weights, atol=0.1)
    given = likeliest(Choices(features, right), np.array([1.0, NO, NO]))
    assert given[0] == 1.0  # as given, whatever was chosen
    np.testing.assert_allclose(given[1:], weights[1:], atol=0.15)
    vague = right.copy()
    vague[np.arange(500), (chosen[:500] + 1) % 4] = True
    vague &= np.isfinite(features[..., 0])
    np.testing.assert_allclose(likeliest(Choices(features, vague)), weights, atol=0.25)


def test_nothing_to_fit_is_said():
    features = np.full((3, 4, 2), NO)
    features[:, 0] = 0.0
    with pytest.raises(InputError, match="nothing to fit"):
        likeliest(Choices(features, np.arange(4) == np.zeros((3, 1))))


def test_a_fit_tells_sides_and_ghosts_and_what_it_says_is_as_often_true(capsys):
    rng = np.random.default_rng(0)
    pictures = []
    for scene in range(120):
        pictures.append(judged_picture(rng, scene))
        if scene % 2:
            pictures.append(pictures[-1]._replace(earlier=len(pictures) - 1))
    summary = cross_validated(pictures, DecisionConfig())
    counts = summary["held_out"]
    assert counts["hands"] > 60 and counts["same side"] > 0.9 * counts["hands"]
    said = capsys.readouterr().out
    assert "| made |" in said and "| made, next |" in said and "side changes" in said
    fitted = fit(pictures, DecisionConfig())
    assert fitted.first["pose_contrast"] + fitted.first["pose"] > 0 and fitted.last["first"] > 0


def test_what_handcheck_says_is_believed_where_it_is_right():
    """It passes what is right, and fails what is not; it knows the side."""
    rng = np.random.default_rng(1)
    pictures = [judged_picture(rng, scene) for scene in range(200)]
    for i, one in enumerate(pictures):
        left = 4.0 if one.present[LEFT] else -4.0
        check = np.array([[4.0, left] if (one.outcome == RIGHTLY).any() else [-2.0, 0.0], [NO, NO]])
        pictures[i] = one._replace(evidence=dataclasses.replace(one.evidence, check=check))
    fitted = fit(pictures, DecisionConfig())
    assert fitted.first["check"] > 0.2 and fitted.first["check_side"] > 0.2


def test_bodies_are_fitted_beside_what_there_is():
    """Bodies have a hand where there is one, of its side. Nothing else changes, nor what is decided without a body;
    and they are trusted more than these pictures teach."""
    rng = np.random.default_rng(2)
    pictures = [judged_picture(rng, scene) for scene in range(200)]
    config, seen = fit(pictures, DecisionConfig()), []
    for one in pictures:
        palms_px = np.array([[40.0, 30], [150, 30]] if one.present[LEFT] else [[150.0, 30], [40, 30]])
        palms_px = palms_px if one.present.any() else palms_px + 500
        body = Body(palms_px, np.zeros((2, 4)), np.array([0.9, 0.9]), *np.zeros((2, 2, 2)), *np.zeros((2, 3)))
        seen.append(one._replace(evidence=dataclasses.replace(one.evidence, body=body)))
    fitted = fit_only("bodies", [*seen, *pictures], config)
    assert set(FEATURES["bodies"]) == {name for name in fitted.first if fitted.first[name] != config.first[name]} | {
        "body_both", "merged_body", "merged_body_side", "merged_body_both"  # say nothing of one hand that is alone
    }  # fmt: skip
    assert fitted.last == config.last
    assert fitted.first["body"] > TRUST["body"] + 0.2 and fitted.first["body_side"] > 0.2
    for one in pictures:
        assert answered(one, None, fitted)[0] == answered(one, None, config)[0]


def test_palms_are_fitted_beside_what_there_is():
    """A palm passes where there is a hand, of its side; what shows none, or one that fails, is decided as before."""
    rng = np.random.default_rng(3)
    pictures = [judged_picture(rng, scene) for scene in range(200)]
    config, seen = fit(pictures, DecisionConfig()), []
    for one in pictures:
        palm = np.full((3, 3), NO)
        palm[0] = [0.9, 6.0 if one.present.any() else 2.0, 4.0 if one.present[LEFT] else -4.0]
        seen.append(one._replace(evidence=dataclasses.replace(one.evidence, palm=palm)))
    fitted = fit_only("palms", [*seen, *pictures], config)
    assert {name for name in fitted.first if fitted.first[name] != config.first[name]} == {"palm", "palm_side"}
    assert fitted.first["palm"] > 0.2 and fitted.first["palm_side"] > 0.2 and fitted.last == config.last
    for one, without in zip(seen, pictures, strict=True):
        if not one.present.any():
            assert answered(one, None, fitted)[0] == answered(without, None, config)[0]


def test_hands_that_only_the_second_pose_networks_know_are_no_inventions():
    """By the first ones' joints a hand is nowhere; by those of the others it is the right one."""
    sample = drawn_hands(7)
    known, nowhere = sample.joints_px, sample.joints_px + 1000
    crops = [HandCrop(np.zeros((8, 8, 3), np.uint8), np.eye(3), side, False) for side in (LEFT, RIGHT)]
    seen = Keypoints(crops, [], nowhere, np.ones((2, 21)), np.zeros(2))
    after = Detection(hand_masks(sample), HandBoxes(np.zeros((2, 4)), np.array([True, True]), np.ones(2)), seen)

    class Finder:
        def seen_better(self, found, boxes_px):
            return found._replace(keypoints=dataclasses.replace(found.keypoints, joints_px=known[[0, 0]]))

    assert outcomes(Finder(), after, np.zeros((2, 4)), sample) == [RIGHTLY, WRONG_SIDE]
    nobody = dataclasses.replace(sample, present=np.zeros(2, bool))
    assert outcomes(None, after, np.zeros((2, 4)), nobody) == [INVENTED, INVENTED]  # and nobody is asked


def test_hands_near_each_other_are_told_from_hands_apart():
    """By their palms: a hand's width apart, and three."""
    left = drawn_hands(7).joints_px[LEFT]
    size_px = np.ptp(left, axis=0).max()
    for widths, expected in ((0.4, True), (3.0, False)):
        pair = np.stack([left, left + np.array([widths * size_px, 0.0])])
        assert near(np.array([True, True]), pair) is expected
        assert not near(np.array([True, False]), pair)


def test_pictures_keep_what_came_before_them_when_some_are_left_out():
    rng = np.random.default_rng(0)
    pictures = [judged_picture(rng, scene) for scene in (0, 1)]
    pictures += [judged_picture(rng, 1, earlier=1), judged_picture(rng, 2)]
    some = renumbered(pictures[1:])
    assert [one.earlier for one in some] == [-1, 0, -1]


def test_evidence_is_kept_in_a_file_and_that_of_other_weights_refused(tmp_path):
    rng = np.random.default_rng(0)
    pictures = [judged_picture(rng, scene) for scene in range(5)]
    body = Body(*(rng.uniform(0, 100, shape) for shape in ((2, 2), (2, 4), 2, (2, 2), (2, 2), 3, 3)))
    pictures[1] = pictures[1]._replace(evidence=dataclasses.replace(pictures[1].evidence, body=body))
    path = tmp_path / "evidence.npz"
    save(path, pictures, "fast@1")
    for one, other in zip(pictures, load(path, "fast@1"), strict=True):
        np.testing.assert_array_equal(first_features(one.evidence), first_features(other.evidence))
        np.testing.assert_array_equal(one.last, other.last)
        assert (one.kind, one.scene, one.earlier) == (other.kind, other.scene, other.earlier)
    with pytest.raises(InputError, match="not of fast@2"):
        load(path, "fast@2")


def test_a_picture_moved_keeps_its_hands_under_its_joints():
    sample = drawn_hands(1)
    earlier = moved(sample, np.random.default_rng(0))
    off = earlier.joints_px - sample.joints_px
    assert earlier.image.shape == sample.image.shape and earlier.image.dtype == np.uint8
    assert 0 < np.abs(off).max() < 0.2 * sample.image.shape[1]
    np.testing.assert_array_equal(moved(sample, np.random.default_rng(0)).image, earlier.image)


def test_what_networks_of_the_truth_see_is_right():
    sample = drawn_hands(3)
    oracle = Oracle(sample, make_card(hand_logit=True, mirror_below_logit=-1.0))
    one = seen(oracle.estimator, sample, "drawn", 0, -1)
    pair = ANSWERS.index((0, 1))
    assert one.outcome[pair].tolist() == [RIGHTLY, RIGHTLY]
    assert one.outcome[ANSWERS.index((0, -1))].tolist() == [RIGHTLY, 0]
    assert [ANSWERS[i] for i in np.flatnonzero(right_answers(one.outcome, ~np.isnan(one.last).all((1, 2))))] == [(0, 1)]


def test_a_hand_that_takes_the_others_place_is_a_side_change():
    box_px, nowhere = [0.0, 0, 10, 10], [NO] * 4
    before = Before(np.array([box_px, nowhere]), np.array([3.0, NO]))
    assert side_changed(before, np.array([nowhere, box_px]))
    assert not side_changed(before, np.array([box_px, nowhere]))
    assert not side_changed(before, np.array([nowhere, [40.0, 0, 50, 10]]))


def test_the_card_takes_the_weights_and_keeps_the_rest(tmp_path):
    folder = write_tiny_weights(tmp_path / "tiny")
    before = read_card(folder)
    fitted = DecisionConfig({"hand": -1.0}, {"first": 1.0}, {"penalty": 1.0})
    write_decision(folder, fitted)
    after = read_card(folder)
    assert after.decision == fitted and after.views == before.views and after.placement == before.placement


def test_it_tells_what_it_cannot_begin_with(tmp_path, run_program):
    folder = write_tiny_weights(tmp_path / "tiny")
    code, errors = run_program(main, folder, "--cache", tmp_path / "e.npz")
    assert code == 2 and "no hand classifier" in errors


def test_a_judge_sees_our_candidates_in_its_own_crops(tmp_path):
    own = HandEstimator.from_preset(write_tiny_weights(tmp_path / "own"))
    judge = HandEstimator.from_preset(write_tiny_weights(tmp_path / "judge", crop_size=64, map_size=16))
    both = judged_by(own, judge)
    assert both.networks.hand_seg_net is own.networks.hand_seg_net
    assert both.networks.pose_net_2d is judge.networks.pose_net_2d
    assert both.card.crop_size == 64 and both.card.decision is own.card.decision
    assert both.card.views is own.card.views


def test_pictures_of_different_judges_keep_their_own_past():
    """A scene comes once by every judge; each goes on from what that judge saw before."""
    rng = np.random.default_rng(0)
    scene = [judged_picture(rng, 7), judged_picture(rng, 7, 0), judged_picture(rng, 7), judged_picture(rng, 7, 2)]
    scene[2:] = [one._replace(kind="made by another") for one in scene[2:]]
    kept = renumbered([judged_picture(rng, 3), *scene])
    assert [one.earlier for one in kept] == [-1, -1, 1, -1, 3]
