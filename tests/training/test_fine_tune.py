"""The plan of a fine-tuning: scenes of the given camera, runs that go on from the given weights."""

from pathlib import Path

import numpy as np
import pytest
from tests.training.tiny import NETWORKS

from twohands.errors import InputError
from twohands.synth.scene.config import SynthConfig
from twohands.synth.scene.sampling import sample_camera
from twohands.training.fine_tune import SHARES, fine_tuning_run, frame_count, scenes_for
from twohands.types import PinholeCamera


@pytest.mark.parametrize(
    ("camera", "size"),
    [
        (PinholeCamera(520, 521, 322.5, 238, 640, 480), (480, 360)),
        (PinholeCamera(1400, 1410, 530, 980, 1080, 1920), (270, 480)),
    ],
)
def test_every_scene_is_taken_by_the_camera(camera, size):
    config = scenes_for(camera)
    assert (config.width, config.height) == size
    for seed in range(20):
        taken, _ = sample_camera(config, np.random.default_rng(seed))
        back = taken.resized(camera.width, camera.height)
        for name in ("fx", "fy", "cx", "cy"):
            assert getattr(back, name) == pytest.approx(getattr(camera, name))


def test_intrinsics_exclude_drawn_ones():
    with pytest.raises(InputError, match="fov must be None"):
        SynthConfig(intrinsics=(500.0, 500.0, 480.0, 270.0), fov=(50.0, 60.0))
    with pytest.raises(InputError):
        SynthConfig(intrinsics=(-500.0, 500.0, 480.0, 270.0))


def test_the_runs_share_the_minutes_and_the_pose_stage_sees_the_new_masks():
    runs = {stage: fine_tuning_run(stage, NETWORKS, 20.0, Path("frames"), Path("seg")) for stage in SHARES}
    assert list(runs) == ["hand_seg_net", "pose_net_3d"]
    assert sum(run.max_minutes for run in runs.values()) == pytest.approx(20.0)
    assert [run.data.segmentation for run in runs.values()] == ["", "seg"]
    assert all(run.networks is NETWORKS and run.data.source == "frames" for run in runs.values())
    assert runs["pose_net_3d"].optim.along_rate > 0  # trains PoseNet2D along


def test_frames_grow_with_the_minutes():
    assert (frame_count(0.1), frame_count(30)) == (40, 3000)
