"""Lays hands that were cut out of photographs, and arms for them, into other pictures."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from twohands.datasets.cutting import CutOut
from twohands.datasets.digits import ANATOMICAL
from twohands.geometry.anatomy import KNUCKLES, skeleton_joints
from twohands.geometry.boxes import inside_picture
from twohands.skeleton import LEFT, N_JOINTS, ROOT, WRIST, part_label
from twohands.training.arms import arm_path, blend, draw_strip, skin_strip, window_of
from twohands.types import HandSample, PinholeCamera

ANY_TURN = 0.25
"""Share of hands that point anywhere; the others are upright but for 25 degrees or so."""
LONGEST_ARM = 6.0
"""An arm leaves the picture within so many times the distance from wrist to middle knuckle, where that can be."""
SIDE_BY_SIDE = 0.85
"""Share of second hands that are put clear of the first, on the side where a person seen from in front has them."""
MOVED_TRUST = 0.5
"""How much wrist and knuckles count that were moved from where real hands' labels have them to our skeleton's."""
BARE, ROLLED = 0.3, 0.45
"""Share of people with bare arms, and with these of people whose sleeves begin on the forearm."""
LIGHT = 2.2
"""Exponent from grey levels to light."""
SMALLER, LARGER = 0.75, 1.5
"""Scales below and above which a cut-out is averaged and its edge kept sharp."""
FADE, HEM = (0.15, 0.45), (0.1, 0.3)
"""Where a forearm fades into a bare one and ends before a sleeve, beyond the wrist, in distances from there to the
middle knuckle."""


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """How one photographed hand is changed.

    Attributes:
        gain: (3,) factors of linear light.
        gamma: exponent of the grey levels.
        slope: (2,) how much brighter it gets from the middle to the right and to the bottom, relative.
        blur_px: standard deviation in pixels of the picture.
    """

    gain: np.ndarray
    gamma: float
    slope: np.ndarray
    blur_px: float


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """Where a cut-out goes: pixels of the picture are `linear @ pixels of the cut-out + shift`.

    Attributes:
        side: LEFT or RIGHT; `linear` mirrors for LEFT.
        linear: (2, 2).
        shift: (2,).
    """

    side: int
    linear: np.ndarray
    shift: np.ndarray

    @property
    def scale(self) -> float:
        """Pixels of the picture for one of the cut-out."""
        return math.sqrt(abs(float(np.linalg.det(self.linear))))

    def points(self, points_px: np.ndarray) -> np.ndarray:
        """(..., 2) pixels of the cut-out as pixels of the picture."""
        return points_px @ self.linear.T + self.shift


class Picture:
    """A picture in the making, with its labels."""

    def __init__(self, image: np.ndarray, camera: PinholeCamera) -> None:
        self.image, self.camera = image, camera
        self.labels = np.zeros(image.shape[:2], np.uint8)
        self.present, self.valid = np.zeros(2, bool), np.zeros((2, N_JOINTS), bool)
        self.joints_px, self.joints_m = np.full((2, N_JOINTS, 2), np.nan), np.full((2, N_JOINTS, 3), np.nan)
        self.confidence = np.ones((2, N_JOINTS))

    def sample(self, image: np.ndarray, source: str) -> HandSample:
        """With the image as the camera took it, and its name."""
        return HandSample(
            image=image,
            camera=self.camera,
            present=self.present,
            joints_px=self.joints_px,
            joints_m=self.joints_m,
            valid=self.valid,
            labels=self.labels,
            source=source,
            confidence=self.confidence,
        )


def free_look(extent_px: float, rng: np.random.Generator) -> Look:
    """Any light and any skin, as blurred as small and large hands are."""
    warmth = rng.normal(0, 0.10)
    gain = np.exp(rng.normal(0.1, 0.4) + np.array([warmth, 0.0, -warmth]) + rng.normal(0, 0.03, 3))
    if rng.random() < 0.5:  # darker skin: less blue than red comes back
        gain *= rng.uniform(0.12, 0.9) ** np.array([1.0, 1.25, 1.4])
    slope = rng.normal(0, 0.25, 2)
    return Look(gain, math.exp(rng.normal(0, 0.15)), slope, own_blur(extent_px / 60, rng))


def own_blur(scale: float, rng: np.random.Generator) -> float:
    """Standard deviation of a hand's own blur, that of its movement and of its distance, in pixels."""
    return float(rng.exponential(0.5 * min(scale, 2.0))) if rng.random() < 0.4 else 0.0


def free_place(
    cut: CutOut,
    side: int,
    extent_px: float,
    shape: tuple[int, ...],
    before: np.ndarray | None,
    rng: np.random.Generator,
) -> Place:
    """A place for a hand of that size anywhere in the picture from where its arm soon leaves it.

    Args:
        cut: the hand.
        side: LEFT or RIGHT.
        extent_px: larger side of the box of its joints.
        shape: (H, W) of the picture.
        before: (2,) the middle of the other hand's palm in the picture, if there is one.
        rng: source of randomness.
    """
    scale = extent_px / float(np.ptp(cut.joints_px, axis=0).max())
    turn = rng.uniform(-np.pi, np.pi) if rng.random() < ANY_TURN else math.radians(rng.normal(0, 25))
    along = np.array([-cut.along[0] if side == LEFT else cut.along[0], cut.along[1]])
    linear = turned(cut, side, scale, math.atan2(along[1], along[0]) + turn)
    size = np.array(shape[1::-1], np.float64)
    middles = rng.uniform(0.02, 0.98, (40, 2)) * size
    direction = linear @ cut.along / scale
    exits = np.where(direction > 0, size - middles, -middles) / np.where(direction == 0, 1e-9, direction)
    cost = np.maximum(exits.min(axis=1) / (scale * cut.palm_px) - LONGEST_ARM, 0)
    if before is not None and rng.random() < SIDE_BY_SIDE:
        beside = (middles[:, 0] - before[0]) * (1 if side == LEFT else -1) / extent_px
        cost += np.maximum(1.1 - beside, 0) * 5
    middle = middles[int(np.argmin(cost))]
    return Place(side, linear, middle - linear @ palm_middle(cut))


def draw_hand_and_arm(
    picture: Picture, cut: CutOut, place: Place, look: Look, sleeve: np.ndarray, kind: float, rng: np.random.Generator
) -> None:
    """A hand with an arm of its own.

    Args:
        picture: changed.
        cut, place, look: the hand.
        sleeve: cloth of the person's sleeves.
        kind: 0..1, below `BARE` a bare arm, below `ROLLED` a sleeve that begins on the forearm, else at the hand.
        rng: source of randomness.
    """
    label = part_label(place.side, 0)
    scale, unit = place.scale, place.scale * cut.palm_px
    along = place.linear @ cut.along / scale
    width = scale * cut.width_px
    end = place.points(cut.end_px)
    path = arm_path(end - along * 2 * scale, along, unit, 2.0 * max(picture.labels.shape), rng)
    growth = np.array([1.0, rng.uniform(1.15, 1.5), rng.uniform(1.2, 1.6), rng.uniform(1.25, 1.7)])
    growth = np.append(np.maximum.accumulate(growth), growth.max() * rng.uniform(1.0, 1.4))
    if kind < ROLLED:
        across = place.linear @ np.array([-cut.along[1], cut.along[0]]) / scale
        mirrored = bool(across @ np.array([-along[1], along[0]]) < 0)
        profile = _profile(cut, look, mirrored)
        draw_strip(picture.image, picture.labels, label, path, width * growth, skin_strip(profile, rng))
    paste(picture, cut, place, look)
    if kind < BARE:
        return
    if kind < ROLLED:
        part = rng.uniform(0.15, 0.9)
        begin = path[0] + (path[1] - path[0]) * part
        wide = width * float(np.interp(part, [0, 1], growth[:2]))
    else:
        room = max(float((cut.end_px - cut.joints_px[WRIST]) @ cut.along) * scale, 0.0)
        begin = end - along * rng.uniform(0, 1) * room - along * 1.5 * scale
        wide = width
    path = np.vstack([begin, path[1:]])
    widths = np.array([wide, *(width * growth[1:] * rng.uniform(0.95, 1.25))]) * rng.uniform(1.08, 1.5)
    draw_strip(picture.image, picture.labels, label, path, widths, sleeve)


def paste(
    picture: Picture, cut: CutOut, place: Place, look: Look, *, fade: bool = False, under: np.ndarray | None = None
) -> None:
    """Lays a hand into the picture and labels its pixels.

    Args:
        picture: changed.
        cut, place, look: the hand.
        fade: let the forearm fade beyond the wrist: another one goes on there.
        under: (H, W) bool, what hides the forearm.
    """
    alpha, beyond = cut.alpha, _beyond_wrist(cut)
    if fade or under is not None:
        low, high = FADE if fade else HEM
        alpha = (alpha * np.clip((high - beyond) / (high - low), 0, 1)).astype(np.uint8)
    forearm = (beyond > 0).astype(np.uint8) * 255
    layers = np.dstack([changed(cut, look), alpha])
    linear, scale = place.linear, place.scale
    if scale < SMALLER:
        layers, forearm, shrunk = _shrunk(layers, forearm, scale)
        linear = linear / shrunk
    left, top, width, height = cv2.boundingRect(layers[..., 3])
    corners = np.array([[left + x, top + y] for x in (0, width) for y in (0, height)])
    window = window_of(corners @ linear.T + place.shift, picture.labels.shape)
    if window is None:
        return
    left, top, right, bottom = window
    shift = place.shift - [left, top] + linear @ [0.5, 0.5] - 0.5  # OpenCV counts from the first pixel's centre
    matrix, size = np.column_stack([linear, shift]), (right - left, bottom - top)
    flags = cv2.INTER_CUBIC if scale > LARGER else cv2.INTER_LINEAR
    colour = cv2.warpAffine(layers[..., :3], matrix, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
    cover = cv2.warpAffine(layers[..., 3], matrix, size, flags=flags)
    if scale > LARGER:  # an edge stays an edge
        steeper = min(scale, 4.0) / LARGER
        levels = np.clip((np.arange(256) - 127.5) * steeper + 127.5, 0, 255).astype(np.uint8)
        cover = cv2.LUT(cover, levels)
    arm = cv2.warpAffine(forearm, matrix, size) > 127
    part = np.s_[top:bottom, left:right]
    if under is not None:
        cover[under[part] & arm] = 0
    if look.blur_px > 0.3:
        cover = cv2.GaussianBlur(cover, (0, 0), look.blur_px)
        colour = cv2.GaussianBlur(colour, (0, 0), look.blur_px)
    blend(picture.image[part], colour, cover)
    solid = cover > 127
    picture.labels[part][solid & ~arm] = part_label(place.side, 1)
    picture.labels[part][solid & arm] = part_label(place.side, 0)


def _shrunk(layers: np.ndarray, forearm: np.ndarray, scale: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A cut-out (H, W, 4) and its forearm (H, W) with fewer pixels, each the mean of those it covers; and the true
    scale (2,)."""
    before = layers.shape[1::-1]
    small = max(round(before[0] * scale), 2), max(round(before[1] * scale), 2)
    alpha = layers[..., 3:].astype(np.float32)
    weighted = cv2.resize(np.dstack([layers[..., :3] * alpha, alpha]), small, interpolation=cv2.INTER_AREA)
    colour = weighted[..., :3] / np.maximum(weighted[..., 3:], 1e-3)
    layers = np.rint(np.dstack([colour, weighted[..., 3]])).astype(np.uint8)
    return layers, cv2.resize(forearm, small, interpolation=cv2.INTER_AREA), np.divide(small, before)


def changed(cut: CutOut, look: Look) -> np.ndarray:
    """(H, W, 3) uint8: the hand's colours in another light."""
    levels = (np.arange(256)[:, None] / 255) ** look.gamma
    table = np.clip(255 * (levels**LIGHT * look.gain) ** (1 / LIGHT), 0, 255).astype(np.uint8)
    colour = cv2.LUT(cut.colour, np.ascontiguousarray(table[None]))
    height, width = cut.alpha.shape
    v, u = np.linspace(-1, 1, height, dtype=np.float32), np.linspace(-1, 1, width, dtype=np.float32)
    shade = np.clip(1 + look.slope[0] * u + look.slope[1] * v[:, None], 0.3, 2).astype(np.float32)
    return cv2.multiply(colour, cv2.merge([shade] * 3), dtype=cv2.CV_8U)


def _profile(cut: CutOut, look: Look, mirrored: bool) -> np.ndarray:
    """(N, 3) uint8: the colours across the forearm's end."""
    across = np.array([-cut.along[1], cut.along[0]])
    steps = np.linspace(-0.42, 0.42, 24)[:, None] * cut.width_px
    points = (cut.end_px - 1.5 * cut.along + steps * across - 0.5).astype(np.float32)
    u, v = points.T
    found = cv2.remap(changed(cut, look), u[None], v[None], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)[0]
    return found[::-1] if mirrored else found


def label_hand(picture: Picture, cut: CutOut, place: Place, confidence: np.ndarray) -> None:
    """The hand's joints, in our skeleton, with how much they count (21,)."""
    side = place.side
    trust = confidence.copy()
    trust[[WRIST, *KNUCKLES]] *= MOVED_TRUST
    points = place.points(skeleton_joints(cut.joints_px, ANATOMICAL))
    picture.joints_px[side], picture.joints_m[side] = points, np.nan
    picture.valid[side], picture.confidence[side] = trust > 0, trust
    height, width = picture.image.shape[:2]
    picture.present[side] = bool((inside_picture(points, width, height) & picture.valid[side]).any())


def _beyond_wrist(cut: CutOut) -> np.ndarray:
    """(H, W) float32: how far each pixel lies beyond the wrist, towards the elbow, in distances from wrist to middle
    knuckle."""
    height, width = cut.alpha.shape
    u, v = np.arange(width, dtype=np.float32) + 0.5, np.arange(height, dtype=np.float32)[:, None] + 0.5
    wrist = cut.joints_px[WRIST]
    away = (u - wrist[0]) * cut.along[0] + (v - wrist[1]) * cut.along[1]
    return (away / cut.palm_px).astype(np.float32)


def palm_middle(cut: CutOut) -> np.ndarray:
    """(2,) the middle of the palm."""
    return cut.joints_px[[WRIST, ROOT]].mean(axis=0)


def turned(cut: CutOut, side: int, scale: float, angle: float) -> np.ndarray:
    """(2, 2): mirrors a left hand, scales, and turns so that the forearm points along `angle` in the picture."""
    mirror = np.diag([-1.0 if side == LEFT else 1.0, 1.0])
    along = mirror @ cut.along
    return scale * rotation(angle - math.atan2(along[1], along[0])) @ mirror


def rotation(angle: float) -> np.ndarray:
    """(2, 2), from x towards y."""
    return np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])


def mean_light(image: np.ndarray, where: np.ndarray) -> np.ndarray:
    """(3,) mean linear light of some pixels."""
    return ((image[where].astype(np.float32) / 255) ** LIGHT).mean(axis=0)
