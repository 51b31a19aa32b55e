"""New weights of a preset: means of its networks with trained ones.

A run's last weights follow its last pictures; their mean with the weights that they come from is steadier, and often
better than either (`docs/history/journal.md` has the figures). The pose networks of both shipped presets were made
like this.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import torch
from torch import nn

from twohands.errors import InputError
from twohands.export.onnx import export_network
from twohands.files import write_whole
from twohands.inference.weights import network_files, read_card, second_folder, write_card
from twohands.models.checkpoint import load_network, read_note
from twohands.models.pose_net_2d import PoseNet2D


def averaged(first: nn.Module, second: nn.Module, share: float) -> nn.Module:
    """The network between two of the same shape.

    Args:
        first: changed in place: every weight and statistic w becomes (1 - share) w + share w' with `second`'s w'.
        second: not changed.
        share: of `second`, 0 to 1.

    Returns:
        `first`.

    Raises:
        InputError: two shapes, or a share outside [0, 1].
    """
    if not 0.0 <= share <= 1.0:
        raise InputError(f"a share is 0 to 1, got {share}")
    if first.config != second.config:
        raise InputError(f"networks of two shapes have no mean: {first.config}, {second.config}")
    others = second.state_dict()
    with torch.no_grad():
        for name, values in first.state_dict().items():
            if values.is_floating_point():  # the rest counts batches
                values.lerp_(others[name], share)
    return first


def raise_judge(network: PoseNet2D, log_odds: float) -> None:
    """Let the judge of PoseNet2D believe all hands more by as much.

    Args:
        network: changed in place.
        log_odds: added to what it says of every crop; negative: believe less.

    Raises:
        InputError: it has no judge.
    """
    if network.judge is None:
        raise InputError("this PoseNet2D has no judge to raise")
    output = network.judge[-1]
    assert isinstance(output, nn.Linear)
    with torch.no_grad():
        output.bias.add_(log_odds)


def average_preset(
    preset: Path, checkpoints: Mapping[str, Path], folder: Path, *, share: float, judge: float = 0.0
) -> None:
    """Write a preset whose networks are means of another one's and of trained ones.

    The card is the old one with the new notes of training, and without the peaks for 8 bits of what is new
    (`export.calibration.add_int8` measures them); what it says in words of data and accuracy is for its author to mend.

    Args:
        preset: weights folder to start from.
        checkpoints: names of networks that the preset has of its own -> trained files; the other networks stay.
        folder: destination, made if missing, and another one than `preset`.
        share: of the trained weights, 0 to 1.
        judge: log-odds by which PoseNet2D's judge is raised after that.

    Raises:
        CheckpointError: a file cannot be read.
        InputError: shapes differ, the preset takes such a network from another one or one that is not beside `folder`,
            or there is no judge to raise.
    """
    read = read_card(preset)
    card = json.loads((preset / "card.json").read_text(encoding="utf-8"))
    own = {name: path for name, path in network_files(preset, read).items() if name not in read.networks}
    if folder.resolve() == preset.resolve():
        raise InputError(f"{folder} is the preset itself; choose another folder")
    for name, other in read.networks.items():
        if not network_files(folder, read)[name].is_file():
            raise InputError(f"{folder} takes {name} of '{other}', which must stand beside it: copy that folder there")
    if read.second and not second_folder(folder, read).is_dir():
        raise InputError(f"{folder} takes its second pose networks of '{read.second}': copy that folder beside it")
    for name in checkpoints:
        if name not in own:
            raise InputError(f"{preset} has no {name} of its own, it takes that of '{read.networks[name]}'")
    if judge and "pose_net_2d" not in checkpoints:
        raise InputError("the judge is part of pose_net_2d, which is not among the trained networks")
    means = {}
    for name, path in checkpoints.items():
        means[name] = averaged(load_network(name, own[name]), load_network(name, path), share)
        card.setdefault("training", {})[name] = read_note(path)
        card.get("int8", {}).pop(name, None)
    if judge:
        network = means["pose_net_2d"]
        assert isinstance(network, PoseNet2D)
        raise_judge(network, judge)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "card.json").unlink(missing_ok=True)  # an older one must not stand beside newer networks
    for name, path in own.items():
        if name in means:
            export_network(means[name], folder / path.name, card["training"][name], card["pose_net_2d"]["map_size"])
        else:
            write_whole(folder / path.name, path.read_bytes())
    write_card(folder, card)
