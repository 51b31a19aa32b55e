"""Other trackers' hands as our poses, in metres."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from twohands.errors import InputError
from twohands.geometry.anatomy import anatomical_joints
from twohands.geometry.boxes import box_from_points
from twohands.geometry.lifting import canonical_from_shape, lift
from twohands.geometry.projection import Method
from twohands.lifting.foreign import ForeignFrame, ForeignHand, ForeignHands
from twohands.lifting.reading import Hints, from_record
from twohands.plausibility import camera_doubts, hand_length_doubts, warn
from twohands.skeleton import N_JOINTS, SIDES
from twohands.types import HandPose, PinholeCamera, TwoHandPose

KEY_BONE_NAMES: Final = ("wrist", "little")
ABSENT: Final = HandPose(present=False)


def lift_hands(
    results: Any,
    camera: PinholeCamera,
    hand_length_m: float,
    *,
    hints: Hints | None = None,
    mirrored: bool = False,
) -> list[TwoHandPose]:
    """Hands that another tracker found, in metres.

    Args:
        results: what MediaPipe (legacy, Tasks), WiLoR(-mini) or HaMeR return for one picture, or a list of these, or
            what JSON holds of them (`lifting.reading`); numpy or torch.
        camera: of the pictures.
        hand_length_m: as `HandEstimator.estimate`: about 0.6 times the length from the wrist's crease to the tip of the
            middle finger, in metres. What a tracker takes for wrist and knuckle is allowed for (its `bone_ratio`).
        hints: what the results do not say.
        mirrored: the pictures were mirrored, as webcams show them.

    Returns:
        One for each picture, of an unmirrored camera; of several hands of one side the most certain.

    Raises:
        DataFormatError: no results of a tracker that we know.
        InputError: a hand length that is no positive number, or a tracker that knows the picture alone.
    """
    foreign = from_record(results, camera, hints)
    warn(hand_length_doubts(hand_length_m) + camera_doubts(camera))
    return place_hands(foreign, camera, hand_length_m * foreign.bone_ratio, mirrored=mirrored)


def place_hands(
    foreign: ForeignHands,
    camera: PinholeCamera,
    bone_length_m: float,
    *,
    poses: Sequence[TwoHandPose] | None = None,
    mirrored: bool = False,
    method: Method = "fitted",
) -> list[TwoHandPose]:
    """Places what was read of another tracker.

    Args:
        foreign: what was read.
        camera: of the pictures.
        bone_length_m: from wrist to middle knuckle where that tracker puts them, metres.
        poses: our own results for the same pictures, whose hands' shapes, with wrist and knuckles moved to where
            anatomists put them, go to hands that have none; found by `index`.
        mirrored: the pictures were mirrored: pixels, shapes and sides are turned back.
        method: as `geometry.projection.project_global`.

    Returns:
        One for each frame; of several hands of one side the most certain. A hand that cannot be placed, or for which
        `poses` has no pose, is present but not valid.

    Raises:
        InputError: the bone length is no positive number, or a hand has no shape and `poses` is not given.
    """
    if not (math.isfinite(bone_length_m) and bone_length_m > 0):
        raise InputError(f"hand length must be a positive number of metres, got {bone_length_m}")
    ours = None if poses is None else {pose.index: pose for pose in poses}
    frames: list[ForeignFrame] = []
    for frame in foreign.frames:
        best = best_of_each_side(frame.hands)
        hands = [_with_pose(hand, frame.index, ours, foreign.system) for hand in best if hand is not None]
        frames.append(
            replace(frame, hands=tuple(_turned(hand, camera) for hand in hands) if mirrored else tuple(hands))
        )
    placed = iter(_placed([hand for frame in frames for hand in frame.hands], foreign, camera, bone_length_m, method))
    results = []
    for frame in frames:
        sides = [ABSENT, ABSENT]
        for hand in frame.hands:
            sides[hand.side] = next(placed)
        results.append(TwoHandPose(sides[0], sides[1], camera, index=frame.index, time_s=frame.time_s))
    return results


def best_of_each_side(hands: Sequence[ForeignHand]) -> tuple[ForeignHand | None, ForeignHand | None]:
    """(LEFT, RIGHT): the hand with the highest score of each side, the first of equals; None where there is none."""
    best: list[ForeignHand | None] = [None, None]
    for hand in hands:
        now = best[hand.side]
        if now is None or (hand.score or 0.0) > (now.score or 0.0):
            best[hand.side] = hand
    return best[0], best[1]


def surplus(foreign: ForeignHands) -> int:
    """Hands that are left out because another of the same side was more certain."""
    return sum(
        len(frame.hands) - sum(h is not None for h in best_of_each_side(frame.hands)) for frame in foreign.frames
    )


def _with_pose(hand: ForeignHand, index: int, ours: Mapping[int, TwoHandPose] | None, system: str) -> ForeignHand:
    if hand.joints_3d is not None:
        return hand
    if ours is None:
        raise InputError(
            f"{system} knows the picture alone; give our results for the same pictures (twohands track PICTURES, then "
            "--pose hands.json), whose hands' shapes are used"
        )
    pose = ours[index].hands[hand.side] if index in ours else ABSENT
    if pose.joints_m is None:
        return hand
    return replace(hand, joints_3d=anatomical_joints(pose.joints_m))


def _turned(hand: ForeignHand, camera: PinholeCamera) -> ForeignHand:
    """The hand as it is, of a picture that was mirrored."""
    pixels = np.stack([camera.width - hand.joints_px[:, 0], hand.joints_px[:, 1]], axis=-1)
    shape = None if hand.joints_3d is None else hand.joints_3d * [-1.0, 1.0, 1.0]
    return replace(hand, side=1 - hand.side, joints_px=pixels, joints_3d=shape)


def _placed(
    hands: Sequence[ForeignHand], foreign: ForeignHands, camera: PinholeCamera, bone_length_m: float, method: Method
) -> list[HandPose]:
    """All hands at once."""
    if not hands:
        return []
    pixels = np.stack([hand.joints_px for hand in hands])
    shapes = np.stack([np.full((N_JOINTS, 3), np.nan) if hand.joints_3d is None else hand.joints_3d for hand in hands])
    unknown = np.full(N_JOINTS, np.nan)
    scores = np.stack([unknown if hand.joint_scores is None else hand.joint_scores for hand in hands])
    pose = lift(pixels, shapes, camera, bone_length_m, view=foreign.view, joint_scores=scores, method=method)
    canonical = np.asarray(canonical_from_shape(shapes, pixels, camera, view=foreign.view))
    boxes = np.asarray(box_from_points(pixels))
    results = []
    for i, hand in enumerate(hands):
        valid = bool(pose.valid[i])
        results.append(
            HandPose(
                present=True,
                score=hand.score,
                box_px=boxes[i],
                joints_px=hand.joints_px,
                joint_scores=hand.joint_scores,
                canonical=canonical[i] if np.isfinite(canonical[i]).all() else None,
                joints_m=np.asarray(pose.joints_m[i]) if valid else None,
                range_m=float(pose.radius_m[i]) if valid else None,
                theta_deg=_degrees(pose.theta[i]),
                phi_deg=_degrees(pose.phi[i]),
                key_bone=KEY_BONE_NAMES[int(pose.key_bone[i])],
                method=method,
                valid=valid,
            )
        )
    return results


def sides_word(poses: Sequence[TwoHandPose]) -> str:
    """How many hands of each side were placed, in words."""
    counts = [sum(bool(pose.hands[side].valid) for pose in poses) for side in range(2)]
    return ", ".join(f"{count} {word}" for count, word in zip(counts, SIDES, strict=True))


def _degrees(angle: float) -> float | None:
    return math.degrees(angle) if math.isfinite(angle) else None
