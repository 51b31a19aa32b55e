"""Reader of STB, the Stereo Hand Pose Tracking Benchmark: one real left hand before a stereo camera.

Expected below the root, as published (docs/datasets.md):

    images/B1Counting/BB_left_0.png ... BB_left_1499.png
    labels/B1Counting_BB.mat            handPara (3, 21, 1500), millimetres

and the same for B1..B6 x {Counting, Random}. Only the left picture of the stereo pair is read: the labels are already
in its frame. Joint 0 of STB is the palm's centre, not the wrist.

Source: the data set's README; docs/datasets.md.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final, Literal, get_args

import numpy as np

from twohands.datasets.conversion import camera_of, number_array, projected_sample, single_hand
from twohands.datasets.files import existing_folder, read_bytes, read_picture, reason
from twohands.errors import DataFormatError, InputError, MissingExtraError
from twohands.skeleton import FROM_STB, LEFT, N_JOINTS, ROOT, WRIST
from twohands.types import HandSample, PinholeCamera

Split = Literal["train", "test"]
JointZero = Literal["palm", "wrist"]

SEQUENCES: Final[dict[Split, tuple[str, ...]]] = {
    "train": tuple(f"B{background}{motion}" for background in range(2, 7) for motion in ("Counting", "Random")),
    "test": ("B1Counting", "B1Random"),
}
"""The usual split: ten sequences to train, both of background 1 to test (15,000 and 3,000 frames)."""

_FOCAL_PX: Final = np.array([822.79041, 822.79041])
_PRINCIPAL_POINT_PX: Final = np.array([318.47345, 250.31296])
"""Of the left Bumblebee2 camera, rectified, 640x480; a calibration, counted from the first pixel's centre."""
_PALM_TO_WRIST: Final = 2.0
"""|wrist - root| / |palm centre - root| that the option "wrist" supposes."""


class STB:
    """The left pictures of one split, sequence by sequence.

    Attributes:
        root: the folder that holds `images` and `labels`.
        split: "train" or "test".

    Args:
        root: the folder.
        split: "train" or "test".
        joint_zero: what joint 0 (our wrist) is. "palm", the label as it is: the hand length is then |palm - root|,
            3.9 cm, which is what the paper's authors used. "wrist": moved along root -> palm to twice that distance,
            a guess that others make too.

    Raises:
        InputError: no such folder, or an unknown split or joint.
        DataFormatError: a label file is missing or damaged.
        MissingExtraError: SciPy, which reads the label files, is not installed.
    """

    def __init__(self, root: str | os.PathLike[str], split: Split = "test", *, joint_zero: JointZero = "palm") -> None:
        if split not in get_args(Split) or joint_zero not in get_args(JointZero):
            raise InputError(f"expected train or test, and palm or wrist, got {split!r} and {joint_zero!r}")
        self.root = existing_folder(root)
        self.split = split
        self._joint_zero = joint_zero
        self._frames: list[tuple[str, int]] = []
        labels: list[np.ndarray] = []
        for sequence in SEQUENCES[split]:
            joints_m = _read_labels(self.root / "labels" / f"{sequence}_BB.mat")
            self._frames += [(sequence, frame) for frame in range(len(joints_m))]
            labels.append(joints_m)
        self._joints_m = np.concatenate(labels)  # (N, 21, 3)

    @property
    def name(self) -> str:
        """Name and split."""
        return f"STB {self.split}"

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, index: int) -> HandSample:
        sequence, frame = self._frames[index]
        source = f"{sequence}/BB_left_{frame}.png"
        image = read_picture(self.root / "images" / source)
        if image.shape[:2] != (480, 640):
            raise DataFormatError(f"{self.root / 'images' / source}: expected 640x480 pixels, got {image.shape}")
        joints_m = self._joints_m[index].copy()
        if self._joint_zero == "wrist":
            joints_m[WRIST] = joints_m[ROOT] + _PALM_TO_WRIST * (joints_m[WRIST] - joints_m[ROOT])
        return projected_sample(image, left_camera(), single_hand(joints_m, LEFT), source)


def left_camera() -> PinholeCamera:
    """The left camera of STB's stereo pair. The paper's authors used another, less exact one (docs/datasets.md)."""
    return camera_of(_FOCAL_PX, _PRINCIPAL_POINT_PX, (640, 480), "STB")


def _read_labels(path: Path) -> np.ndarray:
    """(N, 21, 3) float64, our joint order, frame of the left camera, metres."""
    try:
        import scipy.io
    except ImportError:
        raise MissingExtraError("reading STB's .mat files", "datasets") from None
    read_bytes(path)  # names a missing or empty file
    try:
        hand_para = scipy.io.loadmat(path, variable_names=["handPara"])["handPara"]
    except Exception as error:  # the parser of damaged files raises whatever it stumbles over
        raise DataFormatError(f"{path}: not a MATLAB file with the array handPara ({reason(error)})") from None
    count = max(1, np.size(hand_para) // (3 * N_JOINTS))
    joints_mm = number_array(hand_para, (3, N_JOINTS, count), f"{path}: handPara").transpose(2, 1, 0)
    return joints_mm[:, FROM_STB] / 1e3
