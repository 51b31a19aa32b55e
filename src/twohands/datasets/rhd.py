"""Reader of RHD, the Rendered Hand Pose Dataset, which the paper calls RHP: rendered people, one or two hands.

Expected below the root, as published (docs/datasets.md):

    evaluation/anno_evaluation.pickle   {i: {"xyz": (42, 3), "uv_vis": (42, 3), "K": (3, 3)}}
    evaluation/color/00000.png ...      320x320 RGB
    evaluation/mask/00000.png ...       0 background, 1 person, 2..17 left hand, 18..33 right hand

and the same with `training`. Both hands are labelled in every picture, whether they are seen or not.

Source: the data set's README; docs/datasets.md.
"""

from __future__ import annotations

import io
import os
import pickle
import re
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, Literal, get_args

import numpy as np

from twohands.datasets.conversion import camera_of_matrix, number_array
from twohands.datasets.files import existing_folder, read_bytes, read_picture, reason
from twohands.errors import DataFormatError, InputError
from twohands.skeleton import FINGERS, FROM_RHD, LEFT, N_JOINTS, RIGHT, part_label
from twohands.types import HandSample

Split = Literal["training", "evaluation"]
Hands = Literal["evaluated", "both"]

_FIRST_CLASS: Final = {LEFT: 2, RIGHT: 18}
_N_CLASSES: Final = 34


class RHD:
    """One split, in the order of its numbers.

    `visible` carries the data set's own flags. `labels` are our part labels, without arms: RHD counts these as
    "person", which is our background.

    Attributes:
        root: the folder that holds `training` and `evaluation`.
        split: "training" or "evaluation".

    Args:
        root: the folder.
        split: "training" or "evaluation".
        hands: "evaluated", the protocol of the field: only the hand with more pixels in the mask counts as present
            (the left one if it has strictly more); the other one is NaN, though it may be seen. "both": every hand
            with a pixel in the mask.

    Raises:
        InputError: no such folder, or an unknown split or choice of hands.
        DataFormatError: the annotation file is missing or damaged, or holds anything but numbers.
    """

    def __init__(
        self, root: str | os.PathLike[str], split: Split = "evaluation", *, hands: Hands = "evaluated"
    ) -> None:
        if split not in get_args(Split) or hands not in get_args(Hands):
            raise InputError(f"expected training or evaluation, evaluated or both, got {split!r} and {hands!r}")
        self.root = existing_folder(root)
        self.split = split
        self._hands = hands
        self._path = self.root / split / f"anno_{split}.pickle"
        annotations = read_number_pickle(self._path)
        if not (isinstance(annotations, dict) and annotations and all(isinstance(n, int) for n in annotations)):
            raise DataFormatError(f"{self._path}: expected a dictionary with the pictures' numbers as keys")
        self._annotations: dict[int, Any] = annotations
        self._numbers = sorted(self._annotations)

    @property
    def name(self) -> str:
        """Name and split."""
        return f"RHD {self.split}"

    def __len__(self) -> int:
        return len(self._numbers)

    def __getitem__(self, index: int) -> HandSample:
        number = self._numbers[index]
        source = f"{self.split}/{number:05d}"
        what = f"{self._path}, entry {number}"
        try:
            xyz, uv_vis, k = (self._annotations[number][key] for key in ("xyz", "uv_vis", "K"))
        except (KeyError, TypeError, IndexError):
            raise DataFormatError(f"{what}: expected xyz, uv_vis and K") from None
        joints_m = _in_our_order(number_array(xyz, (2 * N_JOINTS, 3), f"{what}, xyz"))
        joints = _in_our_order(number_array(uv_vis, (2 * N_JOINTS, 3), f"{what}, uv_vis"))  # u, v, visible

        image = read_picture(self.root / self.split / "color" / f"{number:05d}.png")
        mask_path = self.root / self.split / "mask" / f"{number:05d}.png"
        mask = read_picture(mask_path, channels=1)
        if mask.shape != image.shape[:2]:
            raise DataFormatError(f"{mask_path}: expected the picture's size {image.shape[:2]}, got {mask.shape}")
        if mask.max() >= _N_CLASSES:
            raise DataFormatError(f"{mask_path}: classes must be 0..{_N_CLASSES - 1}, got {mask.max()}")
        present = hand_pixels(mask) > 0
        if self._hands == "evaluated":
            present &= np.arange(2) == evaluated_hand(mask)

        size = image.shape[1], image.shape[0]
        return HandSample(
            image=image,
            # Blender's K counts from the outer corner: 160 is the exact middle of 320 pixels, and of the 2D labels
            camera=camera_of_matrix(k, size, f"{what}, K", from_centre=False),
            present=present,
            joints_px=np.where(present[:, None, None], joints[..., :2], np.nan),
            joints_m=np.where(present[:, None, None], joints_m, np.nan),
            valid=np.repeat(present[:, None], N_JOINTS, axis=1),
            labels=part_labels(mask),
            source=source,
            visible=(joints[..., 2] > 0) & present[:, None],
        )


def hand_pixels(mask: np.ndarray) -> np.ndarray:
    """Pixels of each hand.

    Args:
        mask: (H, W) uint8, RHD's classes 0..33.

    Returns:
        (2,) int, (LEFT, RIGHT).
    """
    counts = np.bincount(mask.ravel(), minlength=_N_CLASSES)
    return np.array([counts[_FIRST_CLASS[side] : _FIRST_CLASS[side] + 16].sum() for side in (LEFT, RIGHT)])


def evaluated_hand(mask: np.ndarray) -> int:
    """The hand that the field evaluates (docs/datasets.md): LEFT if it has strictly more pixels in the mask."""
    left, right = hand_pixels(mask)
    return LEFT if left > right else RIGHT


def part_labels(mask: np.ndarray) -> np.ndarray:
    """Our part labels of RHD's classes.

    Args:
        mask: (H, W) uint8. Per hand 16 classes: three for each finger, thumb first, then the palm.

    Returns:
        (H, W) uint8, 0..14; the person is background.
    """
    table = np.zeros(256, np.uint8)
    for side, first in _FIRST_CLASS.items():
        for finger in range(len(FINGERS)):
            table[first + 3 * finger : first + 3 * finger + 3] = part_label(side, 2 + finger)
        table[first + 3 * len(FINGERS)] = part_label(side, 1)
    return table[mask]


def read_number_pickle(path: Path) -> Any:
    """Reads a pickle of numpy arrays in plain containers, and nothing else.

    A pickle is a program: it may name any function and have it called, so `pickle.load` on a downloaded file hands the
    machine to whoever wrote that file. This reader knows only the names that numpy writes for its arrays and scalars,
    has functions of its own for them, and refuses the file at the first other name; dictionaries, lists, numbers and
    texts need no name.

    Args:
        path: the file, of any pickle protocol, written by Python 2 or 3.

    Returns:
        Its content; its arrays are objects of which `np.asarray` makes arrays.

    Raises:
        DataFormatError: the file is missing, cut off, not a pickle, or holds or names anything else.
    """
    try:
        return _NumberUnpickler(io.BytesIO(read_bytes(path)), encoding="latin1").load()
    except DataFormatError:
        raise
    except Exception as error:  # damaged pickles raise whatever they stumble over
        raise DataFormatError(f"{path}: not a complete pickle of numbers ({reason(error)})") from None


def _in_our_order(values: np.ndarray) -> np.ndarray:
    """(42, K) left hand first -> (2, 21, K), (LEFT, RIGHT), our joint order."""
    return values.reshape(2, N_JOINTS, -1)[:, FROM_RHD]


class _NumberUnpickler(pickle.Unpickler):
    """Gives every name that numpy writes for numbers a stand-in: numpy's own dtype takes a state that makes objects of
    raw bytes."""

    def find_class(self, module_name: str, global_name: str, /) -> Any:
        try:
            return _STAND_INS[module_name, global_name]
        except KeyError:
            raise pickle.UnpicklingError(
                f"it names {module_name}.{global_name}, which is no array of numbers"
            ) from None


class _NumberType:
    """Stands in for `numpy.dtype`: floats, integers and truth values of one size."""

    def __init__(self, code: str, *_: Any) -> None:
        if not re.fullmatch(r"[fiub]\d+", code):
            raise pickle.UnpicklingError(f"it holds values of type {code!r}, not numbers")
        self.dtype = np.dtype(code)

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        """(version, byte order, no sub-array, no field names, no fields, numbers that follow from the type)."""
        order, *parts = state[1:5]
        if order not in ("<", ">", "|", "=") or parts != [None] * 3:
            raise pickle.UnpicklingError("it holds values of several parts, not numbers")
        self.dtype = self.dtype.newbyteorder(order)


class _NumberArray:
    """Stands in for an array: numpy makes one of it wherever it takes one."""

    _values: np.ndarray | None = None

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        _, shape, kind, by_columns, data = state
        self._values = _numbers(data, kind).reshape(shape, order="F" if by_columns else "C")

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        if self._values is None:
            raise TypeError("an array without numbers")
        return np.array(self._values, dtype) if copy else np.asarray(self._values, dtype)


def _numbers(data: bytes | str, kind: _NumberType) -> np.ndarray:
    """(N,) numbers of raw bytes, which Python 2 wrote as a text."""
    return np.frombuffer(data.encode("latin1") if isinstance(data, str) else data, kind.dtype)


def _new_array(*_: Any) -> _NumberArray:
    """Stands in for `_reconstruct`: an array whose numbers follow as its state."""
    return _NumberArray()


def _array_of_buffer(data: bytes, kind: _NumberType, shape: tuple[int, ...], order: Literal["C", "F"]) -> _NumberArray:
    """Stands in for `_frombuffer`, protocol 5's whole array."""
    array = _NumberArray()
    array.__setstate__((1, shape, kind, order == "F", data))
    return array


def _scalar(kind: _NumberType, data: bytes | str) -> Any:
    """Stands in for `scalar`: one number."""
    (number,) = _numbers(data, kind)
    return number


def _latin1_bytes(text: str, encoding: str) -> bytes:
    """How protocol 2 spells the bytes of an array."""
    if encoding != "latin1":
        raise pickle.UnpicklingError(f"expected bytes written as latin1, got {encoding}")
    return text.encode("latin1")


_STAND_INS: Final[Mapping[tuple[str, str], Any]] = MappingProxyType(
    {
        ("numpy", "ndarray"): _NumberArray,
        ("numpy", "dtype"): _NumberType,
        ("_codecs", "encode"): _latin1_bytes,
    }
    | {
        (f"numpy.{core}.{module}", name): stand_in
        for core in ("core", "_core")
        for module, name, stand_in in (
            ("multiarray", "_reconstruct", _new_array),
            ("multiarray", "scalar", _scalar),
            ("numeric", "_frombuffer", _array_of_buffer),
        )
    }
)
