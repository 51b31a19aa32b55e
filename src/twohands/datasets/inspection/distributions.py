"""How the hands of a dataset are distributed: the numbers behind the inspection page, the same for every source.

All of them come from labels and pictures alone, so that generated and official data are measured alike.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np

from twohands.datasets.ego3dhands import Ego3DHandsInstance
from twohands.geometry.part_labels import visible_share
from twohands.skeleton import FINGERS, LEFT, LITTLE_MCP, PART_NAMES, RIGHT, ROOT, WRIST

INDEX_MCP = 5
HEAT_MAP = (27, 48)
"""Rows and columns of the 2D heat map: the shape of a 960x540 picture."""


@dataclass(frozen=True, slots=True, eq=False)
class Distributions:
    """Values of all present hands of a dataset; h counts hands, p pictures with two hands.

    Attributes:
        name: the dataset's.
        instances: number of pictures.
        hands: (2,) number of left and right hands.
        range_m: (h,) distance of the root joint from the pinhole, metres.
        theta_deg, phi_deg: (h,) direction of the root joint: angle below the optical axis and to its right
            (docs/conventions.md).
        palm_deg: (h,) 0 where the palm faces the camera, 90 edge on, 180 where its back does.
        pointing_deg: (h,) direction wrist to root in the picture, -180..180: 0 up, 90 to the right.
        flexion_deg: (h, 5) sum of a finger's three bends, thumb first: 0 straight, about 250 in a fist.
        overlap: (p,) intersection over union of the two hands' joint boxes, 0..1.
        visible: (h,) share of the 21 joints whose pixel shows their own hand, arm included, 0..1; NaN without labels.
        skin_ita_deg: (h,) individual typology angle of the median colour of the palm and fingers as lit, degrees;
            NaN without labels. Above 55 very light, below -30 very dark.
        hand_length_m: (h,) |wrist - root|, metres.
        heat: (27, 48) number of joints per cell of the picture.
    """

    name: str
    instances: int
    hands: tuple[int, int]
    range_m: np.ndarray
    theta_deg: np.ndarray
    phi_deg: np.ndarray
    palm_deg: np.ndarray
    pointing_deg: np.ndarray
    flexion_deg: np.ndarray
    overlap: np.ndarray
    visible: np.ndarray
    skin_ita_deg: np.ndarray
    hand_length_m: np.ndarray
    heat: np.ndarray


@dataclass(slots=True)
class Measurements:
    """Collects the values of one instance after the other."""

    _hands: list[dict[str, float | np.ndarray]] = field(default_factory=list)
    _overlap: list[float] = field(default_factory=list)
    _heat: np.ndarray = field(default_factory=lambda: np.zeros(HEAT_MAP))
    _sides: list[int] = field(default_factory=lambda: [0, 0])
    _instances: int = 0

    def add(self, instance: Ego3DHandsInstance) -> None:
        """Takes the values of an instance; hands without 3D labels count in the 2D values only."""
        self._instances += 1
        joints_px, joints_m = instance.joints_px[:, 1:], instance.joints_m[:, 1:]  # (2, 21, ...)
        size = np.array([instance.camera.width, instance.camera.height])
        for side in (LEFT, RIGHT):
            if not instance.present[side]:
                continue
            self._sides[side] += 1
            self._heat += heat_map(joints_px[side] / size)
            hand: dict[str, float | np.ndarray] = {
                "visible": visible_share(joints_px[side], instance.labels, side),
                "skin_ita_deg": skin_tone_deg(instance.image, instance.labels, side),
            }
            if np.isfinite(joints_m[side]).all():
                hand |= hand_values(joints_m[side], side)
            self._hands.append(hand)
        if instance.present.all():
            self._overlap.append(box_overlap(joints_px[LEFT], joints_px[RIGHT]))

    def distributions(self, name: str) -> Distributions:
        """The values so far."""

        def column(key: str) -> np.ndarray:
            return np.array([hand[key] for hand in self._hands if key in hand], float)

        return Distributions(
            name=name,
            instances=self._instances,
            hands=(self._sides[LEFT], self._sides[RIGHT]),
            range_m=column("range_m"),
            theta_deg=column("theta_deg"),
            phi_deg=column("phi_deg"),
            palm_deg=column("palm_deg"),
            pointing_deg=column("pointing_deg"),
            flexion_deg=column("flexion_deg").reshape(-1, len(FINGERS)),
            overlap=np.array(self._overlap),
            visible=column("visible"),
            skin_ita_deg=column("skin_ita_deg"),
            hand_length_m=column("hand_length_m"),
            heat=self._heat.copy(),
        )


def hand_values(joints_m: np.ndarray, side: int) -> dict[str, float | np.ndarray]:
    """The values of one hand that its 3D joints give.

    Args:
        joints_m: (21, 3) camera frame, metres.
        side: LEFT or RIGHT.

    Returns:
        Values by the names of `Distributions`.
    """
    root = joints_m[ROOT]
    theta = np.degrees(np.arctan2(root[1], root[2]))
    phi = np.degrees(np.arctan2(root[0], np.hypot(root[1], root[2])))
    up = root - joints_m[WRIST]
    return {
        "range_m": float(np.linalg.norm(root)),
        "theta_deg": float(theta),
        "phi_deg": float(phi),
        "palm_deg": float(np.degrees(_angle(palm_normal(joints_m, side), -root))),
        "pointing_deg": float(np.degrees(np.arctan2(up[0], -up[1]))),
        "flexion_deg": finger_flexion_deg(joints_m),
        "hand_length_m": float(np.linalg.norm(up)),
    }


def palm_normal(joints_m: np.ndarray, side: int) -> np.ndarray:
    """(3,) unit vector out of the palm, from the plane of the wrist and the knuckles of index and little finger.

    Args:
        joints_m: (21, 3).
        side: LEFT or RIGHT; the two mirror each other.
    """
    normal = np.cross(joints_m[INDEX_MCP] - joints_m[WRIST], joints_m[LITTLE_MCP] - joints_m[WRIST])
    return (1 if side == RIGHT else -1) * normal / np.linalg.norm(normal)


def finger_flexion_deg(joints_m: np.ndarray) -> np.ndarray:
    """(5,) sum of the angles between the four successive bones of each finger, from the wrist to the tip, degrees."""
    total = np.zeros(len(FINGERS))
    for finger in range(len(FINGERS)):
        chain = joints_m[[WRIST, *range(1 + 4 * finger, 5 + 4 * finger)]]  # (5, 3)
        bones = np.diff(chain, axis=0)  # (4, 3)
        total[finger] = sum(np.degrees(_angle(bones[i], bones[i + 1])) for i in range(3))
    return total


def box_overlap(one_px: np.ndarray, two_px: np.ndarray) -> float:
    """Intersection over union of the boxes around two hands' (21, 2) joints, 0..1."""
    low = np.maximum(one_px.min(0), two_px.min(0))
    high = np.minimum(one_px.max(0), two_px.max(0))
    common = float(np.prod(np.maximum(high - low, 0)))
    whole = float(np.prod(np.ptp(one_px, axis=0)) + np.prod(np.ptp(two_px, axis=0))) - common
    return common / whole if whole > 0 else 0.0


def skin_tone_deg(image: np.ndarray, labels: np.ndarray | None, side: int) -> float:
    """Individual typology angle, atan((L - 50) / b) in CIELAB, of the median colour of palm and fingers.

    The colour is as lit: bright light moves the angle up, as it does in photographs.

    Args:
        image: (H, W, 3) uint8 RGB.
        labels: (H, W) part labels, or None.
        side: LEFT or RIGHT.

    Returns:
        Degrees, -90..90; NaN where the hand cannot be seen.

    Source: Chardon et al., Int. J. Cosmetic Science 13 (1991).
    """
    if labels is None:
        return float("nan")
    first = 1 + side * len(PART_NAMES)
    skin = image[(labels > first) & (labels < first + len(PART_NAMES))]  # without the arm, which may wear a sleeve
    if not len(skin):
        return float("nan")
    colour = np.median(skin, axis=0).astype(np.float32).reshape(1, 1, 3) / 255
    lightness, _, b = cv2.cvtColor(colour, cv2.COLOR_RGB2LAB)[0, 0]
    return float(np.degrees(np.arctan2(lightness - 50, max(float(b), 1e-3))))


def heat_map(fractions: np.ndarray) -> np.ndarray:
    """(27, 48) number of points in each cell of the picture.

    Args:
        fractions: (n, 2) (u, v) as fractions of width and height; those outside the picture are left out.
    """
    rows, columns = HEAT_MAP
    heat, _, _ = np.histogram2d(fractions[:, 1], fractions[:, 0], bins=(rows, columns), range=((0, 1), (0, 1)))
    return heat


def _angle(a: np.ndarray, b: np.ndarray) -> float:
    """Radians between two vectors, exact for small angles too."""
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), np.dot(a, b)))
