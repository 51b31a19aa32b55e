"""Weights of one network in one file, with what is needed to build the network again. No pickle.

The trainer writes safetensors; the ONNX files of a preset hold the same weights (rounded to 8 bits or half precision)
and the same metadata, so that training can go on from shipped weights.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from twohands.errors import CheckpointError, InputError
from twohands.files import appearing, let_others_read
from twohands.models.presets import NETWORKS, build_network, config_from_dict

FORMAT = "twohands-checkpoint-1"
HALF = "_half"
"""Ending of the name of a weight that an ONNX file stores in half precision."""
BYTES, SCALE = "_bytes", "_scale"
"""Endings of the names of a kernel that it stores in 8 bits, and of the scale of each of its output channels."""


def save_tensors(tensors: Mapping[str, Tensor], metadata: Mapping[str, str], path: str | Path) -> None:
    """Write a safetensors file atomically: a reader sees the old file or the new one, never half of one.

    Args:
        tensors: name -> tensor; tensors may share memory with a live network, they are not changed.
        metadata: strings stored in the file's header.
        path: destination; its folder is made if missing.

    Raises:
        InputError: it cannot be written.
    """
    path = Path(path)
    plain = {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with appearing(path) as partial:
            save_file(plain, partial, metadata=dict(metadata))
            let_others_read(partial)
    except (OSError, SafetensorError) as error:
        raise InputError(f"{path}: cannot be written: {error}") from error


def load_tensors(path: str | Path) -> tuple[dict[str, Tensor], dict[str, str]]:
    """Read a safetensors file.

    Returns:
        (tensors, metadata).

    Raises:
        CheckpointError: the file is missing or damaged.
    """
    if not Path(path).is_file():
        raise CheckpointError(f"no weights at {path}")
    try:
        with safe_open(path, framework="pt") as file:
            return {name: file.get_tensor(name) for name in file.keys()}, dict(file.metadata() or {})  # noqa: SIM118
    except SafetensorError as error:
        raise CheckpointError(f"{path} is no readable safetensors file: {error}") from error


def save_network(name: str, network: nn.Module, path: str | Path, *, note: Mapping[str, Any] | None = None) -> None:
    """Write one network.

    Args:
        name: "hand_seg_net", "pose_net_2d" or "pose_net_3d".
        network: a network of that kind.
        path: destination file.
        note: further JSON values to keep beside the weights (recipe, seed, accuracy).

    Raises:
        CheckpointError: `network` is not of the named kind.
    """
    if name not in NETWORKS or type(network) is not NETWORKS[name].network:
        raise CheckpointError(f"cannot save a {type(network).__name__} as '{name}'")
    save_tensors(network.state_dict(), describe(name, network, note), path)


def describe(name: str, network: nn.Module, note: Mapping[str, Any] | None = None) -> dict[str, str]:
    """The metadata of a file that holds this network."""
    return {
        "format": FORMAT,
        "network": name,
        "config": json.dumps(dataclasses.asdict(network.config)),  # type: ignore[arg-type]
        "note": json.dumps(dict(note or {})),
    }


def _load_onnx(path: Path) -> tuple[dict[str, Tensor], dict[str, str]]:
    """Weights and metadata of a file written by `export.onnx.export_network`."""
    import onnx
    import onnx.numpy_helper
    from google.protobuf.message import DecodeError

    try:
        model = onnx.load(str(path))
    except (DecodeError, OSError) as error:
        raise CheckpointError(f"{path} is no readable ONNX file: {error}") from error
    metadata = {entry.key: entry.value for entry in model.metadata_props}
    prefix = metadata.get("prefix", "")
    stored = {entry.name: onnx.numpy_helper.to_array(entry) for entry in model.graph.initializer}
    tensors = {}
    for name, values in stored.items():
        plain = name.removesuffix(HALF).removesuffix(BYTES)
        if plain + BYTES == name:
            if plain + SCALE not in stored:
                raise CheckpointError(f"{path}: no scale for '{name}'")
            values = values * stored[plain + SCALE]
        if plain.startswith(prefix):
            tensors[plain.removeprefix(prefix)] = torch.from_numpy(values.copy())
    return tensors, metadata


def _load(path: str | Path) -> tuple[dict[str, Tensor], dict[str, str]]:
    path = Path(path)
    return _load_onnx(path) if path.suffix == ".onnx" and path.is_file() else load_tensors(path)


def load_network(name: str, path: str | Path) -> nn.Module:
    """Build the network that a file describes and fill it.

    Args:
        name: the network that is expected.
        path: a file written by `save_network`, or the ONNX file of a preset.

    Returns:
        The network, in evaluation mode.

    Raises:
        CheckpointError: missing, damaged, of another network, or its tensors do not fit its configuration.
    """
    tensors, metadata = _load(path)
    found = metadata.get("network")
    if metadata.get("format") != FORMAT:
        raise CheckpointError(f"{path} is not a twohands checkpoint (format {metadata.get('format')!r})")
    if found != name:
        raise CheckpointError(f"{path} holds weights of '{found}', but '{name}' was asked for")
    try:
        network = build_network(name, config_from_dict(name, json.loads(metadata["config"])))
        if Path(path).suffix == ".onnx":
            wanted = network.state_dict()
            counters = {key: value for key, value in wanted.items() if _is_counter(key)}
            weights = {key: tensors[key].to(value.dtype) for key, value in wanted.items() if key not in counters}
            tensors = weights | counters
        network.load_state_dict(tensors)
    except (KeyError, ValueError, InputError, RuntimeError) as error:
        message = str(error).splitlines()[0]
        raise CheckpointError(f"{path}: weights and configuration of '{name}' do not fit: {message}") from error
    return network.eval()


def _is_counter(key: str) -> bool:
    """Whether a buffer only counts batches: batch normalisation keeps one that ONNX has no place for."""
    return key.endswith("num_batches_tracked")


def network_name(path: str | Path) -> str | None:
    """Which network a file holds, None if it does not say.

    Raises:
        CheckpointError: the file is missing or damaged.
    """
    return _load(path)[1].get("network")


def read_note(path: str | Path) -> dict[str, Any]:
    """The JSON values stored beside the weights by `save_network`."""
    return json.loads(_load(path)[1].get("note", "{}"))


def same_weights(a: nn.Module, b: nn.Module) -> bool:
    """Whether two networks hold bitwise equal parameters and buffers."""
    first, second = a.state_dict(), b.state_dict()
    return first.keys() == second.keys() and all(torch.equal(first[key], second[key]) for key in first)
