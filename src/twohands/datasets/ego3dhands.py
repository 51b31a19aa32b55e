"""Reader of the Ego3DHands layout, static and dynamic, for the authors' data and for ours alike.

Source: docs/dataset-format.md (files), docs/datasets.md (folders). The names of the published folders are undocumented,
so any folder that contains `location_2d.npy` counts as an instance, wherever it lies below the root.
"""

from __future__ import annotations

import copy
import io
import os
import re
from collections.abc import Iterator, Mapping, Set
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twohands.datasets.files import decode_bytes
from twohands.datasets.manifest import expected_hand_length_m
from twohands.errors import DataFormatError, InputError
from twohands.formats import ego3dhands as fmt
from twohands.formats.structured import parse_json
from twohands.types import HandSample, PinholeCamera

_PNG_END = b"IEND\xaeB`\x82"
"""Type and checksum of the chunk that closes every complete PNG file."""
_ARRAY_FILES = (fmt.JOINTS_2D_FILE, fmt.JOINTS_3D_FILE, fmt.CANONICAL_FILE)


@dataclass(frozen=True, slots=True)
class Ego3DHandsInstance:
    """One instance in house conventions, elbows included.

    Attributes:
        path: the instance's folder, or its name within a tar shard.
        image: (H, W, 3) uint8 RGB; `color_new.png`, or `color.png` on black where there is none.
        camera: the official camera at this image size, or the one of `camera.json` (ours) where there is one.
        present: (2,) bool, (LEFT, RIGHT).
        joints_px: (2, 22, 2) float64 pixels, (elbow, 21 joints); NaN for an absent hand.
        joints_m: (2, 22, 3) float64, camera frame, metres; NaN for an absent hand or a missing file.
        canonical: (2, 22, 3) float64, canonical frame; NaN for an absent hand or a missing file.
        labels: (H, W) uint8 part labels 0..14, or None.
        depth_m: (H, W) float32 planar depth in metres, 0 on the background, or None.
        missing: names of the layout's files that the folder does not hold.
    """

    path: Path
    image: np.ndarray
    camera: PinholeCamera
    present: np.ndarray
    joints_px: np.ndarray
    joints_m: np.ndarray
    canonical: np.ndarray
    labels: np.ndarray | None
    depth_m: np.ndarray | None
    missing: tuple[str, ...]

    def to_sample(self, source: str) -> HandSample:
        """The instance without elbows and canonical joints."""
        joints_px = self.joints_px[:, 1:]  # (2, 21, 2)
        return HandSample(
            image=self.image,
            camera=self.camera,
            present=self.present,
            joints_px=joints_px,
            joints_m=self.joints_m[:, 1:],
            valid=np.asarray(np.isfinite(joints_px).all(axis=-1)),
            labels=self.labels,
            depth_m=self.depth_m,
            source=source,
        )


class Ego3DHands:
    """All instances below a folder, in natural order ("seq2/00009" before "seq10/00001").

    Attributes:
        root: the folder.
        paths: the instances' folders.
        skipped: (folder, reason) of every folder that looks like an instance but cannot be one; the published data
            contains arrays of zero bytes.
        hand_length_m: |wrist - root| of every hand of this dataset, in metres.

    Args:
        root: any folder above instances, or one instance's own folder.

    Raises:
        InputError: the folder does not exist or holds no instance.
    """

    hand_length_m: float = fmt.HAND_LENGTH_M
    _left_out: Set[str] = frozenset()

    def __init__(self, root: str | os.PathLike[str]) -> None:
        self.root = Path(root)
        self.hand_length_m = expected_hand_length_m(self.root) or fmt.HAND_LENGTH_M
        if not self.root.is_dir():
            raise InputError(f"{self.root}: no such folder")
        usable: list[Path] = []
        skipped: list[tuple[Path, str]] = []
        for folder in sorted(_instance_folders(self.root), key=lambda path: _natural_key(path, self.root)):
            empty = [name for name in _ARRAY_FILES if _is_empty_file(folder / name)]
            if empty:
                skipped.append((folder, f"{', '.join(empty)}: zero bytes"))
            else:
                usable.append(folder)
        self.paths = tuple(usable)
        self.skipped = tuple(skipped)
        if not self.paths:
            also = f"; {len(skipped)} skipped because an array file has zero bytes" if skipped else ""
            raise InputError(f"{self.root}: no instance found (a folder containing {fmt.JOINTS_2D_FILE}){also}")

    @property
    def name(self) -> str:
        """Name of the root folder."""
        return self.root.resolve().name

    def __len__(self) -> int:
        return len(self.paths)

    def __getitem__(self, index: int) -> HandSample:
        return self.instance(index).to_sample(self.source(index))

    def instance(self, index: int) -> Ego3DHandsInstance:
        """An instance, elbows and canonical joints included.

        Raises:
            DataFormatError: it is damaged.
        """
        return decode_instance(FolderFiles(self.paths[index]), self.paths[index], self._left_out)

    def leaving_out(self, names: Set[str]) -> Ego3DHands:
        """The same instances without decoding some of their files (`decode_instance`)."""
        other = copy.copy(self)
        other._left_out = names
        return other

    def files(self, index: int) -> Mapping[str, bytes]:
        """The files of an instance."""
        return FolderFiles(self.paths[index])

    @property
    def sequences(self) -> dict[str, tuple[int, ...]]:
        """Frames of every sequence of a dynamic set: the parent folder below the root -> indices, in order of time.

        In a static set the only "sequence" is the folder of all instances ("." if it is the root). Frame order is the
        natural order of the folders' names (docs/datasets.md).
        """
        found: dict[str, list[int]] = {}
        for index, path in enumerate(self.paths):
            parent = "." if path == self.root else path.parent.relative_to(self.root).as_posix()
            found.setdefault(parent, []).append(index)
        return {name: tuple(indices) for name, indices in found.items()}

    def source(self, index: int) -> str:
        """Identifies an instance: its path below the root, or its own name if it is the root."""
        path = self.paths[index]
        return self.name if path == self.root else path.relative_to(self.root).as_posix()


class FolderFiles(Mapping[str, bytes]):
    """The files of a folder by name, read when they are asked for; items raise DataFormatError."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def __getitem__(self, name: str) -> bytes:
        try:
            return (self._folder / name).read_bytes()
        except OSError as error:
            raise DataFormatError(f"{self._folder / name}: cannot be read ({error.strerror})") from None

    def __iter__(self) -> Iterator[str]:
        return (path.name for path in sorted(self._folder.iterdir()) if path.is_file())

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def __contains__(self, name: object) -> bool:
        return (self._folder / str(name)).is_file()


def read_instance(path: str | os.PathLike[str]) -> Ego3DHandsInstance:
    """Reads one instance's folder: `decode_instance` of its files."""
    return decode_instance(FolderFiles(Path(path)), Path(path))


LABELS_ONLY = frozenset({fmt.IMAGE_FILE, fmt.COLOR_FILE, fmt.DEPTH_FILE})
"""What scoring has no use for; reading takes an eighth of the time without."""


def decode_instance(files: Mapping[str, bytes], where: Path, leave_out: Set[str] = frozenset()) -> Ego3DHandsInstance:
    """Decodes one instance.

    Only `location_2d.npy` and one of `color_new.png` and `color.png` are required.

    Args:
        files: file name -> contents.
        where: the instance's folder or name, for messages.
        leave_out: names of PNG files that are not decoded: the picture is then black, of the file's size, and depth or
            labels are None.

    Returns:
        The instance; files it does not hold are named in `missing`.

    Raises:
        DataFormatError: a required file is missing, or any file is damaged or of the wrong shape.
    """
    missing = tuple(name for name in _all_files() if name not in files)
    if fmt.JOINTS_2D_FILE in missing:
        raise DataFormatError(f"{where}: lacks {fmt.JOINTS_2D_FILE}")

    def png(name: str, channels: int) -> np.ndarray:
        if name in leave_out:
            return _black(*_png_size(files[name], str(where / name)), channels)
        return decode_png(files[name], channels, str(where / name))

    def array(name: str) -> np.ndarray:
        return _decode_array(files[name], str(where / name))

    if fmt.IMAGE_FILE not in missing:
        image = png(fmt.IMAGE_FILE, 3)
    elif fmt.COLOR_FILE not in missing:
        image = _on_black(png(fmt.COLOR_FILE, 4))
    else:
        raise DataFormatError(f"{where}: expected {fmt.IMAGE_FILE} or {fmt.COLOR_FILE}, found neither")
    height, width = image.shape[:2]

    def optional_png(name: str) -> np.ndarray | None:
        if name in missing or name in leave_out:
            return None
        pixels = png(name, 3)
        if pixels.shape[:2] != (height, width):
            raise DataFormatError(f"{where / name}: expected {width}x{height} pixels as the image, got {pixels.shape}")
        return pixels

    absent = np.zeros((2, fmt.N_JOINTS_WITH_ELBOW, 3))
    location_2d = array(fmt.JOINTS_2D_FILE)
    location_3d = absent if fmt.JOINTS_3D_FILE in missing else array(fmt.JOINTS_3D_FILE)
    location_canonical = absent if fmt.CANONICAL_FILE in missing else array(fmt.CANONICAL_FILE)
    labels, depth = optional_png(fmt.LABELS_FILE), optional_png(fmt.DEPTH_FILE)
    try:
        joints_px = fmt.decode_joints_px(location_2d, width, height)
        return Ego3DHandsInstance(
            path=where,
            image=image,
            camera=_camera(files, width, height),
            present=np.asarray(np.isfinite(joints_px).all(axis=(1, 2))),
            joints_px=joints_px,
            joints_m=fmt.decode_joints_m(location_3d),
            canonical=fmt.decode_canonical(location_canonical),
            labels=None if labels is None else fmt.decode_labels(labels),
            depth_m=None if depth is None else fmt.decode_depth(depth),
            missing=missing,
        )
    except DataFormatError as error:
        raise DataFormatError(f"{where}: {error}") from None


def _camera(files: Mapping[str, bytes], width: int, height: int) -> PinholeCamera:
    if fmt.CAMERA_FILE not in files:
        return PinholeCamera.ego3dhands(width, height)
    try:
        values = parse_json(files[fmt.CAMERA_FILE])
        fx, fy, cx, cy = (float(values[name]) for name in ("fx", "fy", "cx", "cy"))
        return PinholeCamera(fx, fy, cx, cy, width, height)
    except (DataFormatError, ValueError, KeyError, TypeError, OverflowError, InputError) as error:
        raise DataFormatError(f"{fmt.CAMERA_FILE}: fx, fy, cx and cy expected ({error})") from None


def decode_png(data: bytes, channels: int, where: str) -> np.ndarray:
    """Decodes an 8-bit PNG completely, or not at all.

    Args:
        data: the file's content.
        channels: 1 for grey, 3 for RGB, 4 for RGBA.
        where: the file's name, for messages.

    Returns:
        (H, W, channels) uint8, or (H, W) for one channel.

    Raises:
        DataFormatError: the file is empty, cut off, not a PNG, not 8-bit, or has other channels.
    """
    if not data.endswith(_PNG_END):  # the decoder would fill the rest of a cut-off picture without a word
        raise DataFormatError(f"{where}: {'zero bytes' if not data else 'not a complete PNG file'}")
    return decode_bytes(data, channels, where, "PNG")


def _png_size(data: bytes, where: str) -> tuple[int, int]:
    """(width, height) in pixels from a PNG file's header."""
    if not data.endswith(_PNG_END) or data[12:16] != b"IHDR":
        raise DataFormatError(f"{where}: {'zero bytes' if not data else 'not a complete PNG file'}")
    return int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big")


def _black(width: int, height: int, channels: int) -> np.ndarray:
    """(height, width, channels) uint8 zeros that take no memory; read-only."""
    return np.broadcast_to(np.uint8(0), (height, width, channels))


def _all_files() -> tuple[str, ...]:
    return (fmt.IMAGE_FILE, fmt.COLOR_FILE, fmt.LABELS_FILE, fmt.DEPTH_FILE, *_ARRAY_FILES)


def _on_black(rgba: np.ndarray) -> np.ndarray:
    """(H, W, 3) uint8: the hands of `color.png` on black."""
    return np.rint(rgba[..., :3] * (rgba[..., 3:] / 255.0)).astype(np.uint8)


def _decode_array(data: bytes, where: str) -> np.ndarray:
    try:
        array = np.load(io.BytesIO(data), allow_pickle=False)
    except Exception as error:  # a damaged header fails in many ways
        raise DataFormatError(f"{where}: not a complete .npy file ({error})") from None
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiu":
        raise DataFormatError(f"{where}: expected an array of numbers")
    return array


def _instance_folders(root: Path) -> Iterator[Path]:
    for folder, subfolders, files in os.walk(root, followlinks=True):
        subfolders[:] = [name for name in subfolders if not name.startswith(".")]  # half-written instances
        if fmt.JOINTS_2D_FILE in files:
            yield Path(folder)


def _is_empty_file(path: Path) -> bool:
    return path.is_file() and path.stat().st_size == 0


def _natural_key(path: Path, root: Path) -> tuple[tuple[tuple[bool, int, str], ...], ...]:
    """Sorts digits by value, and text before digits never compares with a number."""
    return tuple(
        tuple(
            (not piece.isdecimal(), int(piece) if piece.isdecimal() else 0, piece)
            for piece in re.split(r"(\d+)", part)
            if piece
        )
        for part in path.relative_to(root).parts
    )
