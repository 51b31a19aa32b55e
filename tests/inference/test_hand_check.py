"""HandCheck: what it is shown, what its answer is in a decision, and how its layer is fitted."""

import dataclasses
import json
import shutil

import numpy as np
import pytest
import torch
from scripts import fit_hand_check
from scripts.fit_hand_check import NOTHING, Look, Looker, Looks, fit, moved_joints, regression, write
from tests.oracles import (
    Oracle,
    drawn_hands,
    hand_masks,
    make_card,
    restaged,
    true_boxes,
    write_tiny_weights,
)

from twohands.errors import InputError
from twohands.export.onnx import export_network
from twohands.geometry.boxes import upright_crop, warp_image
from twohands.geometry.network_input import network_input
from twohands.geometry.segmentation import HandBoxes
from twohands.inference.decision import FIRST_FEATURES, LAST_FEATURES
from twohands.inference.detection import Detection, HandFinder
from twohands.inference.engine import load_networks
from twohands.inference.hand_check import checked
from twohands.inference.handedness import ANSWERS, KEPT, LastLook, first_features, last_features
from twohands.inference.weights import HAND_CHECK, read_card
from twohands.models.checkpoint import load_network
from twohands.models.hand_check import HandCheck, HandCheckConfig
from twohands.skeleton import LEFT, RIGHT

SAMPLE = drawn_hands(7)
SAID = np.array([[5.0, 2.0], [-3.0, -1.0], [0.5, 4.0]])
"""Of both candidates, and of both together: a hand, and a left one."""


def located(oracle: Oracle, crops: list, hand_logit: float = 2.0) -> tuple[np.ndarray, np.ndarray]:
    """Heatmaps of any crops, all of them of hands; that is doubtful if the log-odds are below 3."""
    return oracle.true_maps(crops), np.full(len(crops), hand_logit)


def finder(check, hand_logit: float = 2.0, **decision) -> tuple[HandFinder, Detection]:
    """Of a picture of two hands that are known, and HandCheck a function."""
    card = make_card(hand_logit=True)
    card = dataclasses.replace(card, decision=dataclasses.replace(card.decision, **decision))
    oracle = Oracle(SAMPLE, card)
    estimator = restaged(oracle.estimator, check=check, locate=lambda crops: located(oracle, crops, hand_logit))
    masks, boxes_px = hand_masks(SAMPLE), true_boxes(SAMPLE)
    found = HandFinder(estimator.stages, card, SAMPLE.image, SAMPLE.camera)
    crops = found.crops(masks, boxes_px, np.array([LEFT, RIGHT]))
    boxes = HandBoxes(boxes_px, np.array([True, True]), np.ones(2))
    return found, Detection(masks, boxes, found.looked(masks, boxes_px, crops))


def test_it_sees_the_picture_as_it_is_around_the_joints():
    seen = []
    card = dataclasses.replace(make_card(), check_size=64, check_margin=1.4)
    answer = checked(lambda batch: seen.append(batch) or SAID[:2], card, SAMPLE.image, SAMPLE.joints_px)
    np.testing.assert_array_equal(answer, SAID[:2])
    crops = [warp_image(SAMPLE.image, upright_crop(one, size=64, margin=1.4), 64) for one in SAMPLE.joints_px]
    np.testing.assert_array_equal(seen[0], network_input(np.stack(crops)))


def test_what_it_says_of_every_candidate_is_evidence():
    asked = []
    here, found = finder(lambda image, joints_px, palms: asked.append(joints_px) or SAID[: len(joints_px)])
    evidence, _ = here.evidence(found, None)
    np.testing.assert_allclose(evidence.check, SAID[:2])
    assert np.isnan(evidence.merged_check).all()
    np.testing.assert_allclose(asked[0], found.keypoints.joints_px)


def test_it_is_not_asked_where_posenet2d_is_sure_of_every_candidate():
    here, found = finder(lambda *_: pytest.fail("it was asked"), hand_logit=4.0)
    evidence, _ = here.evidence(found, None)
    assert np.isnan(evidence.check).all()
    assert np.isnan(evidence.checks(np.array([0, 1]))).all()


def test_two_candidates_in_one_place_are_also_checked_as_one_hand():
    here, found = finder(lambda image, joints_px, palms: SAID[: len(joints_px)], same_place_iou=0.0)
    evidence, _ = here.evidence(found, None)
    np.testing.assert_allclose(evidence.check, SAID[:2])
    np.testing.assert_allclose(evidence.merged_check, SAID[2])


def test_a_candidate_that_is_alone_is_checked_alone():
    here, found = finder(lambda image, joints_px, palms: SAID[: len(joints_px)])
    alone = found._replace(keypoints=found.keypoints.rows([RIGHT]))
    evidence, _ = here.evidence(alone, None)
    np.testing.assert_allclose(evidence.check[RIGHT], SAID[0])
    assert np.isnan(evidence.check[LEFT]).all()


def test_without_it_nothing_is_said():
    here, found = finder(None)
    evidence, _ = here.evidence(found, None)
    assert np.isnan(evidence.check).all() and np.isnan(evidence.merged_check).all()


def test_what_it_says_of_the_hands_of_an_answer():
    """Of exchanged candidates that of the other one, of two in one place that of both together where it is surer."""
    here, found = finder(lambda image, joints_px, palms: SAID[: len(joints_px)])
    apart, _ = here.evidence(found, None)
    np.testing.assert_allclose(apart.checks(np.array([1, 0])), SAID[[1, 0], 0])
    np.testing.assert_allclose(apart.checks(np.array([-1, 1])), [np.nan, SAID[1, 0]])
    here, found = finder(lambda image, joints_px, palms: SAID[: len(joints_px)], same_place_iou=0.0)
    together, _ = here.evidence(found, None)
    np.testing.assert_allclose(together.checks(np.array([0, -1])), [SAID[2, 0], np.nan])
    np.testing.assert_allclose(together.checks(np.array([0, 1])), [SAID[0, 0], SAID[2, 0]], err_msg="the surer word")


def test_what_it_says_is_weighed_in_the_last_decision_by_hand():
    source, first = np.array([0, 1]), np.array([1.0, 1.0])
    for check, expected in (([9.0, -2.0], (-5, 0)), ([np.nan, 2.5], (-0.5, 1)), ([3.0, -9.0], (-9, 0))):
        look = LastLook(source, first, first, first, np.array([0.2, 0.2]), check=np.array(check))
        both = dict(zip(LAST_FEATURES, last_features(look)[KEPT.index((True, True))], strict=True))
        assert (both["check_short"], both["check_unseen"]) == expected


def test_what_it_says_is_weighed_in_the_first_decision_by_hand():
    """Of a left hand its word for a left one, of a right hand against it; of both together features of their own."""

    def weighed(answer: tuple[int, int], **decision: float) -> dict[str, float]:
        here, found = finder(lambda image, joints_px, palms: SAID[: len(joints_px)], **decision)
        rows = first_features(here.evidence(found, None)[0])
        return dict(zip(FIRST_FEATURES, rows[ANSWERS.index(answer)], strict=True))

    pair, swapped = weighed((0, 1)), weighed((1, 0))
    assert (pair["check"], pair["check_side"], pair["check_unseen"]) == (5 - 3, 2 + 1, 0)
    assert (swapped["check"], swapped["check_side"]) == (5 - 3, -1 - 2)
    one = weighed((-1, 1), same_place_iou=0.0)
    assert (one["merged_check"], one["merged_check_side"], one["check"]) == (0.5, -4, 0)
    here, found = finder(None)
    unseen = dict(zip(FIRST_FEATURES, first_features(here.evidence(found, None)[0])[5], strict=True))
    assert (unseen["check"], unseen["check_side"], unseen["check_unseen"]) == (0, 0, 2)


def test_crops_that_cannot_be_are_refused():
    for size in (0, 100):
        with pytest.raises(InputError, match="multiple of 32"):
            HandCheckConfig(size)


@pytest.fixture(scope="module")
def preset(tmp_path_factory):
    """A preset with second pose networks, of which no HandCheck is known yet."""
    folder = tmp_path_factory.mktemp("weights")
    write_tiny_weights(folder / "other")
    own = write_tiny_weights(folder / "own")
    card = json.loads((own / "card.json").read_text()) | {"second": "other"}
    (own / "card.json").write_text(json.dumps(card))
    return own


def test_a_fitted_layer_is_shipped_and_asked(preset, tmp_path):
    """As the network that was fitted, and beside the second pose networks."""
    home = shutil.copytree(preset.parent, tmp_path / "weights") / preset.name
    torch.manual_seed(0)
    network, rng = HandCheck(HandCheckConfig(64)), np.random.default_rng(0)
    weights, biases = rng.normal(size=(2, 1152)), np.array([-2.0, 0.5])
    write(home, network, weights, biases, {"crops": 5})
    card = read_card(home)
    second = load_networks(home, card).second
    assert second is not None and second.hand_check is not None
    assert (second.card.check_size, second.card.check_margin) == (64, fit_hand_check.MARGIN)
    path = home.parent / "other" / f"{HAND_CHECK}.onnx"
    loaded, crops = load_network(HAND_CHECK, path), rng.uniform(-0.5, 0.5, (3, 3, 64, 64)).astype(np.float32)
    assert isinstance(loaded, HandCheck)
    np.testing.assert_allclose(loaded.head.bias.detach(), biases)
    with torch.no_grad():
        wanted = loaded(torch.from_numpy(crops)).numpy()
    np.testing.assert_allclose(second.hand_check(crops), wanted, atol=1e-3 * np.abs(wanted).max())


def test_the_published_encoder_is_what_is_exported(tmp_path):
    """The features that a layer is fitted to are those under it in the shipped network."""
    torch.manual_seed(1)
    network = HandCheck(HandCheckConfig(32)).eval()
    crops = np.random.default_rng(2).uniform(-0.5, 0.5, (2, 3, 32, 32)).astype(np.float32)
    features = fit_hand_check.encoder_of(network)(crops)
    export_network(network, tmp_path / "hand_check.onnx")
    loaded = load_network(HAND_CHECK, tmp_path / "hand_check.onnx")
    assert isinstance(loaded, HandCheck)
    with torch.no_grad():
        wanted = loaded.features(torch.from_numpy(crops)).numpy()
    assert features.shape == (2, 1152)
    np.testing.assert_allclose(features, wanted, atol=1e-4 * np.abs(wanted).max())


def test_a_regression_finds_the_log_odds_of_two_normal_distributions():
    """Of unit variance about 1 and -1 they are twice the value, but for the penalty."""
    rng = np.random.default_rng(0)
    true = rng.random(40_000) < 0.5
    values = np.where(true, 1.0, -1.0) + rng.normal(size=len(true))
    weights, bias = regression(
        np.stack([values, rng.normal(size=len(true))], axis=1).astype(np.float32), true, true + 1.0 - true
    )
    np.testing.assert_allclose([*weights, bias], [2.0, 0.0, 0.0], atol=0.2)


def test_hands_and_other_things_count_alike():
    """There are nine hands for one thing that is none; even chances lie in the middle between them all the same."""
    rng = np.random.default_rng(0)
    shown = np.where(rng.random(20_000) < 0.1, NOTHING, rng.integers(0, 2, 20_000))
    values = np.where(shown == NOTHING, -1.0, 1.0) + rng.normal(size=len(shown))
    kinds, pictures = np.full(len(shown), "hands"), np.arange(len(shown))
    weights, biases = fit(Looks(kinds, shown, pictures, values[:, None].astype(np.float32)))
    assert weights[0, 0] > 1.5 and abs(biases[0]) < 0.2 * weights[0, 0]


def test_the_side_is_learnt_from_hands_alone():
    """What shows no hand says nothing of sides, whatever it looks like."""
    rng = np.random.default_rng(0)
    shown = rng.integers(-1, 2, 9000)
    values = np.select([shown == LEFT, shown == RIGHT], [1.0, -1.0], 5.0) + rng.normal(size=len(shown))
    kinds, pictures = np.full(len(shown), "hands"), np.arange(len(shown))
    weights, biases = fit(Looks(kinds, shown, pictures, values[:, None].astype(np.float32)))
    np.testing.assert_allclose([weights[1, 0], biases[1]], [2.0, 0.0], atol=0.2)


def test_every_place_of_a_picture_knows_what_it_shows():
    """Candidates that are hands, hands themselves, and places where none is."""
    oracle = Oracle(SAMPLE, make_card(hand_logit=True))
    estimator = restaged(oracle.estimator, locate=lambda crops: located(oracle, crops))
    looker, rng = Looker(estimator, lambda batch: np.zeros((1, 4)), 32), np.random.default_rng(0)
    places = [place for _ in range(40) for place in looker.places(SAMPLE, rng)]
    sides = {
        kind: {shown for other, shown, _ in places if other == kind} for kind in ("candidates", "hands", "elsewhere")
    }
    assert sides == {"candidates": {LEFT, RIGHT}, "hands": {LEFT, RIGHT}, "elsewhere": {NOTHING}}
    for kind, _, joints_px in places:
        if kind == "elsewhere":
            apart = np.linalg.norm(SAMPLE.joints_px.reshape(-1, 2) - joints_px.mean(axis=0), axis=1).min()
            assert apart > fit_hand_check.NEAREST * np.ptp(joints_px, axis=0).max()
    looks = list(looker.looks(SAMPLE, 3, rng))
    assert all(isinstance(look, Look) and look.picture == 3 and look.features.shape == (4,) for look in looks)


def test_joints_are_moved_as_one():
    joints_px = SAMPLE.joints_px[LEFT]
    moved = moved_joints(joints_px, np.random.default_rng(5))
    before, after = (np.linalg.norm(each[:, None] - each, axis=-1) for each in (joints_px, moved))
    ratio = after[before > 0] / before[before > 0]
    assert ratio.std() < 1e-9 and 0.5 < ratio[0] < 2 and ratio[0] != 1


def test_caches_come_back_and_their_pictures_stay_apart(tmp_path):
    looks = [Look(0, "hands", LEFT, np.ones(3, np.float16)), Look(4, "elsewhere", NOTHING, np.zeros(3, np.float16))]
    fit_hand_check.save(tmp_path / "a.npz", looks)
    back = fit_hand_check.load([tmp_path / "a.npz"] * 2)
    assert back.picture.tolist() == [0, 4, 5, 9] and back.shown.tolist() == [LEFT, NOTHING] * 2
    assert back.features.dtype == np.float32 and back.kind.tolist() == ["hands", "elsewhere"] * 2
    (tmp_path / "b.npz").write_bytes(b"none")
    with pytest.raises(InputError, match=r"b\.npz is no cache of crops"):
        fit_hand_check.load([tmp_path / "b.npz"])
