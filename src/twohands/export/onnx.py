"""Trained networks as ONNX files with a card: the folder that `inference` loads, without torch."""

from __future__ import annotations

import dataclasses
import logging
import math
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
import onnx
import onnx.numpy_helper
import onnxscript.optimizer
import torch
from torch import Tensor, nn

from twohands.errors import CheckpointError, InputError
from twohands.files import appearing
from twohands.inference.int8 import WEIGHT_LEVELS, kernel_peaks
from twohands.inference.weights import CARD_VERSION, NETWORK_INPUT, write_card
from twohands.models.checkpoint import BYTES, HALF, SCALE, describe, load_network, read_note
from twohands.models.hand_check import HandCheck
from twohands.models.hand_seg_net import HandSegNet
from twohands.models.pose_net_2d import PoseNet2D, PoseNet2DConfig
from twohands.models.pose_net_3d import PoseNet3D
from twohands.models.presets import NetworkConfigs
from twohands.skeleton import N_JOINTS

OPSET = 18
WHOLE = "_whole"
"""Ending of the name of a kernel in whole numbers, as float32."""
SMALL_TENSOR = 1024
"""Weights with fewer values stay float32."""


class CoarseMaps(nn.Module):
    """HandSegNet whose maps are as large as it computes them: to enlarge them takes a fifth of its time on a CPU, and
    whoever wants them large does it faster."""

    def __init__(self, net: HandSegNet) -> None:
        super().__init__()
        self.net = net

    def forward(self, x: Tensor) -> tuple[Tensor, ...]:
        """(B, 3, H, W) -> (B, 3, h, w) and (B, 2, h, w), and perhaps `TURN_MAPS`."""
        return self.net.coarse(x)


class HeatmapNet(nn.Module):
    """PoseNet2D whose output is what PoseNet3D consumes, and its judgement if it has one."""

    def __init__(self, net: PoseNet2D) -> None:
        super().__init__()
        self.net = net

    def forward(self, x: Tensor) -> tuple[Tensor, ...]:
        """(B, 3, S, S) -> heatmaps (B, 21 + cues, 32, 32) and perhaps (B, 1 or 2) log-odds."""
        outputs, hand_logit = self.net.judged(x)
        heatmaps = self.net.heatmaps(outputs)
        return (heatmaps,) if hand_logit is None else (heatmaps, hand_logit)


def export_network(
    network: nn.Module, path: str | Path, note: Mapping[str, Any] | None = None, map_size: int = 32
) -> None:
    """Write one network as ONNX with float32 arithmetic, small weights (`small_weights`) and a free batch size,
    atomically.

    Batch normalisation stays in the graph (runtimes fold it when they load it) and weights keep their names, so that
    `models.checkpoint.load_network` reads the file too and training can go on from it.

    Args:
        network: HandSegNet (outputs seg_logits, energy_logits and perhaps turn_maps, as `HandSegNet.coarse`), PoseNet2D
            (output heatmaps, as PoseNet3D consumes them, and hand_logit if it judges), PoseNet3D (output canonical) or
            HandCheck (output hand_logit). Inputs are normalised, NCHW.
        path: destination.
        note: as for `models.checkpoint.save_network`.
        map_size: of the heatmaps that PoseNet3D is given, side in cells.

    Raises:
        InputError: another kind of network.
    """
    if isinstance(network, HandSegNet):
        shape = (2, 3, network.config.height, network.config.width_px)
        name, model, inputs, outputs = "hand_seg_net", CoarseMaps(network), "image", ["seg_logits", "energy_logits"]
        outputs += ["turn_maps"] if network.turn is not None else []
    elif isinstance(network, PoseNet2D):
        shape = (2, 3, network.config.crop_size, network.config.crop_size)
        name, model, inputs, outputs = "pose_net_2d", HeatmapNet(network), "crop", ["heatmaps"]
        outputs += ["hand_logit"] if network.judge is not None else []
    elif isinstance(network, PoseNet3D):
        shape = (2, N_JOINTS + network.config.cues, map_size, map_size)
        name, model, inputs, outputs = "pose_net_3d", network, "heatmaps", ["canonical"]
    elif isinstance(network, HandCheck):
        shape = (2, 3, network.config.crop_size, network.config.crop_size)
        name, model, inputs, outputs = "hand_check", network, "crop", ["logits"]
    else:
        raise InputError(f"cannot export a {type(network).__name__}")
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    was_training = network.training
    model.eval()
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            model,
            (torch.zeros(shape),),
            dynamo=True,
            opset_version=OPSET,
            input_names=[inputs],
            output_names=outputs,
            dynamic_shapes=({0: torch.export.Dim("batch", min=1, max=4096)},),
            optimize=False,  # it would fold batch normalisation
            verbose=False,
        )
    network.train(was_training)
    assert program is not None
    onnxscript.optimizer.fold_constants(program.model)
    onnxscript.optimizer.remove_unused_nodes(program.model)
    result = without_traces(small_weights(program.model_proto))
    prefix = "" if model is network else "net."
    for key, value in {**describe(name, network, note), "prefix": prefix}.items():
        result.metadata_props.add(key=key, value=value)
    with appearing(path) as partial:
        onnx.save(result, str(partial))


def small_weights(model: onnx.ModelProto) -> onnx.ModelProto:
    """Store kernels of convolutions in 8 bits and other large weights as float16, to be turned into float32 when the
    model is loaded.

    A quarter of the file and less; the arithmetic stays float32. Kernels get one scale per output channel, the very
    steps to which `inference.int8` rounds them; a weight moves by at most 0.4 % of its channel's largest. Others change
    by less than 0.05 % of themselves.

    Args:
        model: with float32 initializers; not changed.

    Returns:
        The same network with nodes that make float32 of every large initializer: Cast, and Mul behind it for kernels.
    """
    result = onnx.ModelProto()
    result.CopyFrom(model)
    kernels = {node.input[1] for node in result.graph.node if node.op_type == "Conv"}
    made = []
    for tensor in list(result.graph.initializer):
        if tensor.data_type != onnx.TensorProto.FLOAT or math.prod(tensor.dims) < SMALL_TENSOR:
            continue
        name, values = tensor.name, onnx.numpy_helper.to_array(tensor)
        if name in kernels:
            scale = kernel_peaks(values) / (WEIGHT_LEVELS // 2)
            tensor.CopyFrom(onnx.numpy_helper.from_array(np.round(values / scale).astype(np.int8), name + BYTES))
            result.graph.initializer.append(onnx.numpy_helper.from_array(scale, name + SCALE))
            made.append(onnx.helper.make_node("Cast", [name + BYTES], [name + WHOLE], to=onnx.TensorProto.FLOAT))
            made.append(onnx.helper.make_node("Mul", [name + WHOLE, name + SCALE], [name]))
        elif np.abs(values).max() <= np.finfo(np.float16).max:
            tensor.CopyFrom(onnx.numpy_helper.from_array(values.astype(np.float16), name + HALF))
            made.append(onnx.helper.make_node("Cast", [name + HALF], [name], to=onnx.TensorProto.FLOAT))
    nodes = list(result.graph.node)
    del result.graph.node[:]
    result.graph.node.extend([*made, *nodes])
    onnx.checker.check_model(result)
    return result


def without_traces(model: onnx.ModelProto) -> onnx.ModelProto:
    """The same network without what the exporter notes about its nodes: stack traces with the paths of this machine.

    Args:
        model: changed in place.
    """
    for node in model.graph.node:
        del node.metadata_props[:]
        node.doc_string = ""
    for value in (*model.graph.input, *model.graph.output, *model.graph.value_info, *model.graph.initializer):
        del value.metadata_props[:]
        value.doc_string = ""
    del model.graph.metadata_props[:]
    return model


def export_preset(
    checkpoints: Mapping[str, Path], folder: Path, *, name: str, further: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Write the three networks and their card.

    Args:
        checkpoints: "hand_seg_net", "pose_net_2d", "pose_net_3d" -> file written by the trainer.
        folder: destination, made if missing.
        name: the preset's name.
        further: values added to the card as they are (hardware, measured accuracy, ...).

    Returns:
        The card.

    Raises:
        CheckpointError: a checkpoint is missing, damaged, or was not written by the trainer.
        InputError: the pose networks' cues differ.
    """
    networks = {key: load_network(key, checkpoints[key]) for key in ("hand_seg_net", "pose_net_2d", "pose_net_3d")}
    NetworkConfigs(**{key: network.config for key, network in networks.items()}).check_cues()  # type: ignore[arg-type]
    notes = {key: read_note(path) for key, path in checkpoints.items()}
    crop = notes["pose_net_2d"].get("crop")
    if crop is None:
        raise CheckpointError(f"{checkpoints['pose_net_2d']}: does not say how its crops were cut; train it again")
    configs: dict[str, dict[str, Any]] = {key: dataclasses.asdict(net.config) for key, net in networks.items()}  # type: ignore[arg-type]
    seg, pose = configs["hand_seg_net"], configs["pose_net_2d"]
    map_size = cast(PoseNet2DConfig, networks["pose_net_2d"].config).map_size
    card = {
        "version": CARD_VERSION,
        "name": name,
        "hand_seg_net": {**seg, "input_size": [seg["height"], seg["width_px"]], "network_input": NETWORK_INPUT},
        "pose_net_2d": {
            **pose,
            "map_size": map_size,
            "crop_kind": crop["kind"],
            "crop_margin": crop["margin"],
            "background": crop.get("background", 0.0),
            "heatmap_decode": "softargmax" if pose["activation"] == "softmax" else "subpixel",
        },
        "pose_net_3d": configs["pose_net_3d"],
        "training": notes,
        **dict(further or {}),
    }
    folder.mkdir(parents=True, exist_ok=True)
    # The card comes last: an older one must not stand beside newer networks if this is cut short.
    (folder / "card.json").unlink(missing_ok=True)
    for key, network in networks.items():
        export_network(network, folder / f"{key}.onnx", notes[key], map_size)
    write_card(folder, card)
    return card
