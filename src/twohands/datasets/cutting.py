"""Cuts a photographed hand out of the plain, light paper behind it.

Paper and hand differ in colour, shadows on the paper in brightness alone: so the light of every pixel is taken apart
into a share of the hand's colour and a share of the paper's, and a shadow is little of both. Ours; the paper has
rendered hands alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

from twohands.skeleton import BONES, FINGERTIPS, N_JOINTS, PALM, ROOT, WRIST

GAMMA = 2.2
LEAST_WARMTH = 0.25
"""Least difference between hand and paper in the logarithm of red over blue, for the two to be told apart."""
LEAST_ON_HAND = 0.95
"""Least share of the labelled joints that lie on the mask, or at most `JOINT_REACH` beside it."""
JOINT_REACH = 0.08
"""As a share of the distance from wrist to middle knuckle."""
COVERED = (0.6, 3.2)
"""Range of the mask's area over that distance squared."""
FOREARM = (0.35, 1.5)
"""Range of the forearm's width where it is cut off, over that distance."""
LONGEST_MISS = 0.75
"""A hand of which more is cut off, beyond the wrist towards the knuckles, as a share of that distance, is not whole."""
LONG = 0.8
"""A forearm that can be seen this far, in the same unit, says where it points."""
NAIL = 0.2
"""How far from a fingertip its nail reaches, as a share of that distance."""
_PALM_BONES = ((5, 9), (9, 13), (13, 17), (17, 0), (2, 5))


@dataclass(frozen=True, slots=True, eq=False)
class CutOut:
    """A hand without what was behind it.

    Attributes:
        colour: (H, W, 3) uint8 RGB, straight; hand's colour also where the paper shone through, 0 far from the hand.
        alpha: (H, W) uint8.
        joints_px: (21, 2) float64, pixels of this picture.
        on_hand: (21,) bool, the joints that lie on the mask or a little beside it.
        end_px: (2,) the middle of the forearm where it is cut off.
        along: (2,) unit vector along the forearm, away from the hand.
        width_px: of the forearm there.
        flaw: why it should not be used; empty if nothing is wrong.
    """

    colour: np.ndarray
    alpha: np.ndarray
    joints_px: np.ndarray
    on_hand: np.ndarray
    end_px: np.ndarray
    along: np.ndarray
    width_px: float
    flaw: str = ""

    @property
    def palm_px(self) -> float:
        """Distance from wrist to middle knuckle in pixels."""
        return _palm(self.joints_px)


def cut_out(image: np.ndarray, joints_px: np.ndarray) -> CutOut:
    """A hand in full light before white paper, cut out.

    Args:
        image: (H, W, 3) uint8 RGB, square or nearly so; about 100 pixels wide.
        joints_px: (21, 2) pixels, all finite.

    Returns:
        The hand; what speaks against its use is in `flaw`.
    """
    light = (image.astype(np.float32) / 255) ** GAMMA
    brightness = light.mean(axis=-1)
    joints_px = np.asarray(joints_px, np.float64)
    inner = _skeleton(image.shape[:2], joints_px, 3)
    reach = round(0.22 * float(np.ptp(joints_px, axis=0).max())) | 1
    far = cv2.dilate(inner, _disc(reach)) == 0
    bones, near = inner > 0, cv2.dilate(inner, _disc(3)) > 0
    nails = _around(joints_px[list(FINGERTIPS)], NAIL * _palm(joints_px), image.shape[:2])
    paper = _paper(light, far & (brightness > 0.08))

    warmth = cv2.GaussianBlur(_warmth(light) - _warmth(paper), (0, 0), 0.6)
    lit = bones & (brightness > 0.05)
    if not (lit.any() and far.any()):
        return _flawed(image, joints_px, "too dark, or no paper in sight")
    of_hand, of_paper = np.median(warmth[lit]), np.median(warmth[far])
    if of_hand - of_paper < LEAST_WARMTH:
        return _flawed(image, joints_px, "hand and paper have nearly the same colour")
    warmth = (warmth - of_paper) / (of_hand - of_paper)
    dark = bones & (brightness < 0.3 * paper.mean(axis=-1))  # painted nails, gaps between fingers

    mask = _main_part((warmth > 0.45) & (brightness > 0.012) | dark, bones)
    skin = _hand_colour(light, mask)
    of_skin, of_white = _shares(light, skin, paper)
    shown = of_skin / (of_skin + of_white + 0.01) * np.clip((warmth - 0.15) / 0.35, 0, 1)
    white = _white(brightness, skin.mean(axis=-1), paper.mean(axis=-1))
    mask = _main_part((shown > 0.5) & ~white | dark, bones)
    mask = _without_holes(mask, near, nails, brightness < 0.45 * paper.mean(axis=-1))
    smooth = cv2.medianBlur(mask.astype(np.uint8), 3) > 0
    mask = _main_part(smooth & (mask | ~white), bones)

    deep = cv2.erode(mask.astype(np.uint8), _disc(5))
    skin = _hand_colour(light, mask)
    alpha = np.clip((cv2.GaussianBlur(mask.astype(np.float32), (0, 0), 1.0) - 0.5) * 1.7 + 0.5, 0, 1)
    paper_alone = cv2.GaussianBlur(np.minimum(of_white, 1) * (1 - np.minimum(of_skin, 1)), (0, 0), 0.4)
    alpha = np.maximum(alpha * np.clip(1.3 - 1.2 * paper_alone, 0, 1), deep)
    # At the edge both the light of the paper and its shadow are left out: only pixels as bright as the hand stay.
    against = brightness / np.maximum(skin.mean(axis=-1), 1e-3)
    own = (
        np.clip((alpha - 0.8) / 0.2, 0, 1) * np.clip((against - 0.3) / 0.3, 0, 1) * np.clip((1.5 - against) / 0.3, 0, 1)
    )
    own = np.maximum(own, deep)[..., None]
    colour = np.clip(light * own + skin * (1 - own), 0, 1) ** (1 / GAMMA)

    return _with_forearm(np.rint(colour * 255).astype(np.uint8), np.rint(alpha * 255).astype(np.uint8), mask, joints_px)


def _with_forearm(colour: np.ndarray, alpha: np.ndarray, mask: np.ndarray, joints_px: np.ndarray) -> CutOut:
    """The cut-out, with where its forearm ends."""
    wrist = joints_px[WRIST]
    palm = _palm(joints_px)
    beside = cv2.dilate(mask.astype(np.uint8), _disc(2 * round(JOINT_REACH * palm) + 1))
    height, width = mask.shape
    columns, rows = np.clip(joints_px, 0, [width - 1, height - 1]).astype(int).T
    on_hand = beside[rows, columns] > 0

    along = _unit(wrist - joints_px[list(PALM[1:])].mean(axis=0))
    points = np.argwhere(mask)[:, ::-1] + 0.5
    s, t = _forearm_axes(points, wrist, along)
    at_border = ((points < 1) | (points > [width - 1, height - 1])).any(axis=1) & (s > -LONGEST_MISS * palm)
    end = float(s[at_border].min() if at_border.any() else np.quantile(s, 0.99)) - 1
    if end > LONG * palm:  # the wrist may be bent: the forearm itself says where it points
        middles = [t[np.abs(s - place) < 2] for place in (0.4 * palm, end - 2)]
        if all(len(middle) for middle in middles):
            (a, b) = (float(middle.min() + middle.max()) / 2 for middle in middles)
            along = _unit(along * (end - 2 - 0.4 * palm) + np.array([-along[1], along[0]]) * (b - a))
            s, t = _forearm_axes(points, wrist, along)
            at_border &= s > -LONGEST_MISS * palm
            end = float(s[at_border].min() if at_border.any() else np.quantile(s, 0.99)) - 1
    slice_t = t[np.abs(s - end) < 1.5]
    low, high = (slice_t.min(), slice_t.max()) if len(slice_t) else (0.0, 0.0)
    across = np.array([-along[1], along[0]])
    breadth = float(high - low + 1)

    area = mask.sum() / max(palm, 1) ** 2
    flaws = [
        "joints beside the mask" if on_hand.mean() < LEAST_ON_HAND else "",
        "a mask of another size than the hand" if not COVERED[0] < area < COVERED[1] else "",
        "a hand that is not whole" if end < -LONGEST_MISS * palm else "",
        "a forearm of another width than the hand" if not FOREARM[0] * palm < breadth < FOREARM[1] * palm else "",
    ]
    return CutOut(
        colour,
        alpha,
        joints_px,
        on_hand,
        wrist + along * end + across * (low + high) / 2,
        along,
        breadth,
        next(filter(None, flaws), ""),
    )


def _forearm_axes(points: np.ndarray, wrist: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N,) how far points lie from the wrist along the forearm, and to its side."""
    away = points - wrist
    return away @ along, away @ np.array([-along[1], along[0]])


def _palm(joints_px: np.ndarray) -> float:
    """Distance from wrist to middle knuckle in pixels."""
    return float(np.linalg.norm(joints_px[ROOT] - joints_px[WRIST]))


def _around(points_px: np.ndarray, radius: float, shape: tuple[int, ...]) -> np.ndarray:
    """(H, W) bool, what lies no farther than `radius` from one of the points (N, 2)."""
    drawn = np.zeros(shape, np.uint8)
    for u, v in points_px:
        cv2.circle(drawn, (int(u), int(v)), round(radius), 255, -1)
    return drawn > 0


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / max(float(np.linalg.norm(vector)), 1e-9)


def _flawed(image: np.ndarray, joints_px: np.ndarray, flaw: str) -> CutOut:
    nothing = np.zeros(image.shape[:2], np.uint8)
    return CutOut(
        np.zeros_like(image),
        nothing,
        joints_px,
        np.zeros(N_JOINTS, bool),
        joints_px[WRIST],
        np.array([0.0, 1.0]),
        0.0,
        flaw,
    )


@cache
def _disc(diameter: int) -> np.ndarray:
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (diameter, diameter))


def _skeleton(shape: tuple[int, ...], joints_px: np.ndarray, thickness: int) -> np.ndarray:
    """(H, W) uint8, 255 on the bones and on the palm."""
    drawn = np.zeros(shape, np.uint8)
    points = np.rint((joints_px - 0.5) * 16).astype(np.int32)  # OpenCV's count, in sixteenths of a pixel
    for a, b in (*BONES, *_PALM_BONES):
        cv2.line(drawn, points[a].tolist(), points[b].tolist(), 255, thickness, cv2.LINE_8, 4)
    cv2.fillConvexPoly(drawn, cv2.convexHull(points[[1, *PALM]]), 255, cv2.LINE_8, 4)
    return drawn


def _warmth(light: np.ndarray) -> np.ndarray:
    """Logarithm of red over blue."""
    return np.log((light[..., 0] + 0.01) / (light[..., 2] + 0.01))


@cache
def _cubic(height: int, width: int) -> np.ndarray:
    """(H, W, 10) float32, the monomials up to the third degree over the picture."""
    v, u = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j].astype(np.float32)
    return np.stack([u**i * v**k for i in range(4) for k in range(4 - i)], axis=-1)


def _paper(light: np.ndarray, candidates: np.ndarray) -> np.ndarray:
    """(H, W, 3) float32: the paper as it would be without the hand and its shadows, as a cubic of the place, fitted
    to those candidates that come out neither darker nor brighter."""
    monomials = _cubic(*light.shape[:2])
    sparse, values = monomials[::3, ::3].reshape(-1, 10), light[::3, ::3].reshape(-1, 3)
    candidates = candidates[::3, ::3].ravel()
    used, fitted = candidates, np.zeros((10, 3), np.float32)
    for _ in range(4):
        if used.sum() < 100:
            break
        rows = sparse[used]
        fitted = np.linalg.solve(rows.T @ rows + 1e-3 * np.eye(10, dtype=np.float32), rows.T @ values[used])
        ratio = values.mean(axis=1) / np.maximum((sparse @ fitted).mean(axis=1), 0.02)
        used = candidates & (ratio > 0.85) & (ratio < 1.15)
    return np.maximum(monomials @ fitted, 0.05)


def _main_part(mask: np.ndarray, bones: np.ndarray) -> np.ndarray:
    """The connected part of a mask (H, W) that holds most of the bones."""
    count, parts = cv2.connectedComponents(mask.astype(np.uint8), connectivity=4)
    on_bones = np.bincount(parts[bones], minlength=count)
    on_bones[0] = 0
    return parts == on_bones.argmax() if on_bones.any() else np.zeros_like(mask)


def _without_holes(mask: np.ndarray, near: np.ndarray, nails: np.ndarray, dark: np.ndarray) -> np.ndarray:
    """The mask with its small holes filled that are dark and `near` the bones, painted nails, or tiny and where `nails`
    are, which may shine."""
    _, parts, stats, _ = cv2.connectedComponentsWithStats((~mask).astype(np.uint8), connectivity=4)
    filled = mask.copy()
    for part in np.flatnonzero(stats[:, cv2.CC_STAT_AREA] <= 40):
        hole = parts == part
        painted = near[hole].mean() > 0.7 and dark[hole].mean() > 0.5
        if painted or (hole.sum() <= 15 and nails[hole].mean() > 0.5):
            filled |= hole
    return filled


def _hand_colour(light: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """(H, W, 3) the hand's colour at and beside every pixel of it, from pixels well inside the mask."""
    deep, inside = (cv2.erode(mask.astype(np.uint8), _disc(size)).astype(np.float32) for size in (5, 3))
    result, _ = _blurred(light, inside, 12.0)
    for weight, sigma, trust in ((deep + 0.02 * inside, 4.0, 50.0), (deep, 1.2, 6.0)):
        colour, certainty = _blurred(light, weight, sigma)
        known = np.clip(certainty * trust, 0, 1)[..., None]
        result = colour * known + result * (1 - known)
    return result


def _white(brightness: np.ndarray, skin: np.ndarray, paper: np.ndarray) -> np.ndarray:
    """(H, W) bool: as bright as paper, where the hand is much darker: JPEG smears the hand's colour, but not its
    brightness, over narrow gaps between fingers."""
    return (paper > 2 * skin) & (brightness**2 > skin * paper)


def _blurred(light: np.ndarray, weight: np.ndarray, sigma: float) -> tuple[np.ndarray, np.ndarray]:
    """Weighted mean of the light around every pixel, and the mean weight."""
    both = cv2.GaussianBlur(np.dstack([light * weight[..., None], weight]), (0, 0), sigma)
    return both[..., :3] / (both[..., 3:] + 1e-6), both[..., 3]


def _shares(light: np.ndarray, skin: np.ndarray, paper: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) twice, not negative: the light as so much of the hand's and so much of the paper's, by least squares."""
    aa, bb, ab = (np.einsum("hwc,hwc->hw", a, b) for a, b in ((skin, skin), (paper, paper), (skin, paper)))
    a, b = (np.einsum("hwc,hwc->hw", light, colour) for colour in (skin, paper))
    determinant = aa * bb - ab * ab + 1e-5
    return np.maximum((a * bb - b * ab) / determinant, 0), np.maximum((b * aa - a * ab) / determinant, 0)
