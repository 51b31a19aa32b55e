"""Integrity of a dataset in the Ego3DHands layout: what is there, what is missing, what contradicts itself.

Every check compares two routes to one answer (stored pixels against projected joints, mask against depth, stored
canonical joints against recomputed ones), so that a wrong axis, unit or focal length cannot pass unseen.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np

from twohands.datasets.ego3dhands import Ego3DHands, Ego3DHandsInstance, decode_png
from twohands.datasets.inspection.distributions import Distributions, Measurements
from twohands.datasets.manifest import expected_hand_length_m, read_index
from twohands.datasets.shards import ShardedEgo3DHands
from twohands.errors import DataFormatError
from twohands.formats import ego3dhands as fmt
from twohands.formats.instance_index import INDEX_FILE, IndexEntry, digest
from twohands.geometry.camera import project
from twohands.geometry.canonical import canonical_from_camera
from twohands.geometry.part_labels import hand_classes
from twohands.skeleton import LEFT, PART_NAMES, RIGHT, ROOT, SIDES, WRIST, part_label

REPROJECTION_TOLERANCE_PX = 0.01
"""Stored against projected 2D joints. The official sample differs by 3.5e-5 px at 960x540 (docs/paper-map.md)."""
HAND_LENGTH_TOLERANCE_M = 1e-5
"""The official sample's hands are 8e-8 m short: float32 precision."""
CANONICAL_TOLERANCE = 1e-4
SURFACE_TOLERANCE_M = 0.01
"""A joint lies inside the body, so the surface seen at its pixel is nearer. Joints on the skin (finger tips) and the
pixel's extent at a silhouette ask for some slack."""
OUTLINE_TOLERANCE_PX = 3.0
"""A joint lies in the flesh, so some hand covers its pixel; at 960x540, scaled with the picture's height."""


@dataclass(frozen=True, slots=True)
class Problem:
    """One finding: which instance, and what is wrong with it."""

    source: str
    message: str


@dataclass(frozen=True, slots=True)
class DatasetReport:
    """What `inspect_dataset` found.

    Attributes:
        name: the dataset's name.
        instances: number of usable instances.
        skipped: number of folders that look like instances but cannot be read at all.
        presence: number of instances with "both", "left only", "right only", "none".
        image_sizes: (width, height) -> number of instances.
        missing_files: file name -> number of instances without it.
        range_m: (min, median, max) distance of the root joints from the pinhole, metres; NaN without 3D labels.
        joints_outside: share of labelled joints outside the image, 0..1; NaN without labels.
        reprojection_px: largest distance between stored and projected 2D joints; NaN without 3D labels.
        surface_gap_m: median depth of visible joints below the surface, metres; NaN without depth.
        problems: everything that is damaged or contradicts itself.
        distributions: of the sound instances.
    """

    name: str
    instances: int
    skipped: int
    presence: dict[str, int]
    image_sizes: dict[tuple[int, int], int]
    missing_files: dict[str, int]
    range_m: tuple[float, float, float]
    joints_outside: float
    reprojection_px: float
    surface_gap_m: float
    problems: tuple[Problem, ...]
    distributions: Distributions


def inspect_dataset(
    dataset: Ego3DHands | ShardedEgo3DHands, on_progress: Callable[[int], None] | None = None
) -> DatasetReport:
    """Reads every instance completely and checks it, with its hash where the set has an index.

    Args:
        dataset: what to check.
        on_progress: called with the number of instances done.

    Returns:
        The report; a damaged instance is a problem in it, never an exception.
    """
    problems = [Problem(path.relative_to(dataset.root).as_posix(), reason) for path, reason in dataset.skipped]
    presence: Counter[str] = Counter()
    sizes: Counter[tuple[int, int]] = Counter()
    missing: Counter[str] = Counter()
    ranges: list[np.ndarray] = []
    outside: list[np.ndarray] = []
    reprojection: list[np.ndarray] = []
    gaps: list[np.ndarray] = []
    measurements = Measurements()
    listed, index_problems = _index_of(dataset)
    problems += index_problems
    hand_length_m = expected_hand_length_m(dataset.root)
    for index in range(len(dataset)):
        source = dataset.source(index)
        try:
            files = dataset.files(index)
            problems.extend(Problem(source, message) for message in _hash_problems(source, files, listed))
            instance = dataset.instance(index)
            rgba = _rgba(instance, files)
            amodal = _amodal(instance, files)
        except DataFormatError as error:
            problems.append(Problem(source, str(error)))
        else:
            presence[_presence_name(instance.present)] += 1
            sizes[instance.camera.width, instance.camera.height] += 1
            missing.update(instance.missing)
            ranges.append(np.linalg.norm(instance.joints_m[:, 1 + ROOT], axis=-1))
            outside.append(_outside(instance))
            reprojection.append(reprojection_errors_px(instance))
            gaps.append(surface_gaps_m(instance))
            alpha = None if rgba is None else rgba[..., 3]
            found = instance_problems(instance, alpha, hand_length_m, amodal)
            problems.extend(Problem(source, message) for message in found)
            measurements.add(instance)
        if on_progress is not None:
            on_progress(index + 1)
    return DatasetReport(
        name=dataset.name,
        instances=len(dataset),
        skipped=len(dataset.skipped),
        presence={name: presence[name] for name in ("both", "left only", "right only", "none")},
        image_sizes=dict(sizes),
        missing_files=dict(missing),
        range_m=(_finite(np.min, ranges), _finite(np.median, ranges), _finite(np.max, ranges)),
        joints_outside=_finite(np.mean, outside),
        reprojection_px=_finite(np.max, reprojection),
        surface_gap_m=_finite(np.median, gaps),
        problems=tuple(problems),
        distributions=measurements.distributions(dataset.name),
    )


def instance_problems(
    instance: Ego3DHandsInstance,
    alpha: np.ndarray | None = None,
    hand_length_m: float | None = fmt.HAND_LENGTH_M,
    amodal: np.ndarray | None = None,
) -> list[str]:
    """All contradictions within one instance.

    Args:
        instance: what was read.
        alpha: (H, W) uint8 alpha channel of `color.png`, or None.
        hand_length_m: |wrist - root| that hands must have, metres; None for any.
        amodal: (2, H, W) bool, where each arm is or would be if nothing hid it, or None.

    Returns:
        One line per contradiction; empty for a sound instance.
    """
    return [
        *_presence_problems(instance),
        *_joint_problems(instance, hand_length_m),
        *_outline_problems(instance, amodal),
        *_mask_problems(instance, alpha),
        *_amodal_problems(instance, amodal),
        *_surface_problems(instance),
    ]


def reprojection_errors_px(instance: Ego3DHandsInstance) -> np.ndarray:
    """(2, 22) pixel distance of the stored 2D joints from the projected 3D joints; NaN where one is unknown."""
    return np.linalg.norm(project(instance.joints_m, instance.camera) - instance.joints_px, axis=-1)


def surface_gaps_m(instance: Ego3DHandsInstance) -> np.ndarray:
    """Depth of each visible joint below the surface that is seen at its pixel.

    Returns:
        (2, 22) metres, positive below the surface; NaN where the joint's pixel does not show a part of the same hand
        that the joint belongs to.
    """
    gaps = np.full(instance.joints_px.shape[:2], np.nan)
    if instance.depth_m is None or instance.labels is None:
        return gaps
    height, width = instance.labels.shape
    inside = ~_outside_mask(instance) & np.isfinite(instance.joints_m[..., 2])  # (2, 22)
    for side, joint in np.argwhere(inside):
        u, v = np.floor(instance.joints_px[side, joint]).astype(int)
        row, col = min(v, height - 1), min(u, width - 1)
        if int(instance.labels[row, col]) in _labels_of_joint(side, joint) and instance.depth_m[row, col] > 0:
            gaps[side, joint] = instance.joints_m[side, joint, 2] - instance.depth_m[row, col]
    return gaps


def _presence_problems(instance: Ego3DHandsInstance) -> list[str]:
    found = []
    arrays = ((fmt.JOINTS_3D_FILE, instance.joints_m), (fmt.CANONICAL_FILE, instance.canonical))
    for name, joints in arrays:
        if name in instance.missing:
            continue
        for side in (LEFT, RIGHT):
            known = bool(np.isfinite(joints[side]).all())
            if known != bool(instance.present[side]):
                here, there = ("present", "absent") if known else ("absent", "present")
                found.append(f"{SIDES[side]} hand is {here} in {name} but {there} in {fmt.JOINTS_2D_FILE}")
    if instance.labels is not None:
        for side in (LEFT, RIGHT):
            labels = _labels_of(side)
            pixels = np.count_nonzero((instance.labels >= labels.start) & (instance.labels < labels.stop))
            if pixels and not instance.present[side]:
                found.append(f"{SIDES[side]} hand is absent but {fmt.LABELS_FILE} has {pixels} of its pixels")
    return found


def _index_of(dataset: Ego3DHands | ShardedEgo3DHands) -> tuple[dict[str, IndexEntry], list[Problem]]:
    """The set's index, and what it lists but the set does not hold, or the other way round."""
    try:
        listed = read_index(dataset.root)
    except DataFormatError as error:
        return {}, [Problem(INDEX_FILE, str(error))]
    there = {dataset.source(index) for index in range(len(dataset))}
    gone = [Problem(name, f"listed in {INDEX_FILE} but not there") for name in listed if name not in there]
    strangers = [Problem(name, f"not listed in {INDEX_FILE}") for name in sorted(there - set(listed))] if listed else []
    return listed, gone + strangers


def _hash_problems(source: str, files: Mapping[str, bytes], listed: dict[str, IndexEntry]) -> list[str]:
    entry = listed.get(source)
    if entry is None or digest({name: files[name] for name in files}) == entry.sha256:
        return []
    return [f"its files are not those that were written: their SHA-256 differs from {INDEX_FILE}"]


def _rgba(instance: Ego3DHandsInstance, files: Mapping[str, bytes]) -> np.ndarray | None:
    """(H, W, 4) uint8 of `color.png`, or None where there is none."""
    if fmt.COLOR_FILE in instance.missing:
        return None
    return decode_png(files[fmt.COLOR_FILE], 4, str(instance.path / fmt.COLOR_FILE))


def _joint_problems(instance: Ego3DHandsInstance, hand_length_m: float | None) -> list[str]:
    found = []
    joints_m = instance.joints_m[:, 1:]  # (2, 21, 3)
    lengths = np.linalg.norm(joints_m[:, WRIST] - joints_m[:, ROOT], axis=-1)
    recomputed = np.asarray(canonical_from_camera(joints_m).joints)
    canonical_error = np.abs(recomputed - instance.canonical[:, 1:]).max(axis=(1, 2))
    pixel_error = reprojection_errors_px(instance)
    for side in (LEFT, RIGHT):
        worst = _finite(np.max, [pixel_error[side]])
        if worst > REPROJECTION_TOLERANCE_PX:
            found.append(f"{SIDES[side]} hand: 2D joints are up to {worst:.3g} px from the projected 3D joints")
        if hand_length_m is not None and abs(lengths[side] - hand_length_m) > HAND_LENGTH_TOLERANCE_M:
            found.append(
                f"{SIDES[side]} hand: |wrist - root| is {lengths[side] * 100:.4f} cm, "
                f"expected {hand_length_m * 100:g} cm"
            )
        if canonical_error[side] > CANONICAL_TOLERANCE:
            found.append(
                f"{SIDES[side]} hand: {fmt.CANONICAL_FILE} is up to {canonical_error[side]:.3g} from the canonical "
                f"pose of {fmt.JOINTS_3D_FILE}"
            )
    return found


def _amodal(instance: Ego3DHandsInstance, files: Mapping[str, bytes]) -> np.ndarray | None:
    """(2, H, W) bool of `gt_amodal.png`, where there is one.

    Raises:
        DataFormatError: it is damaged, or not of the image's size.
    """
    if fmt.AMODAL_FILE not in files:
        return None
    where = str(instance.path / fmt.AMODAL_FILE)
    pixels = decode_png(files[fmt.AMODAL_FILE], 1, where)
    if pixels.shape != instance.image.shape[:2]:
        raise DataFormatError(f"{where}: expected the image's size {instance.image.shape[:2]}, got {pixels.shape}")
    return np.stack([np.bitwise_and(pixels, 1 << side) > 0 for side in (LEFT, RIGHT)])


def _outline_problems(instance: Ego3DHandsInstance, amodal: np.ndarray | None) -> list[str]:
    """2D joints against the mask: a joint inside the picture shows its own hand, or what hides it; never background."""
    if instance.labels is None:
        return []
    height, width = instance.labels.shape
    tolerance = max(1.5, OUTLINE_TOLERANCE_PX * height / 540)
    hands = instance.labels > 0 if amodal is None else np.asarray(amodal.any(axis=0))
    distance = cv2.distanceTransform((~hands).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    inside = ~_outside_mask(instance)
    inside[:, 0] = False  # elbows
    found = []
    for side in (LEFT, RIGHT):
        u, v = np.floor(instance.joints_px[side, inside[side]]).astype(int).T
        away = distance[np.minimum(v, height - 1), np.minimum(u, width - 1)]
        if np.any(away > tolerance):
            found.append(
                f"{SIDES[side]} hand: {np.count_nonzero(away > tolerance)} joints lie on the background of "
                f"{fmt.LABELS_FILE}, up to {away.max():.1f} px from the hands"
            )
    return found


def _mask_problems(instance: Ego3DHandsInstance, alpha: np.ndarray | None) -> list[str]:
    masks = {
        fmt.LABELS_FILE: None if instance.labels is None else instance.labels > 0,
        fmt.DEPTH_FILE: None if instance.depth_m is None else instance.depth_m > 0,
        fmt.COLOR_FILE: None if alpha is None else alpha > 0,
    }
    known = [(name, mask) for name, mask in masks.items() if mask is not None]
    found = []
    for (name_a, mask_a), (name_b, mask_b) in pairwise(known):
        if mask_a.shape != mask_b.shape:
            found.append(f"{name_a} and {name_b} differ in size")
        elif different := np.count_nonzero(mask_a != mask_b):
            found.append(f"{name_a} and {name_b} disagree on the foreground in {different} pixels")
    return found


def _amodal_problems(instance: Ego3DHandsInstance, amodal: np.ndarray | None) -> list[str]:
    """What is seen of a hand is a part of it, whatever else is hidden."""
    if amodal is None or instance.labels is None:
        return []
    seen = hand_classes(instance.labels)
    found = []
    for side in (LEFT, RIGHT):
        if denied := np.count_nonzero((seen == 1 + side) & ~amodal[side]):
            found.append(f"{SIDES[side]} hand: {denied} pixels of {fmt.LABELS_FILE} are not in {fmt.AMODAL_FILE}")
    return found


def _surface_problems(instance: Ego3DHandsInstance) -> list[str]:
    gaps = surface_gaps_m(instance)
    found = []
    for side in (LEFT, RIGHT):
        gap = gaps[side, 1:]  # without the elbow, which may be looked at through the end of a sleeve
        in_front = gap < -SURFACE_TOLERANCE_M  # False for NaN
        if in_front.any():
            worst = -np.nanmin(gap)
            found.append(
                f"{SIDES[side]} hand: {np.count_nonzero(in_front)} joints lie up to {worst * 100:.1f} cm in front of "
                f"the surface of {fmt.DEPTH_FILE}"
            )
    return found


def _outside_mask(instance: Ego3DHandsInstance) -> np.ndarray:
    """(2, 22) bool, True also for unknown joints."""
    size = np.array([instance.camera.width, instance.camera.height])
    return ~np.asarray(((instance.joints_px >= 0) & (instance.joints_px <= size)).all(axis=-1))


def _outside(instance: Ego3DHandsInstance) -> np.ndarray:
    """(2, 21) 1 for a joint outside the image, 0 inside, NaN for absent hands; elbows left out."""
    outside = _outside_mask(instance)[:, 1:].astype(float)
    outside[~instance.present] = np.nan
    return outside


def _labels_of(side: int) -> range:
    return range(1 + side * len(PART_NAMES), 1 + (side + 1) * len(PART_NAMES))


def _labels_of_joint(side: int, joint: int) -> set[int]:
    """Part labels that may lie over a joint: a finger's first joint is in the palm as well, the wrist in the arm.

    Args:
        side: LEFT or RIGHT.
        joint: 0..21, 0 the elbow.
    """
    arm, palm = 0, 1
    if joint <= 1:
        parts = {arm, palm} if joint else {arm}
    else:
        finger, bone = divmod(joint - 2, 4)
        parts = {2 + finger} if bone else {2 + finger, palm}
    return {part_label(side, part) for part in parts}


def _presence_name(present: np.ndarray) -> str:
    return {(True, True): "both", (True, False): "left only", (False, True): "right only", (False, False): "none"}[
        bool(present[LEFT]), bool(present[RIGHT])
    ]


def _finite(reduce: Callable[[np.ndarray], float], arrays: list[np.ndarray]) -> float:
    """The reduction over all finite values, NaN where there is none."""
    values = np.concatenate([array.ravel() for array in arrays]) if arrays else np.empty(0)
    values = values[np.isfinite(values)]
    return float(reduce(values)) if values.size else float("nan")
