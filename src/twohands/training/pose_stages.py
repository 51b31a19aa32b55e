"""What one training step of the pose networks computes, and how they are validated."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional

from twohands.errors import InputError
from twohands.geometry.boxes import apply_homography
from twohands.geometry.heatmaps import decode_softargmax, decode_subpixel, decode_windowed, encode_heatmaps
from twohands.models.pose_net_2d import PoseNet2D
from twohands.models.pose_net_3d import PoseNet3D
from twohands.skeleton import N_JOINTS, ROOT
from twohands.training import losses
from twohands.training.batches import Batch
from twohands.training.config import TrainConfig
from twohands.training.parallel import mean_over_processes
from twohands.training.stage import Losses, ParameterGroup, Stage, network_groups, normalised

CUELESS = 0.1
"""Share of the hands whose cues are kept from PoseNet3D, so that it can also answer from joints alone."""


def heatmap_targets(batch: Batch, config: TrainConfig, believed: Tensor | None = None) -> Tensor:
    """Target maps (N, 21, M, M) with peak 1; the spread carries the depth if the run asks for z-heatmaps.

    Args:
        batch: crops of hands.
        config: the run.
        believed: (N, 21) depths that stand for unknown ones; 0 if None.
    """
    net, z = config.networks.pose_net_2d, None
    if config.loss.z_heatmaps:
        z = batch["canonical"][..., 2]
        if believed is not None:
            z = torch.where(batch["canonical_weight"] > 0, z, believed)
    joints_px = batch["joints_px"] - net.surround
    return encode_heatmaps(joints_px, crop_size=net.seen_size, map_size=net.map_size, sigma=net.sigma, z=z)


def believed_depth(net: PoseNet2D, maps: Tensor) -> Tensor:
    """Depths (N, 21) that the spread of a network's maps (N, 21, M, M) tells, without gradient.

    A hand labelled in 2D alone is to teach where its joints are, not how deep: a target that is spread as the network's
    own answer leaves that answer's depth alone. The spread is that of the Gaussian with the same entropy. Maps that are
    no distributions give 0.
    """
    if net.config.activation != "softmax":
        return maps.new_zeros(maps.shape[:2])
    shares = net.probabilities(maps.detach())
    entropy = -torch.xlogy(shares, shares).sum(dim=(2, 3))
    log_variance = entropy - math.log(2 * math.pi * math.e)
    return (2 * math.log(net.config.sigma) - log_variance) / math.log(2)


def heatmap_losses(net: PoseNet2D, outputs: Sequence[Tensor], batch: Batch, config: TrainConfig) -> Losses:
    """PoseNet2D's losses: the paper's mean squared error, or cross-entropy plus L1 on the soft-argmax."""
    outputs = [maps[:, :N_JOINTS] for maps in outputs]
    target, weight = heatmap_targets(batch, config, believed_depth(net, outputs[-1])), batch["weight"]
    if config.loss.heatmap == "mse":
        return {"heatmap": losses.heatmap_mse(outputs, target, weight, config.loss.reduction)}
    cells = (batch["joints_px"] - net.config.surround) * (net.config.map_size / net.config.seen_size)
    result = {"heatmap": torch.stack([losses.heatmap_cross_entropy(maps, target, weight) for maps in outputs]).sum()}
    if config.loss.soft_argmax:
        points = [decode_softargmax(net.probabilities(maps))[0] for maps in outputs]
        distances = torch.stack([losses.joint_l1(p, cells, weight) for p in points]).sum()
        result["soft_argmax"] = config.loss.soft_argmax * distances
    return result


def judge_losses(hand_logit: Tensor | None, batch: Batch, config: TrainConfig) -> Losses:
    """The loss of PoseNet2D's judge; nothing where it has none."""
    if hand_logit is None:
        return {}
    return {"judge": config.loss.judge * losses.judge_loss(hand_logit, batch["hand"])}


def only_hands(batch: Batch) -> tuple[Tensor, Batch]:
    """Which crops (N,) show hands, and the batch of these: nothing else has joints to learn from. If none does,
    in any process, all: without any there are no batch statistics. All processes must call this."""
    hands = batch["hand"] > 0
    if mean_over_processes(hands.sum()) == 0:
        hands = torch.ones_like(hands)
    return hands, {name: values[hands] for name, values in batch.items()}


def read_out(net: PoseNet2D, heatmaps: Tensor) -> Tensor:
    """Joints (N, 21, 2) in crop pixels from `PoseNet2D.heatmaps`, read as the maps were trained."""
    decode = decode_softargmax if net.config.activation == "softmax" else decode_subpixel
    cells = decode(heatmaps[:, :N_JOINTS].detach().float())[0]
    return cells * (net.config.seen_size / net.config.map_size) + net.config.surround


def with_silent_cues(maps: Tensor, cues: int) -> Tensor:
    """`PoseNet2D.heatmaps` of the joints' maps (N, 21, M, M), with cues of 0 behind them."""
    return functional.pad(maps, (0, 0, 0, 0, 0, cues))


class _Errors2D:
    """Collects pixel errors of 2D joints, and the judge's, over batches."""

    def __init__(self) -> None:
        self.crop: list[Tensor] = []
        self.image: list[Tensor] = []
        self.judged: list[Tensor] = []

    def look(self, net: PoseNet2D, batch: Batch) -> Tensor:
        """Heatmaps of a batch; its errors are counted."""
        image = normalised(batch["image"])
        outputs, hand_logit = net.judged(image)
        maps = net.heatmaps(outputs)
        self._add(read_out(net, maps), batch)
        if hand_logit is not None:
            mirrored = net.judged(image.flip(3))[1]
            assert mirrored is not None
            self.judged.append((hand_logit[:, 0] > 0) == (batch["hand"] > 0))
            self.judged.append(mirrored[:, 0][batch["hand"] > 0] < 0)
        return maps

    def _add(self, predicted: Tensor, batch: Batch) -> None:
        counted = batch["weight"] > 0
        self.crop.append((predicted - batch["joints_px"]).norm(dim=-1)[counted])
        homography = batch["image_from_crop"].double()
        full = [apply_homography(homography, points.double()) for points in (predicted, batch["joints_px"])]
        self.image.append((full[0] - full[1]).norm(dim=-1)[counted])

    def figures(self) -> dict[str, float]:
        crop, image = torch.cat(self.crop), torch.cat(self.image)
        judged = {"judged": float(torch.cat(self.judged).float().mean())} if self.judged else {}
        return {
            **judged,
            "crop_px_mean": float(crop.mean()),
            "crop_px_median": float(crop.median()),
            "image_px_mean": float(image.mean()),
            "image_px_median": float(image.median()),
        }


class Pose2DStage(Stage):
    """PoseNet2D on crops composed from true masks. Source: paper section 4.2, supplement."""

    def __init__(self, config: TrainConfig) -> None:
        super().__init__()
        self.config = config
        self.net = PoseNet2D(config.networks.pose_net_2d)

    def forward(self, batch: Batch, iteration: int) -> Losses:
        hands, hand_batch = only_hands(batch)
        outputs, hand_logit = self.net.judged(normalised(batch["image"]), hands, guided=False)
        two_d = heatmap_losses(self.net, outputs, hand_batch, self.config)
        return two_d | judge_losses(hand_logit, batch, self.config)

    def validate(self, batches: Sequence[Batch]) -> dict[str, float]:
        """Mean and median distance of counted joints, in crop pixels and in pixels of the full picture; judged: share
        of crops, and of the same crops mirrored, that the judge is right about."""
        errors = _Errors2D()
        for batch in batches:
            errors.look(self.net, batch)
        return errors.figures()

    def networks(self) -> dict[str, nn.Module]:
        return {"pose_net_2d": self.net}


class Pose3DStage(Stage):
    """PoseNet3D on PoseNet2D's maps: L_j + L_bone + L_proj. Source: paper Eq. 2, supplement.

    The paper's order of training keeps PoseNet2D fixed. With `optim.along_rate` it keeps learning with its own loss and
    with the gradients that arrive through the maps (ours).

    Raises:
        InputError: a PoseNet2D with published layers would learn.
    """

    def __init__(self, config: TrainConfig, pose_net_2d: PoseNet2D) -> None:
        super().__init__()
        if config.optim.along_rate > 0 and pose_net_2d.landmarks is not None:
            raise InputError(
                "a PoseNet2D with landmark_spread cannot learn along: it would learn to overrule its published layers; "
                "set optim.along_rate=0"
            )
        self.config = config
        self.net_2d = pose_net_2d
        self.net_3d = PoseNet3D(config.networks.pose_net_3d)
        self.along = config.optim.along_rate > 0
        self.net_2d.requires_grad_(self.along)
        if self.net_2d.judge is not None and not config.loss.heatmap_along:
            for part in (self.net_2d.judge, self.net_2d.judge_trunk):
                part.requires_grad_(False)  # nothing else teaches them, and processes wait for every gradient

    def train(self, mode: bool = True) -> Pose3DStage:
        """As for every module, but a frozen PoseNet2D keeps its batch statistics too."""
        super().train(mode)
        if not self.along:
            self.net_2d.eval()
        return self

    def forward(self, batch: Batch, iteration: int) -> Losses:
        loss = self.config.loss
        hands, hand_batch = only_hands(batch)
        with torch.set_grad_enabled(self.along):
            outputs, hand_logit = self.net_2d.judged(normalised(batch["image"]), hands)
            maps = self.net_2d.heatmaps(outputs)
        result: Losses = {}
        if self.along and loss.heatmap_along:
            two_d = heatmap_losses(self.net_2d, outputs, hand_batch, self.config)
            two_d |= judge_losses(hand_logit, batch, self.config)
            result = {name: loss.heatmap_along * value for name, value in two_d.items()}
        batch = hand_batch
        if iteration < self.config.truth_maps:
            half = (batch["lot"] < 0.5)[:, None, None, None]
            maps = torch.where(half, self._ideal_maps(batch), maps.float())
        if cues := self.net_3d.config.cues:
            deaf = (batch["lot"] >= 1 - CUELESS)[:, None, None, None]
            maps = torch.where(deaf, with_silent_cues(maps[:, :N_JOINTS], cues), maps)
        predicted = self.net_3d(maps).float()

        truth, weight = batch["canonical"], batch["canonical_weight"]
        norm = loss.joint_norm
        result["joint"] = loss.joint * losses.joint_loss(predicted, truth, weight, norm)
        if loss.bone:
            result["bone"] = loss.bone * losses.bone_loss(predicted, truth, weight, norm)
        if loss.projection:
            implied = losses.projected_joints(
                read_out(self.net_2d, maps), batch["rays_from_crop"], batch["distance"], truth[..., 2]
            )
            both = weight * batch["weight"] * batch["weight"][:, ROOT, None] * implied.isfinite().all(dim=-1)
            implied = implied.nan_to_num()
            result["projection"] = loss.projection * losses.projection_loss(predicted, implied, both, norm)
        if loss.place:
            result["place"] = loss.place * self._place_loss(predicted, maps, batch)
        return result

    def _place_loss(self, predicted: Tensor, maps: Tensor, batch: Batch) -> Tensor:
        """`losses.place_loss` for the maps' joints as they are read and weighed in use."""
        points, scores = decode_windowed(maps[:, :N_JOINTS].float())
        net, distance = self.net_2d.config, batch["distance"]
        return losses.place_loss(
            predicted,
            points * (net.seen_size / net.map_size) + net.surround,
            scores,
            batch["rays_from_crop"],
            batch["joints_px"][:, ROOT],
            distance,
            (distance > 0).float() * batch["weight"][:, ROOT],
        )

    def _ideal_maps(self, batch: Batch) -> Tensor:
        """Maps as a perfect PoseNet2D would give them, joints outside the crop empty."""
        maps = heatmap_targets(batch, self.config) * batch["weight"][..., None, None]
        if self.net_2d.config.activation == "softmax":
            mass = maps.sum(dim=(2, 3), keepdim=True).clamp_min(1e-12)
            maps = maps / mass * (2 * torch.pi * self.net_2d.config.sigma**2)
        return with_silent_cues(maps, self.net_2d.config.cues)

    def validate(self, batches: Sequence[Batch]) -> dict[str, float]:
        """canonical_mean: mean joint distance in hand lengths; bone_mean: mean absolute bone length error in hand
        lengths; PoseNet2D's figures beside them."""
        errors = _Errors2D()
        joint: list[Tensor] = []
        bone: list[Tensor] = []
        for batch in batches:
            maps = errors.look(self.net_2d, batch)
            predicted, truth = self.net_3d(maps).float(), batch["canonical"]
            known = batch["canonical_weight"].bool()
            joint.append((predicted - truth).norm(dim=-1)[known])
            whole = known.all(dim=-1)
            bone.append((losses.bone_lengths(predicted) - losses.bone_lengths(truth))[whole].abs().flatten())
        return {
            "canonical_mean": float(torch.cat(joint).mean()),
            "canonical_median": float(torch.cat(joint).median()),
            "bone_mean": float(torch.cat(bone).mean()),
            **errors.figures(),
        }

    def networks(self) -> dict[str, nn.Module]:
        both: dict[str, nn.Module] = {"pose_net_3d": self.net_3d}
        return {"pose_net_2d": self.net_2d, **both} if self.along else both

    def parameter_groups(self) -> list[ParameterGroup]:
        optim = self.config.optim
        along = network_groups(self.net_2d, optim.along_rate, optim) if self.along else []
        return network_groups(self.net_3d, 1.0, optim) + along
