"""Arms that move while the shutter is open, drawn from one still frame and the velocity of every point of the arms."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import cv2
import numpy as np

from twohands.skeleton import PART_NAMES
from twohands.synth.scene.spec import ArmMotion
from twohands.types import RenderedFrame

STEPS: Final = 14
"""Moments that are averaged."""
LONGEST: Final = 0.16
"""Of a point's way across the picture, as a share of its width: a longer one is cut to it."""
ELBOW_M: Final = 0.05
"""Over which the motion of the upper arm becomes that of the forearm."""


def blurred(frame: RenderedFrame, motion: tuple[ArmMotion | None, ArmMotion | None]) -> RenderedFrame:
    """The frame as a camera takes it while its arms move; labels, depth and joints are those of the middle.

    Args:
        frame: with labels and depth of the arms.
        motion: of the left and right arm; None where it is still.
    """
    labels, size = frame.part_labels, frame.part_labels.shape
    flow = np.zeros((*size, 2), np.float32)
    for side, own in enumerate(motion):
        first = 1 + side * len(PART_NAMES)
        rows, columns = np.nonzero((labels >= first) & (labels < first + len(PART_NAMES)))
        if own is not None and len(rows):
            flow[rows, columns] = _ways(frame, side, own, rows, columns)
    longest = float(np.abs(flow).max())
    if longest < 1.0:
        return frame
    arm = (labels > 0).astype(np.float32)
    premultiplied = np.dstack([frame.rgb, frame.alpha]).astype(np.float32)
    premultiplied[..., :3] *= premultiplied[..., 3:] / 255
    # What the arm hides is taken from around it, and its motion goes on a little beyond its edge.
    sigma = longest / 3 + 2
    around = cv2.GaussianBlur(1 - arm, (0, 0), sigma)[..., None] + 1e-4
    hidden = cv2.GaussianBlur(premultiplied * (1 - arm[..., None]), (0, 0), sigma) / around
    behind = np.where(arm[..., None] > 0, hidden, premultiplied)
    near = cv2.GaussianBlur(arm, (0, 0), sigma)[..., None] + 1e-4
    flow = np.where(arm[..., None] > 0, flow, cv2.GaussianBlur(flow, (0, 0), sigma) / near)
    layer = np.dstack([premultiplied * arm[..., None], 255 * arm])
    columns, rows = np.meshgrid(np.arange(size[1], dtype=np.float32), np.arange(size[0], dtype=np.float32))
    total = np.zeros_like(layer)
    for share in np.linspace(-0.5, 0.5, STEPS, dtype=np.float32):
        at = columns - share * flow[..., 0], rows - share * flow[..., 1]
        total += np.dstack([cv2.remap(part, *at, cv2.INTER_LINEAR) for part in (layer[..., :4], layer[..., 4])])
    total /= STEPS
    out = total[..., :4] + (1 - total[..., 4:] / 255) * behind
    alpha = np.clip(np.maximum(out[..., 3], arm), 0, 255)  # what has a label is not quite see-through
    straight = out[..., :3] * 255 / np.maximum(alpha[..., None], 1)
    covered = alpha > 0.5
    rgb = np.where(covered[..., None], np.clip(straight + 0.5, 0, 255), 0).astype(np.uint8)
    return replace(frame, rgb=rgb, alpha=np.where(covered, np.rint(alpha), 0).astype(np.uint8))


def _ways(frame: RenderedFrame, side: int, motion: ArmMotion, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """(N, 2) pixels that the points of an arm at these pixels travel during the exposure."""
    camera, depth = frame.camera, frame.depth_m[rows, columns].astype(np.float64)
    rays = np.stack([(columns + 0.5 - camera.cx) / camera.fx, (rows + 0.5 - camera.cy) / camera.fy, 1 + 0 * depth], 1)
    points = rays * depth[:, None]
    elbow, wrist = frame.joints_m[side, :2]
    way = wrist - elbow
    below = np.clip((points - elbow) @ way / np.linalg.norm(way) / ELBOW_M + 0.5, 0, 1)[:, None]
    moves = np.cross(motion.swing, points - motion.shoulder) + below * np.cross(motion.bend, points - elbow)
    ends = []
    for place in (points - moves / 2, points + moves / 2):
        ends.append(place[:, :2] / np.maximum(place[:, 2:], 0.03) * [camera.fx, camera.fy])
    way = ends[1] - ends[0]
    length = np.linalg.norm(way, axis=1, keepdims=True)
    return way * np.minimum(1, LONGEST * camera.width / np.maximum(length, 1e-6))
