"""Losses against values worked out by hand."""

import math

import numpy as np
import pytest
import torch
from tests.builders import make_sample

from twohands.skeleton import BONES, LEFT, RIGHT, ROOT
from twohands.training import losses
from twohands.training.pose_targets import CropConfig, pose_target


def test_weighted_mean():
    assert losses.weighted_mean(torch.tensor([1.0, 2.0, 9.0]), torch.tensor([1.0, 1.0, 0.0])).item() == 1.5
    assert losses.weighted_mean(torch.tensor([1.0, 2.0]), torch.zeros(2)).item() == 0.0


def test_segmentation_loss_of_uniform_logits_is_log_3():
    classes = torch.randint(0, 3, (2, 4, 5))
    assert losses.segmentation_loss(torch.zeros(2, 3, 4, 5), classes).item() == pytest.approx(math.log(3))


def test_segmentation_loss_of_one_pixel():
    logits = torch.tensor([1.0, 2.0, 3.0]).view(1, 3, 1, 1)
    expected = math.log(math.e + math.e**2 + math.e**3) - 2
    assert losses.segmentation_loss(logits, torch.ones(1, 1, 1, dtype=torch.int64)).item() == pytest.approx(expected)


def test_energy_loss():
    # sigmoid(0) = 1/2 against 1 and 0, sigmoid(ln 3) = 3/4 against 1 and 0: (1/4 + 1/4 + 1/16 + 9/16) / 4 = 9/32
    logits = torch.tensor([0.0, 0.0, math.log(3), math.log(3)]).view(1, 2, 1, 2)
    target = torch.tensor([1.0, 0.0, 1.0, 0.0]).view(1, 2, 1, 2)
    assert losses.energy_loss(logits, target).item() == pytest.approx(9 / 32)


def test_energy_cross_entropy_has_its_least_value_at_the_target_and_no_vanishing_gradient():
    target = torch.full((1, 2, 1, 1), 0.75)
    entropy = -0.75 * math.log(0.75) - 0.25 * math.log(0.25)
    at_target = torch.full((1, 2, 1, 1), math.log(3))
    assert losses.energy_loss(at_target, target, "cross-entropy").item() == pytest.approx(entropy)
    slopes = {}
    for kind in ("mse", "cross-entropy"):
        far = torch.full((1, 2, 1, 1), -10.0, requires_grad=True)
        losses.energy_loss(far, target, kind).backward()
        slopes[kind] = float(far.grad.abs().sum())
    assert slopes["cross-entropy"] == pytest.approx(0.75, abs=1e-3)
    assert slopes["mse"] < 1e-3


def test_judge_loss_by_hand():
    """log 2 for no opinion; log(1 + 3) for odds of 3 to 1 on the wrong answer."""
    logits, hand = torch.tensor([[0.0], [math.log(3)]]), torch.tensor([1.0, 0.0])
    assert losses.judge_loss(logits, hand).item() == pytest.approx((math.log(2) + math.log(4)) / 2)


def test_heatmap_mse_sums_stages_and_skips_uncounted_joints():
    target = torch.zeros(1, 21, 2, 2)
    first, second = torch.zeros(1, 21, 2, 2), torch.zeros(1, 21, 2, 2)
    first[0, 0, 0, 0] = 2.0  # joint 0, first stage: mean over 4 cells = 4/4 = 1
    second[0, 1] = 3.0  # joint 1, second stage: 9
    second[0, 5] = 100.0  # not counted
    weight = torch.zeros(1, 21)
    weight[0, :2] = 1
    assert losses.heatmap_mse([first, second], target, weight).item() == pytest.approx((1 + 0) / 2 + (0 + 9) / 2)


def test_sum_map_is_the_mean_times_cells_times_joints():
    torch.manual_seed(0)
    outputs, target, weight = [torch.randn(2, 21, 32, 32)], torch.rand(2, 21, 32, 32), torch.ones(2, 21)
    mean = losses.heatmap_mse(outputs, target, weight)
    summed = losses.heatmap_mse(outputs, target, weight, "sum_map")
    assert summed.item() == pytest.approx(mean.item() * 32 * 32 * 21)
    by_hand = (outputs[0] - target).square().sum() / 2  # per hand
    assert summed.item() == pytest.approx(by_hand.item(), rel=1e-5)


@pytest.mark.parametrize("reduction", ["mean", "sum_map"])
def test_no_crops_have_no_error_of_heatmaps(reduction):
    """A process may have none. Named case: sum_map asked the first one for its size."""
    nothing = torch.zeros(0, 21, 8, 8)
    assert losses.heatmap_mse([nothing], nothing, torch.zeros(0, 21), reduction).item() == 0


def test_cross_entropy_normalises_the_target():
    logits = torch.zeros(1, 1, 1, 2)
    logits[..., 1] = math.log(3)  # softmax 1/4, 3/4
    target = torch.tensor([2.0, 2.0]).view(1, 1, 1, 2)  # 1/2, 1/2
    expected = -0.5 * math.log(1 / 4) - 0.5 * math.log(3 / 4)
    assert losses.heatmap_cross_entropy(logits, target, torch.ones(1, 1)).item() == pytest.approx(expected)


def test_cross_entropy_is_least_at_the_target_and_skips_empty_targets():
    target = torch.tensor([1.0, 3.0, 0.5, 0.5]).view(1, 1, 2, 2).repeat(1, 2, 1, 1)
    target[0, 1] = 0  # not counted, whatever its weight
    best = losses.heatmap_cross_entropy(target.clamp_min(1e-30).log(), target, torch.ones(1, 2))
    share = target[0, 0] / 5
    assert best.item() == pytest.approx(-(share * share.log()).sum().item())
    off = target.log().clamp_min(-50) + 0.1 * torch.randn(1, 2, 2, 2, generator=torch.Generator().manual_seed(0))
    assert losses.heatmap_cross_entropy(off, target, torch.ones(1, 2)) > best


def test_joint_l1():
    predicted, truth = torch.zeros(1, 2, 2), torch.tensor([[[1.0, 3.0], [10.0, 10.0]]])
    assert losses.joint_l1(predicted, truth, torch.tensor([[1.0, 0.0]])).item() == 2.0


@pytest.mark.parametrize(("norm", "expected"), [("mse", (1 + 4 + 9) / 63), ("l1", (1 + 2 + 3) / 63)])
def test_joint_loss(norm, expected):
    truth, predicted = torch.zeros(1, 21, 3), torch.zeros(1, 21, 3)
    predicted[0, 4] = torch.tensor([1.0, -2.0, 3.0])
    assert losses.joint_loss(predicted, truth, torch.ones(1, 21), norm).item() == pytest.approx(expected)


def test_joint_loss_is_a_mean_over_counted_joints():
    predicted, weight = torch.ones(1, 21, 3), torch.zeros(1, 21)
    predicted[0, 7] = 100
    weight[0, :7] = 1
    assert losses.joint_loss(predicted, torch.zeros(1, 21, 3), weight).item() == pytest.approx(1.0)


@pytest.mark.parametrize(("norm", "expected"), [("mse", 4 / 20), ("l1", 2 / 20)])
def test_bone_loss_of_one_longer_finger_tip(norm, expected):
    truth = torch.zeros(1, 21, 3)
    truth[0, :, 0] = torch.tensor([0.0] + [1.0, 2.0, 3.0, 4.0] * 5)  # every bone has length 1
    predicted = truth.clone()
    predicted[0, 20, 0] = 6.0  # the last bone has length 3
    assert torch.equal(losses.bone_lengths(truth), torch.ones(1, 20))
    assert losses.bone_loss(predicted, truth, torch.ones(1, 21), norm).item() == pytest.approx(expected)


def test_bone_loss_ignores_direction_and_needs_both_ends():
    torch.manual_seed(0)
    truth = torch.randn(2, 21, 3)
    rotation, _ = torch.linalg.qr(torch.randn(3, 3))
    assert losses.bone_loss(truth @ rotation.T, truth, torch.ones(2, 21)).item() == pytest.approx(0, abs=1e-10)
    weight = torch.ones(2, 21)
    weight[:, 0] = 0  # without the wrist the five bones at the wrist do not count
    longer = truth.clone()
    longer[:, 0] += 5
    assert losses.bone_loss(longer, truth, weight).item() == 0
    assert sum(0 in bone for bone in BONES) == 5


@pytest.mark.parametrize("side", [LEFT, RIGHT])
@pytest.mark.parametrize("kind", ["square", "perspective"])
def test_projected_true_joints_are_the_canonical_xy(side, kind):
    """Paper Eq. 2: with ground-truth p, pi(p) equals the ground truth's x and y exactly."""
    for seed in range(5):
        sample = make_sample(np.random.default_rng(seed))
        target = pose_target(sample, side, 128, CropConfig(kind=kind))
        assert target is not None
        tensors = (torch.from_numpy(np.asarray(a, np.float64))[None] for a in (
            target.joints_px, target.rays_from_crop, target.distance, target.canonical[:, 2]
        ))  # fmt: skip
        implied = losses.projected_joints(*tensors)
        assert np.abs(implied[0].numpy() - target.canonical[:, :2]).max() < 1e-4  # the targets are float32


def test_projected_joints_by_hand():
    # pixels are rays: root straight ahead, another joint at slope (0.1, -0.2), r/L = 3, z = 0.5 -> 3.5 * slope
    points = torch.zeros(1, 21, 2)
    points[0, 3] = torch.tensor([0.1, -0.2])
    z = torch.zeros(1, 21)
    z[0, 3] = 0.5
    implied = losses.projected_joints(points, torch.eye(3)[None], torch.tensor([3.0]), z)
    assert torch.allclose(implied[0, 3], torch.tensor([0.35, -0.7]))
    assert torch.allclose(implied[0, 0], torch.zeros(2))


def test_projected_joints_survive_mixed_precision():
    points = torch.rand(1, 21, 2) * 128
    rays = torch.tensor([[[0.01, 0, -0.5], [0, 0.01, -0.5], [0, 0, 1.0]]])
    exact = losses.projected_joints(points, rays, torch.tensor([3.0]), torch.zeros(1, 21))
    with torch.autocast("cpu", torch.bfloat16):
        mixed = losses.projected_joints(points, rays, torch.tensor([3.0]), torch.zeros(1, 21))
    assert torch.equal(exact, mixed)


def test_projection_loss_counts_x_and_y_only_and_stops_gradients():
    predicted = torch.zeros(1, 21, 3, requires_grad=True)
    implied = torch.zeros(1, 21, 2, requires_grad=True)
    with torch.no_grad():
        predicted[0, 2] = torch.tensor([3.0, 4.0, 100.0])
    loss = losses.projection_loss(predicted, implied, torch.ones(1, 21))
    assert loss.item() == pytest.approx((9 + 16) / 42)
    loss.backward()
    assert predicted.grad is not None and predicted.grad[0, 2, 2] == 0
    assert implied.grad is None


def hands_seen_exactly(side: int, seeds: int = 6) -> tuple[torch.Tensor, ...]:
    """Canonical pose, joints in crop pixels, rays and distance of hands as targets tell them."""
    crops = CropConfig(kind="perspective", margin=2.0)  # all joints inside
    targets = [pose_target(make_sample(np.random.default_rng(seed)), side, 128, crops) for seed in range(seeds)]
    usable = [target for target in targets if target is not None and target.weight.all()]
    assert len(usable) > 2
    pose, pixels, rays = (
        torch.from_numpy(np.stack([getattr(target, name) for target in usable]))
        for name in ("canonical", "joints_px", "rays_from_crop")
    )
    return pose, pixels, rays, torch.tensor([target.distance for target in usable])


def placed(pose, pixels, rays, distance, root_px, weight=None) -> torch.Tensor:
    """`place_loss` with certain joints, all hands counted if nothing else is said."""
    weight = torch.ones(len(pose)) if weight is None else weight
    return losses.place_loss(pose, pixels, torch.ones(len(pose), 21), rays, root_px, distance, weight)


@pytest.mark.parametrize("side", [LEFT, RIGHT])
def test_place_loss_of_true_pose_and_joints_is_0(side):
    pose, pixels, rays, distance = hands_seen_exactly(side)
    assert placed(pose, pixels, rays, distance, pixels[:, ROOT]).item() == pytest.approx(0, abs=1e-4)


def test_place_loss_is_the_error_of_the_roots_place_in_five_hand_lengths():
    """Truly one and a half times as far away: half of the distance found is missing, along the root's ray."""
    pose, pixels, rays, distance = hands_seen_exactly(LEFT)
    ray = (rays @ torch.cat([pixels[:, ROOT], torch.ones(len(pose), 1)], dim=1)[..., None])[..., 0]
    off = (ray / ray.norm(dim=1, keepdim=True)).abs().mean(dim=1) * distance / 2 / 5
    loss = placed(pose, pixels, rays, 1.5 * distance, pixels[:, ROOT])
    assert loss.item() == pytest.approx(float(off.mean()), abs=1e-4)
    first = torch.zeros(len(pose))
    first[0] = 1
    alone = placed(pose, pixels, rays, 1.5 * distance, pixels[:, ROOT], first)
    assert alone.item() == pytest.approx(float(off[0]), abs=1e-4)


def test_place_loss_by_hand():
    """Pixels are slopes: a hand found straight ahead at distance 3 is truly at (0.3, -0.6, 3), sqrt(9.45) away."""
    pose, points = torch.zeros(1, 21, 3), torch.zeros(1, 21, 2)
    pose[0, :, 0] = torch.linspace(-1, 1, 21)
    pose[0, ROOT] = 0
    points[0] = pose[0, :, :2] / 3
    root_px, distance = torch.tensor([[0.1, -0.2]]), torch.tensor([9.45**0.5])
    loss = placed(pose, points, torch.eye(3)[None], distance, root_px)
    assert loss.item() == pytest.approx((0.3 + 0.6) / 3 / 5, abs=1e-5)


def test_place_loss_survives_mixed_precision():
    pose, pixels, rays, distance = hands_seen_exactly(LEFT)
    exact = placed(pose, pixels, rays, 1.1 * distance, pixels[:, ROOT])
    with torch.autocast("cpu", torch.bfloat16):
        mixed = placed(pose, pixels, rays, 1.1 * distance, pixels[:, ROOT])
    assert torch.equal(exact, mixed)


def test_place_loss_teaches_pose_and_joints_but_not_scores():
    pose, pixels, rays, distance = hands_seen_exactly(RIGHT)
    scores = torch.ones(len(pose), 21, requires_grad=True)
    root_px = pixels[:, ROOT].clone()
    for learner in (pose, pixels):
        learner.requires_grad_()
    losses.place_loss(pose, pixels, scores, rays, root_px, 1.2 * distance, torch.ones(len(pose))).backward()
    for learner in (pose, pixels):
        assert learner.grad is not None and learner.grad.isfinite().all() and (learner.grad != 0).any()
    assert scores.grad is None


def test_place_loss_leaves_out_hands_that_cannot_be_placed():
    """All joints of the first hand at one pixel; the second seen behind the camera."""
    pose, pixels, rays, distance = hands_seen_exactly(LEFT)
    root_px = pixels[:, ROOT].clone()
    pixels[0] = pixels[0, ROOT].clone()
    rays[1, 2] = -rays[1, 2]
    for learner in (pose, pixels):
        learner.requires_grad_()
    loss = placed(pose, pixels, rays, distance, root_px)
    loss.backward()
    assert loss.item() == pytest.approx(0, abs=1e-4)
    for learner in (pose, pixels):
        assert learner.grad is not None and learner.grad.isfinite().all()
    assert placed(pose, pixels, rays, distance, root_px, torch.zeros(len(pose))).item() == 0


def test_cells_around_a_small_hand_count_more_and_around_a_large_one_less():
    boxes = torch.tensor([[[8.0, 8.0, 20.0, 20.0], [0.0, 0.0, 96.0, 96.0]]])
    weight = losses.hand_weights(boxes, torch.tensor([[True, True]]), 96, 96, 0.5)
    # 12x12 cells: (48 * 48 / 144) ** 0.5 = 4, half a box beyond it too; 96x96: (1 / 4) ** 0.5
    assert weight.shape == (1, 2, 96, 96)
    assert weight[0, 0, 2, 2] == 4 and weight[0, 0, 25, 25] == 4 and weight[0, 0, 26, 14] == 1
    assert (weight[0, 1] == 0.5).all()
    absent = losses.hand_weights(boxes, torch.tensor([[False, True]]), 96, 96, 0.5)
    assert (absent[0, 0] == 1).all()


def test_weights_of_1_change_no_loss():
    generator = torch.Generator().manual_seed(0)
    logits, energy = torch.randn(1, 3, 4, 4, generator=generator), torch.rand(1, 2, 4, 4, generator=generator)
    classes, one = torch.ones(1, 4, 4, dtype=torch.int64), torch.ones(1, 4, 4)
    plain = losses.segmentation_loss(logits, classes)
    torch.testing.assert_close(losses.segmentation_loss(logits, classes, one), plain)
    for kind in ("mse", "cross-entropy"):
        plain = losses.energy_loss(logits[:, :2], energy, kind)
        torch.testing.assert_close(losses.energy_loss(logits[:, :2], energy, kind, one), plain)
