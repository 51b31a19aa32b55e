"""Reader of InterHand2.6M: one or two real hands in a studio with many cameras.

Expected below the root, as published (docs/datasets.md):

    annotations/test/InterHand2.6M_test_data.json       pictures, hand type, which joints are labelled
    annotations/test/InterHand2.6M_test_camera.json     every camera's place, rotation and intrinsics
    annotations/test/InterHand2.6M_test_joint_3d.json   joints of every frame, world, millimetres
    images/test/Capture0/...

and the same with `train` and `val`.

Source: DATASET.md of facebookresearch/InterHand2.6M.
"""

from __future__ import annotations

import os
from typing import Any, Final, Literal, get_args

import numpy as np

from twohands.datasets.conversion import camera_of, number_array, projected_sample
from twohands.datasets.files import existing_folder, read_json, read_picture
from twohands.errors import DataFormatError, InputError
from twohands.skeleton import FROM_INTERHAND, LEFT, N_JOINTS, RIGHT
from twohands.types import HandSample

Split = Literal["train", "val", "test"]

_HAND_TYPES: Final = {"left": (LEFT,), "right": (RIGHT,), "interacting": (LEFT, RIGHT)}


class InterHand:
    """One split, one sample per annotation, in the file's order.

    `valid` is the data set's own joint_valid: labelled and inside the picture. A hand is present if the hand type says
    so; where the data set distrusts its hand type, if any of its joints is valid.

    Attributes:
        root: the folder that holds `annotations` and `images`.
        split: "train", "val" or "test".

    Args:
        root: the folder.
        split: "train", "val" or "test".
        subset: folder below `annotations`, by default the split's name; releases before 1.0 have "all",
            "human_annot" and "machine_annot".

    Raises:
        InputError: no such folder, or an unknown split.
        DataFormatError: an annotation file is missing or damaged.
    """

    def __init__(self, root: str | os.PathLike[str], split: Split = "test", *, subset: str | None = None) -> None:
        if split not in get_args(Split):
            raise InputError(f"expected split {', '.join(get_args(Split))}, got {split!r}")
        self.root = existing_folder(root)
        self.split = split
        folder = self.root / "annotations" / (subset or split)
        self._data_path, camera_path, joints_path = (
            folder / f"InterHand2.6M_{split}_{what}.json" for what in ("data", "camera", "joint_3d")
        )
        data = read_json(self._data_path, dict)
        self._cameras = read_json(camera_path, dict)
        self._joints = read_json(joints_path, dict)
        try:
            self._pictures = {picture["id"]: picture for picture in data["images"]}
            self._annotations = [dict(annotation) for annotation in data["annotations"]]
        except (KeyError, TypeError, ValueError):
            raise DataFormatError(f"{self._data_path}: expected the lists images and annotations") from None
        if not self._annotations:
            raise DataFormatError(f"{self._data_path}: holds no annotation")

    @property
    def name(self) -> str:
        """Name and split."""
        return f"InterHand2.6M {self.split}"

    def __len__(self) -> int:
        return len(self._annotations)

    def __getitem__(self, index: int) -> HandSample:
        annotation = self._annotations[index]
        try:
            return self._sample(annotation)
        except (KeyError, TypeError, ValueError) as error:
            what = f"annotation {annotation.get('id', index)}"
            raise DataFormatError(
                f"{self._data_path}: {what} and the other annotation files do not fit together ({error!r})"
            ) from None

    def _sample(self, annotation: dict[str, Any]) -> HandSample:
        picture = self._pictures[annotation["image_id"]]
        what = f"{self._data_path}: annotation {annotation['id']}"
        capture, view, frame = (str(picture[key]) for key in ("capture", "camera", "frame_idx"))
        cameras = self._cameras[capture]

        def calibration(key: str, *shape: int) -> np.ndarray:
            return number_array(cameras[key][view], shape, f"{what}, {key} of camera {view}")

        world_mm = number_array(self._joints[capture][frame]["world_coord"], (2 * N_JOINTS, 3), f"{what}, world_coord")
        labelled = number_array(np.ravel(annotation["joint_valid"]), (2 * N_JOINTS,), f"{what}, joint_valid") > 0
        # X_cam = R (X - campos), row by row
        cam_mm = (world_mm - calibration("campos", 3)) @ calibration("camrot", 3, 3).T
        joints_m = np.where(_in_our_order(labelled)[..., None], _in_our_order(cam_mm) / 1e3, np.nan)

        if annotation["hand_type"] not in _HAND_TYPES:
            raise DataFormatError(f"{what}: expected a hand type of {', '.join(_HAND_TYPES)}")
        present = np.any(_in_our_order(labelled), axis=1)
        if annotation["hand_type_valid"]:
            present = np.isin((LEFT, RIGHT), _HAND_TYPES[annotation["hand_type"]])

        size = picture["width"], picture["height"]
        path = self.root / "images" / self.split / picture["file_name"]
        image = read_picture(path)
        if image.shape[:2] != size[::-1]:
            raise DataFormatError(f"{path}: expected {size[0]}x{size[1]} pixels, got {image.shape}")
        camera = camera_of(calibration("focal", 2), calibration("princpt", 2), size, what)
        return projected_sample(image, camera, joints_m, picture["file_name"], present)


def _in_our_order(values: np.ndarray) -> np.ndarray:
    """(42, ...) right hand first -> (2, 21, ...), (LEFT, RIGHT), our joint order."""
    right, left = values[:N_JOINTS], values[N_JOINTS:]
    return np.stack([left, right])[:, FROM_INTERHAND]
