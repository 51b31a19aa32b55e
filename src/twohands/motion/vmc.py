"""VMC protocol over OSC: finger rotations for avatars, one bundle for each frame (docs/export.md, *Avatars*).

Frame: Unity's axes (left-handed: x right, y up, z forward), metres. Each bone has its place and rotation relative to
the bone before it; the hand's are relative to the root, which is the camera, as nobody knows the arm. A VRM avatar in
its T-pose has the identity everywhere. Bones are called as in Unity: LeftHand, LeftThumbProximal, ...
"""

from __future__ import annotations

import contextlib
from typing import Any, Final

import numpy as np

from twohands.errors import InputError
from twohands.geometry.quaternions import quaternions
from twohands.motion.clip import UPRIGHT_FROM_CAMERA
from twohands.motion.fit import FittedHand, HandSkeleton, fit_skeleton, pose_hand
from twohands.skeleton import FINGERS, SIDES, WRIST
from twohands.types import TwoHandPose

LEARNT_FRAMES: Final = 64
"""From so many frames of a clip the bones of a hand are fitted; then they stay."""
_PARTS: Final = ("Proximal", "Intermediate", "Distal")
_UNITY_FROM_UPRIGHT: Final = np.array([1.0, 1.0, -1.0])
_TURNED: Final = np.array([-1.0, -1.0, 1.0, 1.0])
"""Of a quaternion, where z changes its sign."""


def bone_names(side: int) -> dict[int, str]:
    """By joint: the bone that begins in it, as Unity and VRM 0 call it. Fingertips begin none."""
    word = SIDES[side].capitalize()
    names = {WRIST: f"{word}Hand"}
    for number, finger in enumerate(FINGERS):
        names |= {1 + 4 * number + i: f"{word}{finger.capitalize()}{part}" for i, part in enumerate(_PARTS)}
    return names


class SteadyBones:
    """A hand's skeleton while its clip goes on: fitted again after 1, 2, 4, ... LEARNT_FRAMES frames, then fixed.

    Args:
        side: LEFT or RIGHT.
    """

    def __init__(self, side: int) -> None:
        self._side = side
        self._seen: list[np.ndarray] = []
        self._skeleton: HandSkeleton | None = None

    def pose(self, joints_m: np.ndarray) -> FittedHand:
        """The fit of one more frame's joints (21, 3), camera frame, metres."""
        seen = joints_m @ UPRIGHT_FROM_CAMERA.T
        if len(self._seen) < LEARNT_FRAMES:
            self._seen.append(seen)
            count = len(self._seen)
            if self._skeleton is None or count & (count - 1) == 0:
                self._skeleton = fit_skeleton(np.stack(self._seen), self._side)
        assert self._skeleton is not None
        return pose_hand(self._skeleton, seen[None], np.zeros(1, int))


class VmcSender:
    """Sends both hands to a program that knows VMC. Nothing is waited for: what does not arrive is lost, as of UDP.

    Args:
        host, port: where the program listens.

    Raises:
        InputError: there is no such host.
        ModuleNotFoundError: python-osc, of the extra motion, is not installed.
    """

    def __init__(self, host: str, port: int) -> None:
        from pythonosc.udp_client import UDPClient

        try:
            self._client: Any = UDPClient(host, port)
        except (OSError, UnicodeError) as error:
            raise InputError(f"--osc {host}:{port}: {getattr(error, 'strerror', None) or error}") from None
        self.begin()

    def begin(self) -> None:
        """A new clip, perhaps with other hands."""
        self._bones = (SteadyBones(0), SteadyBones(1))

    def send(self, pose: TwoHandPose) -> None:
        """One frame; a hand that is not valid is left out."""
        fits = [
            bones.pose(hand.joints_m) if hand.valid and hand.joints_m is not None else None
            for bones, hand in zip(self._bones, pose.hands, strict=True)
        ]
        with contextlib.suppress(OSError):
            self._client.send(vmc_bundle(pose.time_s or 0.0, [fit for fit in fits if fit is not None]))


def vmc_bundle(time_s: float, hands: list[FittedHand]) -> Any:
    """One frame's bundle.

    Args:
        time_s: the frame's time, seconds.
        hands: fits of one frame each.
    """
    from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder
    from pythonosc.osc_message_builder import OscMessageBuilder

    bundle = OscBundleBuilder(IMMEDIATELY)

    def add(address: str, *values: int | float | str) -> None:
        message = OscMessageBuilder(address)
        for value in values:
            message.add_arg(value, "i" if isinstance(value, int) else "f" if isinstance(value, float) else "s")
        bundle.add_content(message.build())

    add("/VMC/Ext/OK", 1)
    add("/VMC/Ext/T", float(time_s))
    add("/VMC/Ext/Root/Pos", "root", 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    for hand in hands:
        places = hand.skeleton.offsets_m * _UNITY_FROM_UPRIGHT
        places[WRIST] = hand.joints_m[0, WRIST] * _UNITY_FROM_UPRIGHT
        turns = quaternions(hand.local_turns_of())[0] * _TURNED
        for joint, name in bone_names(hand.skeleton.side).items():
            add("/VMC/Ext/Bone/Pos", name, *places[joint].tolist(), *turns[joint].tolist())
    return bundle.build()
