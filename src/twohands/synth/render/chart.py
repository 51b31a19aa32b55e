"""The arm laid flat, as a map to paint skin on: no seams, a sheet for the back of hand and arm, one for the palm side.

Chart frame, the same for both sides: x towards the thumb, y towards the fingertips, origin at the wrist joint, metres
of the average body. Fingers are straight and spread, the thumb is turned until its nail faces as the others do. Round
the forearm x is the length along the skin, so that nothing is stretched at its sides.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from twohands.synth.scene.body import BONES_PER_SIDE, Body, bone, forward_kinematics, load_asset, posed_joints, skin
from twohands.synth.scene.pose import ArmAnatomy, HandAngles, frame, unit
from twohands.synth.scene.things import vertex_normals

SPREAD = np.radians([10.0, 3.0, -5.0, -14.0])
"""Of index to little finger on the chart."""
THUMB_RADIAL = np.radians(42.0)


@dataclass(frozen=True, slots=True, eq=False)
class Chart:
    """Places on the chart.

    Attributes:
        vertices: (V, 3) x and y in metres, and how squarely the skin faces its sheet: 1 on the palm side, -1 on the
            back, 0 where it is seen from the edge.
        joints: (22, 2) metres: elbow, then the 21 hand joints.
    """

    vertices: np.ndarray
    joints: np.ndarray


@lru_cache(maxsize=1)
def chart() -> Chart:
    """The chart of the average body."""
    asset = load_asset()
    body = asset.body()
    placed = np.zeros((asset.n_vertices, 3))
    for side in (0, 1):
        own = asset.side == side
        rotations = np.tile(np.eye(3), (2, BONES_PER_SIDE, 1, 1))
        rotations[side] = _flat(body, side)
        transforms = forward_kinematics(body, rotations.reshape(-1, 3, 3))
        posed = posed_joints(body, transforms)[side]
        y = unit(posed[1] - posed[0])
        palmar = transforms[bone("wrist", side)][:, :3] @ ArmAnatomy(body, side).palmar
        z = unit(palmar - y * (palmar @ y))
        x = np.cross(z, y) * (1 if side == 0 else -1)
        axes = np.stack([x, y, z])
        flat = skin(body, transforms)
        vertices = (flat - posed[1]) @ axes.T
        joints = (posed - posed[1]) @ axes.T
        facing = vertex_normals(flat, asset.faces) @ z
        # From flat on the hand to round on the arm.
        radius = np.hypot(vertices[:, 0], vertices[:, 2])
        arc = radius * np.arctan2(vertices[:, 0], np.abs(vertices[:, 2]))
        roundness = np.clip(-vertices[:, 1] / 0.05, 0, 1)
        across = vertices[:, 0] + roundness * (arc - vertices[:, 0])
        placed[own] = np.stack([across, vertices[:, 1], facing], axis=1)[own]
    return Chart(placed, joints[:, :2])


def _flat(body: Body, side: int) -> np.ndarray:
    """(24, 3, 3) rotations of the bones that straighten hand and fingers without twisting the forearm."""
    anatomy = ArmAnatomy(body, side)
    fingers = np.zeros((4, 4))
    fingers[:, 0] = SPREAD
    angles = HandAngles(anatomy.pronation_rest, 0.0, 0.0, 0.0, np.array([THUMB_RADIAL, 0.0, 0.0, 0.0]), fingers)
    rotations = anatomy.hand_rotations(angles)
    # The thumb about its own length, until it bends about an axis in the palm's plane.
    first = bone("finger1-1", side) - anatomy.first
    turn = rotations[first]
    axis, bends = unit(turn @ anatomy.thumb[1]), turn @ anatomy.thumb[2]
    flat = np.cross(axis, anatomy.palmar)
    rotations[first] = frame(axis, flat) @ frame(axis, bends).T @ turn
    return rotations
