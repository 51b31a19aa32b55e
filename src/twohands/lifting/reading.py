"""Which tracker a file comes from, where its frames are, and its hands in one form.

A file holds one picture's result or many: a list of results, one a line (.jsonl), an object with a list of frames, or
an object whose keys are pictures. A folder holds a file for each picture, as OpenPose and MMPose write them.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from twohands.errors import DataFormatError, InputError
from twohands.formats.pictures import natural_key
from twohands.formats.structured import decode_text, parse_json, read_bytes
from twohands.geometry.anatomy import HAND_LENGTH
from twohands.geometry.lifting import View
from twohands.lifting import keypoints_2d, mano, mediapipe, own
from twohands.lifting.foreign import ForeignFrame, ForeignHand, ForeignHands, field, is_list, numbers
from twohands.lifting.mediapipe import Names
from twohands.peers.mediapipe_hands import BONE_RATIO
from twohands.types import PinholeCamera

Kind = Literal["mediapipe", "mano", "mmpose", "openpose", "twohands"]
MAX_BYTES: Final = 1 << 30
"""Of a file: half an hour of MediaPipe's two hands as JSON takes 0.6 GB."""
SUFFIXES: Final = (".json", ".jsonl", ".csv", ".npz")

_LISTS: Final = ("frames", "instance_info", "results", "predictions", "images")
"""Keys under which a list of frames is kept."""
_RESULTS: Final = ("instances", "hands", "result", "results", "predictions", "detections", "outputs")
"""Keys under which a frame that says more about itself keeps the tracker's result."""
_FRAME: Final = ("frame", "frame_id", "frame_index")
_INDEX: Final = (*_FRAME, "index")
_MILLISECONDS: Final = ("timestamp_ms", "timestampMs", "timestampInMilliseconds")
_FILE: Final = ("file", "image", "image_path", "img_path", "filename")


@dataclass(frozen=True, slots=True)
class Hints:
    """What a file may not say itself.

    Attributes:
        kind: the tracker; None for whichever the keys tell.
        side: LEFT or RIGHT, of the hands of a model that sees single hands.
        names: what MediaPipe's "Left" means; None for what its API is known for.
        view: whose axes the shapes have; None for what the tracker is known for.
    """

    kind: Kind | None = None
    side: int | None = None
    names: Names | None = None
    view: View | None = None


@dataclass(frozen=True, slots=True)
class _Adapter:
    """One tracker: how a result is recognised and read, and what is known of its skeleton."""

    kind: Kind
    title: str
    view: View
    bone_ratio: float
    is_frame: Callable[[Any], bool]
    hands: Callable[[Any, PinholeCamera], tuple[ForeignHand, ...]]


def _adapters(hints: Hints) -> tuple[_Adapter, ...]:
    return (
        _Adapter("twohands", "twohands", "centred", 1.0, own.is_frame, own.hands),
        _Adapter(
            "mediapipe",
            "MediaPipe Hands",
            "centred",
            BONE_RATIO,
            mediapipe.is_frame,
            partial(mediapipe.hands, names=hints.names),
        ),
        _Adapter("mano", "WiLoR or HaMeR", "centred", mano.BONE_RATIO, mano.is_frame, mano.hands),
        _Adapter(
            "openpose", "OpenPose", "camera", HAND_LENGTH, keypoints_2d.is_openpose_frame, keypoints_2d.openpose_hands
        ),
        _Adapter(
            "mmpose",
            "MMPose or rtmlib",
            "camera",
            HAND_LENGTH,
            keypoints_2d.is_mmpose_frame,
            partial(keypoints_2d.mmpose_hands, side=hints.side),
        ),
    )


def read_hands(path: str | os.PathLike[str], camera: PinholeCamera, hints: Hints | None = None) -> ForeignHands:
    """Reads a tracker's results.

    Args:
        path: .json, .jsonl, .csv, .npz, or a folder of .json files, one for each picture.
        camera: of the pictures.
        hints: what the file does not say.

    Raises:
        InputError: no such file or folder, or another ending.
        DataFormatError: no tracker's results that we know, or a key that is missing or holds something else; file and
            key are named.
    """
    path = Path(path)
    hints = hints or Hints()
    if os.path.isdir(path):
        records = {file.stem: _json(file) for file in _json_files(path)}
        return _named(
            path, lambda: from_record([{"file": name, "result": r} for name, r in records.items()], camera, hints)
        )
    if not os.path.isfile(path):
        raise InputError(f"{path}: no such file")
    suffix = path.suffix.lower()
    if suffix in (".json", ".jsonl"):
        record = _json(path) if suffix == ".json" else _json_lines(path)
        return _named(path, lambda: from_record(record, camera, hints))
    if suffix == ".csv":
        text = _text(path)
        return _named(path, lambda: ForeignHands("table", hints.view or "camera", 1.0, own.frames_of_csv(text, camera)))
    if suffix == ".npz":
        stored = _npz(path)
        return _named(path, lambda: _from_arrays(stored, camera, hints))
    raise InputError(f"{path}: expected a file that ends in {', '.join(SUFFIXES)}, or a folder of .json files")


def from_record(record: Any, camera: PinholeCamera, hints: Hints | None = None) -> ForeignHands:
    """Takes a tracker's results as they are in memory: what its Python API returns, or what JSON holds.

    Args:
        record: the result of one picture, or of many as described above.
        camera: of the pictures.
        hints: what the record does not say.

    Raises:
        DataFormatError: no tracker's results that we know, or a key that is missing or holds something else.
    """
    hints = hints or Hints()
    for adapter in _adapters(hints):
        if hints.kind in (None, adapter.kind):
            items = _frames(record, adapter.is_frame)
            if any(adapter.is_frame(result) for _, result in items):
                frames = tuple(_frame(adapter, i, *item, camera) for i, item in enumerate(items))
                _refuse_twice([about for about, _ in items])
                return ForeignHands(adapter.title, hints.view or adapter.view, adapter.bone_ratio, frames)
    keys = _keys(record)
    raise DataFormatError(
        f"no {hints.kind or 'known tracker'}'s results; found {keys}; expected hand_landmarks, landmarks or "
        "multi_hand_landmarks (MediaPipe), pred_keypoints_3d (WiLoR, HaMeR), people (OpenPose), keypoints (MMPose, "
        "rtmlib) or frames with hands (twohands)"
    )


def _frames(record: Any, is_frame: Callable[[Any], bool]) -> list[tuple[Any, Any]]:
    """(what says index, time and file, the tracker's result) of every frame."""
    if is_frame(record) and not _tells_of_many(record):
        return [(record, record)]
    if isinstance(record, Mapping):
        inside = field(record, *_LISTS)
        if is_list(inside) and len(inside):
            return _frames_of_list(inside, is_frame)
        if record and all(isinstance(key, str) and is_frame(value) for key, value in record.items()):
            return [({"file": name}, value) for name, value in record.items()]
    elif is_list(record):
        return _frames_of_list(record, is_frame)
    return []


def _tells_of_many(record: Any) -> bool:
    """Whether a list of records is of many pictures: each names its picture, or holds everybody in it (rtmlib)."""
    return is_list(record) and any(
        isinstance(one, Mapping)
        and (field(one, *_FRAME, *_FILE) is not None or np.ndim(_first(field(one, "keypoints"))) == 2)
        for one in record
    )


def _first(values: Any) -> Any:
    return values[0] if is_list(values) and len(values) else None


def _frames_of_list(items: Iterable[Any], is_frame: Callable[[Any], bool]) -> list[tuple[Any, Any]]:
    found: list[tuple[Any, Any]] = []
    for position, item in enumerate(items):
        if is_frame(item):
            found.append((item, item))
        elif isinstance(item, Mapping) and field(item, *_RESULTS) is not None:
            found.append((item, field(item, *_RESULTS)))
        elif position == 0 and isinstance(item, Mapping) and "version" in item:
            continue  # the header of a hands.jsonl
        else:
            found.append((item, item))
    return found


def _refuse_twice(abouts: Iterable[Any]) -> None:
    """Refuses two records of one picture: of the second one's hands nobody would hear.

    Raises:
        DataFormatError: there are such; named.
    """
    seen: set[tuple[str, str]] = set()
    for about in abouts:
        number, name = field(about, *_INDEX), field(about, *_FILE)
        if number is None and name is None:
            continue
        if (key := (str(number), str(name))) in seen:
            which = f"frame {number}" if name is None else str(name)[:60]
            raise DataFormatError(f"{which} is there twice; one record with all hands of a picture is expected")
        seen.add(key)


def _frame(adapter: _Adapter, position: int, about: Any, result: Any, camera: PinholeCamera) -> ForeignFrame:
    index = field(about, *_INDEX)
    if index is not None and (isinstance(index, bool) or not isinstance(index, int) or index < 0):
        index = None  # a picture's name, or a count of something else
    name = field(about, *_FILE)
    time_s, milliseconds = field(about, "time_s"), field(about, *_MILLISECONDS)
    where = f"frame {position}" if not isinstance(name, str) else name
    try:
        if time_s is None and milliseconds is not None:
            time_s = float(numbers("timestamp", milliseconds, ())) / 1000
        elif time_s is not None:
            time_s = float(numbers("time_s", time_s, ()))
        empty = result is None or ((is_list(result) or isinstance(result, Mapping)) and not len(result))
        if not empty and not adapter.is_frame(result):
            raise DataFormatError(f"no result of {adapter.title}; found {_keys(result)}")
        hands = () if empty else adapter.hands(result, camera)
    except DataFormatError as error:
        raise DataFormatError(f"{where}: {error}") from None
    return ForeignFrame(
        hands, position if index is None else index, time_s, os.path.basename(name) if isinstance(name, str) else None
    )


def _from_arrays(stored: Mapping[str, np.ndarray], camera: PinholeCamera, hints: Hints) -> ForeignHands:
    """What an npz holds: our own arrays, or those of WiLoR and HaMeR, N hands of one picture or of many (`frame`)."""
    if "joints_px" in stored and hints.kind in (None, "twohands"):
        frames, view = own.frames_of_arrays(stored, camera)
        return ForeignHands("table", hints.view or ("camera" if view == "camera" else "centred"), 1.0, frames)
    if "pred_keypoints_3d" not in stored or hints.kind not in (None, "mano"):
        raise DataFormatError(
            f"no {hints.kind or 'known tracker'}'s arrays; found {_keys(stored)}; expected joints_px beside canonical, "
            "joints_3d or joints_m, or pred_keypoints_3d beside pred_keypoints_2d and is_right (WiLoR, HaMeR)"
        )
    count = len(stored["pred_keypoints_3d"]) if stored["pred_keypoints_3d"].ndim else 0
    if "frame" not in stored:
        return from_record(dict(stored), camera, hints)
    numbered = numbers("frame", stored["frame"], (count,)).astype(np.int64)
    per_hand = {name: array for name, array in stored.items() if array.ndim and len(array) == count}
    rest = {name: array for name, array in stored.items() if name not in per_hand}
    records = [
        {"frame": int(number), "result": rest | {name: array[numbered == number] for name, array in per_hand.items()}}
        for number in np.unique(numbered)
    ]
    return from_record(records, camera, hints)


def _keys(record: Any) -> str:
    """What there is instead, for a message."""
    if isinstance(record, Mapping):
        names = [str(name) for name in record]
        return "an object with " + (", ".join(names[:6]) + (", ..." if len(names) > 6 else "") if names else "no key")
    if is_list(record):
        return f"a list of {len(record)}" + (f", first {_keys(record[0])}" if len(record) else "")
    return type(record).__name__


def _named(path: Path, read: Callable[[], ForeignHands]) -> ForeignHands:
    """Errors name the file."""
    try:
        found = read()
    except DataFormatError as error:
        raise DataFormatError(f"{path}: {error}") from None
    except (TypeError, ValueError, KeyError, IndexError, AttributeError, RecursionError, OverflowError) as error:
        raise DataFormatError(f"{path}: not the results of a tracker that is known ({error})") from None
    return found


def _text(path: Path) -> str:
    try:
        return decode_text(read_bytes(path, "tracker's file", MAX_BYTES))
    except DataFormatError as error:
        raise DataFormatError(_with_path(path, error)) from None


def _json(path: Path) -> Any:
    try:
        return parse_json(read_bytes(path, "tracker's file", MAX_BYTES))
    except DataFormatError as error:
        raise DataFormatError(_with_path(path, error)) from None


def _json_lines(path: Path) -> list[Any]:
    records = []
    for number, line in enumerate(_text(path).splitlines(), 1):
        try:
            if line.strip():
                records.append(parse_json(line))
        except DataFormatError as error:
            raise DataFormatError(f"{path}: line {number}: {error}") from None
    return records


def _with_path(path: Path, error: DataFormatError) -> str:
    return str(error) if str(error).startswith(f"{path}: ") else f"{path}: {error}"


def _npz(path: Path) -> dict[str, np.ndarray]:
    try:
        with np.load(path, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except Exception as error:  # a damaged archive fails in many ways
        raise DataFormatError(f"{path}: not a complete npz file of plain numbers ({error})") from None


def _json_files(folder: Path) -> list[Path]:
    """In natural order, frame2 before frame10."""
    try:
        files = [path for path in folder.iterdir() if path.suffix.lower() == ".json" and not path.name.startswith(".")]
    except OSError as error:
        raise InputError(f"{folder}: cannot be read: {error.strerror}") from None
    if not files:
        raise InputError(f"{folder}: no .json file in this folder")
    return sorted(files, key=lambda path: natural_key(path.name))
