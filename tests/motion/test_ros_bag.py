"""Bags, read back by rosbags and by mcap-ros2-support: the clip's joints, cameras and times."""

import numpy as np
import pytest
from tests.motion.moving import moving_hands, turn_about

pytest.importorskip("rosbags")

from twohands.errors import InputError
from twohands.geometry.quaternions import rotations
from twohands.motion.clip import HandMotion
from twohands.motion.fit import fit_motion
from twohands.motion.ros_bag import CAMERA_FRAME, CAMERA_TOPIC, frame_name, write_bag
from twohands.types import PinholeCamera

TIMES = np.array([2.0, 2.033333, 2.1, 1000000.000001])


def clip():
    valid = np.array([[True, True], [False, True], [False, False], [True, False]])
    return moving_hands(4, valid=valid, times=TIMES)


def point(vector) -> list[float]:
    return [vector.x, vector.y, vector.z]


def turn(quaternion) -> np.ndarray:
    return rotations(np.array([quaternion.x, quaternion.y, quaternion.z, quaternion.w]))


def read_by_rosbags(folder):
    """(topic, nanoseconds, message) of each message."""
    from rosbags.highlevel import AnyReader

    with AnyReader([folder]) as bag:
        return [(link.topic, time, bag.deserialize(raw, link.msgtype)) for link, time, raw in bag.messages()]


def read_by_mcap(folder):
    reader = pytest.importorskip("mcap_ros2.reader")
    (file,) = folder.glob("*.mcap")
    return [(m.channel.topic, m.log_time_ns, m.ros_msg) for m in reader.read_ros2_messages(str(file))]


@pytest.mark.parametrize("read", [read_by_rosbags, read_by_mcap])
def test_the_clip_comes_back(tmp_path, read):
    motion = clip()
    write_bag(motion, fit_motion(motion), tmp_path / "bag")
    messages = read(tmp_path / "bag")
    topics = [topic for topic, *_ in messages]
    counts = {topic: topics.count(topic) for topic in set(topics)}
    assert counts == {CAMERA_TOPIC: 4, "/hands/left": 2, "/hands/right": 2, "/tf": 3}
    nanoseconds = [2_000_000_000, 2_033_333_000, 2_100_000_000, 1_000_000_000_001_000]
    for topic, time, message in messages:
        row = nanoseconds.index(time)
        header = message.transforms[0].header if topic == "/tf" else message.header
        assert header.stamp.sec * 10**9 + header.stamp.nanosec == time and header.frame_id == CAMERA_FRAME
        if topic.startswith("/hands"):
            side = int(topic == "/hands/right")
            np.testing.assert_allclose(
                [point(p.position) for p in message.poses], motion.joints_m[row, side], atol=1e-12
            )
        elif topic == "/tf":
            placed = {t.child_frame_id: point(t.transform.translation) for t in message.transforms}
            assert len(placed) == 21 * motion.valid[row].sum()
            for side in np.flatnonzero(motion.valid[row]):
                for joint in range(21):
                    np.testing.assert_allclose(
                        placed[frame_name(side, joint)], motion.joints_m[row, side, joint], atol=1e-12
                    )


def test_cameras_count_from_the_first_pixel_s_middle(tmp_path):
    camera = PinholeCamera(500.0, 510.0, 320.0, 250.0, 640, 480, (0.1, -0.2, 0.001, 0.002))
    motion = moving_hands(1)
    motion = HandMotion(motion.time_s, motion.index, motion.joints_m, motion.valid, camera, "")
    write_bag(motion, fit_motion(motion), tmp_path / "bag")
    (info,) = (message for topic, _, message in read_by_rosbags(tmp_path / "bag") if topic == CAMERA_TOPIC)
    assert (info.width, info.height, info.distortion_model) == (640, 480, "plumb_bob")
    np.testing.assert_array_equal(info.k, [500, 0, 319.5, 0, 510, 249.5, 0, 0, 1])
    np.testing.assert_array_equal(info.p, [500, 0, 319.5, 0, 0, 510, 249.5, 0, 0, 0, 1, 0])
    np.testing.assert_array_equal(info.d, [0.1, -0.2, 0.001, 0.002, 0])


def test_orientations_are_those_of_ros(tmp_path):
    """Of a flat left hand before the camera, fingers up, thumb right: we see its back. x up, z towards the camera."""
    hand = np.zeros((21, 3))
    for base, x in ((5, 0.03), (9, 0.0), (13, -0.02), (17, -0.04)):
        hand[base : base + 4] = [[x, -0.1 - 0.03 * i, 0] for i in range(4)]
    hand[1:5] = [[0.03 + 0.02 * i, -0.03 - 0.02 * i, 0] for i in range(4)]
    hand += [0.0, 0.0, 0.5]
    motion = HandMotion(
        np.zeros(1), np.zeros(1, int), np.stack([hand, np.full((21, 3), np.nan)])[None], np.array([[True, False]]),
        moving_hands(1).camera, "",
    )  # fmt: skip
    write_bag(motion, fit_motion(motion), tmp_path / "bag")
    (message,) = (message for topic, _, message in read_by_rosbags(tmp_path / "bag") if topic == "/hands/left")
    for joint in (0, 5, 10, 20):
        x, y, z = turn(message.poses[joint].orientation).T
        np.testing.assert_allclose([x, z], [[0, -1, 0], [0, 0, -1]], atol=1e-9)
        np.testing.assert_allclose(y, np.cross(z, x), atol=1e-9)
    thumb = turn(message.poses[2].orientation)[:, 0]
    np.testing.assert_allclose(thumb, np.array([1, -1, 0]) / np.sqrt(2), atol=1e-9)


def test_orientations_turn_with_the_hand(tmp_path):
    motion = moving_hands(1)
    rotation = turn_about(np.array([1.0, 2.0, 3.0]), 0.8)
    turned = HandMotion(
        motion.time_s, motion.index, motion.joints_m @ rotation.T, motion.valid, motion.camera, motion.source
    )
    found = []
    for name, each in (("a", motion), ("b", turned)):
        write_bag(each, fit_motion(each), tmp_path / name)
        (tf,) = (message for topic, _, message in read_by_rosbags(tmp_path / name) if topic == "/tf")
        found.append([turn(t.transform.rotation) for t in tf.transforms])
    np.testing.assert_allclose(found[1], rotation @ np.array(found[0]), atol=1e-9)


def test_times_before_the_epoch_are_refused(tmp_path):
    motion = moving_hands(2, times=np.array([-1.0, 0.0]))
    with pytest.raises(InputError, match=r"times of a bag lie between 0 and 2147483647 s, found \[-1\.0, 0\.0\]"):
        write_bag(motion, fit_motion(motion), tmp_path / "bag")
    assert not (tmp_path / "bag").exists()
