"""Results of a clip, written frame by frame in flat memory: hands.jsonl, and at the end hands.npz and hands.csv.

hands.jsonl, version 2: a header, then a line for each frame::

    {"version": 2, "source": ..., "weights": ..., "hand_length_m": ..., "camera": {"fx", "fy", "cx", "cy", "width",
     "height"}, ...}
    {"index": 0, "time_s": 0.0, "hands": {"left": H, "right": H}}

with H as in hands.json (`records`). `index` is the frame's position in the clip, those that were left out included. A
process that is killed leaves whole lines. The arrays and the table are those of `tables`; they appear when the clip has
ended. No file holds a date.
"""

from __future__ import annotations

import json
import os
import shutil
import tempfile
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO, Any, Final

import numpy as np

from twohands.errors import DataFormatError
from twohands.files import appearing, partial_path
from twohands.inference.records import from_dict, to_dict
from twohands.inference.tables import WORDS, csv_text, to_arrays
from twohands.types import HandPose, PinholeCamera, TwoHandPose

VERSION: Final = 2
JSONL, NPZ, CSV = "hands.jsonl", "hands.npz", "hands.csv"
_PER_FRAME: Final = ("index", "time_s", "present", "valid", "between_hands_m", "overlap", *WORDS)
_WORD: Final = "<U12"
"""Longest of `WORDS`, and some room."""


def frame_line(pose: TwoHandPose) -> str:
    """One frame as a line of hands.jsonl, without its end."""
    frame = _record(pose)["frames"][0]
    return json.dumps({name: frame[name] for name in ("index", "time_s", "hands", "between_hands_m", "overlap")})


def header_line(
    camera: PinholeCamera, *, source: str, weights: str, hand_length_m: float, more: Mapping[str, Any] | None = None
) -> str:
    """The first line of hands.jsonl, without its end; arguments as `ClipFiles`."""
    nobody = TwoHandPose(HandPose(present=False), HandPose(present=False), camera)
    about = {"source": source, "weights": weights, "hand_length_m": hand_length_m}
    return json.dumps({"version": VERSION, **about, "camera": _record(nobody)["frames"][0]["camera"], **(more or {})})


class ClipFiles:
    """Writes the results of one clip; a context manager, which ends the files however it is left.

    Args:
        folder: where the files go; exists.
        camera: of all frames.
        source, weights: what the results come from.
        hand_length_m: with which hands are placed, metres.
        more: what else the header says, as JSON values.

    Raises:
        OSError: the disk is full, or the folder cannot be written; what was written until then stays.
    """

    def __init__(
        self,
        folder: Path,
        camera: PinholeCamera,
        *,
        source: str,
        weights: str,
        hand_length_m: float,
        more: Mapping[str, Any] | None = None,
    ) -> None:
        self._folder = folder
        self._camera = camera
        self._about = {"source": source, "weights": weights, "hand_length_m": hand_length_m}
        self._header = header_line(camera, source=source, weights=weights, hand_length_m=hand_length_m, more=more)
        self._columns: dict[str, tuple[IO[bytes], np.dtype[Any], tuple[int, ...]]] = {}
        self.count = 0

    def __enter__(self) -> ClipFiles:
        self._lines = open(self._folder / JSONL, "w", encoding="utf-8")
        self._rows = open(partial_path(self._folder / CSV), "w", encoding="utf-8")
        self._write_line(self._header)
        return self

    def __exit__(self, *_: object) -> None:
        self._lines.close()
        self._rows.close()
        try:
            os.replace(partial_path(self._folder / CSV), self._folder / CSV)
            self._write_npz()
        finally:
            for file, *_row in self._columns.values():
                file.close()

    def write(self, pose: TwoHandPose) -> str:
        """One more frame; returns its line."""
        line = frame_line(pose)
        self._write_line(line)
        self._rows.write(csv_text([pose], header=self.count == 0))
        arrays = to_arrays([pose], self._camera, **self._about)
        for name, array in arrays.items():
            if name in _PER_FRAME or array.shape[:2] == (1, 2):
                row = array.astype(_WORD) if name in WORDS else array
                if name not in self._columns:
                    spool = tempfile.TemporaryFile(dir=self._folder)  # noqa: SIM115
                    self._columns[name] = spool, row.dtype, row.shape[1:]
                self._columns[name][0].write(np.ascontiguousarray(row).tobytes())
        self.count += 1
        return line

    def _write_line(self, line: str) -> None:
        self._lines.write(line + "\n")
        self._lines.flush()

    def _write_npz(self) -> None:
        """All columns one after the other from where they were put by; none is ever in memory as a whole."""
        if not self.count:
            return
        with (
            appearing(self._folder / NPZ) as partial,
            zipfile.ZipFile(partial, "w", zipfile.ZIP_DEFLATED) as archive,
        ):
            for name, array in to_arrays([], self._camera, **self._about).items():
                info = zipfile.ZipInfo(f"{name}.npy")  # of no date: the same clip gives the same bytes
                info.compress_type = zipfile.ZIP_DEFLATED
                with archive.open(info, "w", force_zip64=True) as member:
                    if name in self._columns:
                        spool, dtype, row_shape = self._columns[name]
                        spool.seek(0)
                        np.lib.format.write_array_header_1_0(member, _npy_header(dtype, (self.count, *row_shape)))
                        shutil.copyfileobj(spool, member)
                    else:
                        array = np.full(self.count, "", "<U1") if name == "files" else array
                        np.lib.format.write_array(member, array, allow_pickle=False)


def read_clip(path: Path) -> tuple[dict[str, Any], Iterator[TwoHandPose]]:
    """Reads hands.jsonl.

    Returns:
        The header, and the frames one by one. A last line that was cut off is left out.

    Raises:
        DataFormatError: no such file, another version, or a line that holds something else; also while frames are read.
    """
    lines = _lines_of(path)
    header = next(lines, None)
    if header is None or header.get("version") != VERSION:
        found = None if header is None else header.get("version")
        raise DataFormatError(f"{path}: hands.jsonl of version {VERSION} expected, found {found!r}")
    return header, (_pose(path, header, line) for line in lines)


def _lines_of(path: Path) -> Iterator[dict[str, Any]]:
    try:
        with path.open(encoding="utf-8") as file:
            for number, line in enumerate(file, 1):
                if not line.endswith("\n"):
                    return  # cut off while it was written
                try:
                    record = json.loads(line)
                except (ValueError, RecursionError) as error:
                    raise DataFormatError(f"{path}: line {number}: not JSON ({error})") from None
                if not isinstance(record, dict):
                    raise DataFormatError(f"{path}: line {number}: an object expected, got {type(record).__name__}")
                yield record
    except (OSError, UnicodeDecodeError) as error:
        raise DataFormatError(f"{path}: cannot be read ({error})") from None


def _pose(path: Path, header: dict[str, Any], line: dict[str, Any]) -> TwoHandPose:
    if "version" in line:
        raise DataFormatError(f"{path}: a second header, where another clip begins; one clip for each file expected")
    try:
        (pose,) = from_dict({"version": 1, "frames": [{"camera": header.get("camera"), **line}]})
    except DataFormatError as error:
        raise DataFormatError(f"{path}: frame {line.get('index')}: {error}") from None
    return pose


def _record(pose: TwoHandPose) -> dict[str, Any]:
    return to_dict([pose], source="", weights="")


def _npy_header(dtype: np.dtype[Any], shape: tuple[int, ...]) -> dict[str, Any]:
    return {"descr": np.lib.format.dtype_to_descr(dtype), "fortran_order": False, "shape": shape}
