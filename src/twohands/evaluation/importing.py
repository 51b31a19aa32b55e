"""Predictions of other systems, from JSON or npz; the format is described in docs/evaluation.md.

Images are matched by name, so the order is free; every image of the data set must be there exactly once.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, cast

import numpy as np

from twohands.errors import DataFormatError, InputError
from twohands.evaluation.completion import complete_hand, hand_lengths_m
from twohands.evaluation.frame_checks import FrameCheck, read_numbers, refuse_impossible
from twohands.evaluation.predictions import Predictions, predict, read_npz
from twohands.formats.structured import parse_json, read_bytes
from twohands.skeleton import N_JOINTS, SIDES
from twohands.types import HandPose, HandSample, TwoHandPose

VERSION: Final = 1
MAX_JSON_BYTES: Final = 1 << 29
FIELDS: Final[Mapping[str, tuple[int, ...]]] = MappingProxyType(
    {"joints_m": (N_JOINTS, 3), "joints_px": (N_JOINTS, 2), "canonical": (N_JOINTS, 3), "box_px": (4,), "score": ()}
)
"""What may be said about a present hand, and its shape."""

ABSENT: Final = HandPose(present=False)


@dataclass(frozen=True, slots=True)
class ForeignPredictions:
    """What a third party's file says, still unchecked against any data set.

    Attributes:
        path: the file.
        system: the name it gives itself.
        hands: by image name, what it says about (LEFT, RIGHT); None for an absent hand.
    """

    path: Path
    system: str
    hands: Mapping[str, tuple[Mapping[str, Any] | None, Mapping[str, Any] | None]]


def read_foreign(path: str | os.PathLike[str]) -> ForeignPredictions:
    """Reads a third party's predictions.

    Args:
        path: ends in .json or .npz.

    Raises:
        InputError: no such file, or another ending.
        DataFormatError: not the format of docs/evaluation.md, another version of it, or an image that is there twice.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    if path.suffix == ".json":
        return _read_json(path)
    if path.suffix == ".npz":
        return _read_npz(path)
    raise InputError(f"{path}: predictions to import must be .json or .npz")


def import_predictions(
    foreign: ForeignPredictions,
    samples: Iterable[HandSample],
    *,
    dataset: str,
    hand_length_m: float | None = None,
) -> Predictions:
    """Brings a third party's predictions into our format, for scoring like any other.

    Args:
        foreign: what was read.
        samples: the labelled images they are about.
        dataset: name of the data set.
        hand_length_m: |wrist - root| with which ranges are solved where only 2D joints and a pose are given; None for
            each labelled hand's own.

    Returns:
        The predictions, in the order of the samples.

    Raises:
        DataFormatError: images are missing, belong to no sample, or a hand's numbers cannot be used, or are in another
            frame; named.
    """
    used: set[str] = set()
    frames = FrameCheck()

    def estimate(sample: HandSample) -> TwoHandPose:
        if sample.source not in foreign.hands:
            raise DataFormatError(
                f"{foreign.path}: image '{sample.source}' is missing; every image of the dataset is needed, "
                "one without hands with null for both"
            )
        used.add(sample.source)
        left, right = (
            _hand(sample, side, said, hand_length_m, foreign.path, frames)
            for side, said in enumerate(foreign.hands[sample.source])
        )
        return TwoHandPose(left, right, sample.camera)

    predictions = predict(
        samples,
        estimate,
        dataset=dataset,
        weights=foreign.system,
        settings={"imported": foreign.path.name, "hand_length_m": hand_length_m or "each hand's own, from its labels"},
    )
    if unknown := sorted(foreign.hands.keys() - used):
        others = f" and {len(unknown) - 1} more" if len(unknown) > 1 else ""
        raise DataFormatError(f"{foreign.path}: image '{unknown[0]}'{others}: not in the dataset '{dataset}'")
    if (verdict := frames.verdict()) is not None:
        raise DataFormatError(f"{foreign.path}: {verdict}")
    return predictions


def _hand(
    sample: HandSample,
    side: int,
    said: Mapping[str, Any] | None,
    hand_length_m: float | None,
    path: Path,
    frames: FrameCheck,
) -> HandPose:
    if said is None:
        return ABSENT
    length = hand_length_m or float(hand_lengths_m(sample)[side])
    try:
        hand = complete_hand(sample.camera, length, **said)
        space, pixels = (read_numbers(said.get(name), FIELDS[name]) for name in ("joints_m", "joints_px"))
        if space is not None:
            refuse_impossible(space)
        if sample.present[side]:
            frames.add(sample.camera, sample.joints_px[side], space, pixels)
        return hand
    except DataFormatError as error:
        raise DataFormatError(f"{path}: image '{sample.source}', {SIDES[side]} hand: {error}") from None


def _read_json(path: Path) -> ForeignPredictions:
    try:
        content: Any = parse_json(read_bytes(path, "predictions file", MAX_JSON_BYTES))
    except DataFormatError as error:
        raise DataFormatError(f"{path}: not a readable JSON file ({error})") from None
    top = _object(content)
    if top is None or not isinstance(top.get("images"), list):
        raise DataFormatError(f"{path}: expected an object with version, system and a list 'images'")
    _check_version(path, top.get("version"))
    _refuse_unknown(path, "", top, ("version", "system", "images"))
    hands: dict[str, tuple[Mapping[str, Any] | None, Mapping[str, Any] | None]] = {}
    for number, entry in enumerate(cast("list[Any]", top["images"])):
        image = _object(entry)
        if image is None or not isinstance(image.get("source"), str):
            raise DataFormatError(f"{path}: entry {number} of images has no 'source'")
        source: str = image["source"]
        if source in hands:
            raise DataFormatError(f"{path}: image '{source}' is there twice")
        _refuse_unknown(path, f"image '{source}', ", image, ("source", *SIDES))
        if absent := [side for side in SIDES if side not in image]:
            raise DataFormatError(f"{path}: image '{source}' says nothing about the {absent[0]} hand; null if absent")
        left, right = (_said(path, source, side, image[side]) for side in SIDES)
        hands[source] = (left, right)
    return _not_empty(ForeignPredictions(path, str(top.get("system", path.stem)), hands))


def _said(path: Path, source: str, side: str, value: Any) -> Mapping[str, Any] | None:
    if value is None:
        return None
    said = _object(value)
    if said is None:
        raise DataFormatError(f"{path}: image '{source}', {side} hand: an object or null expected")
    _refuse_unknown(path, f"image '{source}', {side} hand: ", said, tuple(FIELDS))
    return said


def _refuse_unknown(path: Path, where: str, record: Mapping[str, Any], known: tuple[str, ...]) -> None:
    if unknown := sorted(record.keys() - set(known)):
        raise DataFormatError(f"{path}: {where}unknown '{unknown[0][:60]}'; known: {', '.join(known)}")


def _object(value: Any) -> dict[str, Any] | None:
    """A JSON object, or None for anything else."""
    return cast("dict[str, Any]", value) if isinstance(value, dict) else None


def _read_npz(path: Path) -> ForeignPredictions:
    stored: dict[str, np.ndarray] = read_npz(path, "npz file")
    if "header" in stored:
        raise InputError(f"{path}: is a predictions file of twohands already; score it with twohands eval score")
    if missing := [name for name in ("version", "sources", "present") if name not in stored]:
        raise DataFormatError(f"{path}: lacks the array '{missing[0]}'")
    _check_version(path, stored["version"].item() if stored["version"].size == 1 else None)
    _refuse_unknown(path, "", stored, ("version", "system", "sources", "present", *FIELDS))
    sources = [str(source) for source in stored["sources"].ravel()]
    given = [name for name in FIELDS if name in stored]
    for name, kinds in (("present", "biu"), *((name, "fiu") for name in given)):
        shape = (len(sources), 2, *FIELDS.get(name, ()))
        if stored[name].shape != shape or stored[name].dtype.kind not in kinds:
            raise DataFormatError(
                f"{path}: {name} must hold {'true or false' if name == 'present' else 'numbers'} of shape {shape}, "
                f"got {stored[name].dtype} of shape {stored[name].shape}"
            )
    hands: dict[str, tuple[Mapping[str, Any] | None, Mapping[str, Any] | None]] = {}
    for index, source in enumerate(sources):
        if source in hands:
            raise DataFormatError(f"{path}: image '{source}' is there twice")
        left, right = (
            _row(stored, given, index, side) if bool(stored["present"][index, side]) else None for side in (0, 1)
        )
        hands[source] = (left, right)
    system = str(stored["system"]) if "system" in stored else path.stem
    return _not_empty(ForeignPredictions(path, system, hands))


def _row(stored: Mapping[str, np.ndarray], given: list[str], index: int, side: int) -> dict[str, Any]:
    """What an npz says about one hand; an array that is NaN throughout says nothing."""
    row = {name: stored[name][index, side] for name in given}
    row = {name: value for name, value in row.items() if not np.isnan(value).all()}
    return row | ({"score": float(row["score"])} if "score" in row else {})


def _check_version(path: Path, version: Any) -> None:
    if version != VERSION:
        raise DataFormatError(f"{path}: expected predictions of version {VERSION}, got {version!r}")


def _not_empty(foreign: ForeignPredictions) -> ForeignPredictions:
    if not foreign.hands:
        raise DataFormatError(f"{foreign.path}: holds no predictions")
    return foreign
