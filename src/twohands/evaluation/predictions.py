"""Predictions of one run over a dataset, written first and scored later; scoring never runs a network.

File format, version 1: one compressed .npz without pickled objects. Arrays are those of `Predictions`; `header` is a
JSON text; masks are stored as one-channel PNG files, end to end in `masks_png`, cut at `masks_end`.
"""

from __future__ import annotations

import hashlib
import json
import os
import zipfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from twohands.errors import DataFormatError, InputError
from twohands.files import appearing
from twohands.formats.pictures import decode_pixels
from twohands.formats.structured import parse_json
from twohands.geometry.camera import unproject
from twohands.geometry.rotation import centring_angles
from twohands.skeleton import N_JOINTS, ROOT, SIDES
from twohands.types import HandPose, HandSample, PinholeCamera, TwoHandPose

VERSION: Final = 1
MAX_NPZ_BYTES: Final = 8 << 30
"""Of a predictions file, unpacked: a million pictures take 3 GB."""

_ARRAYS: Final = {
    "present": ((), np.bool_),
    "valid": ((), np.bool_),
    "score": ((), np.float64),
    "box_px": ((4,), np.float64),
    "joints_px": ((N_JOINTS, 2), np.float64),
    "joint_scores": ((N_JOINTS,), np.float64),
    "canonical": ((N_JOINTS, 3), np.float64),
    "joints_m": ((N_JOINTS, 3), np.float64),
}
"""Per hand: shape behind (N, 2), and type."""
_PACKED: Final = {"sources": "U", "masks_png": "u", "masks_end": "i"}
"""Further arrays of a file, of one axis, and their kind of type."""
_HEADER: Final = {"dataset": str, "dataset_id": str, "weights": str, "settings": dict}
"""What a file's header holds beside version and command."""


@dataclass(frozen=True, slots=True)
class Predictions:
    """What a system said about N images; two-hand axis (LEFT, RIGHT).

    Attributes:
        dataset: name of the dataset.
        dataset_id: fingerprint of the N samples' labels (`Fingerprint`).
        weights: what identifies the network weights.
        settings: everything else needed to repeat the run.
        command: the command that was given, for people; "" where there was none.
        sources: (N,) the samples' names.
        present: (N, 2) bool.
        valid: (N, 2) bool, whether `joints_m` can be used.
        score: (N, 2) confidence of presence 0..1; NaN where unknown.
        box_px: (N, 2, 4) u0, v0, u1, v1 pixels; NaN if absent.
        joints_px: (N, 2, 21, 2) pixels; NaN if absent.
        joint_scores: (N, 2, 21) 0..1; NaN if absent.
        canonical: (N, 2, 21, 3) unitless, centred frame; NaN if absent.
        joints_m: (N, 2, 21, 3) camera frame, metres; NaN if absent or not valid.
        masks_png: N PNG files of (H, W) uint8 masks, 0 background, 1 left, 2 right; empty bytes for no mask.
    """

    dataset: str
    dataset_id: str
    weights: str
    settings: dict[str, Any]
    sources: tuple[str, ...]
    present: NDArray[np.bool_]
    valid: NDArray[np.bool_]
    score: NDArray[np.float64]
    box_px: NDArray[np.float64]
    joints_px: NDArray[np.float64]
    joint_scores: NDArray[np.float64]
    canonical: NDArray[np.float64]
    joints_m: NDArray[np.float64]
    masks_png: tuple[bytes, ...]
    command: str = ""

    def __len__(self) -> int:
        return len(self.sources)

    def mask(self, index: int) -> NDArray[np.uint8] | None:
        """(H, W) uint8 mask of one image, or None if none was recorded."""
        data = self.masks_png[index]
        return np.asarray(_decode_png(data)) if data else None

    def pose(self, index: int, camera: PinholeCamera) -> TwoHandPose:
        """What was said about one image, as the estimator says it."""
        left, right = (self._hand(index, side, camera) for side in (0, 1))
        return TwoHandPose(left, right, camera, self.mask(index), index)

    def _hand(self, index: int, side: int, camera: PinholeCamera) -> HandPose:
        if not self.present[index, side]:
            return HandPose(present=False)

        def known(name: str) -> NDArray[np.float64] | None:
            values = getattr(self, name)[index, side]
            return values if np.isfinite(values).all() else None

        valid = bool(self.valid[index, side])
        joints_m = known("joints_m") if valid else None
        score = float(self.score[index, side])
        joints_px = known("joints_px")
        theta, phi = None, None
        if joints_m is not None:
            theta, phi = _direction_deg(joints_m[ROOT])
        elif joints_px is not None:
            theta, phi = _direction_deg(np.asarray(unproject(joints_px[ROOT], camera)))
        return HandPose(
            present=True,
            score=score if np.isfinite(score) else None,
            box_px=known("box_px"),
            joints_px=joints_px,
            joint_scores=known("joint_scores"),
            canonical=known("canonical"),
            joints_m=joints_m,
            range_m=None if joints_m is None else float(np.linalg.norm(joints_m[ROOT])),
            theta_deg=theta,
            phi_deg=phi,
            valid=valid,
        )


class Fingerprint:
    """Identifies labelled samples by their names and labels, in order: scores are only for the data they came from."""

    def __init__(self) -> None:
        self._hash = hashlib.sha256()

    def add(self, sample: HandSample) -> None:
        """Takes in one more sample; its picture does not count."""
        self._hash.update(sample.source.encode(errors="surrogateescape"))
        self._hash.update(np.asarray(sample.present, np.uint8).tobytes())
        for joints in (sample.joints_px, sample.joints_m):
            self._hash.update(np.ascontiguousarray(joints, dtype="<f8").tobytes())

    def __str__(self) -> str:
        return self._hash.hexdigest()[:16]


def predict(
    samples: Iterable[HandSample],
    estimate: Callable[[HandSample], TwoHandPose],
    *,
    dataset: str,
    weights: str,
    settings: dict[str, Any],
) -> Predictions:
    """Runs an estimator over samples and keeps everything that can be scored.

    Args:
        samples: labelled images; each is read once, in order.
        estimate: the system under test. It must use no more of the sample than its settings say.
        dataset: name of the dataset.
        weights: what identifies the network weights.
        settings: everything else needed to repeat the run, as JSON values.

    Returns:
        The predictions.

    Raises:
        DataFormatError: the estimator's hands are no predictions (`check_predictions`).
    """
    fingerprint = Fingerprint()
    sources: list[str] = []
    hands: list[tuple[HandPose, HandPose]] = []
    masks: list[bytes] = []
    for sample in samples:
        pose = estimate(sample)
        fingerprint.add(sample)
        sources.append(sample.source)
        hands.append(pose.hands)
        masks.append(b"" if pose.masks is None else _encode_png(pose.masks))
    arrays: dict[str, Any] = {name: _stack(hands, name) for name in _ARRAYS}
    predictions = Predictions(
        dataset=dataset,
        dataset_id=str(fingerprint),
        weights=weights,
        settings=settings,
        sources=tuple(sources),
        masks_png=tuple(masks),
        **arrays,
    )
    check_predictions(predictions, weights)
    return predictions


def save_predictions(path: str | os.PathLike[str], predictions: Predictions, *, overwrite: bool = False) -> None:
    """Writes a predictions file, all of it or nothing.

    Args:
        path: ends in .npz.
        predictions: what to write.
        overwrite: replace an existing file.

    Raises:
        InputError: the file exists, cannot be written, or its name does not end in .npz.
    """
    target = check_predictions_path(path, overwrite=overwrite)
    header = {"version": VERSION} | {name: getattr(predictions, name) for name in (*_HEADER, "command")}
    try:
        with appearing(target) as partial, partial.open("wb") as file:
            np.savez_compressed(
                file,
                header=np.array(json.dumps(header)),
                sources=np.array(predictions.sources, dtype=np.str_),
                masks_png=np.frombuffer(b"".join(predictions.masks_png), np.uint8),
                masks_end=np.cumsum([len(data) for data in predictions.masks_png], dtype=np.int64),
                **{name: getattr(predictions, name) for name in _ARRAYS},
            )
    except OSError as error:
        raise InputError(f"{target}: cannot be written ({error.strerror})") from None


def check_predictions_path(path: str | os.PathLike[str], *, overwrite: bool = False) -> Path:
    """Checks before the long work, not after it, that a predictions file can be written there.

    Raises:
        InputError: the file exists, its folder does not, or its name does not end in .npz.
    """
    target = Path(path)
    if target.suffix != ".npz":
        raise InputError(f"{target}: the name of a predictions file must end in .npz")
    if target.exists() and not overwrite:
        raise InputError(f"{target}: exists already; choose another name or ask to overwrite it")
    if not target.parent.is_dir() or not os.access(target.parent, os.W_OK):
        raise InputError(f"{target}: folder {target.parent} does not exist or cannot be written to")
    return target


def load_predictions(path: str | os.PathLike[str]) -> Predictions:
    """Reads a predictions file.

    Raises:
        InputError: no such file.
        DataFormatError: not a predictions file of this version, or damaged.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    stored = read_npz(path, "predictions file")
    try:
        content: Any = parse_json(str(stored["header"]))
    except (KeyError, DataFormatError) as error:
        raise DataFormatError(f"{path}: not a complete predictions file ({error})") from None
    if unknown := sorted(stored.keys() - _ARRAYS.keys() - _PACKED.keys() - {"header"}):
        raise DataFormatError(f"{path}: unknown array '{unknown[0][:60]}'")
    if not isinstance(content, dict):
        raise DataFormatError(f"{path}: not a complete predictions file (its header is no JSON object)")
    header = cast("dict[str, Any]", content)
    if header.get("version") != VERSION:
        raise DataFormatError(f"{path}: expected predictions of version {VERSION}, got {header.get('version')}")
    if missing := sorted((_ARRAYS.keys() | _PACKED.keys()) - stored.keys()):
        raise DataFormatError(f"{path}: predictions file lacks {', '.join(missing)}")
    for name, kind in _HEADER.items():
        if not isinstance(header.get(name), kind):
            raise DataFormatError(
                f"{path}: the header of the predictions file lacks {name}, or it is no {kind.__name__}"
            )
    count = stored["sources"].size
    expected: dict[str, tuple[tuple[int, ...], str]] = {
        name: ((stored[name].size,), kind) for name, kind in _PACKED.items()
    }
    expected |= {name: ((count, 2, *shape), np.dtype(dtype).kind) for name, (shape, dtype) in _ARRAYS.items()}
    for name, (shape, kind) in expected.items():
        array = stored[name]
        if array.shape != shape or array.dtype.kind != kind:
            raise DataFormatError(
                f"{path}: {name} is {array.dtype} of shape {array.shape}, expected kind '{kind}' of shape {shape}"
            )
    data = stored["masks_png"].tobytes()
    ends = [0, *stored["masks_end"].tolist()]
    if len(ends) != count + 1 or ends != sorted(ends) or ends[-1] != len(data):
        raise DataFormatError(f"{path}: the masks of the predictions file are damaged")
    predictions = Predictions(
        **{name: header[name] for name in _HEADER},
        sources=tuple(str(source) for source in stored["sources"]),
        masks_png=tuple(data[start:end] for start, end in pairwise(ends)),
        command=str(header.get("command", "")),
        **{name: stored[name] for name in _ARRAYS},
    )
    check_predictions(predictions, str(path))
    return predictions


def read_npz(path: Path, what: str) -> dict[str, Any]:
    """All arrays of an npz file, none of them pickled.

    Args:
        path: the file.
        what: it is, for messages.

    Raises:
        DataFormatError: it is damaged, or would take more than `MAX_NPZ_BYTES`.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            size = sum(member.file_size for member in archive.infolist())
        if size <= MAX_NPZ_BYTES:
            with np.load(path, allow_pickle=False) as arrays:
                return {name: arrays[name] for name in arrays.files}
    except Exception as error:  # a damaged archive fails in many ways
        raise DataFormatError(f"{path}: not a complete {what} ({' '.join(str(error).split())[:200]})") from None
    raise DataFormatError(f"{path}: {what} of more than {MAX_NPZ_BYTES >> 30} GiB")


def check_predictions(predictions: Predictions, where: str) -> None:
    """Looks for what no score can be made of.

    Args:
        predictions: any.
        where: file or system, for the message.

    Raises:
        DataFormatError: no image at all, an image twice, or a hand that is present with numbers that are partly
            missing: each of its arrays must be finite throughout, or NaN throughout for "not predicted"; or that is
            behind the camera.
    """
    if not len(predictions):
        raise DataFormatError(f"{where}: holds no predictions")
    seen: set[str] = set()
    for source in predictions.sources:
        if source in seen:
            raise DataFormatError(f"{where}: image '{source}' is there twice")
        seen.add(source)
    for name in ("box_px", "joints_px", "canonical", "joints_m"):
        values: NDArray[np.float64] = getattr(predictions, name)
        within = tuple(range(2, values.ndim))
        finite = np.isfinite(values)
        partly = np.any(finite, axis=within) & ~np.all(finite, axis=within)  # (N, 2)
        infinite = np.any(np.isinf(values), axis=within)
        _refuse(predictions, predictions.present & (partly | infinite), f"{name} that are not all finite", where)
    no_joints = ~np.isfinite(predictions.joints_m).all(axis=(2, 3))
    _refuse(predictions, predictions.present & predictions.valid & no_joints, "no joints_m though it is valid", where)
    behind = predictions.joints_m[:, :, ROOT, 2] <= 0
    _refuse(predictions, predictions.present & predictions.valid & behind, "joints_m behind the camera (z <= 0)", where)


def _refuse(predictions: Predictions, wrong: NDArray[np.bool_], what: str, where: str) -> None:
    """Raises for the first hand that is wrong."""
    if wrong.any():
        index, side = (int(i) for i in np.argwhere(wrong)[0])
        others = f" ({int(wrong.sum()) - 1} more)" if wrong.sum() > 1 else ""
        raise DataFormatError(
            f"{where}: image '{predictions.sources[index]}', {SIDES[side]} hand: {what}{others}; NaN throughout means "
            "not predicted"
        )


def _direction_deg(root: NDArray[np.float64]) -> tuple[float | None, float | None]:
    """(theta, phi) in degrees of a root joint (3,), or of the ray on which it is seen; None outside the lens model."""
    angles = [float(np.degrees(angle)) for angle in centring_angles(root)]
    theta, phi = (angle if np.isfinite(angle) else None for angle in angles)
    return theta, phi


def _stack(hands: list[tuple[HandPose, HandPose]], name: str) -> NDArray[Any]:
    """(N, 2, ...) one attribute of all hands; NaN, or False, where a hand has none."""
    shape, dtype = _ARRAYS[name]
    empty = False if dtype is np.bool_ else np.nan
    stacked = np.full((len(hands), 2, *shape), empty, dtype)
    for index, pair in enumerate(hands):
        for side, hand in enumerate(pair):
            value = getattr(hand, name)
            if value is not None and (hand.present or name == "score"):
                stacked[index, side] = value
    return stacked


def _encode_png(mask: NDArray[np.uint8]) -> bytes:
    return cv2.imencode(".png", mask)[1].tobytes()


def _decode_png(data: bytes) -> NDArray[np.uint8]:
    mask = decode_pixels(data, cv2.IMREAD_UNCHANGED)
    if mask is None:
        raise DataFormatError("a mask of the predictions file is damaged")
    return np.asarray(mask, np.uint8)


assert {field.name for field in fields(Predictions)} >= _ARRAYS.keys()
