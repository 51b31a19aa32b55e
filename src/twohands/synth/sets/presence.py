"""Frames of whole people as a camera takes them: which hands can be seen at all is judged on the drawn picture."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import cv2
import numpy as np

from twohands.geometry.camera import project
from twohands.skeleton import PART_NAMES
from twohands.synth.render.motion_blur import blurred
from twohands.synth.scene.spec import SceneSpec
from twohands.synth.scene.views import quarter_turns
from twohands.types import RenderedFrame

LEAST_PIXELS: Final = 12
LEAST_SHARE: Final = 0.12
"""Of the hull of a hand's joints in the picture: a hand is hidden where less of it is seen than both."""


def taken(frame: RenderedFrame, scene: SceneSpec) -> RenderedFrame:
    """The frame of a scene as its camera takes it: of whole people, turned as they stand, hands that cannot be seen are
    absent, and moving arms blurred; of arms alone, the same."""
    if not scene.people:
        return frame
    return blurred(seen_hands(replace(frame, turns=quarter_turns(scene.view))), scene.motion)


def seen_hands(frame: RenderedFrame) -> RenderedFrame:
    """The frame with hands absent that things, the person or another hand hide, or that lie outside the picture.

    The labels, depth and amodal mask of an absent hand's arm are taken out; the arm stays in the picture.
    """
    present = frame.present.copy()
    first = np.array([1, 1 + len(PART_NAMES)])
    for side in np.flatnonzero(present):
        hand = cv2.inRange(frame.part_labels, int(first[side] + 1), int(first[side] + len(PART_NAMES) - 1))
        seen = cv2.countNonZero(hand)
        corner = [frame.camera.width, frame.camera.height]
        hull = cv2.convexHull(np.clip(project(frame.joints_m[side, 1:], frame.camera), 0, corner).astype(np.float32))
        present[side] = seen >= max(LEAST_PIXELS, LEAST_SHARE * cv2.contourArea(hull))
    labels, depth, amodal = frame.part_labels, frame.depth_m, frame.amodal
    for side in np.flatnonzero(~present):
        arm = (labels >= first[side]) & (labels < first[side] + len(PART_NAMES))
        labels, depth = np.where(arm, np.uint8(0), labels), np.where(arm, np.float32(0), depth)
    if amodal is not None:
        amodal = amodal & present[:, None, None]
    joints = np.where(present[:, None, None], frame.joints_m, np.nan)
    return replace(frame, present=present, part_labels=labels, depth_m=depth, amodal=amodal, joints_m=joints)
