"""The pipeline gives true metres for true maps, feeds its networks what they expect, and yields to ground truth."""

import dataclasses
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from tests.oracles import (
    FIRST,
    UNUSED,
    Oracle,
    drawn_hands,
    full_truth,
    hand_masks,
    make_card,
    restaged,
    true_boxes,
    write_tiny_weights,
)

from twohands.errors import InputError, PlausibilityWarning
from twohands.evaluation.predictions import predict
from twohands.geometry.boxes import apply_homography, upright_roll_deg
from twohands.geometry.camera import unproject
from twohands.geometry.canonical import canonical_from_camera
from twohands.geometry.heatmaps import encode_heatmaps
from twohands.geometry.network_input import network_input
from twohands.geometry.rotation import rotation_about_z
from twohands.geometry.segmentation import HandBoxes
from twohands.inference.detection import HandFinder
from twohands.inference.engine import Networks
from twohands.inference.estimator import HandEstimator
from twohands.inference.keypoints import Keypoints, joint_boxes
from twohands.inference.placement import posterior_ranges
from twohands.inference.stages import StageTruth
from twohands.inference.views import HandViewer, nearest_turns
from twohands.skeleton import LEFT, RIGHT, ROOT, WRIST
from twohands.types import HandPose, HandSample, PinholeCamera

HAND_LENGTH_M = 0.1


def finder_of(estimator: HandEstimator, sample: HandSample) -> HandFinder:
    return HandFinder(estimator.stages, estimator.card, sample.image, sample.camera)


@pytest.mark.parametrize("crop_kind", ["square", "perspective"])
@pytest.mark.parametrize("decode", ["subpixel", "softargmax"])
def test_true_maps_give_true_metres(crop_kind, decode):
    """Detection, crops, mirroring, read-out and projection lose less than a millimetre between them."""
    range_error_m, error_px, error = (1e-3, 0.05, 1e-6) if decode == "subpixel" else (3e-3, 0.3, 1e-3)
    for seed in range(6):
        sample = drawn_hands(seed)
        oracle = Oracle(sample, make_card(crop_kind=crop_kind, heatmap_decode=decode), z_heatmaps=decode == "subpixel")
        pose = oracle.estimator.estimate(sample.image, sample.camera, HAND_LENGTH_M)
        assert oracle.calls == ["hand_seg_net", "pose_net_2d", "pose_net_3d"]
        for side, hand in enumerate(pose.hands):
            assert hand.present and hand.valid and hand.score > 0.95
            true_range = np.linalg.norm(sample.joints_m[side, 9])
            assert abs(hand.range_m - true_range) < range_error_m
            np.testing.assert_allclose(hand.joints_px, sample.joints_px[side], atol=error_px)
            np.testing.assert_allclose(hand.canonical, oracle.canonical[side], atol=error)
        np.testing.assert_array_equal(pose.masks, hand_masks(sample))


def test_truth_for_every_stage_gives_exact_metres_and_runs_no_network():
    estimator = HandEstimator(UNUSED, make_card())
    for seed in range(10):
        sample = drawn_hands(seed)
        pose = estimator.estimate(sample.image, sample.camera, HAND_LENGTH_M, full_truth(sample))
        for side, hand in enumerate(pose.hands):
            np.testing.assert_allclose(hand.joints_m, sample.joints_m[side], atol=1e-9)
            assert abs(hand.range_m - np.linalg.norm(sample.joints_m[side, 9])) < 1e-9
            x, y, z = sample.joints_m[side, 9]
            assert hand.theta_deg == pytest.approx(np.degrees(np.arctan2(y, z)))
            assert hand.phi_deg == pytest.approx(np.degrees(np.arctan2(x, np.hypot(y, z))))
            assert (hand.method, hand.score) == ("fitted", 1.0)


@pytest.mark.parametrize(
    ("given", "calls"),
    [
        (("masks", "boxes_px"), ["pose_net_2d", "pose_net_3d"]),
        (("boxes_px",), ["hand_seg_net", "pose_net_2d", "pose_net_3d"]),
        (("canonical",), ["hand_seg_net", "pose_net_2d"]),
        (("heatmaps", "canonical"), ["hand_seg_net"]),
        (("masks", "boxes_px", "heatmaps"), ["pose_net_3d"]),
    ],
)
def test_a_stage_with_truth_is_not_run_and_the_others_are(given, calls):
    sample = drawn_hands(0)
    ran = []

    def recorder(name, *outputs):
        def network(batch):
            ran.append(name)
            values = tuple(np.zeros((len(batch), *shape), np.float32) + value for shape, value in outputs)
            return values if len(values) > 1 else values[0]

        return network

    networks = Networks(
        recorder("hand_seg_net", ((3, 135, 240), 0.0), ((2, 135, 240), np.where(np.arange(240) < 60, 9.0, -9.0))),
        recorder("pose_net_2d", ((21, 32, 32), 0.5), ((), 0.0)),
        recorder("pose_net_3d", ((21, 3), 1.0)),
    )
    truth = full_truth(sample)
    chosen = StageTruth(**{name: getattr(truth, name) for name in given})
    HandEstimator(networks, make_card()).estimate(sample.image, sample.camera, HAND_LENGTH_M, chosen)
    assert ran == calls


def test_true_2d_joints_replace_the_read_out_but_not_the_maps_for_3d():
    sample = drawn_hands(3)
    oracle = Oracle(sample, make_card())
    shifted = sample.joints_px + 1.0
    pose = oracle.estimator.estimate(sample.image, sample.camera, HAND_LENGTH_M, StageTruth(joints_px=shifted))
    assert oracle.calls == ["hand_seg_net", "pose_net_2d", "pose_net_3d"]
    np.testing.assert_array_equal(pose.left.joints_px, shifted[LEFT])


@pytest.mark.parametrize("absent", [LEFT, RIGHT])
def test_an_absent_hand_is_reported_absent_and_the_other_is_unharmed(absent):
    present = (absent != LEFT, absent != RIGHT)
    sample = drawn_hands(1, present=present)
    pose = Oracle(sample, make_card()).estimator.estimate(sample.image, sample.camera, HAND_LENGTH_M)
    gone, seen = pose.hands[absent], pose.hands[1 - absent]
    assert not gone.present
    assert all(getattr(gone, f.name) is None for f in dataclasses.fields(gone) if f.name != "present")
    assert seen.valid
    assert abs(seen.range_m - np.linalg.norm(sample.joints_m[1 - absent, 9])) < 1e-3


def test_no_hand_is_a_result_and_runs_only_the_first_network():
    sample = drawn_hands(2, present=(False, False))
    oracle = Oracle(sample, make_card())
    pose = oracle.estimator.estimate(sample.image, sample.camera, HAND_LENGTH_M)
    assert not pose.left.present and not pose.right.present
    assert oracle.calls == ["hand_seg_net"]


def test_truth_can_deny_a_hand_that_has_a_box():
    sample = drawn_hands(4)
    truth = dataclasses.replace(full_truth(sample), present=np.array([False, True]))
    pose = HandEstimator(UNUSED, make_card()).estimate(sample.image, sample.camera, HAND_LENGTH_M, truth)
    assert [hand.present for hand in pose.hands] == [False, True]


def test_only_a_hand_far_from_its_box_is_looked_at_again():
    """HandSegNet's box of the right hand is twice too large, that of the left is right: the second look is at the right
    hand alone, into its joints' box, and everything after takes its answer from there."""
    sample = drawn_hands(5)
    oracle = Oracle(sample, make_card())
    boxes_px = true_boxes(sample)
    centre, half = (boxes_px[RIGHT, :2] + boxes_px[RIGHT, 2:]) / 2, boxes_px[RIGHT, 2:] - boxes_px[RIGHT, :2]
    rough_px = boxes_px.copy()
    rough_px[RIGHT] = np.concatenate([centre - half, centre + half])
    cut = []

    def maps(batch):
        """True maps of the crops that were cut last."""
        return oracle.true_maps([crop for crop in cut[-len(batch) :]]), np.zeros(len(batch))

    estimator = HandEstimator(dataclasses.replace(oracle.estimator.networks, pose_net_2d=maps), oracle.card)
    plain_crop = estimator.stages.crop
    estimator = restaged(estimator, crop=lambda *arguments: cut.append(plain_crop(*arguments)) or cut[-1])
    masks = hand_masks(sample)
    rough = HandBoxes(rough_px, np.array([True, True]), np.ones(2))
    _, boxes, look, *_ = estimator.find_hands(finder_of(estimator, sample), masks, rough)
    np.testing.assert_array_equal(rough.boxes_px, rough_px)  # named case: boxes that came in were written over
    assert [crop.side for crop in cut] == [LEFT, RIGHT, RIGHT]
    assert look.crops[LEFT] is cut[0] and look.crops[RIGHT] is cut[2]
    np.testing.assert_allclose(boxes.boxes_px, boxes_px, atol=0.1)
    expected = plain_crop(sample.image, masks, boxes_px[RIGHT], RIGHT, sample.camera)
    np.testing.assert_allclose(look.crops[RIGHT].image_from_crop, expected.image_from_crop, rtol=0.02, atol=0.5)
    np.testing.assert_array_equal(look.heatmaps, oracle.true_maps(look.crops))
    np.testing.assert_allclose(look.joints_px, sample.joints_px, atol=0.1)


def test_small_or_outlying_joints_keep_the_box_of_before():
    before = np.array([[10.0, 10, 60, 60], [20, 20, 70, 80], [5, 5, 50, 50], [0, 0, 9, 9]])
    joints_px = np.full((4, 21, 2), 30.0)
    joints_px[0, 4], joints_px[0, 8] = (25, -40), (90, 55)  # beyond the picture's edge
    joints_px[1, 4] = (37.9, 60)  # 7.9 pixels wide
    joints_px[2] += 200  # all outside
    joints_px[3, 4], joints_px[3, 8] = (25, -40), (900, 55)  # no farther beyond the edge than the 55 pixels of the box
    boxes = joint_boxes(joints_px, (96, 80), before, 8.0)
    np.testing.assert_array_equal(boxes, [[25, -40, 90, 55], before[1], before[2], [25, -40, 135, 55]])


def lowered(sample: HandSample, pixels: int) -> HandSample:
    """A picture that shows the same hands so many pixels lower."""
    labels, joints_px = np.zeros_like(sample.labels), sample.joints_px + np.array([0, pixels])
    labels[pixels:] = sample.labels[:-pixels]
    camera = dataclasses.replace(sample.camera, cy=sample.camera.cy + pixels)
    return dataclasses.replace(sample, labels=labels, joints_px=joints_px, camera=camera)


@pytest.mark.parametrize("seed", range(4))
def test_joints_beyond_the_edge_are_looked_for_there_and_the_box_in_the_results_ends_at_it(seed):
    """Named case: crops ended at the picture's edge, so that the fingers of hands cut by it were squeezed into what was
    left (a third of the hands in the clips of signing people)."""
    sample = drawn_hands(seed)
    low = int(sample.joints_px[..., 1].max(axis=1).argmax())
    height = sample.camera.height
    sample = lowered(sample, height - int(np.sort(sample.joints_px[low, :, 1])[-5]))
    oracle = Oracle(sample, make_card())
    estimator = restaged(
        oracle.estimator,
        locate=lambda crops: (oracle.true_maps(crops), np.full(len(crops), 9.0)),
        lift=lambda keypoints: oracle.canonical[keypoints.sides],
    )
    hand = estimator.estimate(sample.image, sample.camera, HAND_LENGTH_M).hands[low]
    np.testing.assert_allclose(hand.joints_px, sample.joints_px[low], atol=0.5)
    assert hand.joints_px[:, 1].max() > height and hand.box_px[3] == height
    np.testing.assert_allclose(hand.joints_m, sample.joints_m[low], atol=2e-3)


def test_true_presence_overrules_a_low_score_but_the_box_is_still_estimated():
    sample = drawn_hands(5)
    oracle = Oracle(sample, make_card())

    def faint(batch):
        seg_logits, energy_logits = oracle.hand_seg_net(batch)
        energy = 0.3 / (1 + np.exp(-energy_logits))
        return seg_logits / 20, np.log(energy / (1 - energy))

    networks = dataclasses.replace(oracle.estimator.networks, hand_seg_net=faint)
    estimator = HandEstimator(networks, oracle.card)
    _, without = estimator.segment(sample.image)
    _, told = estimator.segment(sample.image, StageTruth(present=np.array([True, False])))
    assert without.present.tolist() == [False, False]
    assert told.present.tolist() == [True, False]
    assert np.isnan(told.boxes_px[RIGHT]).all()
    np.testing.assert_allclose(told.boxes_px[LEFT], true_boxes(sample)[LEFT], atol=6)


def test_a_hand_of_the_frame_before_needs_less_evidence_and_a_new_one_more():
    sample = drawn_hands(5, present=(True, False))
    oracle = Oracle(sample, make_card(hand_logit=True, first=FIRST | {"was_present": 3.0}, last={"first": 1.0}))

    def unsure(crops):
        return oracle.true_maps(crops), np.array([-3.0 if crop.side == LEFT else -9.0 for crop in crops])

    estimator = restaged(judging(oracle, oracle.hand_seg_net), locate=unsure)
    unknown = estimator.estimate(sample.image, sample.camera)
    absent, present = (
        dataclasses.replace(unknown, left=HandPose(present=there), right=HandPose(present=False))
        for there in (False, True)
    )
    found = [estimator.estimate(sample.image, sample.camera, previous=pose) for pose in (None, absent, present)]
    assert [pose.left.present for pose in found] == [False, False, True]
    assert not any(pose.right.present for pose in found)


def test_without_a_fitted_decision_the_first_network_decides_alone():
    sample = drawn_hands(2)
    oracle = Oracle(sample, make_card(hand_logit=True, first={}))
    pose = oracle.estimator.estimate(sample.image, sample.camera, HAND_LENGTH_M)
    assert pose.left.present and pose.right.present
    assert oracle.calls == ["hand_seg_net", "pose_net_2d", "pose_net_3d"]


def test_in_doubt_both_the_picture_and_its_mirror_image_count():
    """A ghost that is seen in one of the two only, as faintly as the true hand is seen clearly, is gone in the mean."""
    sample = drawn_hands(5, present=(True, False))
    oracle = Oracle(sample, make_card())

    def seeing_a_ghost(batch):
        seg_logits, energy_logits = oracle.hand_seg_net(batch)
        if np.array_equal(batch, network_input(sample.image[None])):
            seg_logits[:, 2, :60, :60], energy_logits[:, 1, 10:50, 10:50] = 12.0, 2.0
        return seg_logits, energy_logits

    networks = dataclasses.replace(oracle.estimator.networks, hand_seg_net=seeing_a_ghost)
    estimator = HandEstimator(networks, make_card(tta_score_range=(1.0, 1.0)))
    assert estimator.segment(sample.image)[1].present.tolist() == [True, True]
    assert oracle.calls == ["hand_seg_net"]
    estimator = HandEstimator(networks, make_card(tta_score_range=(0.5, 0.95)))
    masks, boxes = estimator.segment(sample.image)
    assert oracle.calls == 3 * ["hand_seg_net"]
    assert boxes.present.tolist() == [True, False]
    np.testing.assert_array_equal(masks, hand_masks(sample))


@pytest.mark.parametrize("decode", ["subpixel", "softargmax"])
def test_looks_of_rolled_cameras_agree_on_true_answers_and_outvote_an_error(decode):
    """Joints that only the first look of three sees 3 pixels too far to the right are where the others see them."""
    sample = drawn_hands(4)
    card = make_card(heatmap_decode=decode, tta_rolls_deg=(20.0, -35.0))
    oracle = Oracle(sample, card, z_heatmaps=decode == "subpixel")
    estimator = HandEstimator(oracle.estimator.networks, card)
    crops, shift, error_px = [], [3.0, 0.0, 0.0], 0.05 if decode == "subpixel" else 0.3

    def locate(given):
        crops.append(given)
        return oracle.true_maps(given), np.zeros(len(given))

    def read_out(heatmaps, given):
        joints_px, scores = plain.read_out(heatmaps, given)
        return joints_px + np.array([shift[len(crops) - 1], 0.0]), scores

    def lift(keypoints):
        roll = rotation_about_z(np.radians([0.0, *card.views.tta_rolls_deg][len(crops) - 1]))
        return canonical_from_camera(sample.joints_m @ roll.T).joints

    plain = estimator.stages
    estimator = restaged(estimator, locate=locate, read_out=read_out, lift=lift)
    pose = estimator.estimate(sample.image, sample.camera, HAND_LENGTH_M)
    assert len(crops) == 3
    for side, hand in enumerate(pose.hands):
        np.testing.assert_allclose(hand.joints_px, sample.joints_px[side], atol=error_px)
        np.testing.assert_allclose(hand.canonical, oracle.canonical[side], atol=0.01)
    middle = card.crop_size / 2
    for rolled, degrees in zip(crops[1:], card.views.tta_rolls_deg, strict=True):
        for pair in zip(crops[0], rolled, strict=True):
            ends = [apply_homography(c.image_from_crop, np.array([[middle, middle], [middle, 0.0]])) for c in pair]
            (x, y), (turned_x, turned_y) = (end[1] - end[0] for end in ends)
            turned = np.degrees(np.arctan2(x * turned_y - y * turned_x, x * turned_x + y * turned_y))
            assert turned == pytest.approx(-degrees, abs=12)  # what is upright to the rolled camera leans the other way


def keypoints_of(estimator, sample, masks, boxes_px) -> Keypoints:
    """Of both hands in the given boxes."""
    crops = [estimator.stages.crop(sample.image, masks, boxes_px[side], side, sample.camera) for side in (LEFT, RIGHT)]
    return estimator.stages.keypoints(crops)


def test_a_hand_outside_the_picture_keeps_no_other_from_being_looked_at_again():
    sample = drawn_hands(4)
    card = make_card(tta_rolls_deg=(15.0, -15.0))
    oracle = Oracle(sample, card)
    estimator = HandEstimator(oracle.estimator.networks, card)
    masks, boxes = estimator.segment(sample.image)
    look = keypoints_of(estimator, sample, masks, boxes.boxes_px)
    look.joints_px[RIGHT] = -50.0
    canonical, crops = estimator.stages.lift(look), []

    def locate(given):
        crops.append([crop.side for crop in given])
        return look.heatmaps[:1], look.hand_logits[:1]

    stages = dataclasses.replace(
        estimator.stages,
        locate=locate,
        read_out=lambda heatmaps, given: (look.joints_px[:1], look.joint_scores[:1]),
        lift=lambda seen: canonical[seen.sides],
    )
    again, poses = HandViewer(stages, card, sample.image, masks, sample.camera).agreed(look, canonical)
    assert crops == [[LEFT], [LEFT]]
    np.testing.assert_allclose(again.joints_px, look.joints_px, atol=1e-9)
    np.testing.assert_allclose(poses[RIGHT], canonical[RIGHT], atol=1e-12)
    assert np.abs(poses[LEFT] - canonical[LEFT]).max() > 0.01


def test_hands_are_seen_again_where_those_see_them_whose_joints_count():
    """Where a first view is cut off, views around its own joints are cut off alike."""
    sample, card = drawn_hands(4), make_card(tta_rolls_deg=(15.0, -15.0))
    estimator = HandEstimator(Oracle(sample, card).estimator.networks, card)
    masks, boxes = estimator.segment(sample.image)
    look = keypoints_of(estimator, sample, masks, boxes.boxes_px)
    better, crops = dataclasses.replace(look, joints_px=look.joints_px * 0.8 + 10), []

    def locate(given):
        crops.extend(given)
        return look.heatmaps, look.hand_logits

    stages = dataclasses.replace(
        estimator.stages, locate=locate, read_out=lambda heatmaps, given: (look.joints_px, look.joint_scores)
    )
    viewer, canonical = HandViewer(stages, card, sample.image, masks, sample.camera), estimator.stages.lift(look)
    again, _ = viewer.agreed(look, canonical, better)
    viewer.agreed(better, canonical)
    for crop, expected in zip(crops[:4], crops[4:], strict=True):
        np.testing.assert_array_equal(crop.image, expected.image)
    np.testing.assert_allclose(again.joints_px, look.joints_px, atol=1e-9)  # what they see there counts


@pytest.mark.parametrize(
    ("scores", "looks", "counts"),
    [
        ((0.5, 0.9), 2, 1),  # turned it is surer
        ((0.5, 0.54), 2, 0),  # but hardly
        ((0.95, 1.0), 1, 0),  # no doubt, no second look
    ],
)
def test_a_doubtful_hand_is_seen_upside_down_too_and_the_surer_view_counts(scores, looks, counts):
    """The first view puts the fingers where the wrist is, the other the joints 3 pixels off; poses come back in the
    camera of the picture."""

    def upside_down(joints_px):
        return joints_px.min(axis=-2, keepdims=True) + joints_px.max(axis=-2, keepdims=True) - joints_px

    sample = drawn_hands(4)
    card = make_card(turns_deg=(180.0,))
    oracle = Oracle(sample, card)
    plain, crops = HandEstimator(oracle.estimator.networks, card).stages, []

    def locate(given):
        crops.append(given)
        return oracle.true_maps(given), np.zeros(len(given))

    def read_out(heatmaps, given):
        joints_px, _ = plain.read_out(heatmaps, given)
        view = len(crops) - 1
        seen = joints_px + np.array([3.0, 0.0]) if view else upside_down(joints_px)
        return seen, np.full(joints_px.shape[:2], scores[view])

    def lift(keypoints):
        rolls = [rotation_about_z(np.radians(crop.roll_deg)) for crop in keypoints.crops]
        joints_m = [sample.joints_m[crop.side] @ roll.T for crop, roll in zip(keypoints.crops, rolls, strict=True)]
        return canonical_from_camera(np.array(joints_m)).joints

    estimator = restaged(HandEstimator(oracle.estimator.networks, card), locate=locate, read_out=read_out, lift=lift)
    pose = estimator.estimate(sample.image, sample.camera, HAND_LENGTH_M)
    assert [[crop.roll_deg for crop in given] for given in crops] == [[0.0, 0.0], [180.0, 180.0]][:looks]
    for side, hand in enumerate(pose.hands):
        true_px = sample.joints_px[side]
        np.testing.assert_allclose(
            hand.joints_px, true_px + np.array([3.0, 0.0]) if counts else upside_down(true_px), atol=0.3
        )
        np.testing.assert_allclose(hand.joint_scores, scores[counts])
        np.testing.assert_allclose(hand.canonical, oracle.canonical[side], atol=0.05)


def test_every_hand_is_turned_by_its_own_turn_and_the_surer_view_counts():
    """Fingers that point to the left need another turn than those that point down."""
    sample = drawn_hands(4)
    card = make_card(turns_deg=(90.0, 180.0))
    oracle = Oracle(sample, card)
    estimator = HandEstimator(oracle.estimator.networks, card)
    masks, boxes = estimator.segment(sample.image)
    look = keypoints_of(estimator, sample, masks, boxes.boxes_px)
    sure = {0.0: (0.5, 0.5), 90.0: (0.9, 0.6), 180.0: (0.7, 0.8)}

    def read_out(heatmaps, given):
        scores = [np.full(21, sure[crop.roll_deg][crop.side]) for crop in given]
        return np.array([look.joints_px[crop.side] for crop in given]), np.array(scores)

    stages = dataclasses.replace(
        estimator.stages,
        locate=lambda given: (look.heatmaps, look.hand_logits),
        read_out=read_out,
        lift=lambda seen: oracle.canonical[seen.sides],
    )
    away = look.joints_px - look.joints_px[:, [WRIST]]
    turned_px = look.joints_px[:, [WRIST]] + np.stack([away[LEFT][:, ::-1] * np.array([1.0, -1.0]), -away[RIGHT]])
    first = dataclasses.replace(look, joints_px=turned_px, joint_scores=np.full((2, 21), 0.5))
    viewer = HandViewer(stages, card, sample.image, masks, sample.camera)
    seen, _ = viewer.turned(first, oracle.canonical)
    assert [crop.roll_deg for crop in seen.crops] == [90.0, 180.0]
    np.testing.assert_array_equal(seen.sides, [LEFT, RIGHT])
    np.testing.assert_allclose(seen.joint_scores.mean(axis=1), [0.9, 0.8])


def test_a_hand_is_turned_as_brings_its_fingers_nearest_to_up():
    off_deg = np.array([0.0, 44.0, 46.0, 100.0, -170.0, -100.0])
    np.testing.assert_array_equal(nearest_turns(off_deg, (180.0, 90.0, 270.0)), [0, 0, 90, 90, 180, 270])
    assert not nearest_turns(off_deg, ()).any()


@pytest.mark.parametrize(("within_deg", "again"), [(180.0, ()), (35.0, (LEFT,)), (5.0, (LEFT, RIGHT))])
def test_a_hand_whose_fingers_point_elsewhere_is_seen_again_with_its_fingers_up(within_deg, again):
    """The first look is off by 3 pixels, the second right; poses come back in the camera of the picture."""
    sample = drawn_hands(7)
    lean_deg = np.abs(upright_roll_deg(sample.joints_px))
    assert 5 < lean_deg[RIGHT] < 35 < lean_deg[LEFT]
    card = make_card(upright_within_deg=within_deg)
    oracle = Oracle(sample, card)
    plain, crops = HandEstimator(oracle.estimator.networks, card).stages, []

    def locate(given):
        crops.append(given)
        return oracle.true_maps(given), np.zeros(len(given))

    def read_out(heatmaps, given):
        joints_px, scores = plain.read_out(heatmaps, given)
        return joints_px + np.array([[0.0 if crop.roll_deg else 3.0, 0.0] for crop in given])[:, None], scores

    def lift(keypoints):
        rolls = [rotation_about_z(np.radians(crop.roll_deg)) for crop in keypoints.crops]
        joints_m = [sample.joints_m[crop.side] @ roll.T for crop, roll in zip(keypoints.crops, rolls, strict=True)]
        return canonical_from_camera(np.array(joints_m)).joints

    estimator = restaged(HandEstimator(oracle.estimator.networks, card), locate=locate, read_out=read_out, lift=lift)
    pose = estimator.estimate(sample.image, sample.camera, HAND_LENGTH_M)
    assert [crop.side for given in crops[1:] for crop in given] == list(again)
    for crop in (crop for given in crops[1:] for crop in given):
        in_crop = apply_homography(np.linalg.inv(crop.image_from_crop), sample.joints_px[crop.side])
        along = in_crop[ROOT] - in_crop[WRIST]
        assert abs(np.degrees(np.arctan2(along[0], -along[1]))) < 15
    for side, hand in enumerate(pose.hands):
        expected_px = sample.joints_px[side] + np.array([0.0 if side in again else 3.0, 0.0])
        np.testing.assert_allclose(hand.joints_px, expected_px, atol=0.3)
        np.testing.assert_allclose(hand.canonical, oracle.canonical[side], atol=0.05)


def test_mirrored_picture_gives_the_mirrored_result_with_hands_swapped():
    """Flip the picture: left becomes right, x changes sign, everything else stays."""
    sample = drawn_hands(6)
    width = sample.image.shape[1]
    assert sample.labels is not None
    flipped = sample.labels[:, ::-1]
    mirrored = dataclasses.replace(
        sample,
        image=np.ascontiguousarray(sample.image[:, ::-1]),
        labels=np.where(flipped == 0, 0, np.where(flipped <= 7, flipped + 7, flipped - 7)).astype(np.uint8),
        joints_px=(sample.joints_px * [-1, 1] + [width, 0])[::-1],
        joints_m=(sample.joints_m * [-1, 1, 1])[::-1],
    )
    card = make_card()
    pose = Oracle(sample, card).estimator.estimate(sample.image, sample.camera, HAND_LENGTH_M)
    other = Oracle(mirrored, card).estimator.estimate(mirrored.image, mirrored.camera, HAND_LENGTH_M)
    for hand, twin in zip(pose.hands, other.hands[::-1], strict=True):
        np.testing.assert_allclose(twin.joints_m, hand.joints_m * [-1, 1, 1], atol=2e-5)
        assert twin.phi_deg == pytest.approx(-hand.phi_deg, abs=1e-3)
        assert twin.theta_deg == pytest.approx(hand.theta_deg, abs=1e-3)


def test_the_networks_see_a_left_like_hand_on_black_with_the_other_dimmed():
    """The right hand's crop of the mirrored picture is the left hand's crop of the picture."""
    sample = drawn_hands(7)
    width = sample.image.shape[1]
    estimator = HandEstimator(UNUSED, make_card(crop_kind="square"))
    masks, box = hand_masks(sample), true_boxes(sample)[LEFT]
    left = estimator.stages.crop(sample.image, masks, box, LEFT, sample.camera)
    swap = np.array([0, 2, 1], np.uint8)
    mirrored_box = np.array([width - box[2], box[1], width - box[0], box[3]])
    right = estimator.stages.crop(
        np.ascontiguousarray(sample.image[:, ::-1]), swap[masks[:, ::-1]], mirrored_box, RIGHT, sample.camera
    )
    assert (left.mirrored, right.mirrored) == (False, True)
    difference = np.abs(left.image.astype(int) - right.image).max(axis=2)
    assert (difference <= 2).mean() > 0.98  # nearest-neighbour masks may fall either way on an exact tie
    assert (left.image == 0).all(axis=2).any(), "background is black"


def test_ranges_scale_with_the_hand_length():
    sample = drawn_hands(8)
    estimator = HandEstimator(UNUSED, make_card())
    small = estimator.estimate(sample.image, sample.camera, 0.05, full_truth(sample))
    large = estimator.estimate(sample.image, sample.camera, 0.10, full_truth(sample))
    np.testing.assert_allclose(2 * small.left.joints_m, large.left.joints_m, rtol=1e-12)


def test_a_projection_that_cannot_be_solved_is_not_valid_and_keeps_the_2d_result():
    sample = drawn_hands(9)
    truth = full_truth(sample)
    collapsed = np.array(truth.joints_px)
    collapsed[LEFT] = collapsed[LEFT, 9]  # all joints on one pixel say nothing about the range
    truth = dataclasses.replace(truth, joints_px=collapsed)
    pose = HandEstimator(UNUSED, make_card()).estimate(sample.image, sample.camera, HAND_LENGTH_M, truth)
    assert pose.left.present and pose.left.valid is False
    assert pose.left.joints_m is None and pose.left.range_m is None
    assert pose.left.joints_px is not None and pose.left.theta_deg is not None
    assert pose.right.valid


def test_what_is_perhaps_a_hands_is_shown_to_the_networks_and_not_reported():
    sample = drawn_hands(5)
    oracle = Oracle(sample, make_card())

    def doubting_the_left_hand(batch):
        seg_logits, energy_logits = oracle.hand_seg_net(batch)
        seg_logits[:, 0] = np.maximum(seg_logits[:, 0], seg_logits[:, 1] + 0.5)
        return seg_logits, energy_logits

    sure = HandEstimator(oracle.estimator.networks, make_card()).estimate(sample.image, sample.camera)
    networks = dataclasses.replace(oracle.estimator.networks, hand_seg_net=doubting_the_left_hand)
    found = HandEstimator(networks, make_card()).estimate(sample.image, sample.camera)
    np.testing.assert_allclose(found.left.joints_m, sure.left.joints_m)  # the oracle knows nothing but the true crops
    assert sure.masks is not None and set(np.unique(sure.masks)) == {0, 1, 2}
    np.testing.assert_array_equal(found.masks, np.where(sure.masks == 2, 2, 0))


@pytest.mark.parametrize(
    "given",
    [
        ("masks", "boxes_px", "present", "joints_px", "heatmaps", "canonical"),
        ("masks", "boxes_px"),
        ("masks", "present"),
        ("boxes_px",),
        ("joints_px",),
        (),
    ],
)
@pytest.mark.parametrize("tta_rolls_deg", [(), (10.0,)])
def test_inputs_are_left_as_they_were(given, tta_rolls_deg):
    sample = drawn_hands(0)
    every = {field.name: getattr(full_truth(sample), field.name) for field in dataclasses.fields(StageTruth)}
    truth = StageTruth(**{name: every[name] for name in given})
    networks = one_hand((80, 140))
    estimator = HandEstimator(networks, make_card(hand_logit=True, tta_rolls_deg=tta_rolls_deg))
    previous = estimator.estimate(sample.image, sample.camera, HAND_LENGTH_M)
    lengths_m = np.array([0.08, 0.1])
    arrays = [sample.image, lengths_m, *(every[name] for name in given)]
    arrays += [value for hand in previous.hands for value in dataclasses.astuple(hand) if isinstance(value, np.ndarray)]
    before = [array.copy() for array in arrays]
    pose = estimator.estimate(sample.image, sample.camera, lengths_m, truth, previous=previous)
    assert pose.left.present
    for a, b in zip(before, arrays, strict=True):
        np.testing.assert_array_equal(a, b)


def test_equal_inputs_give_equal_results_and_an_estimator_keeps_no_memory():
    sample, other = drawn_hands(0), drawn_hands(1)
    estimator = HandEstimator(one_hand((80, 140)), make_card(hand_logit=True, tta_rolls_deg=(10.0,)))
    first = estimator.estimate(sample.image, sample.camera)
    estimator.estimate(other.image, other.camera, 0.07)
    again = estimator.estimate(sample.image, sample.camera)
    np.testing.assert_array_equal(first.left.joints_m, again.left.joints_m)
    assert first.left.score == again.left.score


@pytest.mark.parametrize(
    ("image", "camera", "hand_length_m", "message"),
    [
        (np.zeros((135, 240), np.uint8), None, 0.1, r"\(H, W, 3\) uint8"),
        (np.zeros((135, 240, 3), np.float32), None, 0.1, "float32"),
        (None, None, 0.1, "got NoneType; cv2.imread gives None"),
        ([[[0, 0, 0]]], None, 0.1, "got list"),
        (np.zeros((135, 240, 3), np.uint8), PinholeCamera.ego3dhands(480, 270), 0.1, "480x270"),
        (np.zeros((135, 240, 3), np.uint8), None, 0.0, "hand length"),
        (np.zeros((135, 240, 3), np.uint8), None, float("nan"), "nan"),
    ],
)
def test_what_does_not_fit_together_is_refused(image, camera, hand_length_m, message):
    estimator = HandEstimator(UNUSED, make_card())
    with pytest.raises(InputError, match=message):
        estimator.estimate(image, camera or PinholeCamera.ego3dhands(240, 135), hand_length_m)


def test_uncertain_ranges_become_likely_ones_and_the_hands_move_along_their_lines_of_sight():
    sample = drawn_hands(2)
    plain = Oracle(sample, make_card()).estimator.estimate(sample.image, sample.camera, HAND_LENGTH_M)
    oracle = Oracle(sample, make_card(range_errors=(0.2, 0.4)))
    likely = oracle.estimator.estimate(sample.image, sample.camera, HAND_LENGTH_M)
    scores = np.array([hand.joint_scores.mean() for hand in plain.hands])
    expected = posterior_ranges(np.array([hand.range_m for hand in plain.hands]), scores, oracle.card.placement)
    for before, after, range_m in zip(plain.hands, likely.hands, expected, strict=True):
        assert after.range_m == pytest.approx(range_m) and abs(after.range_m - before.range_m) > 0.01
        assert (after.theta_deg, after.phi_deg) == (before.theta_deg, before.phi_deg)
        np.testing.assert_array_equal(after.canonical, before.canonical)
        moved = after.joints_m - before.joints_m
        root = before.joints_m[ROOT]
        np.testing.assert_allclose(moved, np.tile((after.range_m / before.range_m - 1) * root, (21, 1)), atol=1e-9)
    # What is known is not doubted.
    known = StageTruth(joints_px=sample.joints_px)
    assert oracle.estimator.estimate(sample.image, sample.camera, HAND_LENGTH_M, known).left.range_m == pytest.approx(
        plain.left.range_m, abs=1e-3
    )


def one_hand(columns, far_joint=None, rows=(0, 135)):
    """Networks that see a left hand in these columns and rows of a picture of 240x135 and its joints in the middle of
    every crop, but for one, which they see at the crop's right end."""

    def hand_seg_net(batch):
        inside = np.isin(np.arange(240), np.arange(*columns)) & np.isin(np.arange(135), np.arange(*rows))[:, None]
        logits = np.where(inside, 6.0, -6.0)[None, None]
        return np.concatenate([-logits, logits, 0 * logits - 9], 1), np.concatenate([logits, 0 * logits - 9], axis=1)

    cells = np.stack([9 + 10 * np.linspace(0, 1, 21), 16 + 4 * np.cos(np.arange(21))], axis=-1)
    if far_joint is not None:
        cells[far_joint] = 31, 16
    maps = np.asarray(encode_heatmaps(8 * cells, crop_size=256), np.float32)
    canonical = np.concatenate([(cells - cells[ROOT]) / 6, np.zeros((21, 1))], axis=1)
    return Networks(
        hand_seg_net,
        lambda batch: (np.stack([maps] * len(batch)), np.full(len(batch), 9.0)),
        lambda maps: np.stack([canonical] * len(maps)).astype(np.float32),
    )


PICTURE = np.full((135, 240, 3), 90, np.uint8)


@pytest.mark.parametrize("decode", ["subpixel", "softargmax"])
@pytest.mark.parametrize("rolls_deg", [(), (10.0, -10.0)])
def test_a_joint_seen_behind_a_wide_camera_leaves_finite_numbers_everywhere(decode, rolls_deg):
    """The crop of a hand at the edge reaches beyond 90 degrees; one bad joint must not spoil the hand, nor a run."""
    camera = PinholeCamera.from_fov(140, 240, 135)
    card = make_card(heatmap_decode=decode, tta_rolls_deg=rolls_deg)
    estimator = HandEstimator(one_hand((140, 236), far_joint=8, rows=(40, 100)), card)
    pose = estimator.estimate(PICTURE, camera)
    hand = pose.left
    assert hand.present and not pose.right.present
    for values in (hand.joints_px, hand.joint_scores, hand.canonical, hand.box_px):
        assert np.isfinite(values).all()
    assert hand.valid and np.isfinite(hand.joints_m).all() and hand.range_m > 0
    assert hand.joint_scores[8] < 0.1 and hand.joint_scores[:8].min() > 0.5
    assert hand.joints_px[8, 0] > 240
    plain = HandEstimator(one_hand((140, 236), rows=(40, 100)), card).estimate(PICTURE, camera).left
    if not rolls_deg:  # which look at the box of all joints
        np.testing.assert_array_equal(np.delete(hand.joints_px, 8, 0), np.delete(plain.joints_px, 8, 0))
    absent = np.full((2, 21, 3), np.nan)
    sample = HandSample(PICTURE, camera, np.zeros(2, bool), absent[..., :2], absent, np.zeros((2, 21), bool))
    found = predict([sample], lambda s: estimator.estimate(s.image, s.camera), dataset="", weights="", settings={})
    np.testing.assert_array_equal(found.joints_px[0, LEFT], hand.joints_px)


def test_a_hand_is_valid_only_where_its_joints_are_finite():
    estimator = HandEstimator(one_hand((80, 140)), make_card())
    camera = PinholeCamera.ego3dhands(240, 135)
    assert estimator.estimate(PICTURE, camera).left.valid
    read_out = estimator.stages.read_out

    def one_unknown(*given):
        joints_px, scores = read_out(*given)
        scores[0, 4] = np.nan
        return joints_px, scores

    hand = restaged(estimator, read_out=one_unknown).estimate(PICTURE, camera).left
    assert hand.valid is False and hand.joints_m is None and hand.range_m is None and hand.joints_px is not None


def test_a_root_beyond_the_lens_model_keeps_its_canonical_pose():
    """Nothing is unprojected there, so there is no range; the looks of rolled cameras take the pinhole's rays."""
    camera = dataclasses.replace(PinholeCamera.from_fov(100, 240, 135), distortion=(-1.2, 0, 0, 0))
    hands = []
    for rolls_deg in ((), (10.0, -10.0)):
        estimator = HandEstimator(one_hand((180, 230)), make_card(tta_rolls_deg=rolls_deg))
        hands.append(estimator.estimate(PICTURE, camera).left)
        assert np.isnan(unproject(hands[-1].joints_px[ROOT], camera)).any() and hands[-1].valid is False
    assert np.isfinite(hands[1].canonical).all()
    assert 0 < np.abs(hands[1].canonical - hands[0].canonical).max() < 0.5


@pytest.mark.parametrize("rolls_deg", [(), (10.0, -10.0)])
def test_an_estimated_box_of_which_there_is_no_crop_is_no_error_and_a_true_one_is(rolls_deg):
    camera = PinholeCamera.from_fov(170, 240, 135)
    estimator = HandEstimator(one_hand((0, 200)), make_card(tta_rolls_deg=rolls_deg))
    box_px = estimator.segment(PICTURE)[1].boxes_px
    with pytest.raises(InputError, match="half space"):
        estimator.stages.crop(PICTURE, np.zeros((135, 240), np.uint8), box_px[LEFT], LEFT, camera)
    pose = estimator.estimate(PICTURE, camera)
    assert pose.left.present and np.isfinite(pose.left.joints_px).all() and not pose.right.present
    with pytest.raises(InputError, match="half space"):
        estimator.estimate(PICTURE, camera, truth=StageTruth(boxes_px=box_px))


def test_canonical_truth_is_that_of_the_real_hand():
    """`StageTruth.canonical` is not mirrored, so it is what `canonical_from_camera` gives for a right hand too."""
    sample = drawn_hands(2)
    truth = StageTruth(canonical=canonical_from_camera(sample.joints_m).joints)
    oracle = Oracle(sample, make_card())
    with_truth = oracle.estimator.estimate(sample.image, sample.camera, HAND_LENGTH_M, truth)
    without = oracle.estimator.estimate(sample.image, sample.camera, HAND_LENGTH_M)
    np.testing.assert_allclose(with_truth.right.joints_m, without.right.joints_m, atol=1e-6)


def judging(oracle, hand_seg_net):
    """The oracle's pipeline behind another HandSegNet, with a PoseNet2D that knows which hand a crop's centre is in."""
    card = dataclasses.replace(oracle.card, hand_logit=True)
    left_like = oracle.canonical * np.array([[[1, 1, 1]], [[-1, 1, 1]]])
    networks = Networks(hand_seg_net, UNUSED.pose_net_2d, lambda maps: left_like[np.flatnonzero(oracle.sample.present)])
    centres = true_boxes(oracle.sample).reshape(2, 2, 2).mean(axis=1)

    def locate(crops):
        middles = [crop.image_from_crop @ [card.crop_size / 2, card.crop_size / 2, 1] for crop in crops]
        off = [np.linalg.norm(m[:2] / m[2] - centres[crop.side]) for m, crop in zip(middles, crops, strict=True)]
        return oracle.true_maps(crops), np.where(np.array(off) < 10, 12.0, -12.0)

    return restaged(HandEstimator(networks, card), locate=locate)


def swapped(oracle):
    """A HandSegNet that calls the left hand right and the right one left."""

    def hand_seg_net(batch):
        logits, energies = oracle.hand_seg_net(batch)
        return logits[:, [0, 2, 1]], energies[:, ::-1]

    return hand_seg_net


def test_swapped_hands_are_set_right_by_the_judge():
    """HandSegNet calls the left hand right and the right one left; PoseNet2D does not."""
    sample = drawn_hands(0)
    oracle = Oracle(sample, make_card())

    pose = judging(oracle, swapped(oracle)).estimate(sample.image, sample.camera, HAND_LENGTH_M)
    np.testing.assert_array_equal(pose.masks, hand_masks(sample))
    for side, hand in enumerate(pose.hands):
        assert hand.present and hand.score > 0.9
        np.testing.assert_allclose(hand.joints_px, sample.joints_px[side], atol=0.3)
        np.testing.assert_allclose(hand.joints_m, sample.joints_m[side], atol=5e-3)


def test_of_two_hands_both_may_be_exchanged_where_one_is_doubtful():
    """Named case: a swapped pair, one of which the judge takes for what HandSegNet says, lost a hand."""
    sample = drawn_hands(0)
    oracle = Oracle(sample, make_card())

    estimator = judging(oracle, swapped(oracle))
    locate = estimator.stages.locate

    def unsure(crops):
        maps, logits = locate(crops)
        taken_for_right = [crop.side == RIGHT and logit < 0 for crop, logit in zip(crops, logits, strict=True)]
        return maps, np.where(taken_for_right, 0.5, logits)

    pose = restaged(estimator, locate=unsure).estimate(sample.image, sample.camera, HAND_LENGTH_M)
    assert pose.left.present and pose.right.present
    np.testing.assert_array_equal(pose.masks, hand_masks(sample))


def test_hands_that_the_judge_swaps_are_cut_anew_from_true_masks_too():
    """Named case: with true masks, which stay, swapped hands kept the crops in which they were dimmed."""
    sample = drawn_hands(0)
    oracle = Oracle(sample, make_card())

    def swapped(batch):
        logits, energies = oracle.hand_seg_net(batch)
        return logits, energies[:, ::-1]

    estimator, looks = judging(oracle, swapped), []
    locate = estimator.stages.locate

    def noted(crops):
        looks.append(crops)
        return locate(crops)

    estimator = restaged(estimator, locate=noted)
    pose = estimator.estimate(sample.image, sample.camera, HAND_LENGTH_M, StageTruth(masks=hand_masks(sample)))
    np.testing.assert_array_equal(pose.masks, hand_masks(sample))
    as_found, mirrored, last = looks
    assert [crop.side for crop in mirrored] == [RIGHT, LEFT]
    assert [crop.side for crop in as_found] == [crop.side for crop in last] == [LEFT, RIGHT]
    for before, after in zip(as_found[::-1], last, strict=True):
        assert after.image.max() > before.image.max()


def striped(oracle):
    """A HandSegNet that finds the left hand as a right one too, and calls every other column of it so."""

    def hand_seg_net(batch):
        logits, energies = oracle.hand_seg_net(batch)
        logits[:, 2] = np.where(np.arange(logits.shape[-1]) % 2, logits[:, 1] + 1, logits[:, 2])
        return logits, np.repeat(energies[:, :1], 2, axis=1)

    return hand_seg_net


def test_a_ghost_on_the_other_hand_is_refused_and_gives_its_pixels_back():
    sample = drawn_hands(1, present=(True, False))
    oracle = Oracle(sample, make_card())
    plain = HandEstimator(dataclasses.replace(oracle.estimator.networks, hand_seg_net=striped(oracle)), oracle.card)
    assert plain.segment(sample.image)[1].present.all()
    pose = judging(oracle, striped(oracle)).estimate(sample.image, sample.camera, HAND_LENGTH_M)
    assert pose.left.present and not pose.right.present
    np.testing.assert_array_equal(pose.masks, hand_masks(sample))
    np.testing.assert_allclose(pose.left.joints_px, sample.joints_px[LEFT], atol=0.3)


def test_a_hand_found_as_both_is_judged_by_the_whole_of_it():
    """Every other column of a left hand is called a right one. Shown so, it looks like a right hand; whole, like a
    left one."""
    sample = drawn_hands(1, present=(True, False))
    oracle = Oracle(sample, make_card())
    estimator = judging(oracle, striped(oracle))
    cut, in_parts = estimator.stages.crop, []

    def crop(image, masks, *where):
        crop = cut(image, masks, *where)
        if len(np.unique(masks)) == 3:
            in_parts.append(crop)
        return crop

    def locate(crops):
        logits = [[-8.0, 4.0] if any(crop is part for part in in_parts) else [12.0, -12.0] for crop in crops]
        return oracle.true_maps(crops), np.array([both[crop.side] for both, crop in zip(logits, crops, strict=True)])

    def same_joints(heatmaps, crops):
        return np.repeat(sample.joints_px[:1], len(crops), axis=0), np.ones((len(crops), 21))

    estimator = restaged(estimator, crop=crop, locate=locate, read_out=same_joints)
    pose = estimator.estimate(sample.image, sample.camera, HAND_LENGTH_M)
    assert in_parts and pose.left.present and not pose.right.present
    np.testing.assert_array_equal(pose.masks, hand_masks(sample))
    np.testing.assert_allclose(pose.left.joints_px, sample.joints_px[LEFT], atol=0.3)


@pytest.mark.parametrize("scores", [0.9, 0.0])
def test_a_hand_with_its_joints_nowhere_in_particular_is_none(scores):
    """HandSegNet is sure, PoseNet2D's judge is not; the right hand's maps have the last word."""
    sample = drawn_hands(2)
    oracle = Oracle(sample, make_card())
    estimator = judging(oracle, oracle.hand_seg_net)
    locate, read_out = estimator.stages.locate, estimator.stages.read_out

    def unsure(crops):
        return locate(crops)[0], np.array([[12.0, 0.5][crop.side] for crop in crops])

    def scored(heatmaps, crops):
        by_side = np.array([[1.0, scores][crop.side] for crop in crops])
        return read_out(heatmaps, crops)[0], np.repeat(by_side[:, None], 21, axis=1)

    estimator = restaged(estimator, locate=unsure, read_out=scored)
    masks, boxes = estimator.segment(sample.image)
    masks, boxes, look, *_ = estimator.find_hands(finder_of(estimator, sample), masks, boxes)
    there = [True, scores > 0.5]
    assert boxes.present.tolist() == there and look.sides.tolist() == np.flatnonzero(there).tolist()
    assert (boxes.scores > 0.5).tolist() == there and np.isfinite(boxes.boxes_px).all(axis=1).tolist() == there
    assert [(masks == 1 + side).any() for side in (LEFT, RIGHT)] == there
    np.testing.assert_array_equal(masks == 1 + LEFT, hand_masks(sample) == 1 + LEFT)


def test_what_is_no_hand_is_refused():
    sample = drawn_hands(2)
    estimator = judging(Oracle(sample, make_card()), Oracle(sample, make_card()).hand_seg_net)
    no_hand = restaged(estimator, locate=lambda crops: (np.zeros((len(crops), 21, 32, 32)), np.full(len(crops), -12.0)))
    pose = no_hand.estimate(sample.image, sample.camera, HAND_LENGTH_M)
    assert not pose.left.present and not pose.right.present and not pose.masks.any()


def test_a_joint_without_line_of_sight_does_not_cost_the_hand_its_range():
    """Named case: behind a barrel lens a fingertip found far outside the picture made a hand's range unknown."""
    sample = drawn_hands(0)
    camera = dataclasses.replace(sample.camera, distortion=(-0.28, 0.0, 0.0, 0.0))
    canonical = canonical_from_camera(sample.joints_m).joints
    x = sample.joints_m[..., :2] / sample.joints_m[..., 2:]
    bent = x * (1 - 0.28 * (x**2).sum(axis=-1, keepdims=True))
    joints_px, lengths_m = [camera.fx, camera.fy] * bent + [camera.cx, camera.cy], np.full(2, HAND_LENGTH_M)
    joints_px[RIGHT, 8] = [10 * camera.width, camera.cy]
    assert np.isnan(unproject(joints_px[RIGHT, 8], camera)).any()
    pose = HandEstimator(UNUSED, make_card()).stages.place(canonical, joints_px, np.ones((2, 21)), camera, lengths_m)
    assert pose.valid.all()
    np.testing.assert_allclose(pose.joints_m, sample.joints_m, atol=1e-6)


def test_a_rolled_look_without_line_of_sight_does_not_cost_the_hand_its_pose():
    """Named case: behind a barrel lens one rolled look that found the root far outside the picture made all of the
    hand's pose NaN."""
    sample = drawn_hands(4)
    camera = dataclasses.replace(sample.camera, distortion=(-0.28, 0.0, 0.0, 0.0))
    card = make_card(tta_rolls_deg=(20.0, -20.0))
    estimator = HandEstimator(Oracle(sample, card).estimator.networks, card)
    masks, boxes = estimator.segment(sample.image)
    look = keypoints_of(estimator, sample, masks, boxes.boxes_px)
    look = dataclasses.replace(look, joint_scores=np.ones((2, 21)))
    canonical = canonical_from_camera(sample.joints_m).joints
    away = look.joints_px.copy()
    away[LEFT, ROOT] = [10 * camera.width, camera.cy]
    faint = np.full((2, 21), 0.4)
    stages = dataclasses.replace(
        estimator.stages,
        locate=lambda crops: (look.heatmaps, look.hand_logits),
        read_out=lambda heatmaps, crops: (away, faint),
        lift=lambda seen: canonical,
    )
    again, poses = HandViewer(stages, card, sample.image, masks, camera).agreed(look, canonical)
    assert np.isfinite(poses).all() and np.isfinite(again.joints_px).all()
    np.testing.assert_allclose(np.delete(again.joint_scores.ravel(), LEFT * 21 + ROOT), np.sqrt((1 + 0.4 + 0.4) / 3))
    assert again.joint_scores[LEFT, ROOT] < 0.1  # the looks do not agree where it is


def test_four_threads_share_one_estimator(tmp_path):
    """As a web server or a window with a worker does; one request for all raised "Infer Request is busy"."""
    estimator = HandEstimator.from_preset(write_tiny_weights(tmp_path / "tiny"))
    camera = PinholeCamera.from_fov(60, 160, 96)
    rng = np.random.default_rng(0)
    images = [rng.integers(0, 256, (96, 160, 3), dtype=np.uint8) for _ in range(24)]
    expected = [estimator.estimate(image, camera) for image in images]
    with ThreadPoolExecutor(max_workers=4) as threads:
        found = list(threads.map(lambda image: estimator.estimate(image, camera), images))
    for one, other in zip(expected, found, strict=True):
        for hand, same in zip(one.hands, other.hands, strict=True):
            assert hand.present == same.present and hand.range_m == same.range_m
            if hand.present:
                np.testing.assert_array_equal(hand.joints_px, same.joints_px)


def test_hand_lengths_and_cameras_in_another_unit_are_warned_of(tmp_path):
    estimator = HandEstimator.from_preset(write_tiny_weights(tmp_path / "tiny"))
    image = np.zeros((96, 160, 3), np.uint8)
    with pytest.warns(PlausibilityWarning, match="centimetres; metres are expected") as given:
        estimator.estimate(image, PinholeCamera.from_fov(60, 160, 96), hand_length_m=11)
    assert {warning.filename for warning in given} == {__file__}  # of the line to be mended
    with pytest.warns(PlausibilityWarning, match="exchanged"):
        estimator.estimate(image, PinholeCamera(100, 100, 48, 80, 160, 96))
