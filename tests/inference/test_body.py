"""A person's body: where it is looked for, what its hands are worth as candidates and as evidence."""

import dataclasses
import hashlib
import json
from functools import partial

import numpy as np
import pytest
from tests.geometry.test_body import ANCHORS, standing
from tests.inference.test_following import surely
from tests.oracles import Oracle, drawn_hands, hand_masks, make_card, restaged

from twohands.geometry.body import BODY_TERMS, Body, body_square
from twohands.geometry.boxes import apply_homography
from twohands.geometry.segmentation import HandBoxes
from twohands.inference.body import BodyNetworks, BodySight, guessed_masks, seen_body, with_body
from twohands.inference.detection import Detection, HandFinder
from twohands.inference.engine import load_networks
from twohands.inference.estimator import HandEstimator
from twohands.inference.placement import refine
from twohands.inference.stages import StageTruth
from twohands.inference.trail import Trail
from twohands.inference.weights import BODY_NETWORKS, network_files, preset_folder, read_card

NO = np.nan
SIZE = (200, 300)
BODY = Body(
    np.array([[200.0, 100], [60, 100]]),
    np.array([[180.0, 80, 220, 120], [40, 80, 80, 120]]),
    np.array([0.9, 0.9]),
    np.array([[130.0, 100], [130, 20]]),
    np.array([[10.0, 0], [0, 10]]),
    np.array([40.0, 8.0, 60.0]),
    np.array([-5.0, -10.0, 2.0]),
)
NOTHING = np.full(4, NO)


class Networks:
    """A body that is found where it is put, and seen in every crop around it; what was asked is kept."""

    def __init__(self, *, found=True, chances=(0.9,)):
        self.asked: list[str] = []
        self.found, self.chances = found, list(chances)
        self.networks = BodyNetworks(self.finder, self.joints)

    def finder(self, batch):
        assert batch.shape == (1, 224, 224, 3) and batch.min() >= -1 and batch.max() <= 1
        self.asked.append("finder")
        points, logits = np.zeros((1, ANCHORS, 12), np.float32), np.full((1, ANCHORS, 1), -9.0, np.float32)
        points[0, 0, 4:8] = 100, 100, 100, 40
        logits[0, 0] = 4.0 if self.found else 1.0  # a chance of .98 or .73
        return points, logits

    def joints(self, batch):
        assert batch.shape == (1, 256, 256, 3) and batch.min() >= 0 and batch.max() <= 1
        self.asked.append("joints")
        return standing().reshape(1, -1)[:, :195].astype(np.float32), np.array([[self.chances.pop(0)]], np.float32)


def picture(size=SIZE):
    return np.random.default_rng(0).integers(0, 256, (*size, 3), np.uint8)


def test_a_body_is_found_and_then_seen_closer():
    said = Networks()
    body = seen_body(said.networks, picture((224, 224)))
    assert said.asked == ["finder", "joints"]
    place = body_square(np.array([[104.0, 104], [104, 44]]))  # of the finder's first anchor
    np.testing.assert_allclose(
        body.palms_px, apply_homography(place, np.array([[170, 490 / 3], [90, 490 / 3]])), rtol=1e-5
    )


@pytest.mark.parametrize(
    ("said", "asked", "there"),
    [
        (Networks(chances=[0.9]), ["joints"], True),  # where it was
        (Networks(chances=[0.1, 0.9]), ["joints", "finder", "joints"], True),  # not there any more, but elsewhere
        (Networks(found=False, chances=[0.1]), ["joints", "finder"], False),  # gone
        (Networks(chances=[0.1, 0.1]), ["joints", "finder", "joints"], False),  # what was found is none
    ],
)
def test_in_a_clip_it_is_looked_for_where_it_was(said, asked, there):
    body = seen_body(said.networks, picture(), BODY.around_px)
    assert said.asked == asked and (body is not None) == there


@pytest.mark.parametrize("found", [BODY, None])
def test_a_body_is_looked_for_once_and_only_when_it_is_asked_for(found):
    asked, known_px = [], np.zeros((2, 2))

    def look(around_px):
        asked.append(around_px)
        return found

    sight = BodySight(look, known_px)
    assert sight.around_px is known_px and not asked  # the clip goes on with what it knew
    assert sight() is found and sight() is found
    assert len(asked) == 1 and asked[0] is known_px
    assert sight.around_px is (None if found is None else BODY.around_px)


def boxes(left=NOTHING, right=NOTHING) -> HandBoxes:
    boxes_px = np.array([left, right], float)
    return HandBoxes(boxes_px, np.isfinite(boxes_px).all(axis=1), np.zeros(2))


def test_hands_that_are_missed_are_guessed():
    found = with_body(boxes(), lambda: BODY, SIZE)
    assert found.present.all() and found.guessed.all()
    np.testing.assert_array_equal(found.boxes_px, BODY.boxes_px)


@pytest.mark.parametrize(
    ("seen", "guessed"),
    [
        ({"left": [190, 90, 210, 110]}, [[190, 90, 210, 110], BODY.boxes_px[1]]),
        ({"right": [50, 90, 70, 110]}, [BODY.boxes_px[0], [50, 90, 70, 110]]),
        ({"left": [50, 90, 70, 110]}, [[50, 90, 70, 110], BODY.boxes_px[0]]),  # of the other side: that is told later
    ],
)
def test_the_wrist_that_has_no_candidate_gives_one(seen, guessed):
    found = with_body(boxes(**seen), lambda: BODY, SIZE)
    np.testing.assert_array_equal(found.boxes_px, np.array(guessed, float))
    assert found.guessed.sum() == 1 and found.present.all()


@pytest.mark.parametrize(
    "body",
    [
        None,
        BODY._replace(visible=np.array([0.4, 0.4])),  # hidden
        BODY._replace(palms_px=np.array([[310.0, 100], [60, 210]])),  # outside the picture
    ],
)
def test_hands_that_are_not_shown_are_not_guessed(body):
    assert not with_body(boxes(), lambda: body, SIZE).present.any()


def test_nothing_is_guessed_beside_two_candidates():
    two = boxes([0, 0, 10, 10], [20, 0, 30, 10])
    assert with_body(two, lambda: BODY, SIZE) is two


def test_guessed_hands_are_perhaps_there():
    masks = np.zeros(SIZE, np.uint8)
    masks[:, :60] = 1  # the left hand's
    found = guessed_masks(masks, with_body(boxes(), lambda: BODY, SIZE))
    assert found[100, 200] == 3 and found[100, 70] == 4  # perhaps left, perhaps right
    assert found[100, 50] == 1 and found[81, 181] == 0  # what is seen stays; a box's corner is no hand
    assert not masks[:, 60:].any()  # nothing is written into what was given
    np.testing.assert_array_equal(guessed_masks(masks, boxes([0, 0, 9, 9])), masks)


def known_hands(**stages):
    """An estimator that knows the hands of a picture, and the picture."""
    sample = drawn_hands(7)
    card = make_card(hand_logit=True)
    decision = dataclasses.replace(card.decision, first={"hand": 9.0}, last={"hand": 9.0})
    oracle = Oracle(sample, dataclasses.replace(card, decision=decision))

    def located(crops):
        return oracle.true_maps(crops), np.full(len(crops), 5.0)

    def lifted(keypoints):
        return oracle.canonical[keypoints.sides]

    return restaged(oracle.estimator, locate=located, lift=lifted, **stages), sample


def test_a_body_is_looked_for_where_it_was():
    asked = []

    def body(image, around_px):
        asked.append(around_px)
        return BODY

    estimator, sample = known_hands(body=body)
    first = estimator.estimate(sample.image, sample.camera)
    np.testing.assert_array_equal(first.around_px, BODY.around_px)
    estimator.estimate(sample.image, sample.camera, previous=Trail.of(first), index=1)
    assert asked[0] is None and asked[1] is first.around_px


def at_a_wrist(sample, side=0) -> Body:
    """A body with that wrist at that hand, and the other one far away, as large as one of 3 m is in the sample."""
    palms_px = np.full((2, 2), -900.0)
    palms_px[side] = sample.joints_px[side].mean(axis=0)
    return BODY._replace(palms_px=palms_px, sizes_px=np.full(3, sample.camera.fx / 3), depths_px=np.zeros(3))


def test_uncertain_hands_are_as_far_as_the_body_whose_they_are():
    """Also in the next frames, where nobody asks for a body, until somebody asks and there is none."""
    estimator, sample = known_hands()
    body, asked = at_a_wrist(sample), []
    placement = dataclasses.replace(
        estimator.card.placement, range_errors=(1e3, 1e3), body_weights=(0.0,) * BODY_TERMS, body_spread=1e-3
    )
    card = dataclasses.replace(estimator.card, placement=placement)
    seen = {"body": lambda *_: asked.append(1) or body, "refine": partial(refine, placement), "card": card}
    estimator = HandEstimator(estimator.networks, card, dataclasses.replace(estimator.stages, **seen))
    first = pose = estimator.estimate(sample.image, sample.camera)
    for frame in range(1, 4):
        np.testing.assert_allclose([hand.range_m for hand in pose.hands], 3.0, rtol=1e-5)
        trail = Trail((pose,), pose, may_rest=frame < 3, sides=surely(first))
        pose = estimator.estimate(sample.image, sample.camera, previous=trail, index=frame)
        assert pose.followed == (frame < 3) and len(asked) == 1
    body = None
    pose = estimator.estimate(sample.image, sample.camera, previous=Trail.of(pose), index=4)
    assert len(asked) == 2 and [hand.body_range_m for hand in pose.hands] == [None, None]


def test_who_has_longer_hands_is_farther_for_the_same_size():
    estimator, sample = known_hands()
    weights = (*(0.0,) * (BODY_TERMS - 1), 1.0)
    placement = dataclasses.replace(
        estimator.card.placement, range_errors=(1e3, 1e3), body_weights=weights, body_spread=1e-3
    )
    card = dataclasses.replace(estimator.card, placement=placement)
    seen = {"body": lambda *_: at_a_wrist(sample), "refine": partial(refine, placement), "card": card}
    estimator = HandEstimator(estimator.networks, card, dataclasses.replace(estimator.stages, **seen))
    pose = estimator.estimate(sample.image, sample.camera, np.array([0.1, 0.12]))
    np.testing.assert_allclose([hand.range_m for hand in pose.hands], [3.0, 3.6], rtol=1e-3)


def test_a_body_without_a_hand_at_a_wrist_says_nothing_of_hands():
    estimator, sample = known_hands()
    placement = dataclasses.replace(estimator.card.placement, body_weights=(0.0,) * BODY_TERMS)
    card = dataclasses.replace(estimator.card, placement=placement)
    for body, known in ((at_a_wrist(sample), True), (at_a_wrist(sample)._replace(visible=np.full(2, 0.4)), False)):
        stages = dataclasses.replace(estimator.stages, body=lambda *_, body=body: body)
        pose = HandEstimator(estimator.networks, card, stages).estimate(sample.image, sample.camera)
        assert (pose.left.body_range_m is not None) == (pose.right.body_range_m is not None) == known


def test_with_ground_truth_no_body_is_looked_for():
    def body(image, around_px):
        raise AssertionError("looked for a body")

    estimator, sample = known_hands(body=body)
    assert estimator.estimate(sample.image, sample.camera, truth=StageTruth(masks=hand_masks(sample))).left.present


def test_the_shipped_networks_are_those_that_were_published():
    """They take and give what is asked of them, and see nobody in noise."""
    folder = preset_folder("fast")
    networks = load_networks(folder, read_card(folder), threads=1)
    assert networks.second is not None and networks.second.body is not None
    assert seen_body(networks.second.body, picture((240, 320))) is None
    points, logits = networks.second.body.finder(np.zeros((1, 224, 224, 3), np.float32))
    joints, chance = networks.second.body.joints(np.zeros((1, 256, 256, 3), np.float32))
    assert (points.shape, logits.shape, joints.shape) == ((1, ANCHORS, 12), (1, ANCHORS, 1), (1, 195))
    assert 0 <= chance.item() <= 1
    card = json.loads((folder.parent / "second" / "card.json").read_bytes())["body"]
    for name, path in network_files(folder.parent / "second", networks.second.card).items():
        if name in BODY_NETWORKS:
            assert hashlib.sha256(path.read_bytes()).hexdigest() == card[name]["sha256"]


def test_what_a_body_says_goes_into_the_decision():
    estimator, sample = known_hands()
    finder = HandFinder(estimator.stages, estimator.card, sample.image, sample.camera, body=lambda: BODY)
    masks, found = estimator.segment(sample.image)
    crops = finder.crops(masks, found.boxes_px, np.flatnonzero(found.present))
    looked = Detection(masks, found, finder.looked(masks, found.boxes_px, crops))
    assert finder.evidence(looked, None)[0].body is BODY
