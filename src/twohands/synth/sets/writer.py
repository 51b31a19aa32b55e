"""Encodes rendered instances in the official Ego3DHands layout (docs/dataset-format.md)."""

from __future__ import annotations

import io
import json

import cv2
import numpy as np

from twohands.errors import InputError
from twohands.formats import ego3dhands as layout
from twohands.geometry.camera import project
from twohands.geometry.canonical import canonical_from_camera
from twohands.geometry.rotation import centring_angles, rotation_from_angles
from twohands.skeleton import ROOT, WRIST
from twohands.types import PinholeCamera, RenderedFrame


def encode_instance(frame: RenderedFrame, image: np.ndarray) -> dict[str, bytes]:
    """The files of one instance.

    Args:
        frame: rendered hands; its depth and joints must be scaled as the files should be.
        image: (H, W, 3) uint8 RGB, the hands on a background.

    Returns:
        File name -> contents: all seven files of the layout, `camera.json` if the camera is not the official one, and
        `gt_amodal.png` if the frame has amodal masks.
    """
    height, width = frame.part_labels.shape
    camera = frame.camera
    files = {} if camera == PinholeCamera.ego3dhands(width, height) else {layout.CAMERA_FILE: _camera(camera)}
    if frame.amodal is not None:
        files[layout.AMODAL_FILE] = _png(frame.amodal[0] + np.uint8(2) * frame.amodal[1])
    hands = np.minimum(frame.part_labels, 1)  # things are no part of this file
    depth = np.minimum(frame.depth_m, layout.MAX_DEPTH_M)  # of people across a room, the file cannot hold more
    return files | {
        layout.COLOR_FILE: _png(cv2.copyTo(_bgra(frame.rgb, frame.alpha), hands)),
        layout.IMAGE_FILE: _png(cv2.cvtColor(image, cv2.COLOR_RGB2BGR)),
        layout.LABELS_FILE: _png(layout.encode_labels(frame.part_labels)),
        layout.DEPTH_FILE: _png(cv2.cvtColor(layout.encode_depth(depth), cv2.COLOR_RGB2BGR)),
        layout.JOINTS_2D_FILE: _npy(layout.encode_joints_px(joints_px_with_elbow(frame), width, height)),
        layout.JOINTS_3D_FILE: _npy(layout.encode_joints_m(frame.joints_m)),
        layout.CANONICAL_FILE: _npy(layout.encode_canonical(canonical_with_elbow(frame.joints_m))),
    }


def joints_px_with_elbow(frame: RenderedFrame) -> np.ndarray:
    """(2, 22, 2) pixels of all joints; NaN for an absent hand.

    An elbow, or a joint of a hand that is partly out of the picture, may lie behind the camera, where nothing projects.
    The layout wants a number for it all the same: the pinhole formula's, far outside the picture.
    """
    joints_px = np.array(project(frame.joints_m, frame.camera))
    behind = frame.joints_m[..., 2] <= 0
    points = frame.joints_m[behind]
    focal, centre = [frame.camera.fx, frame.camera.fy], [frame.camera.cx, frame.camera.cy]
    joints_px[behind] = points[:, :2] / np.minimum(points[:, 2:], -1e-3) * focal + centre
    return joints_px


def canonical_with_elbow(joints_m: np.ndarray) -> np.ndarray:
    """Canonical coordinates of all 22 joints, the elbow carried along.

    Args:
        joints_m: (2, 22, 3) camera frame; NaN for an absent hand.

    Returns:
        (2, 22, 3), unitless, centred frame; NaN for an absent hand.

    Source: paper Eq. 1.
    """
    hand = joints_m[:, 1:]
    result = np.full(joints_m.shape, np.nan)
    for side in range(len(joints_m)):
        if not np.isfinite(hand[side]).all():
            continue
        theta, phi = centring_angles(hand[side, ROOT])
        rotation = np.asarray(rotation_from_angles(theta, phi))
        length = np.linalg.norm(hand[side, WRIST] - hand[side, ROOT])
        result[side, 0] = rotation @ (joints_m[side, 0] - hand[side, ROOT]) / length
        result[side, 1:] = canonical_from_camera(hand[side]).joints
    return result


def _bgra(rgb: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    bgra = cv2.cvtColor(rgb, cv2.COLOR_RGB2BGRA)
    return np.asarray(cv2.insertChannel(alpha, bgra, 3))


def _png(pixels: np.ndarray) -> bytes:
    # No compression level: OpenCV's default takes differences to the left and their runs, which is two to three times
    # faster than any level with its search for repetitions, and the files are smaller.
    ok, data = cv2.imencode(".png", np.ascontiguousarray(pixels))
    if not ok:
        raise InputError("a picture could not be encoded as PNG")
    return data.tobytes()


def _camera(camera: PinholeCamera) -> bytes:
    return (json.dumps({name: getattr(camera, name) for name in ("fx", "fy", "cx", "cy")}) + "\n").encode()


def _npy(array: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=False)
    return buffer.getvalue()
