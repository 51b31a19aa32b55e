"""The three networks as plain functions of arrays, run by OpenVINO.

The estimator knows only `Networks`: three callables. A test, or another runtime, hands in its own.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from threading import Lock
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from twohands.errors import CheckpointError
from twohands.geometry.body import FINDER_SIZE, JOINTS_SIZE
from twohands.geometry.palm import PALM_SIZE
from twohands.geometry.picture_turn import TURN_MAPS
from twohands.inference.body import BodyNetworks
from twohands.inference.int8 import quantise
from twohands.inference.palm import PalmDetector
from twohands.inference.runtime import import_openvino, open_core, read_network
from twohands.inference.weights import (
    BODY_NETWORKS,
    HAND_CHECK,
    PALM_DETECTOR,
    WeightsCard,
    network_files,
    read_card,
    second_folder,
)
from twohands.skeleton import N_JOINTS

HEAVY_LAYERS = ("Convolution", "FullyConnected", "MatMul")
"""OpenVINO's names of the layers that take nearly all the time."""

FINDER_SHAPE, JOINTS_SHAPE, PALM_SHAPE = (FINDER_SIZE, 2254, 2254), (JOINTS_SIZE, 195, 1), (PALM_SIZE, 2016, 2016)
"""Second dimensions of what the published networks of bodies and palms take and give."""
NO_PEAKS: Final[Mapping[str, float]] = MappingProxyType({})


@dataclass(frozen=True, slots=True)
class SecondNetworks:
    """Pose networks that know hands which a preset's own do not, and what they expect.

    Attributes:
        card: of their own preset.
        pose_net_2d, pose_net_3d: as in `Networks`.
        hand_check: (B, 3, S, S) -> (B, 2) log-odds that crops show a hand, and a left one (`models.hand_check`); None
            without.
        body: of people's bodies; None without.
        palm: of palms; None without.
    """

    card: WeightsCard
    pose_net_2d: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
    pose_net_3d: Callable[[np.ndarray], np.ndarray]
    hand_check: Callable[[np.ndarray], np.ndarray] | None = None
    body: BodyNetworks | None = None
    palm: PalmDetector | None = None


@dataclass(frozen=True, slots=True)
class Networks:
    """The learned parts of the pipeline; float32 arrays in and out, B any batch size.

    Attributes:
        hand_seg_net: (B, 3, h, w), h and w multiples of 32 -> seg_logits (B, 3, h', w') for background, left, right,
            and energy_logits (B, 2, h', w') for left, right; and, if the card says so, the maps that
            `geometry.picture_turn.turn_logits` reads.
        pose_net_2d: (B, 3, S, S) -> heatmaps (B, 21 + cues, M, M), and (B,) log-odds that a crop shows a hand of the
            side it was cut for, 0 from a network without a hand classifier; of one with published layers, a hand of
            either side.
        pose_net_3d: (B, 21 + cues, M, M) -> canonical joints (B, 21, 3) of a left-like hand.
        runtime: what runs them and in which arithmetic, for the reader.
        second: pose networks that know other hands; None without any.
    """

    hand_seg_net: Callable[[np.ndarray], tuple[np.ndarray, ...]]
    pose_net_2d: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
    pose_net_3d: Callable[[np.ndarray], np.ndarray]
    runtime: str = "functions"
    second: SecondNetworks | None = None


class OpenVinoNetwork:
    """One ONNX or TensorFlow Lite file, compiled for the CPU, called like a function, from any number of threads.

    The arithmetic is int8 where the peaks of the activations are known, else float32, also where the processor has
    units for bfloat16: hands that are in the balance would be found on one machine and not on another.

    Args:
        path: the file.
        input_channels: second dimension of what this role in the pipeline feeds.
        output_channels: second dimension of each output that this role promises; further ones of published networks
            are left out.
        threads: CPU threads; 0 leaves OpenVINO's choice.
        any_size: whether it is given pictures of any size, whatever the file says. It is slower by a fiftieth then, and
            the first picture of another form is no delay.
        int8_peaks: peaks of its activations (`inference.int8`); none for floating point.

    Raises:
        CheckpointError: the file is missing, damaged, or holds a network for another role.
    """

    def __init__(
        self,
        path: Path,
        *,
        input_channels: int,
        output_channels: tuple[int, ...],
        threads: int = 0,
        any_size: bool = False,
        int8_peaks: Mapping[str, float] = NO_PEAKS,
    ) -> None:
        core = open_core()
        try:
            model = read_network(core, path)
        except (RuntimeError, ValueError) as error:  # ValueError: of its own message, where a damaged name is no text
            raise CheckpointError(f"{path}: not a readable network") from error
        if path.suffix == ".tflite":
            model = import_openvino().Model(model.outputs[: len(output_channels)], model.get_parameters())
        found_in = [_channels(port) for port in model.inputs]
        found_out = [_channels(port) for port in model.outputs]
        if found_in != [input_channels] or found_out != list(output_channels):
            raise CheckpointError(
                f"{path}: another network; expected {input_channels} channels in and {list(output_channels)} out, "
                f"found {found_in} in and {found_out} out"
            )
        quantise(model, int8_peaks)
        if any_size:
            model.reshape([-1, input_channels, -1, -1])
        config = {
            "PERFORMANCE_HINT": "LATENCY",
            "INFERENCE_NUM_THREADS": threads,
            "INFERENCE_PRECISION_HINT": "f32",  # bfloat16 where there is AMX sees other hands than elsewhere
        }
        self._to_compile: Callable[[], Any] | None = partial(core.compile_model, model, "CPU", config)
        self._compiling = Lock()
        self._idle: deque[Any] = deque()  # requests that no thread is using

    def compile(self) -> None:
        """Do now what the first call would do first."""
        with self._compiling:
            if self._to_compile is not None:
                self._network = self._to_compile()
                self._to_compile = None  # what was read takes as much memory again

    def __call__(self, batch: np.ndarray) -> tuple[np.ndarray, ...]:
        """Run the network.

        Args:
            batch: (B, C, H, W) float32.

        Returns:
            Every output, in the order of the file.
        """
        self.compile()
        try:
            request = self._idle.pop()
        except IndexError:
            request = self._network.create_infer_request()
        result = request.infer([np.ascontiguousarray(batch, dtype=np.float32)], share_inputs=True)
        outputs = tuple(result[port] for port in self._network.outputs)  # copies: the request serves the next call
        self._idle.append(request)
        return outputs

    @property
    def threads(self) -> int:
        """CPU threads that it really uses."""
        self.compile()
        return self._network.get_property("INFERENCE_NUM_THREADS")

    @property
    def arithmetic(self) -> set[str]:
        """Numbers that convolutions and matrices are multiplied in: "f32", "bf16", "f16", "int8"; as compiled for this
        processor, whatever the file says."""
        self.compile()
        layers = [op.get_rt_info() for op in self._network.get_runtime_model().get_ops()]
        heavy = [layer for layer in layers if layer["layerType"].value in HEAVY_LAYERS]
        found = {str(layer["runtimePrecision"].value) for layer in heavy}
        return {"int8" if name in ("u8", "i8") else name for name in found}


def load_networks(folder: Path, card: WeightsCard, threads: int = 0) -> Networks:
    """Compile the networks of a preset's folder, its second pose networks included.

    Args:
        folder: of the preset.
        card: what the preset's card says.
        threads: CPU threads; 0 leaves OpenVINO's choice, all cores.

    Raises:
        CheckpointError: a file is missing, damaged, or holds another network.
    """

    def opened(folder: Path, card: WeightsCard, name: str, inputs: int, *outputs: int) -> OpenVinoNetwork:
        return OpenVinoNetwork(
            network_files(folder, card)[name],
            input_channels=inputs,
            output_channels=outputs,
            threads=threads,
            any_size=name == "hand_seg_net",
            int8_peaks=card.int8.get(name, NO_PEAKS),
        )

    def pose_networks(folder: Path, card: WeightsCard) -> tuple[OpenVinoNetwork, OpenVinoNetwork]:
        maps = N_JOINTS + card.cues
        outputs = (maps, card.hand_logit + card.published_layers) if card.hand_logit else (maps,)
        return opened(folder, card, "pose_net_2d", 3, *outputs), opened(folder, card, "pose_net_3d", maps, N_JOINTS)

    maps = (3, 2, TURN_MAPS) if card.says_turn else (3, 2)
    seg, first = opened(folder, card, "hand_seg_net", 3, *maps), pose_networks(folder, card)
    used, second = [seg, *first], None
    if card.second:
        other = second_folder(folder, card)
        others_card = read_card(other)
        others = pose_networks(other, others_card)
        used += others
        check = None
        if others_card.check_size:
            network = opened(other, others_card, HAND_CHECK, 3, 2)
            used.append(network)
            check = partial(_only_output, network)
        body = None
        if others_card.body:
            shapes = zip(BODY_NETWORKS, (FINDER_SHAPE, JOINTS_SHAPE), strict=True)
            of_body = [opened(other, others_card, name, *shape) for name, shape in shapes]
            used += of_body
            body = BodyNetworks(*of_body)
        palm = None
        if others_card.palm:
            palm = opened(other, others_card, PALM_DETECTOR, *PALM_SHAPE)
            used.append(palm)
        second = SecondNetworks(others_card, *_pose_functions(*others), check, body, palm)
    # Nothing but this side by side: where Python looks into networks, it and OpenVINO may wait for each other's locks.
    with ThreadPoolExecutor() as pool:
        list(pool.map(OpenVinoNetwork.compile, used))
    arithmetic = " and ".join(sorted({kind for network in used for kind in network.arithmetic}))
    runtime = f"OpenVINO on {seg.threads} thread{'s'[: seg.threads > 1]} in {arithmetic}"

    return Networks(seg, *_pose_functions(*first), runtime, second)


def _pose_functions(
    pose_2d: OpenVinoNetwork, pose_3d: OpenVinoNetwork
) -> tuple[Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]], Callable[[np.ndarray], np.ndarray]]:
    """`pose_net_2d` and `pose_net_3d` of `Networks`."""

    def pose_net_2d(batch: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        heatmaps, *judged = pose_2d(batch)
        return heatmaps, judged[0][:, -1] if judged else np.zeros(len(batch), np.float32)

    return pose_net_2d, partial(_only_output, pose_3d)


def _only_output(network: OpenVinoNetwork, batch: np.ndarray) -> np.ndarray:
    return network(batch)[0]


def _channels(port: object) -> int | None:
    """Second dimension of a network's input or output; None where it is free or there is none."""
    shape = port.get_partial_shape()  # type: ignore[attr-defined]
    if shape.rank.is_dynamic or shape.rank.get_length() < 2 or shape[1].is_dynamic:
        return None
    return shape[1].get_length()
