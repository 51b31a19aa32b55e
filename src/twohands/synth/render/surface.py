"""Meshes as renderers need them: the arms' attributes (labels, palm side, nails, seams), which depend on the asset
alone, and what a scene makes of arms and things.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from twohands.synth.scene.body import bone, load_asset, part_labels, skin
from twohands.synth.scene.pose import ArmAnatomy, unit
from twohands.synth.scene.spec import SceneSpec, moved
from twohands.synth.scene.things import Thing, vertex_normals


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """Attributes of the V vertices.

    Attributes:
        label: (V,) float32 part label 1..14.
        palmar: (V,) float32, 0 on the back of hand and arm, 1 on palm and finger pads.
        nail: (V, 3) float32, position on the last phalanx: along (0 at its joint, 1 at the tip), across
            (-1..1), dorsal (1 on the back); (-1, 0, 0) elsewhere.
        along: (V,) float32, on the forearm's axis from the wrist (0) to the elbow (1) at rest, beyond 1 on the upper
            arm and negative on the hand.
        flush: (V,) float32, 0..1 where blood shows: knuckles and fingertips.
        first_face: (2,) first triangle of the left and of the right arm in `faces`.
        faces: (F, 3) int32, the left arm's triangles before the right arm's.
    """

    label: np.ndarray
    palmar: np.ndarray
    nail: np.ndarray
    along: np.ndarray
    flush: np.ndarray
    first_face: tuple[int, int]
    faces: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class ThingMesh:
    """All things of a scene as one mesh of V vertices.

    Attributes:
        position: (V, 3) camera frame, scaled metres.
        normal: (V, 3) outward unit normals, camera frame.
        albedo: (V, 3) linear RGB.
        roughness: (V,) 0.1 (polished) to 0.9 (cloth).
        label: (V,) part that wears the thing, or `things.NO_LABEL`.
        faces: (F, 3), counter-clockwise from outside.
    """

    position: np.ndarray
    normal: np.ndarray
    albedo: np.ndarray
    roughness: np.ndarray
    label: np.ndarray
    faces: np.ndarray


def posed_vertices(scene: SceneSpec) -> np.ndarray:
    """(V, 3) vertices of a scene, clothes included, camera frame, scaled metres; as `shaders.POSE_VERTEX`."""
    body, clothes, along = scene.body, scene.clothes, surface().along
    sleeve = smoothstep(0.0, 0.03, along - clothes.sleeve_from)
    glove = 1 - smoothstep(-0.03, 0.0, along - clothes.glove_until)
    thickness = clothes.thickness_m * np.maximum(sleeve, 0.3 * glove)
    dressed = body.vertices + thickness[:, None] * vertex_normals(body.vertices, body.asset.faces)
    return skin(replace(body, vertices=dressed), scene.transforms, scene.view) * scene.scale


def posed_things(scene: SceneSpec) -> ThingMesh | None:
    """The scene's things, or None where it has none."""
    if not scene.things:
        return None
    counts = [len(thing.vertices) for thing in scene.things]
    first = np.cumsum([0, *counts])
    return ThingMesh(
        np.concatenate([moved(scene.view, thing.vertices) * scene.scale for thing in scene.things]),
        np.concatenate([thing.normals @ scene.view[:, :3].T for thing in scene.things]),
        np.concatenate([_painted(thing) for thing in scene.things]),
        np.repeat([thing.roughness for thing in scene.things], counts),
        np.repeat([thing.label for thing in scene.things], counts),
        np.concatenate([thing.faces + start for thing, start in zip(scene.things, first, strict=False)]),
    )


def _painted(thing: Thing) -> np.ndarray:
    """(V, 3) albedo of a thing's vertices, stripes included."""
    if thing.colours is not None:
        return thing.colours
    striped = (thing.stripes * thing.pattern_at % 1.0 < 0.5) & (thing.stripes > 0)
    return np.where(striped[:, None], thing.second, thing.albedo)


def smoothstep(low: float, high: float, x: np.ndarray) -> np.ndarray:
    """0 below `low`, 1 above `high`, GLSL's cubic between."""
    t = np.clip((x - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)


@lru_cache(maxsize=1)
def surface() -> Surface:
    """The attributes, found on the average body at rest."""
    asset = load_asset()
    body = asset.body()
    normals = vertex_normals(body.vertices, asset.faces)
    strongest = np.take_along_axis(asset.bone_index, asset.bone_weight.argmax(1)[:, None], 1)[:, 0]
    palmar = np.zeros(asset.n_vertices)
    nail = np.tile([-1.0, 0.0, 0.0], (asset.n_vertices, 1))
    flush = np.zeros(asset.n_vertices)
    along = np.zeros(asset.n_vertices)
    upper = np.isin(strongest, [bone(name, side) for name in ("upperarm01", "upperarm02") for side in (0, 1)])
    for side in (0, 1):
        anatomy = ArmAnatomy(body, side)
        joints = body.joints[side]
        own = asset.side == side
        along[own] = ((joints[1] - body.vertices) @ anatomy.forearm / anatomy.lower_length)[own]
        beyond_wrist = np.clip((body.vertices - joints[1]) @ anatomy.hand_axis / 0.07 + 0.75, 0.25, 1)
        facing = normals @ anatomy.palmar
        palmar[own] = (np.clip(facing / 0.5 + 0.5, 0, 1) * beyond_wrist)[own]
        for finger in range(5):
            last = joints[4 + 4 * finger]
            tip = joints[5 + 4 * finger]
            bend = anatomy.thumb[2] if finger == 0 else anatomy.finger_axes[finger - 1]
            axis = unit(tip - last)
            across = unit(bend - axis * (bend @ axis))
            dorsal = np.cross(axis, across)
            chosen = strongest == bone(f"finger{finger + 1}-3", side)
            offset = body.vertices[chosen] - last
            extent = (offset @ axis).max()
            width = np.abs(offset @ across).max()
            nail[chosen] = np.stack([offset @ axis / extent, offset @ across / width, normals[chosen] @ dorsal], 1)
            flush[chosen] = np.clip(offset @ axis / extent, 0, 1)
            # Pads of thumb and curled fingers do not face the palm's way at rest.
            palmar[chosen] = np.clip(-(normals[chosen] @ dorsal) / 0.5 + 0.5, 0, 1)
            for joint in (2 + 4 * finger, 3 + 4 * finger):
                distance = np.linalg.norm(body.vertices - joints[joint], axis=1)
                flush = np.maximum(flush, own * np.clip(1.4 - distance / 0.011, 0, 1) * (1 - palmar))
    left_face = asset.side[asset.faces[:, 0]] == 0
    faces = np.concatenate([asset.faces[left_face], asset.faces[~left_face]])
    as32 = lambda array: np.ascontiguousarray(array, dtype=np.float32)  # noqa: E731
    return Surface(
        as32(part_labels(asset)),
        as32(palmar),
        as32(nail),
        as32(np.where(upper, np.maximum(along, 1.0), along)),
        as32(flush),
        (0, int(left_face.sum())),
        faces.astype(np.int32),
    )
