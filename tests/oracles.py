"""Networks that know the answer: what the pipeline makes of perfect maps, and what it feeds its networks."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
from tests.builders import make_sample

from twohands.geometry.boxes import apply_homography, box_from_points
from twohands.geometry.canonical import canonical_from_camera
from twohands.geometry.heatmaps import encode_energy, encode_heatmaps
from twohands.geometry.network_input import network_input
from twohands.inference.decision import DecisionConfig, PictureView, PlacementConfig, ViewConfig
from twohands.inference.engine import Networks
from twohands.inference.estimator import HandEstimator
from twohands.inference.stages import StageTruth
from twohands.inference.weights import WeightsCard
from twohands.types import HandCrop, HandSample

CONFIGS = {"views": ViewConfig, "decision": DecisionConfig, "placement": PlacementConfig}
FIRST = {"pose": 1.0, "energy": 0.3, "swapped": -1.0, "merged_pose": 1.0, "both_in_one_place": -1.0}
LAST = {"first": 1.0, "joints": 10.0}
"""A decision by hand, for networks that speak the truth."""


def drawn_hands(seed: int, **options) -> HandSample:
    """A drawn picture of two hands, 240x135, with all labels; options as `make_sample`."""
    return make_sample(np.random.default_rng([4, seed]), **options)


def make_card(**changes) -> WeightsCard:
    """A card for small maps; `changes` are fields of `WeightsCard` or of its three records."""
    values = {
        "name": "oracle",
        "seg_input_size": (135, 240),
        "crop_size": 128,
        "crop_kind": "perspective",
        "crop_margin": 1.5,
        "heatmap_decode": "subpixel",
        "views": {"tta_views": (PictureView((135, 240), mirrored=True),)},
        "decision": {"first": FIRST, "last": LAST},
        "placement": {},
    }
    for name, value in changes.items():
        section = next((key for key, kind in CONFIGS.items() if name in kind.__dataclass_fields__), None)
        (values if section is None else values[section])[name] = value
    return WeightsCard(**(values | {key: kind(**values[key]) for key, kind in CONFIGS.items()}))


def restaged(estimator: HandEstimator, **stages) -> HandEstimator:
    """The same estimator with other stages, fields of `Stages`."""
    return HandEstimator(estimator.networks, estimator.card, dataclasses.replace(estimator.stages, **stages))


def hand_masks(sample: HandSample) -> np.ndarray:
    """(H, W) uint8, 0 background, 1 left, 2 right, from part labels."""
    assert sample.labels is not None
    return np.select([sample.labels == 0, sample.labels <= 7], [0, 1], 2).astype(np.uint8)


def true_boxes(sample: HandSample) -> np.ndarray:
    """(2, 4) tight boxes of the joints; NaN for absent hands."""
    return box_from_points(sample.joints_px)


def full_truth(sample: HandSample) -> StageTruth:
    """Truth for every stage."""
    return StageTruth(
        masks=hand_masks(sample),
        boxes_px=true_boxes(sample),
        present=sample.present,
        joints_px=sample.joints_px,
        heatmaps=np.zeros((2, 21, 32, 32)),
        canonical=canonical_from_camera(sample.joints_m).joints,
    )


def unused_network(batch: np.ndarray):
    """A network that must not be called."""
    raise AssertionError("a network was run although the truth was given")


UNUSED = Networks(unused_network, unused_network, unused_network)


class Oracle:
    """Three networks that return the truth about one sample, in the form in which trained ones would.

    Each checks what it is fed: the first gets the whole picture, or its mirror image, the second the crops that the
    pipeline's own boxes give, the third the second's maps.

    Attributes:
        estimator: a pipeline that runs on these networks.
        calls: names of the networks in the order in which they were run.
    """

    def __init__(self, sample: HandSample, card: WeightsCard, *, z_heatmaps: bool = True) -> None:
        self.sample, self.card, self.z_heatmaps = sample, card, z_heatmaps
        self.canonical = canonical_from_camera(sample.joints_m).joints
        self.calls: list[str] = []
        self.maps = np.zeros((0, 21, 32, 32))
        self.estimator = HandEstimator(Networks(self.hand_seg_net, self.pose_net_2d, self.pose_net_3d), card)

    def hand_seg_net(self, batch: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        assert batch.shape == (1, 3, *self.card.seg_input_size) and batch.dtype == np.float32
        assert batch.min() >= -0.5 and batch.max() < 0.5
        self.calls.append("hand_seg_net")
        height, width = self.card.seg_input_size
        assert self.sample.image.shape[:2] == (height, width), "the oracle knows only pictures of the input's size"
        seg_logits = 20.0 * np.stack([hand_masks(self.sample) == k for k in range(3)]) - 10.0
        energy = encode_energy(true_boxes(self.sample), self.sample.present, height, width)
        energy = np.clip(energy, 1e-6, 1 - 1e-6)
        energy_logits = np.log(energy / (1 - energy))
        if np.array_equal(batch, network_input(self.sample.image[None, :, ::-1])):
            seg_logits, energy_logits = seg_logits[[0, 2, 1], :, ::-1], energy_logits[::-1, :, ::-1]
        return seg_logits[None].astype(np.float32), energy_logits[None].astype(np.float32)

    def pose_net_2d(self, batch: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        self.calls.append("pose_net_2d")
        estimator = HandEstimator(Networks(self.hand_seg_net, unused_network, unused_network), self.card)
        masks, boxes = estimator.segment(self.sample.image)
        self.calls.pop()
        crops = [
            estimator.stages.crop(self.sample.image, masks, boxes.boxes_px[side], side, self.sample.camera)
            for side in np.flatnonzero(self.sample.present)
        ]
        np.testing.assert_array_equal(batch, network_input(np.stack([crop.image for crop in crops])))
        self.maps = self.true_maps(crops)
        return self.maps, np.zeros(len(crops))

    def true_maps(self, crops: list[HandCrop]) -> np.ndarray:
        """(B, 21, M, M) maps of the true joints in these crops."""
        maps = []
        for crop in crops:
            joints = apply_homography(np.linalg.inv(crop.image_from_crop), self.sample.joints_px[crop.side])
            z = self.canonical[crop.side, :, 2] if self.z_heatmaps else None
            maps.append(encode_heatmaps(joints, crop_size=self.card.crop_size, z=z))
        return np.stack(maps).astype(np.float32)

    def pose_net_3d(self, heatmaps: np.ndarray) -> np.ndarray:
        self.calls.append("pose_net_3d")
        np.testing.assert_array_equal(heatmaps, self.maps)
        left_like = self.canonical * np.array([[[1, 1, 1]], [[-1, 1, 1]]])
        return left_like[np.flatnonzero(self.sample.present)].astype(np.float32)


def write_tiny_weights(folder: Path, *, crop_size: int = 32, map_size: int = 8, energy_bias: float = 4.0) -> Path:
    """A real weights folder of three ONNX networks, small and meaningless, for tests of files and commands.

    Args:
        folder: made if need be.
        crop_size: side of the crop.
        map_size: side of the heatmaps.
        energy_bias: energy logit in the lower middle of the picture, where both "hands" are found; negative: no hand.
    """
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    height, width = 48, 80
    rng = np.random.default_rng(0)
    folder.mkdir(parents=True, exist_ok=True)

    def constant(name: str, values: np.ndarray):
        return numpy_helper.from_array(values.astype(np.float32), name)

    def save(name: str, inputs: list, outputs: list, nodes: list, constants: list) -> None:
        graph = helper.make_graph(nodes, name, inputs, outputs, constants)
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
        onnx.checker.check_model(model)
        onnx.save(model, str(folder / f"{name}.onnx"))

    def port(name: str, *shape: int | str):
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, list(shape))

    energy = np.full((1, 2, height, width), -6.0)
    energy[:, 0, 20:40, 10:30] = energy_bias
    energy[:, 1, 20:40, 50:70] = energy_bias
    seg = np.zeros((1, 3, height, width))
    seg[:, 1, :, : width // 2] = 1.0
    seg[:, 2, :, width // 2 :] = 1.0
    save(
        "hand_seg_net",
        [port("image", "b", 3, height, width)],
        [port("seg_logits", "b", 3, height, width), port("energy_logits", "b", 2, height, width)],
        [
            helper.make_node("ReduceMean", ["image"], ["mean"], axes=[1, 2, 3], keepdims=1),
            helper.make_node("Mul", ["mean", "zero"], ["nothing"]),
            helper.make_node("Add", ["nothing", "seg"], ["seg_logits"]),
            helper.make_node("Add", ["nothing", "energy"], ["energy_logits"]),
        ],
        [constant("zero", np.zeros(1)), constant("seg", seg), constant("energy", energy)],
    )
    hand = np.linspace(-0.8, 0.8, 21)
    joints = np.stack([(hand * 0.4 + 0.5) * crop_size, (0.5 - 0.35 * np.cos(3 * hand)) * crop_size], axis=-1)
    maps = encode_heatmaps(joints, crop_size=crop_size, map_size=map_size, sigma=1.0)[None]
    save(
        "pose_net_2d",
        [port("crop", "b", 3, crop_size, crop_size)],
        [port("heatmaps", "b", 21, map_size, map_size)],
        [
            helper.make_node("ReduceMean", ["crop"], ["mean"], axes=[1, 2, 3], keepdims=1),
            helper.make_node("Mul", ["mean", "zero"], ["nothing"]),
            helper.make_node("Add", ["nothing", "maps"], ["heatmaps"]),
        ],
        [constant("zero", np.zeros(1)), constant("maps", maps)],
    )
    canonical = np.concatenate([joints / crop_size * 2 - 1, rng.normal(0, 0.1, (21, 1))], axis=1)
    canonical = (canonical - canonical[9])[None]
    canonical = canonical / np.linalg.norm(canonical[0, 0])
    save(
        "pose_net_3d",
        [port("heatmaps", "b", 21, map_size, map_size)],
        [port("canonical", "b", 21, 3)],
        [
            helper.make_node("ReduceMean", ["heatmaps"], ["mean"], axes=[2, 3], keepdims=0),
            helper.make_node("Mul", ["mean", "zero"], ["flat"]),
            helper.make_node("Unsqueeze", ["flat", "last"], ["nothing"]),
            helper.make_node("Add", ["nothing", "canonical_pose"], ["canonical"]),
        ],
        [
            constant("zero", np.zeros(1)),
            numpy_helper.from_array(np.array([2], np.int64), "last"),
            constant("canonical_pose", canonical),
        ],
    )
    card = {
        "version": 2,
        "name": "tiny",
        "hand_seg_net": {"input_size": [height, width]},
        "pose_net_2d": {
            "crop_size": crop_size,
            "crop_kind": "square",
            "crop_margin": 1.5,
            "heatmap_decode": "subpixel",
            "map_size": map_size,
        },
    }
    (folder / "card.json").write_text(json.dumps(card))
    return folder
