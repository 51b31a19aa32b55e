"""Rendered hands whose places photographed ones can take."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from twohands.datasets.cutting import CutOut
from twohands.datasets.digits import ANATOMICAL
from twohands.geometry.anatomy import anatomical_joints
from twohands.geometry.camera import project
from twohands.skeleton import ELBOW, ROOT, WRIST, part_label
from twohands.synth.render.compositing import compose
from twohands.synth.sets.cache import StoredFrame
from twohands.training.arms import window_of
from twohands.training.pasting import Look, Picture, Place, mean_light, own_blur, rotation, turned
from twohands.types import PinholeCamera

NEAREST_M = 0.05
"""Depth from which on a joint has a place in the picture."""
ANOTHER_COLOUR = 0.5
"""Of logarithms of linear light: what differs this much from a hand in any channel is no skin of its arm."""


@dataclass(frozen=True, slots=True, eq=False)
class Seat:
    """Where a rendered hand sits that a photographed one can replace.

    Attributes:
        side: LEFT or RIGHT.
        wrist_px: (2,) where the photographs' labels have it.
        towards_elbow: (2,) unit vector, or to where the arm is seen if it points at the camera; None if it is not seen.
        palm_px: how long wrist to middle knuckle is when seen from the side.
        light: (3,) mean linear light of the rendered hand.
        sleeved: whether what the arm wears next to it has another colour.
    """

    side: int
    wrist_px: np.ndarray
    towards_elbow: np.ndarray | None
    palm_px: float
    light: np.ndarray
    sleeved: bool

    def place(self, cut: CutOut, rng: np.random.Generator) -> Place:
        """Of a hand on this arm, a little larger or smaller and a little bent to the side."""
        towards = self.towards_elbow
        angle = rng.uniform(0, 2 * np.pi) if towards is None else math.atan2(towards[1], towards[0])
        linear = turned(cut, self.side, self.palm_px / cut.palm_px * math.exp(rng.normal(0, 0.06)), angle)
        bend = rotation(math.radians(rng.normal(0, 12)))
        linear = bend @ linear
        return Place(self.side, linear, self.wrist_px - linear @ cut.joints_px[WRIST])


def seat_of(frame: StoredFrame, camera: PinholeCamera, side: int) -> Seat | None:
    """Where a hand of a frame sits; None if it is absent, hardly to be seen, or too near the camera's plane."""
    joints = frame.joints_m[side]
    if not frame.present[side] or not (joints[1:, 2] > NEAREST_M).all():
        return None
    as_labelled = anatomical_joints(joints[1:], ANATOMICAL)
    palm_m = float(np.linalg.norm(as_labelled[ROOT] - as_labelled[WRIST]))
    palm_px = palm_m * camera.fx / as_labelled[ROOT, 2]
    wrist_px = np.asarray(project(as_labelled[WRIST], camera))
    window = window_of(wrist_px + 2.5 * palm_px * np.array([[-1, -1], [1, 1]]), frame.labels.shape)
    if window is None or not 5 < palm_px < 150:
        return None
    left, top, right, bottom = window
    labels, rgb = frame.labels[top:bottom, left:right], frame.rgb[top:bottom, left:right]
    hand = cv2.inRange(labels, np.array(part_label(side, 1)), np.array(part_label(side, 6))) > 0
    if hand.sum() < 0.3 * palm_px**2:
        return None
    light = mean_light(rgb, hand)
    near = np.zeros(labels.shape, np.uint8)
    cv2.circle(near, np.rint(wrist_px - [left, top]).astype(int).tolist(), round(1.2 * palm_px), 1, -1)
    arm = (near > 0) & (labels == part_label(side, 0))
    seen = np.argwhere(arm)[:, ::-1] + [left + 0.5, top + 0.5]
    towards = None
    for end, least in ((_seen_at(joints[ELBOW], camera), 0.5), (seen.mean(axis=0) if len(seen) >= 8 else None, 0.15)):
        away = np.zeros(2) if end is None else end - wrist_px
        if towards is None and np.linalg.norm(away) > least * palm_px:
            towards = away / np.linalg.norm(away)
    cloth = mean_light(rgb, arm) if arm.sum() >= 8 else light
    sleeved = bool(np.abs(np.log((cloth + 0.01) / (light + 0.01))).max() > ANOTHER_COLOUR)
    return Seat(side, wrist_px, towards, palm_px, light, sleeved)


def _seen_at(point_m: np.ndarray, camera: PinholeCamera) -> np.ndarray | None:
    """(2,) pixels of a point; None if it is not well before the camera."""
    return np.asarray(project(point_m, camera)) if point_m[2] > NEAREST_M else None


def without(frame: StoredFrame, gone: np.ndarray) -> StoredFrame:
    """A frame with some of its pixels (H, W) bool taken away: where they were before a body, the body goes on, in the
    colours around; elsewhere nothing is left."""
    if not gone.any():
        return frame
    height, width = gone.shape
    small = (max(width // 8, 1), max(height // 8, 1))
    kept = np.where(gone, np.uint8(0), frame.alpha)
    cover = cv2.resize(kept, small, interpolation=cv2.INTER_AREA).astype(np.float32) / 255
    known = cv2.resize((~gone).astype(np.float32), small, interpolation=cv2.INTER_AREA)
    premultiplied = cv2.resize(
        cv2.multiply(frame.rgb, cv2.merge([kept] * 3), scale=1 / 255), small, interpolation=cv2.INTER_AREA
    )
    around = cv2.GaussianBlur(np.dstack([premultiplied.astype(np.float32), cover, known]), (0, 0), 2.5)
    share = around[..., 3] / np.maximum(around[..., 4], 1e-3)
    colour = around[..., :3] / np.maximum(around[..., 3:4], 1e-3)
    filled = np.dstack([np.clip(colour, 0, 255), np.clip((share - 0.4) / 0.2, 0, 1) * 255])
    filled = cv2.resize(filled.astype(np.uint8), (width, height), interpolation=cv2.INTER_LINEAR)
    rgb, alpha = frame.rgb.copy(), frame.alpha.copy()
    cv2.copyTo(np.ascontiguousarray(filled[..., :3]), gone.astype(np.uint8), rgb)
    cv2.copyTo(np.ascontiguousarray(filled[..., 3]), gone.astype(np.uint8), alpha)
    return replace(frame, rgb=rgb, alpha=alpha, labels=np.where(gone, np.uint8(0), frame.labels))


def rendered_picture(frame: StoredFrame, camera: PinholeCamera, background: np.ndarray, kept: Sequence[int]) -> Picture:
    """A frame before a background, with the labels of the hands that are kept."""
    picture = Picture(compose(frame.rgb, frame.alpha, background), camera)
    picture.labels = frame.labels.copy()
    for side in kept:
        joints = frame.joints_m[side, 1:]
        picture.present[side] = frame.present[side]
        picture.valid[side] = frame.present[side] & (np.nan_to_num(joints[:, 2]) > 0.01)
        picture.joints_m[side], picture.joints_px[side] = joints, project(joints, camera)
    return picture


def matched_look(cut: CutOut, seat: Seat, natural: bool, scale: float, rng: np.random.Generator) -> Look:
    """The light of the rendered hand; its colour too, or half of it if `natural`, nothing of it where it is bluish: a
    glove's."""
    own = mean_light(cut.colour, cut.alpha > 200)
    gain = seat.light / np.maximum(own, 1e-3)
    red, green, blue = seat.light
    if natural or not red > green > 0.8 * blue:
        gain = np.sqrt(gain * gain.mean()) if red > blue else np.full(3, gain.mean())
    gain = np.clip(gain * math.exp(rng.normal(0, 0.06)), 0.02, 4)
    return Look(gain, math.exp(rng.normal(0, 0.1)), rng.normal(0, 0.15, 2), own_blur(scale, rng))


def parts_of(labels: np.ndarray, sides: Sequence[int], first: int) -> np.ndarray:
    """(H, W) bool: the parts of some hands, from the first part on."""
    wanted = np.zeros(256, bool)
    for side in sides:
        wanted[part_label(side, first) : part_label(side, 6) + 1] = True
    return wanted[labels]
