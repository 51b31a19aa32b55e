"""Reader of FreiHAND: one real right hand per picture, cropped to 224x224.

Expected below the root, as published (docs/datasets.md):

    training_xyz.json     n hands of (21, 3) metres, camera frame, our joint order
    training_K.json       n matrices K, one per picture
    training/rgb/00000000.jpg ...  4 n pictures: four backgrounds for every hand

and the same with `evaluation`, one picture for every hand. All hands are right ones.

Source: README and toolbox of lmb-freiburg/freihand.
"""

from __future__ import annotations

import os
from typing import Final, Literal, get_args

from twohands.datasets.conversion import camera_of_matrix, number_array, projected_sample, single_hand
from twohands.datasets.files import existing_folder, read_json, read_picture
from twohands.errors import DataFormatError, InputError
from twohands.skeleton import N_JOINTS, RIGHT
from twohands.types import HandSample

Split = Literal["training", "evaluation"]
Background = Literal["gs", "hom", "sample", "auto"]

BACKGROUNDS: Final[tuple[str, ...]] = get_args(Background)
"""Of the training pictures, in their order on disk: green screen as taken, then three kinds of replacement."""


class FreiHAND:
    """One split, one picture per labelled hand.

    Attributes:
        root: the folder that holds the JSON files.
        split: "training" or "evaluation".

    Args:
        root: the folder.
        split: "training" or "evaluation".
        background: which version of the training pictures: "gs" green screen, "hom" harmonised, "sample" and "auto"
            recoloured. The evaluation pictures exist once.

    Raises:
        InputError: no such folder, or an unknown split or background.
        DataFormatError: a label file is missing or damaged, or the two do not belong together.
    """

    def __init__(
        self, root: str | os.PathLike[str], split: Split = "evaluation", *, background: Background = "gs"
    ) -> None:
        if split not in get_args(Split) or background not in BACKGROUNDS:
            raise InputError(
                f"expected training or evaluation and one of {', '.join(BACKGROUNDS)}, got {split!r}, {background!r}"
            )
        if split == "evaluation" and background != "gs":
            raise InputError(f"FreiHAND's evaluation pictures have no version {background!r}, only 'gs'")
        self.root = existing_folder(root)
        self.split = split
        self._xyz_path, self._k_path = (self.root / f"{split}_{what}.json" for what in ("xyz", "K"))
        self._xyz = read_json(self._xyz_path, list)
        self._k = read_json(self._k_path, list)
        if not self._xyz or len(self._xyz) != len(self._k):
            raise DataFormatError(
                f"{self._k_path}: expected one matrix for every hand of {self._xyz_path.name}, "
                f"got {len(self._k)} for {len(self._xyz)}"
            )
        self._first_picture = BACKGROUNDS.index(background) * len(self._xyz)

    @property
    def name(self) -> str:
        """Name and split."""
        return f"FreiHAND {self.split}"

    def __len__(self) -> int:
        return len(self._xyz)

    def __getitem__(self, index: int) -> HandSample:
        index = range(len(self))[index]
        source = f"{self.split}/rgb/{self._first_picture + index:08d}.jpg"
        image = read_picture(self.root / source)
        height, width = image.shape[:2]
        joints_m = number_array(self._xyz[index], (N_JOINTS, 3), f"{self._xyz_path}, entry {index}")
        camera = camera_of_matrix(self._k[index], (width, height), f"{self._k_path}, entry {index}")
        return projected_sample(image, camera, single_hand(joints_m, RIGHT), source)
