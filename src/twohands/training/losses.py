"""Every loss of both recipes; each a pure function that returns a scalar tensor.

Weights are (B, 21), 1 for joints that count. A batch in which nothing counts has loss 0, not NaN. Where several
processes train together, each sees its own part of the batch, and the mean of their losses is the loss of the whole.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import torch
from torch import Tensor
from torch.nn import functional

from twohands.geometry.projection import canonical_xy_from_rays, project_global, range_weights
from twohands.geometry.rotation import rotate
from twohands.skeleton import BONES, ROOT
from twohands.training.parallel import mean_over_processes
from twohands.types import PinholeCamera

PARENT_JOINTS = [parent for parent, _ in BONES]
CHILD_JOINTS = [child for _, child in BONES]

_SLOPES = PinholeCamera(1.0, 1.0, 0.0, 0.0, 1, 1)
"""A camera whose pixels are the slopes x / z and y / z of the rays."""

_PLACE_UNIT = 5.0
"""Of L_place, in hand lengths: about 45 cm, a hand's usual distance."""

USUAL_HAND_CELLS = 48.0**2
"""Cells of a hand's box whose cells weigh 1 for HandSegNet, see `hand_weights`."""
WEIGHTS = (0.25, 8.0)
"""Range of these weights."""

_LARGEST_PLACE_ERROR = 1.0
"""Of an axis, in that unit, from which on a hand is lost and teaches nothing about its place."""


def weighted_mean(values: Tensor, weight: Tensor) -> Tensor:
    """sum(values * weight) / sum(weight); 0 if no weight is positive.

    With several processes the denominator is their mean: what the processes return has the weighted mean over all of
    them as its plain mean, however unevenly the weight is spread. All of them must call this.
    """
    total = mean_over_processes(weight.sum())
    return (values * weight).sum() / total.clamp_min(1e-12)


def hand_weights(boxes_px: Tensor, present: Tensor, height: int, width: int, exponent: float) -> Tensor:
    """How much the cells around each hand count, so that small hands are not drowned by large ones. Ours.

    A hand that fills the picture has a hundred times the cells of one across the room. Around a hand, half a box beyond
    its own, cells weigh (`USUAL_HAND_CELLS` / cells of the box) ** exponent, within `WEIGHTS`; all else weighs 1.

    Args:
        boxes_px: (B, 2, 4) u0, v0, u1, v1 in cells of the maps.
        present: (B, 2) bool.
        height, width: of the maps.
        exponent: 0 lets all cells count alike, 1 all hands.

    Returns:
        (B, 2, H, W) float32.
    """
    low, high = boxes_px[..., :2].float(), boxes_px[..., 2:].float()
    size = (high - low).clamp_min(1)
    weight = (USUAL_HAND_CELLS / size.prod(dim=-1)).pow(exponent).clamp(*WEIGHTS)  # (B, 2)
    inside = []
    for axis, cells in ((1, height), (0, width)):
        middle = torch.arange(cells, device=boxes_px.device) + 0.5
        reach = size[..., axis, None] / 2
        inside.append((middle > low[..., axis, None] - reach) & (middle < high[..., axis, None] + reach))
    around = inside[0][..., :, None] & inside[1][..., None, :] & present[..., None, None]
    return torch.where(around, weight[..., None, None], 1.0)


def segmentation_loss(logits: Tensor, classes: Tensor, weight: Tensor | None = None) -> Tensor:
    """Cross-entropy per pixel, weighted mean over pixels.

    Args:
        logits: (B, 3, H, W).
        classes: (B, H, W) int64.
        weight: (B, H, W); None lets all pixels count alike.

    Source: paper section 4.1 and supplement; the weights are ours.
    """
    if weight is None:
        return functional.cross_entropy(logits.float(), classes)
    return (functional.cross_entropy(logits.float(), classes, reduction="none") * weight).mean()


def energy_loss(
    logits: Tensor,
    energy: Tensor,
    kind: Literal["mse", "cross-entropy"] = "mse",
    weight: Tensor | None = None,
) -> Tensor:
    """How far sigmoid(logits) is from the energy maps, mean over cells.

    Args:
        logits: (B, 2, H, W).
        energy: (B, 2, H, W), 0..1.
        kind: "mse", the paper's (supplement). "cross-entropy", ours: binary cross-entropy has the same minimum, but no
            vanishing gradient where the sigmoid is saturated; with the squared error the maps of small hands can stay
            near 0 for thousands of iterations.
        weight: (B, 2, H, W); None lets all cells count alike.
    """
    if kind == "mse":
        wrong = functional.mse_loss(torch.sigmoid(logits.float()), energy, reduction="none")
    else:
        wrong = functional.binary_cross_entropy_with_logits(logits.float(), energy, reduction="none")
    return wrong.mean() if weight is None else (wrong * weight).mean()


def judge_loss(logits: Tensor, hand: Tensor) -> Tensor:
    """Binary cross-entropy of the judgement whether a crop shows the hand that it was cut for, mean over crops.

    Args:
        logits: (B, 1).
        hand: (B,), 1 or 0.
    """
    wrong = functional.binary_cross_entropy_with_logits(logits[:, 0].float(), hand, reduction="none")
    return weighted_mean(wrong, torch.ones_like(hand))


def heatmap_mse(
    outputs: Sequence[Tensor], target: Tensor, weight: Tensor, reduction: Literal["mean", "sum_map"] = "mean"
) -> Tensor:
    """Sum over the stages of the mean squared error of heatmaps.

    Args:
        outputs: one (B, 21, M, M) per stage.
        target: (B, 21, M, M).
        weight: (B, 21).
        reduction: "mean" over cells and counted joints; "sum_map" multiplies it by M * M * 21, the scale on which the
            paper's runs with plain SGD and learning rate 1e-6 (supplement) make sense.
    """
    per_stage = [weighted_mean((maps.float() - target).square().mean(dim=(2, 3)), weight) for maps in outputs]
    loss = torch.stack(per_stage).sum()
    return loss if reduction == "mean" else loss * math.prod(target.shape[1:])


def heatmap_cross_entropy(logits: Tensor, target: Tensor, weight: Tensor) -> Tensor:
    """Cross-entropy between a target distribution over the cells and the softmax of the logits, in nats per joint.

    Ours; the paper uses the mean squared error. It learns far faster, because every cell's gradient is of the size
    of its probability error, not diluted over 1,024 cells.

    Args:
        logits: (B, 21, M, M).
        target: (B, 21, M, M), not negative; normalised here to sum 1 per joint. Joints whose target is all zero do
            not count.
        weight: (B, 21).
    """
    mass = target.sum(dim=(2, 3))
    share = target / mass.clamp_min(1e-12)[..., None, None]
    log_p = logits.float().flatten(2).log_softmax(dim=2).view(logits.shape)
    return weighted_mean(-(share * log_p).sum(dim=(2, 3)), weight * (mass > 0))


def joint_l1(predicted: Tensor, truth: Tensor, weight: Tensor) -> Tensor:
    """Mean absolute error per coordinate of (B, 21, D) points, in their unit."""
    return weighted_mean((predicted - truth).abs().mean(dim=-1), weight)


def joint_loss(predicted: Tensor, truth: Tensor, weight: Tensor, norm: Literal["mse", "l1"] = "mse") -> Tensor:
    """L_j: mean over counted joints and 3 axes of (w_hat - w)^2 ("mse", the paper) or |w_hat - w| ("l1", ours).

    predicted and truth (B, 21, 3), canonical units. Source: paper Eq. 2.
    """
    difference = predicted - truth
    values = difference.square() if norm == "mse" else difference.abs()
    return weighted_mean(values.mean(dim=-1), weight)


def bone_lengths(joints: Tensor) -> Tensor:
    """(B, 21, 3) -> (B, 20), in the order of `skeleton.BONES`."""
    return (joints[:, CHILD_JOINTS] - joints[:, PARENT_JOINTS]).norm(dim=-1)


def bone_loss(predicted: Tensor, truth: Tensor, weight: Tensor, norm: Literal["mse", "l1"] = "mse") -> Tensor:
    """L_bone: mean over the 20 bones of the squared (or absolute) length error; a bone counts if both ends do.

    predicted and truth (B, 21, 3), canonical units. Source: paper Eq. 2.
    """
    difference = bone_lengths(predicted) - bone_lengths(truth)
    values = difference.square() if norm == "mse" else difference.abs()
    return weighted_mean(values, weight[:, CHILD_JOINTS] * weight[:, PARENT_JOINTS])


def _rays(pixels: Tensor, rays_from_crop: Tensor) -> Tensor:
    """Rays (B, N, 3) through crop pixels (B, N, 2), see `PoseTarget.rays_from_crop`."""
    return rotate(rays_from_crop, torch.cat([pixels, torch.ones_like(pixels[..., :1])], dim=-1))


def projected_joints(joints_px: Tensor, rays_from_crop: Tensor, distance: Tensor, canonical_z: Tensor) -> Tensor:
    """pi(p): x and y that 2D joints imply in the canonical frame, given the true distance and depths.

    u_j = R(theta, phi) K^-1 [p_j, 1] with the angles of p_root, m_j = (u_x, u_y) / u_z, pi(p_j) = m_j (r/L + z_j).

    Args:
        joints_px: (B, 21, 2) crop pixels.
        rays_from_crop: (B, 3, 3), see `PoseTarget.rays_from_crop`.
        distance: (B,) r/L.
        canonical_z: (B, 21).

    Returns:
        (B, 21, 2) canonical units, left-like hand; NaN where a joint's ray does not point forward.

    Source: paper Eq. 2 (L_proj); docs/paper-map.md, *Canonical pose and alignment*.
    """
    with torch.autocast(joints_px.device.type, enabled=False):  # 8 bits of a pixel are not enough
        return canonical_xy_from_rays(_rays(joints_px, rays_from_crop), distance, canonical_z)


def projection_loss(
    predicted: Tensor, implied_xy: Tensor, weight: Tensor, norm: Literal["mse", "l1"] = "mse"
) -> Tensor:
    """L_proj: mean over counted joints and 2 axes of (xy(w_hat) - pi(p))^2, or of the absolute value.

    Args:
        predicted: (B, 21, 3).
        implied_xy: (B, 21, 2) from `projected_joints`; no gradient flows into it.
        weight: (B, 21).

    Source: paper Eq. 2.
    """
    return joint_loss(predicted[..., :2], implied_xy.detach(), weight, norm)


def place_loss(
    predicted: Tensor,
    joints_px: Tensor,
    scores: Tensor,
    rays_from_crop: Tensor,
    root_px: Tensor,
    distance: Tensor,
    weight: Tensor,
) -> Tensor:
    """L_place: mean over hands and 3 axes of |t_hat - t| / (5 L), t the root joint's place in the camera frame.

    Ours. t_hat is where `project_global` fits the hand in use, so both networks learn what their errors do to range
    and direction together, not joint by joint. A centimetre counts the same near and far. Gradients flow into the pose
    and the 2D joints.

    Args:
        predicted: (B, 21, 3) canonical pose.
        joints_px: (B, 21, 2) crop pixels, estimated.
        scores: (B, 21) certainty of the 2D joints, 0..1; no gradient flows into them.
        rays_from_crop: (B, 3, 3), see `PoseTarget.rays_from_crop`.
        root_px: (B, 2) crop pixels, true.
        distance: (B,) r/L, true.
        weight: (B,) 1 for hands that count. Hands that cannot be placed do not.
    """
    with torch.autocast(joints_px.device.type, enabled=False):  # 8 bits of a pixel are not enough
        rays = _rays(torch.cat([joints_px, root_px[:, None]], dim=1), rays_from_crop).double()
        rays, to_root = rays[:, :-1], rays[:, -1]
        root = to_root * (distance / to_root.norm(dim=-1))[:, None]
        forward = (rays[..., 2] > 0).all(dim=-1)
        slopes = rays[..., :2] / torch.where(forward[:, None], rays[..., 2], 1.0)[..., None]
        trust = range_weights(scores.detach().double())
        place = project_global(predicted.double(), slopes, _SLOPES, 1.0, method="fitted", weights=trust)
        off = (place.joints_m[:, ROOT] - root).abs() / _PLACE_UNIT
        placed = forward & place.valid
        off = torch.where(placed[:, None], off, 0.0).clamp_max(_LARGEST_PLACE_ERROR)
        return weighted_mean(off.mean(dim=-1).float(), weight * placed)
