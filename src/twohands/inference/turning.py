"""Pictures of cameras that lie on their side or hang head down: seen upright, and what is found turned back.

Ours. HandSegNet has learnt from upright people; seen upside down it misses most of their hands. By how many quarters a
picture is turned it says by itself (`HandMaps.turn_logits`), since it sees people, their arms and the room. A turn of a
picture by quarters loses nothing: it is what a camera sees that is rolled so far about its line of sight.

A turn is a number of quarters, 0..3, counter-clockwise, by which an upright picture was turned; -turn makes it upright.
Points (u, v) of a picture of height H and width W lie at (v, W - u) in the picture that is turned by one quarter.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from twohands.geometry.boxes import box_from_points
from twohands.geometry.canonical import unrolled_canonical
from twohands.geometry.picture_turn import TURNS
from twohands.geometry.rotation import centring_angles, rotation_about_z, rotation_from_angles
from twohands.inference.decision import DecisionConfig
from twohands.inference.side_keeping import SideMemory, Track
from twohands.inference.trail import Trail
from twohands.types import HandPose, PinholeCamera, TwoHandPose

See = Callable[..., TwoHandPose]
"""image, camera, trail=Trail or None -> what is found in a picture that is taken for upright."""


def upright_first(
    see: See, image: np.ndarray, camera: PinholeCamera, trail: Trail | None, config: DecisionConfig
) -> TwoHandPose:
    """What is found in a picture, seen as the clip has shown it to be turned; and once more where the picture says
    otherwise, which is believed if it says the same then and does not show fewer hands.

    Args:
        see: finds hands.
        image: (H, W, 3).
        camera: of the image.
        trail: of the clip; None of a picture alone.
        config: how frames add up.

    Returns:
        Both hands in the image as it is, with what it says of its turn; nothing where that is not believed.
    """
    size = image.shape[0], image.shape[1]
    known = None if trail is None else trail.turn_logits

    def seen(turn: int) -> TwoHandPose:
        if not turn:
            return see(image, camera, trail=trail)
        upright = None if trail is None else turned_trail(trail, size, -turn)
        pose = see(turned_image(image, -turn), turned_camera(camera, -turn), trail=upright)
        pose = turned_pose(replace(pose, image=None), turn)
        return replace(pose, camera=camera, image=image)  # as they were given: not rounded, nor copied, by turns

    first = likely_turn(known)
    pose = seen(first)
    turn = likely_turn(told_turn(known, pose, config))
    if turn == first:
        return pose
    again = seen(turn)
    believed = likely_turn(told_turn(known, again, config)) == turn and _hands(again) >= _hands(pose)
    return again if believed else replace(pose, turn_logits=None)


def told_turn(known: np.ndarray | None, pose: TwoHandPose, config: DecisionConfig) -> np.ndarray | None:
    """What the frames of a clip say of its turn, (4,), after one more; `known` before it. They err alike, so that they
    say less together than apart, and none is believed beyond a limit, as of the hands' sides."""
    if pose.turn_logits is None:
        return known
    said = pose.turn_logits if known is None else known + config.side_trust * pose.turn_logits
    return np.maximum(said - said.max(), -config.side_limit)


def likely_turn(known: np.ndarray | None) -> int:
    """The most likely turn, by what is known, (4,)."""
    return 0 if known is None else int(np.argmax(known))


def turned_image(image: np.ndarray, turn: int) -> np.ndarray:
    """A picture (H, W, ...) turned by quarters, counter-clockwise; contiguous."""
    return np.ascontiguousarray(np.rot90(image, turn))


def turned_camera(camera: PinholeCamera, turn: int) -> PinholeCamera:
    """The camera of the picture that is turned."""
    for _ in range(turn % TURNS):
        k1, k2, p1, p2, *others = camera.distortion or (0.0,) * 4
        distortion = (k1, k2, -p2, p1, *others) if camera.distortion else ()
        cx, cy = camera.cy, camera.width - camera.cx
        camera = PinholeCamera(camera.fy, camera.fx, cx, cy, camera.height, camera.width, distortion)
    return camera


def turned_points(points_px: np.ndarray, size: tuple[int, int], turn: int) -> np.ndarray:
    """Pixels (..., 2) of a picture of size (H, W) in the picture that is turned."""
    points_px, (height, width) = np.asarray(points_px, np.float64), size
    for _ in range(turn % TURNS):
        points_px = np.stack([points_px[..., 1], width - points_px[..., 0]], axis=-1)
        height, width = width, height
    return points_px


def turned_pose(pose: TwoHandPose, turn: int) -> TwoHandPose:
    """What was found in a picture, as it lies in the picture that is turned and in the frame of its camera."""
    if not turn % TURNS:
        return pose
    size, camera = (pose.camera.height, pose.camera.width), turned_camera(pose.camera, turn)
    left, right = (_turned_hand(hand, size, turn) for hand in pose.hands)
    masks, crop_masks, image = (
        None if known is None else turned_image(known, turn) for known in (pose.masks, pose.crop_masks, pose.image)
    )
    logits = None if pose.turn_logits is None else np.roll(pose.turn_logits, turn)
    around_px = None if pose.around_px is None else turned_points(pose.around_px, size, turn)
    turned = replace(pose, left=left, right=right, camera=camera, masks=masks, crop_masks=crop_masks)
    return replace(turned, turn_logits=logits, around_px=around_px, image=image)


def turned_trail(trail: Trail, size: tuple[int, int], turn: int) -> Trail:
    """What a clip has shown so far, frames of size (H, W), as if all had been turned."""
    if not turn % TURNS:
        return trail
    last = tuple(turned_pose(pose, turn) for pose in trail.last)
    seen = last[-1] if trail.seen is trail.last[-1] else turned_pose(trail.seen, turn)
    left, right = (None if track is None else _turned_track(track, size, turn) for track in trail.sides.tracks)
    return Trail(
        last, seen, trail.may_rest, trail.rested, SideMemory(trail.sides.config, (left, right)), trail.turn_logits
    )


def _hands(pose: TwoHandPose) -> int:
    return sum(hand.present for hand in pose.hands)


def _turned_hand(hand: HandPose, size: tuple[int, int], turn: int) -> HandPose:
    if not hand.present:
        return hand
    roll = rotation_about_z(math.radians(-90 * turn))
    changes: dict[str, object] = {}
    for name in ("joints_px", "other_px"):
        if (points_px := getattr(hand, name)) is not None:
            changes[name] = turned_points(points_px, size, turn)
    if hand.box_px is not None:
        corners = turned_points(np.reshape(hand.box_px, (2, 2)), size, turn)
        changes["box_px"] = np.asarray(box_from_points(corners))
    if hand.joints_m is not None:
        changes["joints_m"] = hand.joints_m @ roll.T
    if hand.theta_deg is not None and hand.phi_deg is not None:
        ray = roll @ rotation_from_angles(*np.radians([hand.theta_deg, hand.phi_deg]))[2]
        theta, phi = centring_angles(ray)
        changes |= {"theta_deg": math.degrees(theta), "phi_deg": math.degrees(phi)}
        if hand.canonical is not None:
            changes["canonical"] = np.asarray(unrolled_canonical(hand.canonical, ray, roll.T))
    return replace(hand, **changes)  # type: ignore[arg-type]


def _turned_track(track: Track, size: tuple[int, int], turn: int) -> Track:
    middle = turned_points(track.middle, size, turn)
    return replace(track, middle=middle, step=turned_points(track.middle + track.step, size, turn) - middle)
