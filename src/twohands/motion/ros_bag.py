"""A ROS 2 bag, MCAP storage: /tf, a PoseArray of each hand, and CameraInfo, at the frames' own times. Needs no ROS.

Frame: ROS' optical frame, which is our camera frame (x right, y down, z forward), metres. The orientation of a joint is
that of the fitted bone that begins in it, as ROS has bodies: x along the bone, z out of the back of the hand (of the
thumb, its nail), y to complete them. Positions are the clip's own. A hand that is not valid has no message.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from twohands.errors import InputError
from twohands.geometry.quaternions import quaternions
from twohands.motion.clip import UPRIGHT_FROM_CAMERA, HandMotion
from twohands.motion.fit import FittedHand
from twohands.skeleton import JOINT_NAMES, N_JOINTS, SIDES
from twohands.types import PinholeCamera

CAMERA_FRAME: Final = "camera_optical_frame"
CAMERA_TOPIC: Final = "/camera/camera_info"
_TF, _POSES, _INFO = "tf2_msgs/msg/TFMessage", "geometry_msgs/msg/PoseArray", "sensor_msgs/msg/CameraInfo"
_ROS_FROM_BONE: Final = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""Columns: where ROS' x, y and z lie among a bone's along, nail and hinge."""
_MOST_SECONDS: Final = (1 << 31) - 1
"""Of a ROS time."""


def hand_topic(side: int) -> str:
    """Where the PoseArrays of a hand go."""
    return f"/hands/{SIDES[side]}"


def frame_name(side: int, joint: int) -> str:
    """Of a joint in /tf: left_wrist, left_thumb_1, ..."""
    return f"{SIDES[side]}_{JOINT_NAMES[joint]}"


def write_bag(motion: HandMotion, fitted: Mapping[int, FittedHand], folder: Path) -> None:
    """Writes a bag.

    Args:
        motion: the clip.
        fitted: `fit_motion` of it.
        folder: the bag; does not exist.

    Raises:
        InputError: a time is before the epoch, or later than ROS can say.
        ModuleNotFoundError: rosbags, of the extra motion, is not installed.
        OSError: it cannot be written.
    """
    if not (motion.time_s[0] >= 0 and motion.time_s[-1] <= _MOST_SECONDS):
        raise InputError(f"times of a bag lie between 0 and {_MOST_SECONDS} s, found {motion.time_s[[0, -1]].tolist()}")
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    messages = _Messages(store.types)
    turns = {side: quaternions(_ros_turns(hand)) for side, hand in fitted.items()}
    row_of = {side: {int(row): n for n, row in enumerate(hand.rows)} for side, hand in fitted.items()}
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        topics = {"/tf": _TF, CAMERA_TOPIC: _INFO} | {hand_topic(side): _POSES for side in fitted}
        links = {topic: bag.add_connection(topic, kind, typestore=store) for topic, kind in topics.items()}

        def write(topic: str, nanoseconds: int, message: Any) -> None:
            bag.write(links[topic], nanoseconds, store.serialize_cdr(message, topics[topic]))

        for row, time_s in enumerate(motion.time_s):
            nanoseconds = round(float(time_s) * 1e9)
            stamp = messages.stamp(nanoseconds)
            write(CAMERA_TOPIC, nanoseconds, messages.camera_info(stamp, motion.camera))
            transforms = []
            for side in fitted:
                if row in row_of[side]:
                    places, turned = motion.joints_m[row, side], turns[side][row_of[side][row]]
                    write(hand_topic(side), nanoseconds, messages.poses(stamp, places, turned))
                    transforms += messages.transforms(stamp, side, places, turned)
            if transforms:
                write("/tf", nanoseconds, messages.types[_TF](transforms=transforms))


def _ros_turns(hand: FittedHand) -> np.ndarray:
    """(N, 21, 3, 3) from ROS' axes of each bone to the camera frame."""
    return UPRIGHT_FROM_CAMERA.T @ hand.turns @ hand.skeleton.frames @ _ROS_FROM_BONE


class _Messages:
    """Builds ROS messages of plain numbers.

    Args:
        types: message classes by name.
    """

    def __init__(self, types: Mapping[str, Any]) -> None:
        self.types = types
        self._vector, self._point = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Point"]
        self._quaternion = types["geometry_msgs/msg/Quaternion"]

    def stamp(self, nanoseconds: int) -> Any:
        seconds, rest = divmod(nanoseconds, 1_000_000_000)
        return self.types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=rest)

    def poses(self, stamp: Any, places: np.ndarray, turns: np.ndarray) -> Any:
        """PoseArray of a hand's joints (21, 3) and quaternions (21, 4)."""
        pose = self.types["geometry_msgs/msg/Pose"]
        several = [
            pose(position=self._point(*place), orientation=self._quaternion(*turn))
            for place, turn in zip(places.tolist(), turns.tolist(), strict=True)
        ]
        return self.types[_POSES](header=self._header(stamp), poses=several)

    def transforms(self, stamp: Any, side: int, places: np.ndarray, turns: np.ndarray) -> list[Any]:
        """TransformStamped of each joint, from the camera."""
        stamped, transform = self.types["geometry_msgs/msg/TransformStamped"], self.types["geometry_msgs/msg/Transform"]
        return [
            stamped(
                header=self._header(stamp),
                child_frame_id=frame_name(side, joint),
                transform=transform(
                    translation=self._vector(*places[joint].tolist()),
                    rotation=self._quaternion(*turns[joint].tolist()),
                ),
            )
            for joint in range(N_JOINTS)
        ]

    def camera_info(self, stamp: Any, camera: PinholeCamera) -> Any:
        """Intrinsics as ROS counts them: from the middle of the first pixel."""
        matrix = np.array([[camera.fx, 0, camera.cx - 0.5], [0, camera.fy, camera.cy - 0.5], [0, 0, 1]])
        coefficients = np.zeros(8 if len(camera.distortion) == 8 else 5)
        coefficients[: len(camera.distortion)] = camera.distortion
        region = self.types["sensor_msgs/msg/RegionOfInterest"](
            x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
        )
        return self.types[_INFO](
            header=self._header(stamp),
            height=int(camera.height),
            width=int(camera.width),
            distortion_model="rational_polynomial" if len(camera.distortion) == 8 else "plumb_bob",
            d=coefficients,
            k=matrix.reshape(-1),
            r=np.eye(3).reshape(-1),
            p=np.concatenate([matrix, np.zeros((3, 1))], axis=1).reshape(-1),
            binning_x=0,
            binning_y=0,
            roi=region,
        )

    def _header(self, stamp: Any) -> Any:
        return self.types["std_msgs/msg/Header"](stamp=stamp, frame_id=CAMERA_FRAME)
