"""Reader of photographs of right hands that show a digit before white paper, with joints that another system found.

Expected below the root (docs/datasets.md):

    images/DIGIT_IMG_NUMBER.jpg   100x100, the Sign Language Digits Dataset
    pseudo_labels.json            {name: {"score": 0.98, "joints_px": [[u, v], ...]}}, 21 joints in our order

The joints are where MediaPipe Hands has them (`ANATOMICAL`), and guesses: `HandSample.confidence` says how good.
Nothing is known in 3D, and nothing of the camera.

Source: github.com/ardamavi/Sign-Language-Digits-Dataset (Apache-2.0).
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from typing import Any, Final, Literal, get_args

import numpy as np

from twohands.datasets.conversion import number_array, single_hand
from twohands.datasets.files import existing_folder, read_json, read_picture
from twohands.errors import DataFormatError, InputError
from twohands.skeleton import N_JOINTS, RIGHT
from twohands.types import HandSample, PinholeCamera

Part = Literal["training", "held-out", "all"]

LABELS_FILE: Final = "pseudo_labels.json"
ASSUMED_FOV_DEG: Final = 60.0
"""Of the unknown camera."""
HELD_OUT: Final = 5
"""One person of so many is held out from all training."""
SWAPPED: Final = 4
"""A digit that is less by fewer than this than the one before is out of order; by more, another person has begun."""
SCORES: Final = (0.85, 0.97)
"""A hand with the first score or less counts a quarter of one with the second or more."""
ANATOMICAL: Final = 0.5
"""Wrist and knuckles lie about so far of the way from our skeleton's to the anatomical ones (`geometry.anatomy`): the
labels' palm is then 0.88 times as long as ours. PoseNet2D, trained on renderings alone, says 0.87 of 80 hands that are
not held out; `peers.mediapipe_hands.BONE_RATIO` is 0.9."""
_NAME = re.compile(r"(\d)_IMG_(\d+)\.jpg")


class Digits:
    """One part of the photographs, in the order in which they were taken.

    Every person showed the digits 0 to 9 in turn. A person begins where the digit falls by `SWAPPED` or more in the
    order of the numbers; a single picture before that belongs to the next person. Every fifth person (numbers 4, 9, 14,
    ... from 0) is held out: their pictures serve to choose and to judge, never to train.

    Attributes:
        root: the folder that holds the labels.
        part: "training", "held-out" or "all".
        names: of the pictures.
        persons: (N,) int, whose hand each shows.

    Args:
        root: the folder.
        part: which persons.

    Raises:
        InputError: no such folder or part.
        DataFormatError: the labels are missing or damaged.
    """

    def __init__(self, root: str | os.PathLike[str], part: Part = "held-out") -> None:
        if part not in get_args(Part):
            raise InputError(f"expected one of {', '.join(get_args(Part))}, got {part!r}")
        self.root = existing_folder(root)
        self.part = part
        self._path = self.root / LABELS_FILE
        self._labels: dict[str, Any] = read_json(self._path, dict)
        for name in self._labels:
            if not _NAME.fullmatch(name):
                raise DataFormatError(f"{self._path}: expected names like 0_IMG_1118.jpg, got {name!r}")
        names = sorted(self._labels, key=_number)
        persons = persons_of(map(_digit, names))
        held_out = persons % HELD_OUT == HELD_OUT - 1
        chosen = np.flatnonzero(np.ones(len(names), bool) if part == "all" else held_out == (part == "held-out"))
        self.names = tuple(names[i] for i in chosen)
        self.persons = persons[chosen]

    @staticmethod
    def is_at(folder: str | os.PathLike[str]) -> bool:
        """Whether a folder holds such photographs."""
        return os.path.isfile(os.path.join(folder, LABELS_FILE))

    @property
    def name(self) -> str:
        """Name and part."""
        return f"digits {self.part}"

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, index: int) -> HandSample:
        name = self.names[index]
        what = f"{self._path}, entry {name}"
        image = read_picture(self.root / "images" / name)
        height, width = image.shape[:2]
        try:
            joints, score = self._labels[name]["joints_px"], float(self._labels[name]["score"])
        except (KeyError, TypeError, ValueError):
            raise DataFormatError(f"{what}: expected joints_px and a score") from None
        joints_px = single_hand(number_array(joints, (N_JOINTS, 2), what), RIGHT)
        present = np.array([False, True])
        valid = np.repeat(present[:, None], N_JOINTS, axis=1)
        return HandSample(
            image=image,
            camera=PinholeCamera.from_fov(ASSUMED_FOV_DEG, width, height),
            present=present,
            joints_px=joints_px,
            joints_m=np.full((2, N_JOINTS, 3), np.nan),
            valid=valid,
            source=f"images/{name}",
            confidence=np.where(valid, np.interp(score, SCORES, (0.25, 1.0)), 0.0),
        )


def persons_of(digits: Iterable[int]) -> np.ndarray:
    """(N,) int: whose hand each of a row of pictures shows, from the digits that they show; see `Digits`."""
    row = np.fromiter(digits, int)
    begins = np.concatenate([[True], np.diff(row) <= -SWAPPED])[: len(row)]
    begins[1:] &= ~(begins[1:] & begins[:-1])  # the one before was a picture by itself
    return np.cumsum(begins) - 1


def _digit(name: str) -> int:
    return int(name[0])


def _number(name: str) -> int:
    return int(name.split("_")[2].removesuffix(".jpg"))
