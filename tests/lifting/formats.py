"""True hands in the words of every tracker: what its files would hold if it saw everything right.

Written after the code that writes these files: MediaPipe's results as dictionaries, `wilor_mini`'s pipeline, HaMeR's
`demo.py` (the batch and `out`), OpenPose's `--write_json`, MMPose's `split_instances`, rtmlib's return values.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from twohands.geometry.canonical import canonical_from_camera
from twohands.skeleton import LEFT, RIGHT
from twohands.types import HandSample

MEDIAPIPE_STYLES = {
    "legacy": ("multi_hand_landmarks", "multi_hand_world_landmarks", "multi_handedness", "label"),
    "legacy of the browser": ("multiHandLandmarks", "multiHandWorldLandmarks", "multiHandedness", "label"),
    "tasks": ("hand_landmarks", "hand_world_landmarks", "handedness", "category_name"),
    "tasks-vision": ("landmarks", "worldLandmarks", "handedness", "categoryName"),
}


def shape_of(sample: HandSample, side: int, scale: float = 0.09) -> np.ndarray:
    """(21, 3) as seen by a camera that looks at the hand, about its middle, in a unit of the tracker's own."""
    shape = scale * np.asarray(canonical_from_camera(sample.joints_m[side]).joints)
    return shape - shape.mean(axis=0)


def sides(sample: HandSample) -> list[int]:
    return [side for side in (RIGHT, LEFT) if sample.present[side]]  # not in our order


def mediapipe(sample: HandSample, style: str = "tasks") -> dict[str, Any]:
    marks, world, handedness, label = MEDIAPIPE_STYLES[style]
    legacy = style.startswith("legacy")
    size = [sample.camera.width, sample.camera.height]
    names = ("Right", "Left") if legacy else ("Left", "Right")
    points = lambda array, axes: [dict(zip(axes, map(float, row), strict=False)) for row in array]  # noqa: E731
    image = [points(np.c_[sample.joints_px[side] / size, np.zeros(21)], "xyz") for side in sides(sample)]
    space = [points(shape_of(sample, side), "xyz") for side in sides(sample)]
    says = [[{"index": 0, "score": 0.9, label: names[side]}] for side in sides(sample)]
    if style == "legacy":
        image, space = ([{"landmark": one} for one in lists] for lists in (image, space))
        says = [{"classification": one} for one in says]
    return {marks: image, world: space, handedness: says}


def wilor_mini(sample: HandSample) -> list[dict[str, Any]]:
    focal = 5000 / 256 * max(sample.camera.width, sample.camera.height)
    return [
        {
            "hand_bbox": [0.0, 0.0, 1.0, 1.0],
            "is_right": float(side == RIGHT),
            "wilor_preds": {
                "pred_cam": [[1.0, 0.0, 0.0]],
                "pred_keypoints_3d": shape_of(sample, side)[None].tolist(),
                "pred_keypoints_2d": sample.joints_px[side][None].tolist(),
                "scaled_focal_length": focal,
            },
        }
        for side in sides(sample)
    ]


def hamer_batch(sample: HandSample) -> dict[str, np.ndarray]:
    """`out` and the batch together: right hands all, 2D joints as fractions of the crop."""
    turns = np.array([[1.0 if side == RIGHT else -1.0] for side in sides(sample)])[:, None]
    pixels = np.stack([sample.joints_px[side] for side in sides(sample)])
    centre = (pixels.min(axis=1) + pixels.max(axis=1)) / 2
    size = 2.5 * np.ptp(pixels, axis=1).max(axis=1)
    fractions = (pixels - centre[:, None]) / size[:, None, None]
    shapes = np.stack([shape_of(sample, side) for side in sides(sample)])
    ones = np.ones_like(turns)
    return {
        "pred_keypoints_3d": shapes * np.concatenate([turns, ones, ones], axis=-1),
        "pred_keypoints_2d": fractions * np.concatenate([turns, ones], axis=-1),
        "right": np.array([float(side == RIGHT) for side in sides(sample)]),
        "box_center": centre,
        "box_size": size,
        "img_size": np.array([[sample.camera.width, sample.camera.height]] * len(turns), np.float64),
    }


def openpose(sample: HandSample) -> dict[str, Any]:
    person: dict[str, Any] = {"person_id": [-1], "pose_keypoints_2d": [], "face_keypoints_2d": []}
    for side, word in enumerate(("left", "right")):
        rows = np.c_[sample.joints_px[side] - 0.5, np.full(21, 0.8)]
        person[f"hand_{word}_keypoints_2d"] = rows.ravel().tolist() if sample.present[side] else [0.0] * 63
    return {"version": 1.3, "people": [person]}


def mmpose_whole_body(sample: HandSample) -> list[dict[str, Any]]:
    points, scores = np.zeros((133, 2)), np.zeros(133)
    for side, start in ((LEFT, 91), (RIGHT, 112)):
        if sample.present[side]:
            points[start : start + 21], scores[start : start + 21] = sample.joints_px[side] - 0.5, 0.8
    return [
        {"keypoints": points.tolist(), "keypoint_scores": scores.tolist(), "bbox": [[0, 0, 9, 9]], "bbox_score": 0.9}
    ]


def mmpose_hand(sample: HandSample, side: int) -> list[dict[str, Any]]:
    points = (sample.joints_px[side] - 0.5).tolist()
    return [{"keypoints": points, "keypoint_scores": [0.8] * 21, "bbox": [[0.0, 0.0, 9.0, 9.0]], "bbox_score": 0.9}]


def rtmlib(sample: HandSample) -> dict[str, Any]:
    (person,) = mmpose_whole_body(sample)
    return {"keypoints": [person["keypoints"]], "scores": [person["keypoint_scores"]]}
