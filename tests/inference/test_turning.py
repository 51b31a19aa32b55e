"""Turns of pictures by quarters: what is found comes back exactly, and who is believed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from twohands.geometry.camera import project
from twohands.geometry.canonical import camera_from_canonical, canonical_from_camera
from twohands.geometry.picture_turn import TURN_AREAS, TURNS, turn_logits
from twohands.geometry.rotation import centring_angles
from twohands.inference.decision import DecisionConfig
from twohands.inference.side_keeping import SideMemory, Track
from twohands.inference.trail import Trail
from twohands.inference.turning import (
    likely_turn,
    told_turn,
    turned_camera,
    turned_image,
    turned_points,
    turned_pose,
    turned_trail,
    upright_first,
)
from twohands.skeleton import ROOT
from twohands.types import HandPose, PinholeCamera, TwoHandPose

CAMERA = PinholeCamera(310.0, 330.0, 200.0, 110.0, 400, 240, (0.05, -0.02, 0.003, -0.004, 0.01))
CONFIG = DecisionConfig()


def some_hand(rng: np.random.Generator, camera: PinholeCamera = CAMERA) -> HandPose:
    """A hand before the camera, all of its parts agreeing."""
    joints_m = rng.normal(0, 0.04, (21, 3)) + np.array([0.06, -0.03, 0.6])
    root = joints_m[ROOT]
    theta, phi = centring_angles(root)
    joints_px = project(joints_m, camera)
    return HandPose(
        present=True,
        score=0.9,
        box_px=np.array([*joints_px.min(axis=0), *joints_px.max(axis=0)]),
        joints_px=joints_px,
        joint_scores=np.ones(21),
        canonical=np.asarray(canonical_from_camera(joints_m).joints),
        joints_m=joints_m,
        range_m=float(np.linalg.norm(root)),
        theta_deg=float(np.degrees(theta)),
        phi_deg=float(np.degrees(phi)),
        valid=True,
    )


def pose_of(turn_logits: np.ndarray | None = None) -> TwoHandPose:
    """One hand of two."""
    rng = np.random.default_rng(3)
    masks = rng.integers(0, 3, (240, 400)).astype(np.uint8)
    return TwoHandPose(
        some_hand(rng), HandPose(present=False), CAMERA, masks, crop_masks=masks, turn_logits=turn_logits
    )


def test_a_pixel_goes_where_the_picture_takes_it():
    """The one bright pixel of a picture, (u, v) = (5, 2): its middle, (5.5, 2.5), of 7 x 4."""
    image = np.zeros((4, 7), np.uint8)
    image[2, 5] = 255
    for turn in range(TURNS):
        row, column = np.argwhere(turned_image(image, turn))[0]
        assert np.array_equal(turned_points(np.array([5.5, 2.5]), (4, 7), turn), [column + 0.5, row + 0.5])


@pytest.mark.parametrize("turn", range(TURNS))
def test_a_turned_camera_sees_turned_points_where_the_picture_has_them(turn):
    """Distortion included: points of the camera frame roll by a quarter, (x, y) to (y, -x), and so do their pixels."""
    points = np.random.default_rng(0).normal(0, 0.2, (50, 3)) + np.array([0, 0, 1.0])
    rolled = points.copy()
    for _ in range(turn):
        rolled = rolled[:, [1, 0, 2]] * (1, -1, 1)
    there = project(rolled, turned_camera(CAMERA, turn))
    assert np.allclose(there, turned_points(project(points, CAMERA), (240, 400), turn), atol=1e-9)


@pytest.mark.parametrize("turn", range(1, TURNS))
def test_what_is_found_in_a_turned_picture_agrees_with_itself(turn):
    pose = turned_pose(pose_of(), turn)
    hand = pose.left
    size = (400, 240) if turn % 2 else (240, 400)
    assert (pose.camera.height, pose.camera.width) == size == pose.masks.shape
    assert np.allclose(project(hand.joints_m, pose.camera), hand.joints_px, atol=1e-9)
    assert np.allclose(hand.box_px, [*hand.joints_px.min(axis=0), *hand.joints_px.max(axis=0)])
    angles = np.radians([hand.theta_deg, hand.phi_deg])
    length_m = np.linalg.norm(hand.joints_m[0] - hand.joints_m[ROOT])
    placed = camera_from_canonical(hand.canonical, length_m, np.array(hand.range_m), *angles)
    assert np.allclose(placed, hand.joints_m, atol=1e-12)
    assert not pose.right.present


def test_a_turn_and_back_changes_nothing():
    pose = pose_of(np.array([0.0, -1.0, -2.0, -3.0]))
    for turn in range(TURNS):
        there = turned_pose(pose, turn)
        assert there.turn_logits[turn] == 0.0  # the upright picture, turned by so many
        back = turned_pose(there, -turn)
        for name in ("joints_px", "box_px", "joints_m", "canonical", "theta_deg", "phi_deg"):
            assert np.allclose(getattr(back.left, name), getattr(pose.left, name), atol=1e-9), name
        assert np.allclose([getattr(back.camera, n) for n in ("fx", "fy", "cx", "cy")], [310, 330, 200, 110])
        assert np.allclose(back.camera.distortion, CAMERA.distortion)
        assert np.array_equal(back.masks, pose.masks) and np.array_equal(back.turn_logits, pose.turn_logits)


def test_a_hand_of_which_nothing_is_known_but_its_joints_is_turned():
    pose = replace(pose_of(), left=HandPose(present=True, joints_px=np.zeros((21, 2)), score=0.5))
    assert np.array_equal(turned_pose(pose, 1).left.joints_px, np.tile([0.0, 400.0], (21, 1)))


def test_a_clips_memory_is_turned_with_its_frames():
    """A hand at (100, 50) that moves by (8, 2): a quarter further at (50, 300), moving by (2, -8)."""
    track = Track(np.array([100.0, 50.0]), 40.0, np.array([8.0, 2.0]), 3.0, 1)
    pose = replace(pose_of(), around_px=np.array([[100.0, 50.0], [108.0, 52.0]]))
    trail = Trail((pose, pose), pose, True, 2, SideMemory(CONFIG, (track, None)))
    turned = turned_trail(trail, (240, 400), 1)
    assert np.array_equal(turned.last[-1].around_px, [[50.0, 300.0], [52.0, 292.0]])
    left, right = turned.sides.tracks
    assert np.array_equal(left.middle, [50.0, 300.0]) and np.array_equal(left.step, [2.0, -8.0])
    assert (left.size, left.logit, left.unseen, right) == (40.0, 3.0, 1, None)
    assert turned.may_rest and turned.rested == 2 and turned.seen is turned.last[-1]
    assert turned_trail(trail, (240, 400), 0) is trail


def test_every_area_has_maps_of_its_own():
    """Each area's map of turn 1 is 1 within it and 5 without: 9 in all."""
    maps = np.zeros((TURN_AREAS**2, TURNS, 7, 12))
    for area in range(TURN_AREAS**2):
        maps[area, 1] = np.where(cells_of(area, 7, 12), 1.0, 5.0)
    assert np.allclose(turn_logits(maps.reshape(-1, 7, 12)), [0, 9, 0, 0])


def cells_of(area: int, height: int, width: int) -> np.ndarray:
    """(height, width) bool, the cells of an area: from i / 3 to (i + 1) / 3 of the rows, rounded down, and so on."""
    i, j = divmod(area, TURN_AREAS)
    mask = np.zeros((height, width), bool)
    mask[i * height // 3 : (i + 1) * height // 3, j * width // 3 : (j + 1) * width // 3] = True
    return mask


def test_a_map_of_fewer_cells_than_areas_is_read():
    assert np.isfinite(turn_logits(np.ones((TURN_AREAS**2 * TURNS, 1, 2)))).all()


class Eye:
    """Sees nothing but what pictures say of their turn: `said` of an upright one is of turn 0."""

    def __init__(self, turned: int, lead: float) -> None:
        self.turned, self.lead, self.views = turned, lead, []

    def __call__(self, image: np.ndarray, camera: PinholeCamera, trail: Trail | None) -> TwoHandPose:
        assert image.shape[:2] == (camera.height, camera.width)
        assert trail is None or trail.seen.camera == camera
        self.views.append(int(image[0, 0, 0]))  # by how many quarters this view is turned against the picture
        logits = np.zeros(TURNS)
        logits[(self.turned + self.views[-1]) % TURNS] = self.lead
        return TwoHandPose(HandPose(False), HandPose(False), camera, turn_logits=logits)


def marked_picture() -> np.ndarray:
    """Whatever corner comes to the upper left says by how many quarters the picture was turned."""
    image = np.zeros((240, 400, 3), np.uint8)
    image[0, -1], image[-1, -1], image[-1, 0] = 1, 2, 3
    return image


def test_an_upright_picture_is_seen_once():
    eye = Eye(0, 10.0)
    pose = upright_first(eye, marked_picture(), CAMERA, None, CONFIG)
    assert eye.views == [0] and pose.camera == CAMERA


@pytest.mark.parametrize("turned", [1, 2, 3])
def test_a_turned_picture_is_seen_upright(turned):
    eye = Eye(turned, 10.0)
    pose = upright_first(eye, marked_picture(), CAMERA, None, CONFIG)
    assert eye.views == [0, (-turned) % TURNS]
    assert np.argmax(pose.turn_logits) == turned and pose.camera == CAMERA


def test_a_picture_that_says_upright_of_every_view_is_taken_as_it_is():
    """Whoever sees three views turned and none upright is not believed."""

    class Fickle(Eye):
        def __call__(self, image: np.ndarray, camera: PinholeCamera, trail: Trail | None) -> TwoHandPose:
            pose = super().__call__(image, camera, trail)
            return replace(pose, turn_logits=np.array([0.0, 10.0, 0.0, 0.0]))

    eye = Fickle(0, 0.0)
    pose = upright_first(eye, marked_picture(), CAMERA, None, CONFIG)
    assert eye.views == [0, 3] and pose.turn_logits is None


def test_a_turn_that_loses_a_hand_is_not_believed():
    class Loses(Eye):
        def __call__(self, image: np.ndarray, camera: PinholeCamera, trail: Trail | None) -> TwoHandPose:
            pose = super().__call__(image, camera, trail)
            return replace(pose, left=HandPose(present=self.views[-1] == 0))

    eye = Loses(2, 10.0)
    pose = upright_first(eye, marked_picture(), CAMERA, None, CONFIG)
    assert eye.views == [0, 2] and pose.left.present and pose.turn_logits is None


def test_a_clip_that_is_turned_is_seen_so_at_once():
    before = pose_of()
    trail = Trail((before,), before, turn_logits=np.array([-6.0, -6.0, 0.0, -6.0]))
    eye = Eye(2, 10.0)
    upright_first(eye, marked_picture(), CAMERA, trail, CONFIG)
    assert eye.views == [2]


def test_frames_add_up_and_one_alone_turns_no_clip():
    upright, odd = pose_of(np.array([8.0, 0, 0, 0])), pose_of(np.array([0, 0, 8.0, 0]))
    known = told_turn(None, upright, CONFIG)
    assert np.array_equal(known, [0, -6, -6, -6])
    known, frames = told_turn(known, odd, CONFIG), 1
    assert likely_turn(known) == 0 == likely_turn(None)
    while likely_turn(known) == 0:
        known, frames = told_turn(known, odd, CONFIG), frames + 1
    assert frames == 3  # -6 + .3 * 8 a frame
    assert told_turn(known, pose_of(None), CONFIG) is known
