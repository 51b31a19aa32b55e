"""BVH files, read back by others: the fitted skeleton, to 1e-4 m."""

import dataclasses
import json
import math
import os
import subprocess
import sys

import numpy as np
import pytest
from tests.builders import random_rotations
from tests.motion.moving import moving_hands, turn_about

from twohands.motion.bvh import angles_zyx, bvh_text, joint_names
from twohands.motion.fit import fit_motion

TOLERANCE_M = 1e-4


def noisy_motion(**options):
    """Bones vary by some per cent, as those of estimates do."""
    motion = moving_hands(30, **options)
    motion.joints_m[:] += np.random.default_rng(0).normal(0, 0.002, motion.joints_m.shape)
    return motion


def test_angles_make_the_rotation_again():
    turns = random_rotations(300, np.random.default_rng(0))
    straight_up = turn_about(np.array([0, 1.0, 0]), math.pi / 2)
    turns = np.concatenate([turns, [np.eye(3), straight_up, straight_up.T, straight_up @ turns[0] @ straight_up]])
    for turn, (z, y, x) in zip(turns, angles_zyx(turns), strict=True):
        about_z, about_y, about_x = (turn_about(np.eye(3)[axis], angle) for axis, angle in ((2, z), (1, y), (0, x)))
        np.testing.assert_allclose(about_z @ about_y @ about_x, turn, atol=1e-9)


def test_names():
    names = joint_names(0)
    assert len(names) == 21
    assert (names[0], names[1], names[6], names[19]) == (
        "LeftHand",
        "LeftHandThumb1",
        "LeftHandIndex2",
        "LeftHandPinky3",
    )


def test_pybvh_reads_the_fitted_skeleton(tmp_path):
    pybvh = pytest.importorskip("pybvh")
    motion = noisy_motion()
    for side, hand in fit_motion(motion).items():
        text, times = bvh_text(motion, hand)
        path = tmp_path / "hand.bvh"
        path.write_text(text)
        read = pybvh.read_bvh_file(path)
        assert read.frame_count == 30 and read.frame_time == pytest.approx(1 / 30) and not times.still.any()
        found = read.node_positions()
        names = [node.name for node in read.nodes]
        ours = joint_names(side)
        order = [names.index(n) if n in names else names.index(f"EndSite{ours[j - 1]}") for j, n in enumerate(ours)]
        assert np.abs(found[:, order] - hand.joints_m).max() < TOLERANCE_M


def test_a_hand_that_is_away_stands_still_in_the_file():
    valid = np.ones((30, 2), bool)
    valid[10:20, 0] = False
    motion = noisy_motion(valid=valid)
    text, times = bvh_text(motion, fit_motion(motion)[0])
    rows = text.split("MOTION\n")[1].splitlines()[2:]
    assert len(rows) == 30 and times.still.sum() == 10
    assert len(set(rows[9:20])) == 1 and rows[20] != rows[19]


def test_dropped_frames_are_filled_on_the_way():
    """Two frames missing: the wrist is half-way there, and all other frames are as without a gap."""
    kept = np.delete(np.arange(30), [7, 20])
    whole = moving_hands(30)
    part = dataclasses.replace(
        whole, **{name: getattr(whole, name)[kept] for name in ("time_s", "index", "joints_m", "valid")}
    )
    hand = fit_motion(part)[1]
    text, times = bvh_text(part, hand)
    rows = np.loadtxt(text.split("MOTION\n")[1].splitlines()[2:])
    assert len(rows) == 30 and not times.still.any()
    np.testing.assert_allclose(rows[kept, :3], hand.joints_m[:, 0], atol=1e-5)
    np.testing.assert_allclose(rows[7, :3], (rows[6, :3] + rows[8, :3]) / 2, atol=1e-5)


BLENDER = """
import json, sys
import bpy
bpy.ops.import_anim.bvh(filepath=sys.argv[1], axis_forward="Y", axis_up="Z", rotate_mode="NATIVE")
rig = bpy.context.object
frames = []
for frame in range(1, int(sys.argv[2]) + 1):
    bpy.context.scene.frame_set(frame)
    world = rig.matrix_world
    frames.append({bone.name: [list(world @ bone.head), list(world @ bone.tail)] for bone in rig.pose.bones})
print("FOUND" + json.dumps(frames))
"""


@pytest.mark.slow
def test_blender_reads_the_fitted_skeleton(tmp_path):
    python = os.environ.get("BLENDER_PYTHON", sys.executable)
    asked = "import importlib.util, sys; sys.exit(importlib.util.find_spec('bpy') is None)"
    if subprocess.run([python, "-c", asked]).returncode:
        pytest.skip("no Blender here (extra blender, Python 3.11); BLENDER_PYTHON may name an interpreter that has it")
    motion = noisy_motion()
    hand = fit_motion(motion)[0]
    path = tmp_path / "hand.bvh"
    path.write_text(bvh_text(motion, hand)[0])
    script = tmp_path / "read.py"
    script.write_text(BLENDER)
    said = subprocess.run([python, str(script), str(path), "30"], capture_output=True, text=True, check=True).stdout
    frames = json.loads(said.split("FOUND")[1].splitlines()[0])
    for frame, bones in enumerate(frames):
        for joint, name in enumerate(joint_names(0)):
            if joint == 0 or joint % 4:
                np.testing.assert_allclose(bones[name][0], hand.joints_m[frame, joint], atol=TOLERANCE_M)
            else:  # a fingertip is where its bone ends
                tail = bones[joint_names(0)[joint - 1]][1]
                np.testing.assert_allclose(tail, hand.joints_m[frame, joint], atol=TOLERANCE_M)
