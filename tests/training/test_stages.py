"""What PoseNet2D learns from hands whose depth is unknown."""

import dataclasses

import pytest
import torch
from tests.training.tiny import tiny_run

from twohands.geometry.heatmaps import encode_heatmaps
from twohands.models.pose_net_2d import PoseNet2D, PoseNet2DConfig
from twohands.training.pose_stages import Pose2DStage, believed_depth, heatmap_losses, heatmap_targets, read_out


def run_and_maps(depth: float, at_px: float = 0.0):
    """A stage, a batch of one hand with unknown depth, and maps that tell a depth, `at_px` beside the joints."""
    stage = Pose2DStage(tiny_run("pose_net_2d"))
    net = stage.net.config
    joints = torch.linspace(0.3, 0.7, 42).reshape(1, 21, 2) * net.crop_size
    z = torch.full((1, 21), depth)
    maps = encode_heatmaps(
        joints + at_px, crop_size=net.crop_size, map_size=net.map_size, sigma=net.sigma, z=z, cutoff=0.0
    )
    batch = {
        "joints_px": joints,
        "weight": torch.ones(1, 21),
        "canonical": torch.zeros(1, 21, 3),
        "canonical_weight": torch.zeros(1, 21),
    }
    return stage, batch, maps.clamp_min(1e-30).log()


@pytest.mark.parametrize("depth", [-1.0, 0.0, 0.7])
def test_the_spread_of_maps_tells_their_depth(depth):
    stage, _, logits = run_and_maps(depth)
    assert stage.net.config.activation == "softmax"
    assert (believed_depth(stage.net, logits) - depth).abs().max() < 0.02


@pytest.mark.parametrize("depth", [-1.0, 0.7])
def test_a_hand_of_unknown_depth_teaches_its_place_and_not_its_depth(depth):
    """Maps at the right place have no gradient whatever depth they tell; a labelled depth of 0 would change them."""
    stage, batch, logits = run_and_maps(depth)

    def slope(batch, logits) -> float:
        logits = logits.clone().requires_grad_()
        config = dataclasses.replace(stage.config, loss=dataclasses.replace(stage.config.loss, soft_argmax=0.0))
        heatmap_losses(stage.net, [logits], batch, config)["heatmap"].backward()
        assert logits.grad is not None
        return float(logits.grad.abs().sum())

    known = batch | {"canonical_weight": torch.ones(1, 21)}
    beside = run_and_maps(depth, at_px=6.0)[2]
    assert slope(batch, logits) < 0.03
    assert slope(known, logits) > 10 * slope(batch, logits)
    assert slope(batch, beside) > 10 * slope(batch, logits)


def test_targets_of_a_crop_with_surroundings_are_read_where_the_joints_are():
    """Maps of the middle 64 of 128 pixels: joints in it come back in pixels of the whole crop."""
    shape = PoseNet2DConfig("mediapipe-hands", 128, stages=1, activation="softmax", sigma=1.5, surround=32)
    run = tiny_run("pose_net_2d")
    run = dataclasses.replace(run, networks=dataclasses.replace(run.networks, pose_net_2d=shape))
    joints = torch.linspace(48, 80, 42).reshape(1, 21, 2)
    known = {"joints_px": joints, "canonical": torch.zeros(1, 21, 3), "canonical_weight": torch.ones(1, 21)}
    maps = heatmap_targets(known, run)
    assert maps.shape == (1, 21, 16, 16)
    torch.testing.assert_close(read_out(PoseNet2D(shape), maps), joints, atol=0.05, rtol=0)
