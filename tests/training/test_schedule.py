"""Learning rates and averaged weights against hand-computed values."""

import copy
import dataclasses

import pytest
import torch
from torch import nn

from twohands.errors import InputError
from twohands.training.config import OptimConfig, TrainConfig, recipe, with_override
from twohands.training.schedule import learning_rate, progress, update_average


def test_the_paper_halves_every_5000_iterations():
    optim = recipe("paper", "hand_seg_net").optim
    rates = [learning_rate(optim, i, 0.0) for i in (0, 4999, 5000, 9999, 10000, 29999)]
    assert rates == [1e-3, 1e-3, 5e-4, 5e-4, 2.5e-4, 1e-3 / 32]


def test_cosine_warms_up_and_falls_to_a_hundredth():
    optim = OptimConfig(schedule="cosine", learning_rate=1.0, warm_up=10)
    assert learning_rate(optim, 0, 0.0) == pytest.approx(0.1)
    assert learning_rate(optim, 9, 0.0) == pytest.approx(1.0)
    assert learning_rate(optim, 500, 0.5) == pytest.approx(0.505)
    assert learning_rate(optim, 1000, 1.0) == pytest.approx(0.01)


def test_progress_follows_whatever_ends_first():
    config = TrainConfig(iterations=100, max_minutes=10)
    assert progress(config, 20, 60) == pytest.approx(0.2)
    assert progress(config, 20, 300) == pytest.approx(0.5)
    assert progress(config, 20, 6000) == 1.0
    assert progress(dataclasses.replace(config, max_minutes=0), 20, 6000) == pytest.approx(0.2)


def test_average_moves_by_the_ramped_rate_and_copies_counters():
    average, model = nn.BatchNorm1d(2), nn.BatchNorm1d(2)
    nn.init.constant_(average.weight, 0.0)
    nn.init.constant_(model.weight, 1.0)
    model.num_batches_tracked += 5
    model.running_mean += 10
    update_average(average, model, decay=0.9, iteration=0)  # decay min(0.9, 1/10)
    assert torch.allclose(average.weight, torch.tensor(0.9))
    assert torch.allclose(average.running_mean, torch.tensor(9.0))
    assert average.num_batches_tracked == 5
    update_average(average, model, decay=0.9, iteration=10**6)
    assert torch.allclose(average.weight, torch.tensor(0.9 + 0.1 * 0.1))


def test_average_of_a_constant_is_the_constant():
    model = nn.Linear(3, 3)
    average = copy.deepcopy(model)
    for step in range(5):
        update_average(average, model, 0.99, step)
    assert torch.equal(average.weight, model.weight)


@pytest.mark.parametrize(
    ("stage", "iterations", "decay"),
    [("hand_seg_net", 30000, 0.0), ("pose_net_2d", 15000, 0.0), ("pose_net_3d", 15000, 5e-4)],
)
def test_the_paper_recipe(stage, iterations, decay):
    """The paper's supplement, number by number."""
    config = recipe("paper", stage)
    assert (config.iterations, config.batch_images, config.max_minutes) == (iterations, 4, 0)
    optim = config.optim
    assert (optim.optimizer, optim.learning_rate, optim.weight_decay, optim.ema) == ("adam", 1e-3, decay, 0.0)
    assert (config.loss.heatmap, config.loss.joint_norm, config.loss.z_heatmaps) == ("mse", "mse", True)
    assert (config.loss.energy, config.loss.joint, config.loss.bone, config.loss.projection) == (1, 1, 1, 1)
    assert optim.along_rate == 0
    net = config.networks.pose_net_2d
    assert (net.variant, net.crop_size, net.stages, net.width, net.batch_norm) == ("cpm9", 256, 6, 1.0, True)
    assert config.crop.kind == "square"


def test_our_recipe_fits_together():
    config = recipe("ours", "pose_net_3d")
    assert config.networks.pose_net_2d.activation == "softmax" and config.loss.heatmap == "cross-entropy"
    assert config.optim.along_rate > 0 and config.loss.heatmap_along > 0
    assert config.optim.optimizer == "muon"


def test_overrides():
    config = recipe("ours", "hand_seg_net")
    changed = with_override(config, "optim.learning_rate=5e-4")
    assert changed.optim.learning_rate == 5e-4
    assert dataclasses.replace(changed, optim=config.optim) == config
    assert with_override(config, "loss.z_heatmaps=false").loss.z_heatmaps is False
    assert with_override(config, "precision=32-true").precision == "32-true"


@pytest.mark.parametrize(
    "assignments",
    [("networks.pose_net_2d.activation=linear", "loss.heatmap=mse"), ("crop.smallest=1.1", "crop.largest=1.3")],
)
def test_overrides_that_only_fit_together_come_in_any_order(assignments):
    """Named case: the first was refused before the second was read."""
    config = recipe("ours", "pose_net_2d")
    changed = with_override(config, *assignments)
    assert changed == with_override(config, *reversed(assignments)) != config
    with pytest.raises(InputError):
        with_override(config, assignments[0])


def test_the_last_override_of_a_name_counts():
    config = recipe("ours", "pose_net_2d")
    assert with_override(config, "iterations=3", "crop.roll=5", "iterations=7").iterations == 7
    assert with_override(config) == config


@pytest.mark.parametrize(
    ("assignment", "message"),
    [
        ("optim.speed=1", "unknown setting 'optim.speed'"),
        ("optim=1", "group of settings"),
        ("iterations", "NAME=VALUE"),
        ("iterations=many", "needs a value of type int, got 'many'"),
        ("loss.z_heatmaps=perhaps", "type bool"),
        ("networks.hand_seg_net.height=100", "multiple of 32, got 100"),
        ("optim.optimizer=lion", "lion"),
        ("precision=16", "16"),
    ],
)
def test_bad_overrides_are_refused(assignment, message):
    with pytest.raises(InputError, match=message):
        with_override(recipe("ours", "hand_seg_net"), assignment)


def test_losses_and_maps_must_fit():
    with pytest.raises(InputError, match="cross-entropy with softmax"):
        with_override(recipe("ours", "pose_net_2d"), "loss.heatmap=mse")


def test_unknown_names():
    with pytest.raises(InputError, match="pose_net_4d"):
        recipe("ours", "pose_net_4d")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="theirs"):
        recipe("theirs", "pose_net_2d")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="depth"):
        TrainConfig.from_dict({"depth": 3})
