"""A small cache of frames drawn without a renderer."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
from tests.builders import make_sample

from twohands.skeleton import LEFT, RIGHT

BODY = (60, 90, 140)


def write_frames(folder: Path, count: int = 3, present: tuple[bool, bool] = (True, True)) -> None:
    """Hands of bones in the colour of skin, each with a thick arm to an elbow below, before a blue body that fills the
    middle of the picture."""
    folder.mkdir(parents=True)
    width, height = 240, 135
    arrays = {
        "rgba": np.zeros((count, height, width, 4), np.uint8),
        "labels": np.zeros((count, height, width), np.uint8),
        "joints": np.full((count, 2, 22, 3), np.nan, np.float32),
        "present": np.tile(np.array(present), (count, 1)),
        "intrinsics": np.zeros((count, 4), np.float32),
        "done": np.ones(count, bool),
    }
    for i in range(count):
        sample = make_sample(np.random.default_rng(i), width=width, height=height, present=present)
        camera = sample.camera
        assert sample.labels is not None
        rgba, labels = arrays["rgba"][i], sample.labels.copy()
        rgba[:, 60:180] = (*BODY, 255)
        for side in (LEFT, RIGHT):
            if not present[side]:
                continue
            joints = sample.joints_m[side]
            elbow = joints[0] + [0, 0.2, 0]
            arrays["joints"][i, side] = np.vstack([elbow, joints])
            start, end = (camera.fx * p[:2] / p[2] + [camera.cx, camera.cy] for p in (elbow, joints[0]))
            arm = np.zeros_like(labels)
            cv2.line(arm, np.rint(start).astype(int).tolist(), np.rint(end).astype(int).tolist(), 1, 12)
            labels[(arm > 0) & (labels == 0)] = 1 + 7 * side
        rgba[labels > 0] = (200, 150, 120, 255)
        arrays["labels"][i] = labels
        arrays["intrinsics"][i] = camera.fx, camera.fy, camera.cx, camera.cy
    for name, values in arrays.items():
        np.save(folder / f"{name}.npy", values)
    (folder / "manifest.json").write_text(json.dumps({"format": "frames-2", "seed": 5, "config": {"sensor": 0.0}}))
