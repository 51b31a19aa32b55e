"""Hands that leave a video's picture are carried on for a moment after the networks have lost sight of them.

Of a hand that leaves, the last frame or two show no more than a wrist or a finger tip, too little for any network; but
where it was going is known from the frames before. Ours; the paper's videos show both hands throughout.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

import numpy as np

from twohands.geometry.boxes import box_in_picture, inside_picture
from twohands.geometry.camera import unproject
from twohands.geometry.rotation import centring_angles
from twohands.skeleton import ROOT
from twohands.types import HandPose, PinholeCamera

CARRIED_FRAMES = 1
"""So many frames a hand is carried on. In 2,000 frames of generated video, not trained or tested on, one frame brings
the hands that preset `fast` misses from 35 to 24 and those that it invents from 6 to 8, three frames to 20 and 14."""
VELOCITY_FRAMES = 3
"""Its velocity is the mean over so many frames, or as many as there are."""
LONGEST_STEP = 1.5
"""A step in time of more than so many times the one before is a pause, over which no hand is carried."""


class LeavingHand:
    """One hand over video.

    State: when and where it was last found, in frames of one camera that follow each other without a pause; for how
    many frames it has been carried since.

    Args:
        frames: for how many frames it is carried at most; 0 for never.
    """

    def __init__(self, frames: int = CARRIED_FRAMES) -> None:
        self._frames = frames
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._seen: deque[tuple[float, HandPose]] = deque(maxlen=VELOCITY_FRAMES + 1)
        self._carried = 0
        self._camera: PinholeCamera | None = None

    def update(self, hand: HandPose, time: float, camera: PinholeCamera) -> HandPose:
        """Take one frame.

        Args:
            hand: as the estimator gives it.
            time: of this frame, later than the last one's, any unit.
            camera: of this frame.

        Returns:
            The same hand. If it is absent, was found in at least two frames before and, at the velocity of its joints
            in the picture, is leaving it, with joints on either side of the border: as last found, with `joints_px`,
            `box_px`, `theta_deg` and `phi_deg` carried on to this frame, and no range: `valid` is False.
        """
        if (self._carried and hand.present) or camera != self._camera or self._pausing(time):
            self.reset()
        self._camera = camera
        if hand.present and hand.joints_px is not None:
            self._seen.append((time, hand))
            return hand
        carried = None
        if not hand.present and self._carried < self._frames:
            carried = self._carry(time, camera)
        if carried is None:
            self.reset()
            return hand
        self._carried += 1
        return carried

    def _pausing(self, time: float) -> bool:
        """Whether this frame comes much later than the frames before let expect."""
        if len(self._seen) < 2:
            return False
        before, last = self._seen[-2][0], self._seen[-1][0]
        return time - last > LONGEST_STEP * (last - before) * (1 + self._carried)

    def _carry(self, time: float, camera: PinholeCamera) -> HandPose | None:
        """The hand at this time; None where it is not leaving the picture or cannot be carried."""
        if len(self._seen) < 2:
            return None
        (start, first), (end, last) = self._seen[0], self._seen[-1]
        assert first.joints_px is not None and last.joints_px is not None
        velocity = (last.joints_px - first.joints_px).mean(axis=0) / (end - start)
        joints_px = last.joints_px + velocity * (time - end)
        inside = inside_picture(joints_px, camera.width, camera.height)
        theta, phi = (math.degrees(angle) for angle in centring_angles(unproject(joints_px[ROOT], camera)))
        if inside.all() or not inside.any() or not math.isfinite(theta + phi):
            return None
        box_px = np.asarray(box_in_picture(joints_px, camera.width, camera.height))
        return replace(
            last,
            box_px=box_px,
            joints_px=joints_px,
            joints_m=None,
            range_m=None,
            range_sigma_m=None,
            theta_deg=theta,
            phi_deg=phi,
            method=None,
            valid=False,
        )
