"""Reader of RHD, the Rendered Hand Pose Dataset, which the paper calls RHP: rendered people, one or two hands.

Expected below the root, as published (docs/datasets.md):

    evaluation/anno_evaluation.pickle   {i: {"xyz": (42, 3), "uv_vis": (42, 3), "K": (3, 3)}}
    evaluation/color/00000.png ...      320x320 RGB
    evaluation/mask/00000.png ...       0 background, 1 person, 2..17 left hand, 18..33 right hand

and the same with `training`. Both hands are labelled in every picture, whether they are seen or not.

Source: SPEC 7.5, the data set's README.
"""

from __future__ import annotations

import io
import os
import pickle
from pathlib import Path
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
        except (KeyError, TypeError):
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
    """The hand that the field evaluates: LEFT if it has strictly more pixels in the mask, else RIGHT (SPEC 7.5)."""
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
    machine to whoever wrote that file. This reader resolves only the names that numpy writes for its arrays and
    scalars, and refuses the file at the first other name; dictionaries, lists, numbers and texts need no name.

    Args:
        path: the file, of any pickle protocol, written by Python 2 or 3.

    Returns:
        Its content.

    Raises:
        DataFormatError: the file is missing, cut off, not a pickle, or names anything else.
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
    _ALLOWED: Final = {
        *((f"numpy.{core}.multiarray", name) for core in ("core", "_core") for name in ("_reconstruct", "scalar")),
        *((f"numpy.{core}.numeric", "_frombuffer") for core in ("core", "_core")),
        ("numpy", "ndarray"),
        ("numpy", "dtype"),
    }

    def find_class(self, module_name: str, global_name: str, /) -> Any:
        if (module_name, global_name) == ("_codecs", "encode"):
            return _latin1_bytes
        if (module_name, global_name) not in self._ALLOWED:
            raise pickle.UnpicklingError(f"it names {module_name}.{global_name}, which is no array of numbers")
        return super().find_class(module_name, global_name)


def _latin1_bytes(text: str, encoding: str) -> bytes:
    """How protocol 2 spells the bytes of an array."""
    if encoding != "latin1":
        raise pickle.UnpicklingError(f"expected bytes written as latin1, got {encoding}")
    return text.encode("latin1")
