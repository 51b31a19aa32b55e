"""MediaPipe Hands on our pictures.

It predicts 21 joints in the picture and 21 "world" joints in metres about the hand's own centre; it knows neither the
camera nor where the hand is. Two ways to a place in the camera frame are measured:

- "solver": its world joints as a canonical pose, placed by `geometry.projection` with the same intrinsics and hand
  length that our pipeline is given;
- "own-size": what its users do, PnP of the world joints at their own size, which needs no hand length.

Two of its programming interfaces are run: the legacy solution (`mp.solutions.hands`, last in 0.10.21, with its models
inside), which names hands as in a mirrored picture, and the Tasks API (in 0.10.21 as in 1.2), which names the person's
own and needs a model file, `hand_landmarker.task`. Such a file is a zip of two networks; those of the 0.10.21 wheel,
`palm_detection_full.tflite` and `hand_landmark_full.tflite`, stored as `hand_detector.tflite` and
`hand_landmarks_detector.tflite`, make one.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any, Final, Literal

import cv2
import numpy as np

from twohands.errors import DataFormatError, InputError
from twohands.evaluation.completion import complete_hand, hand_lengths_m
from twohands.geometry.camera import unproject
from twohands.peers.base import DetectedHand, Handedness, by_labels, by_own_handedness
from twohands.skeleton import LEFT, RIGHT
from twohands.types import HandPose, HandSample, PinholeCamera, TwoHandPose

Placement = Literal["solver", "own-size"]
_SIDE_OF_LABEL: Final = {"Left": LEFT, "Right": RIGHT}
BONE_RATIO: Final = 0.9
"""MediaPipe's distance from wrist to middle knuckle beside our hand length. The length with which its joints give the
true range is 0.92 of ours on 96 real crops of one hand (0.6 of whose length we take for ours), and 0.83 to 0.89 on
rendered hands."""
_WORKER: Final = Path(__file__).with_name("mediapipe_worker.py")


class MediaPipeHands:
    """MediaPipe Hands in a process of its own; a context manager.

    Args:
        python: interpreter of an environment that holds mediapipe; None for this one. MediaPipe 0.10.21 wants numpy
            before 2.0 and brings another OpenCV, so that it is best kept apart.
        handedness: whose word counts on which hand is which.
        placement: how its hands get their place.
        complexity: model 0 (lite) or 1 (full), of the legacy solution.
        confidence: least detection confidence.
        video: whether pictures are the frames of one video, in which it follows hands; else each is looked at afresh.
        model: file of the Tasks API; None for the legacy solution.

    Raises:
        InputError: no such interpreter, it has no mediapipe, or mediapipe no usable model.
    """

    def __init__(
        self,
        python: str | Path | None = None,
        *,
        handedness: Handedness = "matched",
        placement: Placement = "solver",
        complexity: int = 1,
        confidence: float = 0.5,
        video: bool = False,
        model: str | Path | None = None,
    ) -> None:
        self._handedness: Handedness = handedness
        self._placement: Placement = placement
        self._model = {"complexity": complexity, "confidence": confidence, "video": video}
        if model is not None and not Path(model).is_file():
            raise InputError(f"{model}: no such model file")
        settings = self._model | {"model": None if model is None else str(Path(model).absolute())}
        interpreter = str(python or sys.executable)
        if Path(interpreter).is_file():  # else it is looked for along PATH
            interpreter = str(Path(interpreter).absolute())
        environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
        try:
            self._process = subprocess.Popen(
                [interpreter, str(_WORKER), json.dumps(settings)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env=environment,
            )
        except OSError as error:
            raise InputError(f"{interpreter}: cannot be run ({error.strerror})") from None
        try:
            first = self._answer()
            if isinstance(first, dict) and first.get("what") == "model":
                raise InputError(
                    f"{first['error']}; --mediapipe-model FILE names it: the official hand_landmarker.task, or a zip "
                    "of the two networks in the wheel of mediapipe 0.10.21 (docs/evaluation.md)"
                )
            self._version, self._api = str(first["version"]), str(first["api"])
        except InputError:
            self.close()
            raise
        except (DataFormatError, KeyError, TypeError):
            self.close()
            raise InputError(
                f"{interpreter} has no MediaPipe Hands; make an environment for it (python3.11 -m venv DIR && "
                "DIR/bin/pip install mediapipe==0.10.21) and name its interpreter with --peer-python DIR/bin/python"
            ) from None

    def __enter__(self) -> MediaPipeHands:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Ends the process."""
        if self._process.stdin is not None:
            with contextlib.suppress(OSError):  # what it did not read any more is of no interest
                self._process.stdin.close()
        try:
            self._process.wait(timeout=10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()

    @property
    def version(self) -> str:
        """MediaPipe's version, and the API that is used."""
        return f"{self._version} ({self._api})" if self._api == "tasks" else self._version

    @property
    def name(self) -> str:
        """Name, version, and how it was placed."""
        place = "our solver" if self._placement == "solver" else "own size"
        return f"MediaPipe Hands {self.version} ({place}, {self._handedness} handedness)"

    @property
    def settings(self) -> dict[str, Any]:
        """Everything needed to repeat the run."""
        return {
            **self._model,
            "api": self._api,
            "handedness": self._handedness,
            "labels_used": ["hand length"] * (self._placement == "solver")
            + ["2D joints, to tell left from right"] * (self._handedness == "matched"),
            "placement": self._placement,
            "camera": "the dataset's",
        }

    def detect(self, image: np.ndarray) -> list[DetectedHand]:
        """Hands in one picture, in MediaPipe's order.

        Args:
            image: (H, W, 3) uint8 RGB, not mirrored.

        Raises:
            DataFormatError: the process has died.
        """
        height, width = image.shape[:2]
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps({"height": height, "width": width}).encode() + b"\n")
            self._process.stdin.write(np.ascontiguousarray(image).tobytes())
            self._process.stdin.flush()
        except OSError:
            raise DataFormatError("MediaPipe's process has ended") from None
        return [
            DetectedHand(
                side=_SIDE_OF_LABEL[hand["label"]],
                score=min(float(hand["score"]), 1.0),  # 1.0000001 at times
                joints_px=np.array(hand["joints"], np.float64) * [width, height],
                shape_m=np.array(hand["world_m"], np.float64),
            )
            for hand in self._answer()
        ]

    def __call__(self, sample: HandSample) -> TwoHandPose:
        """Both hands of one sample."""
        found = self.detect(sample.image)
        if self._handedness == "matched":
            sides = by_labels(found, sample.joints_px, sample.present)
        else:
            sides = by_own_handedness(found)
        lengths = hand_lengths_m(sample)
        left, right = (self._place(hand, sample.camera, float(lengths[side])) for side, hand in enumerate(sides))
        return TwoHandPose(left, right, sample.camera)

    def _place(self, hand: DetectedHand | None, camera: PinholeCamera, hand_length_m: float) -> HandPose:
        if hand is None:
            return HandPose(present=False)
        if self._placement == "solver":
            return complete_hand(
                camera, hand_length_m, joints_px=hand.joints_px, canonical=hand.shape_m, score=hand.score
            )
        joints_m = placed_by_pnp(hand.shape_m, hand.joints_px, camera)
        if joints_m is None:
            pose = complete_hand(
                camera, hand_length_m, joints_px=hand.joints_px, canonical=hand.shape_m, score=hand.score
            )
            return HandPose(True, hand.score, pose.box_px, pose.joints_px, canonical=pose.canonical, valid=False)
        return complete_hand(camera, hand_length_m, joints_m=joints_m, joints_px=hand.joints_px, score=hand.score)

    def _answer(self) -> Any:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise DataFormatError("MediaPipe's process has ended")
        try:
            return json.loads(line)
        except ValueError:
            raise DataFormatError("MediaPipe's process gave an answer that is not JSON") from None


def placed_by_pnp(shape_m: np.ndarray, joints_px: np.ndarray, camera: PinholeCamera) -> np.ndarray | None:
    """A rigid shape placed so that it is seen where its joints are seen.

    Args:
        shape_m: (21, 3) metres, any origin and orientation.
        joints_px: (21, 2) pixels.
        camera: intrinsics; lens distortion is undone.

    Returns:
        (21, 3) camera frame, metres; None where there is no solution in front of the camera.
    """
    rays = np.asarray(unproject(joints_px, camera))
    seen = rays[:, :2] / rays[:, 2:]
    if not (np.isfinite(seen).all() and np.isfinite(shape_m).all()):
        return None
    ok, turn, shift = cv2.solvePnP(shape_m, seen, np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP)
    if not ok:
        return None
    turn, shift = cv2.solvePnPRefineLM(shape_m, seen, np.eye(3), None, turn, shift)
    joints_m = shape_m @ np.asarray(cv2.Rodrigues(turn)[0], np.float64).T + np.asarray(shift, np.float64).ravel()
    return joints_m if np.isfinite(joints_m).all() and (joints_m[:, 2] > 0).all() else None
