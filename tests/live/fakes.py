"""An estimator without networks, and a server of it in a thread."""

from __future__ import annotations

import contextlib
import struct
import threading
from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np

from twohands.formats.profiles import IntrinsicsSource
from twohands.geometry.projection import project_global
from twohands.live.clip import LiveClip
from twohands.live.door import Door
from twohands.live.messages import Settings
from twohands.live.server import LiveServer, listen
from twohands.types import HandPose, PinholeCamera, TwoHandPose

IMAGE = np.full((48, 64, 3), 90, np.uint8)


def estimate(image, camera, hand_length_m, *, index=0, time_s=None, previous=None) -> TwoHandPose:
    """One left hand, whose score is the grey of the picture's left edge, and no right one."""
    joints_m = np.tile([0.0, 0.0, 5 * hand_length_m], (21, 1)) + np.arange(21)[:, None] / 1000
    hand = HandPose(
        present=True,
        score=float(image[:, 0].mean()) / 255,
        box_px=np.array([8.0, 8.0, 40.0, 40.0]),
        joints_px=np.linspace(10, 30, 42).reshape(21, 2),
        joint_scores=np.ones(21),
        canonical=np.zeros((21, 3)),
        joints_m=joints_m,
        range_m=float(np.linalg.norm(joints_m[9])),
        theta_deg=0.0,
        phi_deg=0.0,
        key_bone="wrist",
        method="fitted",
        valid=True,
    )
    return TwoHandPose(hand, HandPose(False), camera, index=index, time_s=time_s)


def seen_hand(range_m: float | None, sigma_m: float | None = None):
    """An estimator of a left hand in the middle of the picture, which is at that range if it has 10 cm and the
    field of view is 60 degrees; None for no hand."""
    canonical = np.random.default_rng(6).uniform(-0.7, 0.7, (21, 3)) * [1, 1, 0.02]
    canonical[9], canonical[0] = 0, (0, 1, 0)
    told = camera_for(None, IMAGE.shape[1], IMAGE.shape[0])[0]
    absent = HandPose(False)
    pixels = [told.cx, told.cy] + told.fx * canonical[:, :2] * 0.1 / ((range_m or 1) + 0.1 * canonical[:, 2:])

    def of(image, camera, hand_length_m, *, index=0, time_s=None, previous=None) -> TwoHandPose:
        if range_m is None:
            return TwoHandPose(absent, absent, camera, index=index, time_s=time_s)
        placed = project_global(canonical, pixels, camera, hand_length_m)
        hand = HandPose(
            present=True,
            score=1.0,
            box_px=np.array([8.0, 8.0, 40.0, 40.0]),
            joints_px=pixels,
            joint_scores=np.ones(21),
            canonical=canonical,
            joints_m=np.asarray(placed.joints_m),
            range_m=float(placed.radius_m),
            theta_deg=0.0,
            phi_deg=0.0,
            key_bone="wrist",
            method="fitted",
            valid=True,
            range_sigma_m=sigma_m,
        )
        return TwoHandPose(hand, absent, camera, index=index, time_s=time_s)

    return of


def camera_for(fov_deg: float | None, width: int, height: int) -> tuple[PinholeCamera, IntrinsicsSource]:
    return PinholeCamera.from_fov(fov_deg or 60.0, width, height), "assumed" if fov_deg is None else "fov"


def make_clip(estimate=estimate) -> LiveClip:
    return LiveClip(estimate, camera_for, "fake", {"config": None}, Settings("stream", 0.1))


@contextlib.contextmanager
def serving(
    clip: LiveClip | None = None,
    camera: Any = None,
    page: tuple[str, str] = ("<!doctype html>page", "default-src 'none'"),
    **door: Any,
) -> Iterator[int]:
    """A server of a page and its policy on a free port of this machine; gives the port."""
    with listen("127.0.0.1", 0) as listening:
        port = listening.getsockname()[1]
        server = LiveServer(clip or make_clip(), Door(port, **door), *page, camera)
        started = threading.Event()
        thread = threading.Thread(target=server.run, args=(listening, started.set), daemon=True)
        thread.start()
        try:
            assert started.wait(300)
            yield port
        finally:
            server.stop()
            thread.join(300)


def picture(time_s: float, image: np.ndarray = IMAGE) -> bytes:
    return struct.pack("<d", time_s) + cv2.imencode(".png", image)[1].tobytes()
