"""glTF 2.0: every joint a node that moves as the clip's does, exactly; bones as a skinned mesh that can be seen.

Frame: upright (x right, y up, z backward), metres, the camera at the origin looks along -z: glTF's own axes. A joint's
node turns as the fitted bone does and is moved so that it lies where the clip has it, so bones vary in length as they
do there. Seconds count from the clip's first frame. While a hand is not valid it has the scale 0, which glTF gives this
meaning.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from twohands.errors import InputError
from twohands.geometry.quaternions import quaternions, without_jumps
from twohands.motion.clip import UPRIGHT_FROM_CAMERA, HandMotion
from twohands.motion.fit import FittedHand, HandSkeleton
from twohands.skeleton import JOINT_NAMES, N_JOINTS, PARENTS, SIDES, WRIST
from twohands.version import __version__

COLOURS: Final = ((0.10, 0.35, 0.80), (0.80, 0.25, 0.08))
"""Linear RGB of the left and the right hand."""
_JOINT_RADIUS_M: Final = 0.005
_BONE_RADIUS_M: Final = 0.0035
_FLOAT, _UINT16, _UINT8 = 5126, 5123, 5121
_VERTICES, _INDICES = 34962, 34963


def gltf_file(motion: HandMotion, fitted: Mapping[int, FittedHand], *, binary: bool) -> bytes:
    """The content of a .glb file, or of a .gltf file that holds its numbers itself.

    Args:
        motion: the clip.
        fitted: `fit_motion` of it.
        binary: .glb.

    Raises:
        InputError: frames lie too close for 32 bits of time.
        ModuleNotFoundError: pygltflib, of the extra motion, is not installed.
    """
    import pygltflib

    seconds = (motion.time_s - motion.time_s[0]).astype(np.float32)
    if not (np.diff(seconds) > 0).all():
        raise InputError("frames lie too close in time for glTF, which counts seconds in 32 bits")
    document = _Document(pygltflib)
    for side, hand in fitted.items():
        document.add_hand(motion, hand, side, seconds)
    document.add_camera(motion)
    return document.content(binary)


class _Document:
    """A glTF document that grows."""

    def __init__(self, library: Any) -> None:
        self._library = library
        self._data = bytearray()
        self._animation = library.Animation(name="hands", samplers=[], channels=[])
        self._gltf = library.GLTF2(
            asset=library.Asset(version="2.0", generator=f"twohands {__version__}"),
            scene=0,
            scenes=[library.Scene(name="camera frame, y up", nodes=[])],
        )

    def add_hand(self, motion: HandMotion, hand: FittedHand, side: int, seconds: np.ndarray) -> None:
        """A hand's nodes, their animation, and the mesh that shows it."""
        library, gltf = self._library, self._gltf
        top = self._add_node(library.Node(name=f"{SIDES[side]}_hand"))
        gltf.scenes[0].nodes.append(top)
        first = len(gltf.nodes)
        for joint, (name, offset) in enumerate(zip(JOINT_NAMES, hand.skeleton.offsets_m, strict=True)):
            self._add_node(library.Node(name=f"{SIDES[side]}_{name}", translation=offset.tolist()))
            gltf.nodes[top if joint == WRIST else first + PARENTS[joint]].children.append(first + joint)
        self._animate(top, "scale", seconds, *_visibility(motion.valid[:, side]))
        turns = without_jumps(quaternions(hand.local_turns_of()))
        places = _local_places(motion.joints_m[hand.rows, side] @ UPRIGHT_FROM_CAMERA.T, hand.turns)
        rows = np.asarray(hand.rows)
        for joint in range(N_JOINTS):
            self._animate(first + joint, "translation", seconds, rows, places[:, joint], "LINEAR")
            if joint == WRIST or joint % 4:  # fingertips turn with the bone before them
                self._animate(first + joint, "rotation", seconds, rows, turns[:, joint], "LINEAR")
        self._add_mesh(hand.skeleton, side, first)

    def add_camera(self, motion: HandMotion) -> None:
        """The clip's camera, as far as glTF knows cameras: without distortion, its axis through the middle."""
        camera, library = motion.camera, self._library
        height, width = camera.height / camera.fy, camera.width / camera.fx
        perspective = library.Perspective(
            yfov=float(2 * np.arctan(height / 2)), aspectRatio=float(width / height), znear=0.01
        )
        self._gltf.cameras.append(library.Camera(type="perspective", perspective=perspective, name="camera"))
        self._gltf.scenes[0].nodes.append(self._add_node(library.Node(name="camera", camera=0)))

    def content(self, binary: bool) -> bytes:
        """Of the file."""
        gltf = self._gltf
        gltf.animations = [self._animation]
        gltf.buffers = [self._library.Buffer(byteLength=len(self._data))]
        gltf.set_binary_blob(bytes(self._data))
        if binary:
            return b"".join(gltf.save_to_bytes())
        gltf.convert_buffers(self._library.BufferFormat.DATAURI)
        return gltf.to_json(indent=1).encode()

    def _add_node(self, node: Any) -> int:
        self._gltf.nodes.append(node)
        return len(self._gltf.nodes) - 1

    def _add_mesh(self, skeleton: HandSkeleton, side: int, first: int) -> None:
        library, gltf = self._library, self._gltf
        vertices, joints, triangles = _mesh(skeleton)
        inverse = np.tile(np.eye(4), (N_JOINTS, 1, 1))
        inverse[:, 3, :3] = -skeleton.rest_m  # columns first
        weights = np.zeros((len(vertices), 4))
        weights[:, 0] = 1.0
        numbers = np.zeros((len(vertices), 4))
        numbers[:, 0] = joints
        attributes = library.Attributes(
            POSITION=self._accessor(vertices, _FLOAT, "VEC3", _VERTICES, bounds=True),
            JOINTS_0=self._accessor(numbers, _UINT8, "VEC4", _VERTICES),
            WEIGHTS_0=self._accessor(weights, _FLOAT, "VEC4", _VERTICES),
        )
        indices = self._accessor(triangles.reshape(-1), _UINT16, "SCALAR", _INDICES)
        material = library.Material(
            name=SIDES[side],
            pbrMetallicRoughness=library.PbrMetallicRoughness(
                baseColorFactor=[*COLOURS[side], 1.0], metallicFactor=0.0, roughnessFactor=0.7
            ),
            alphaCutoff=None,
        )
        gltf.materials.append(material)
        primitive = library.Primitive(attributes=attributes, indices=indices, material=len(gltf.materials) - 1)
        gltf.meshes.append(library.Mesh(name=f"{SIDES[side]}_bones", primitives=[primitive]))
        skin = library.Skin(
            name=SIDES[side],
            joints=[first + joint for joint in range(N_JOINTS)],
            skeleton=first,
            inverseBindMatrices=self._accessor(inverse.reshape(-1, 16), _FLOAT, "MAT4"),
        )
        gltf.skins.append(skin)
        node = library.Node(name=f"{SIDES[side]}_bones", mesh=len(gltf.meshes) - 1, skin=len(gltf.skins) - 1)
        gltf.scenes[0].nodes.append(self._add_node(node))

    def _animate(
        self, node: int, path: str, seconds: np.ndarray, rows: np.ndarray, values: np.ndarray, interpolation: str
    ) -> None:
        library, animation = self._library, self._animation
        kind = "VEC4" if path == "rotation" else "VEC3"
        sampler = library.AnimationSampler(
            input=self._accessor(seconds[rows], _FLOAT, "SCALAR", bounds=True),
            output=self._accessor(values, _FLOAT, kind),
            interpolation=interpolation,
        )
        animation.samplers.append(sampler)
        target = library.AnimationChannelTarget(node=node, path=path)
        animation.channels.append(library.AnimationChannel(sampler=len(animation.samplers) - 1, target=target))

    def _accessor(
        self, values: np.ndarray, component: int, kind: str, target: int | None = None, *, bounds: bool = False
    ) -> int:
        library, gltf = self._library, self._gltf
        stored = np.ascontiguousarray(values, {_FLOAT: "<f4", _UINT16: "<u2", _UINT8: "u1"}[component])
        self._data += bytes(-len(self._data) % 4)
        view = library.BufferView(buffer=0, byteOffset=len(self._data), byteLength=stored.nbytes, target=target)
        self._data += stored.tobytes()
        gltf.bufferViews.append(view)
        table = stored.reshape(len(stored), -1)
        accessor = library.Accessor(
            bufferView=len(gltf.bufferViews) - 1, componentType=component, count=len(stored), type=kind
        )
        if bounds:
            accessor.min, accessor.max = table.min(axis=0).tolist(), table.max(axis=0).tolist()
        gltf.accessors.append(accessor)
        return len(gltf.accessors) - 1


def _visibility(valid: np.ndarray) -> tuple[np.ndarray, np.ndarray, str]:
    """Rows at which a hand comes or goes, its scales from there on, and how they follow each other."""
    rows = np.flatnonzero(np.concatenate([[True], valid[1:] != valid[:-1]]))
    return rows, np.repeat(valid[rows, None].astype(float), 3, axis=1), "STEP"


def _local_places(joints: np.ndarray, turns: np.ndarray) -> np.ndarray:
    """(N, 21, 3) of each joint as its parent sees it."""
    parents = np.maximum(PARENTS, 0)
    local = np.einsum("njba,njb->nja", turns[:, parents], joints - joints[:, parents])
    local[:, WRIST] = joints[:, WRIST]
    return local


def _mesh(skeleton: HandSkeleton) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """An octahedron at every joint and a three-sided bar along every bone, in the rest pose.

    Returns:
        vertices (V, 3) metres; the joint (V,) that each goes with; triangles (T, 3), counter-clockwise from outside.
    """
    ball = np.concatenate([np.eye(3), -np.eye(3)])
    ball_sides = [(0, 1, 2), (1, 3, 2), (3, 4, 2), (4, 0, 2), (1, 0, 5), (3, 1, 5), (4, 3, 5), (0, 4, 5)]
    angles = np.arange(3) * 2 * np.pi / 3
    bar_sides = [side for i, j in ((0, 1), (1, 2), (2, 0)) for side in ((i, j, 3 + i), (j, 3 + j, 3 + i))]
    vertices: list[np.ndarray] = []
    joints: list[int] = []
    triangles: list[np.ndarray] = []

    def add(points: np.ndarray, owners: list[int], sides: list[tuple[int, ...]]) -> None:
        triangles.append(np.array(sides) + len(joints))
        vertices.append(points)
        joints.extend(owners)

    for joint in range(N_JOINTS):
        add(skeleton.rest_m[joint] + _JOINT_RADIUS_M * ball, [joint] * 6, ball_sides)
        if joint:
            parent = PARENTS[joint]
            along = skeleton.offsets_m[joint]
            side = np.cross(along, np.eye(3)[np.abs(along).argmin()])
            side = side / max(np.linalg.norm(side), 1e-9)
            other = np.cross(along / max(np.linalg.norm(along), 1e-9), side)
            ring = _BONE_RADIUS_M * (np.cos(angles)[:, None] * side + np.sin(angles)[:, None] * other)
            points = np.concatenate([skeleton.rest_m[parent] + ring, skeleton.rest_m[joint] + ring])
            add(points, [parent] * 3 + [joint] * 3, bar_sides)
    return np.concatenate(vertices), np.array(joints), np.concatenate(triangles)
