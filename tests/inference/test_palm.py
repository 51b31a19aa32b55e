"""Palms: what the detector is shown, how hands are seen by them, and what they are worth as evidence."""

import dataclasses
import hashlib
import json
from types import SimpleNamespace

import numpy as np
import pytest
from tests.geometry.test_palm import ANCHORS, PALM, said
from tests.inference.test_hand_check import SAID, SAMPLE, finder
from tests.oracles import make_card

from twohands.geometry.boxes import upright_crop, upright_roll_deg, warp_image
from twohands.geometry.network_input import network_input
from twohands.geometry.palm import Palm
from twohands.inference.decision import FIRST_FEATURES
from twohands.inference.engine import load_networks
from twohands.inference.hand_check import checked
from twohands.inference.handedness import ANSWERS, PASSED, first_features
from twohands.inference.palm import seen_palms
from twohands.inference.weights import network_files, preset_folder, read_card
from twohands.skeleton import LEFT, RIGHT, ROOT, WRIST


def true_palm(side: int, logit: float = 1.0) -> Palm:
    """The palm of a hand of the picture."""
    joints_px = SAMPLE.joints_px[side]
    along_px = joints_px[ROOT] - joints_px[WRIST]
    middle_px = (joints_px.min(axis=0) + joints_px.max(axis=0)) / 2
    return Palm(logit, middle_px, along_px, float(np.hypot(*along_px)))


def test_the_detector_sees_the_whole_picture():
    shown = []

    def network(batch):
        shown.append(batch)
        points, logits = said((1152, 1.0, (80.0, 90.0)))
        return points[None].astype(np.float32), logits[None, :, None].astype(np.float32)

    image = np.full((96, 192, 3), 255, np.uint8)
    (palm,) = seen_palms(network, image)
    assert shown[0].shape == (1, 192, 192, 3) and shown[0].dtype == np.float32 and shown[0].max() == 1
    assert (shown[0][0, :47] == 0).all() and (shown[0][0, 49:143] == 1).all()  # in the middle of the square
    np.testing.assert_allclose(palm.middle_px, [88, 98 - 15 - 48])


def test_handcheck_sees_hands_by_their_joints_and_by_their_palms():
    seen = []
    card = dataclasses.replace(make_card(), check_size=64, check_margin=1.4)
    checked(lambda batch: seen.append(batch) or SAID, card, SAMPLE.image, SAMPLE.joints_px, [PALM])
    places = [upright_crop(one, size=64, margin=1.4) for one in SAMPLE.joints_px] + [PALM.square(64)]
    np.testing.assert_array_equal(seen[0], network_input(np.stack([warp_image(SAMPLE.image, p, 64) for p in places])))


def test_what_is_seen_of_a_palm_is_evidence_of_the_candidate_in_its_place():
    asked = []

    def check(image, joints_px, palms):
        asked.append(palms)
        return np.concatenate([SAID[:2], [[7.0, -1.5]] * len(palms)])

    here, found = finder(check)
    elsewhere = PALM._replace(middle_px=np.array([-500.0, -500.0]))
    here = dataclasses.replace(here, palms=lambda: (true_palm(RIGHT, 2.5), elsewhere))
    evidence, _ = here.evidence(found, None)
    near, hand, left = evidence.palm[RIGHT]
    assert (hand, left) == (7.0, -1.5) and 0.9 < near <= 1
    assert evidence.palm[LEFT, 0] < 0.1 and np.isnan(evidence.palm[2]).all()  # far away; not in one place
    assert [palm.logit for palm in asked[0]] == [2.5]  # HandCheck sees no palm twice, and none that nobody shows
    np.testing.assert_allclose(evidence.check, SAID[:2])


def test_one_palm_is_of_one_hand():
    """Of two candidates that show the same, either may be its hand; of both, the nearer one is. A hand alone was found
    twice, once by each."""
    here, found = finder(lambda image, joints_px, palms: np.zeros((len(joints_px) + len(palms), 2)))
    evidence = dataclasses.replace(here.evidence(found, None)[0], pose=np.zeros((2, 2)))
    palm, column = np.array([[0.5, 5.0, 0.0], [0.75, 5.0, 0.0], [np.nan] * 3]), FIRST_FEATURES.index("palm")
    rows = first_features(dataclasses.replace(evidence, palm=palm))
    said = {answer: rows[ANSWERS.index(answer), column] for answer in ((0, -1), (-1, 1), (0, 1))}
    assert said == {(0, -1): 1.0, (-1, 1): 1.5, (0, 1): 1.5}
    palm[0, 2] = 0.5  # another one
    rows = first_features(dataclasses.replace(evidence, palm=palm))
    assert rows[ANSWERS.index((0, 1)), column] == 2.5


def test_two_candidates_in_one_place_have_a_palm_together():
    here, found = finder(lambda image, joints_px, palms: np.zeros((len(joints_px) + len(palms), 2)), same_place_iou=0.0)
    here = dataclasses.replace(here, palms=lambda: (true_palm(RIGHT),))
    assert np.isfinite(here.evidence(found, None)[0].palm).all()


@pytest.mark.parametrize(
    ("palm", "pose", "left", "right"),
    [
        ([0.5, 5.0, -3.0], [0.0, 0.0], [0.5 * (5 - PASSED), -1.5], [0.5 * (5 - PASSED), 1.5]),
        ([1.0, 20.0, 9.0], [-5.0, -1.0], [6, 6], [6, -6]),  # both are limited
        ([1.0, 20.0, 9.0], [-5.0, 1.5], [4.5, 4.5], [4.5, -4.5]),  # a quarter sure that it is a hand
        ([1.0, 20.0, 9.0], [2.0, np.nan], [4, 4], None),  # a third; not seen as the other one
        ([1.0, 20.0, 9.0], [7.0, -7.0], [0, 0], [0, 0]),  # sure: palms are not asked
        ([1.0, PASSED, 5.0], [0.0, 0.0], [0, 0], [0, 0]),  # it does not pass, and says nothing
        ([np.nan] * 3, [0.0, 0.0], [0, 0], [0, 0]),
    ],
)
def test_a_palm_is_weighed_by_hand(palm, pose, left, right):
    """How far it passes, and whose it is, as seen from the hand's side; both times how near it is, and how far
    PoseNet2D is from being sure, of 6."""
    here, found = finder(lambda image, joints_px, palms: np.zeros((len(joints_px) + len(palms), 2)))
    evidence, _ = here.evidence(found, None)
    seen = np.transpose([pose, pose[::-1]])  # of the second candidate, the other hand's
    known = dataclasses.replace(evidence, palm=np.array([palm, palm, [np.nan] * 3]), pose=seen)
    columns = [FIRST_FEATURES.index(name) for name in ("palm", "palm_side")]
    for answer, expected in (((0, -1), left), ((-1, 0), right)):
        values = first_features(known)[ANSWERS.index(answer), columns]
        np.testing.assert_allclose(values, [np.nan, np.nan] if expected is None else expected)


def test_of_candidates_in_one_place_palms_say_nothing_that_is_known_of_either():
    """Named case: a pair on one hand was believed, for one candidate the palm passed, for the other PoseNet2D."""
    here, found = finder(lambda image, joints_px, palms: np.zeros((len(joints_px) + len(palms), 2)), same_place_iou=0.0)
    pose, palm = np.array([[-5.0, 7.0], [-5.0, np.nan]]), np.array([[1.0, 9.0, 2.0]] * 3)
    evidence = dataclasses.replace(here.evidence(found, None)[0], palm=palm, pose=pose, merged_pose=np.zeros(2))
    columns = [FIRST_FEATURES.index(name) for name in FIRST_FEATURES if "palm" in name]
    assert not np.nan_to_num(first_features(evidence)[:, columns]).any()
    apart = first_features(dataclasses.replace(evidence, merged_pose=None))[:, FIRST_FEATURES.index("palm")]
    assert apart[ANSWERS.index((0, -1))] == 6 and apart[ANSWERS.index((-1, 1))] != 6


@pytest.fixture
def second_crops():
    """What the second pose networks are first shown of the picture's right hand, by its palms."""

    def shown(*palms: Palm, expected=None):
        here, found = finder(None)
        stages = here.stages
        views = dataclasses.replace(stages.card.views, upright_within_deg=25.0)
        other = dataclasses.replace(stages, card=dataclasses.replace(stages.card, views=views))
        crops = []

        def keypoints(batch):
            crops.extend(batch)
            return found.keypoints.rows([RIGHT] * len(batch))

        here = dataclasses.replace(
            here,
            stages=Recorded(stages, dataclasses.replace(other, second=None), keypoints),
            palms=lambda: palms,
            expected=expected,
        )
        here.second_looked(found.masks, found.boxes.boxes_px, np.array([RIGHT]), None)
        return crops[0]

    return shown


class Recorded:
    """Stages whose keypoints are kept."""

    def __init__(self, own, second, keypoints):
        self.own, self.second, self.keypoints = own, second, keypoints

    def of_pair(self, pair):
        return self.second if pair else self.own

    def __getattr__(self, name):
        return getattr(self.own, name)


@pytest.mark.parametrize(
    ("palms", "by_palm"),
    [
        ((), False),
        ((true_palm(RIGHT),), True),
        ((true_palm(RIGHT, logit=-0.5),), False),  # not sure
        ((true_palm(LEFT),), False),  # the other hand's
    ],
)
def test_the_second_pose_networks_see_a_sure_palm_with_its_fingers_up(second_crops, palms, by_palm):
    roll_deg = second_crops(*palms).roll_deg
    expected_deg = float(upright_roll_deg(SAMPLE.joints_px[RIGHT])) if by_palm else 0.0
    assert roll_deg == pytest.approx(expected_deg)


def test_in_a_clip_the_turn_of_the_last_frame_comes_first(second_crops):
    last_px = np.full((2, 2, 21, 2), np.nan)
    last_px[1, RIGHT] = SAMPLE.joints_px[RIGHT][:, ::-1]  # turned
    known = SimpleNamespace(seen_px=last_px)
    roll_deg = second_crops(true_palm(RIGHT), expected=known).roll_deg
    assert roll_deg == pytest.approx(float(upright_roll_deg(last_px[1, RIGHT])))
    last_px[1, RIGHT, 3] = np.nan  # nothing is known of it
    assert second_crops(true_palm(RIGHT), expected=known).roll_deg != pytest.approx(roll_deg)


def test_the_shipped_detector_is_that_which_was_published():
    """It takes and gives what is asked of it, and sees no sure palm in noise."""
    folder = preset_folder("fast")
    networks = load_networks(folder, read_card(folder), threads=1)
    assert networks.second is not None and networks.second.palm is not None
    noise = np.random.default_rng(0).integers(0, 256, (240, 320, 3), np.uint8)
    assert all(palm.logit < 0 for palm in seen_palms(networks.second.palm, noise))
    points, logits = networks.second.palm(np.zeros((1, 192, 192, 3), np.float32))
    assert (points.shape, logits.shape) == ((1, ANCHORS, 18), (1, ANCHORS, 1))
    card = json.loads((folder.parent / "second" / "card.json").read_bytes())["palm"]
    path = network_files(folder.parent / "second", networks.second.card)["palm_detector"]
    assert hashlib.sha256(path.read_bytes()).hexdigest() == card["palm_detector"]["sha256"]
