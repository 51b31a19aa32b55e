"""Means of networks, hand-computed, and the presets made of them."""

import json
import shutil

import pytest
import torch
from tests.training.tiny import NETWORKS

from twohands.errors import InputError
from twohands.export.averaging import average_preset, averaged, raise_judge
from twohands.export.onnx import export_preset
from twohands.inference.weights import read_card
from twohands.models.checkpoint import load_network, read_note, save_network
from twohands.models.pose_net_2d import PoseNet2D, PoseNet2DConfig
from twohands.models.pose_net_3d import PoseNet3DConfig
from twohands.models.presets import build_network

NAMES = ("hand_seg_net", "pose_net_2d", "pose_net_3d")


def filled(name: str, value: float) -> torch.nn.Module:
    """A network all of whose weights and statistics are one number."""
    network = build_network(name, getattr(NETWORKS, name))
    with torch.no_grad():
        for values in network.state_dict().values():
            if values.is_floating_point():
                values.fill_(value)
    return network.eval()


@pytest.mark.parametrize("name", NAMES)
def test_every_weight_and_statistic_is_the_mean(name):
    second = filled(name, 6.0)
    mean = averaged(filled(name, 2.0), second, 0.75)
    values = [value for value in mean.state_dict().values() if value.is_floating_point()]
    assert any("running_var" in key for key in mean.state_dict())
    assert all(torch.all(value == 5.0) for value in values)
    assert all(torch.all(value == 6.0) for value in second.state_dict().values() if value.is_floating_point())


def test_shares_of_nothing_and_all_are_the_networks_themselves():
    for share, wanted in ((0.0, 2.0), (1.0, 6.0)):
        mean = averaged(filled("pose_net_3d", 2.0), filled("pose_net_3d", 6.0), share)
        assert all(torch.all(value == wanted) for value in mean.parameters())


def test_no_mean_of_two_shapes_nor_outside_of_both():
    other = build_network("pose_net_3d", PoseNet3DConfig(width=0.25, fc_relu=True, cues=3))
    with pytest.raises(InputError, match="two shapes"):
        averaged(filled("pose_net_3d", 1.0), other, 0.5)
    for share in (-0.1, 1.1, float("nan")):
        with pytest.raises(InputError, match="0 to 1"):
            averaged(filled("pose_net_3d", 1.0), filled("pose_net_3d", 1.0), share)


def test_a_raised_judge_says_that_much_more_of_every_crop_and_the_maps_stay():
    torch.manual_seed(0)
    network = build_network("pose_net_2d", NETWORKS.pose_net_2d).eval()
    assert isinstance(network, PoseNet2D)
    crops = torch.rand(3, 3, 128, 128) - 0.5
    with torch.no_grad():
        maps, before = network.judged(crops)
        raise_judge(network, 0.75)
        same, after = network.judged(crops)
    assert before is not None and after is not None
    torch.testing.assert_close(after, before + 0.75)
    torch.testing.assert_close(same, maps)


def test_without_a_judge_there_is_nothing_to_raise():
    with pytest.raises(InputError, match="no judge"):
        raise_judge(PoseNet2D(PoseNet2DConfig("encoder-decoder", stages=1, width=0.25, activation="softmax")), 1.0)


@pytest.fixture(scope="module")
def preset(tmp_path_factory):
    """A preset "first" of networks full of 2, and trained files full of 6."""
    root = tmp_path_factory.mktemp("averaging")
    for stem, value in (("old", 2.0), ("new", 6.0)):
        for name in NAMES:
            note = {"seed": int(value)} | ({"crop": {"kind": "perspective", "margin": 1.2}} if "2d" in name else {})
            save_network(name, filled(name, value), root / stem / f"{name}.safetensors", note=note)
    export_preset({name: root / "old" / f"{name}.safetensors" for name in NAMES}, root / "first", name="first")
    card = json.loads((root / "first/card.json").read_text())
    card |= {"schedule": "10 min", "int8": {name: {"relu": 1.0} for name in NAMES[:2]}}
    (root / "first/card.json").write_text(json.dumps(card))
    return root


def test_a_preset_of_means_keeps_what_is_not_new(preset):
    new = {name: preset / "new" / f"{name}.safetensors" for name in NAMES[1:]}
    average_preset(preset / "first", new, preset / "mean", share=0.25, judge=0.5)
    card = json.loads((preset / "mean/card.json").read_text())
    assert card["schedule"] == "10 min" and set(card["int8"]) == {"hand_seg_net"}
    assert [card["training"][name]["seed"] for name in NAMES] == [2, 6, 6]
    read_card(preset / "mean")
    first = (preset / "first/hand_seg_net.onnx").read_bytes()
    assert (preset / "mean/hand_seg_net.onnx").read_bytes() == first
    for name in NAMES[1:]:
        assert read_note(preset / "mean" / f"{name}.onnx")["seed"] == 6
        state = load_network(name, preset / "mean" / f"{name}.onnx").state_dict()
        raised = {key for key in state if key.startswith("judge.") and key.endswith(".bias")}
        last = max(raised, default=None)
        for key, values in state.items():
            if values.is_floating_point():
                assert torch.all(values == (3.5 if key == last else 3.0)), key
    assert not list((preset / "mean").glob("*.partial"))


def test_what_cannot_be_averaged_is_said_before_anything_is_written(preset):
    new = {"pose_net_3d": preset / "new/pose_net_3d.safetensors"}
    with pytest.raises(InputError, match="the preset itself"):
        average_preset(preset / "first", new, preset / "first", share=0.5)
    with pytest.raises(InputError, match="the judge is part of pose_net_2d"):
        average_preset(preset / "first", new, preset / "none", share=0.5, judge=1.0)
    card = json.loads((preset / "first/card.json").read_text())
    doubter = preset / "doubter"
    shutil.copytree(preset / "first", doubter)
    (doubter / "card.json").write_text(json.dumps(card | {"second": "first"}))
    with pytest.raises(InputError, match="its second pose networks of 'first': copy that folder"):
        average_preset(doubter, new, preset / "elsewhere/none", share=0.5)
    borrower = preset / "borrower"
    borrower.mkdir()
    (borrower / "card.json").write_text(json.dumps(card | {"networks": dict.fromkeys(NAMES, "first")}))
    with pytest.raises(InputError, match="no pose_net_3d of its own, it takes that of 'first'"):
        average_preset(borrower, new, preset / "none", share=0.5)
    with pytest.raises(InputError, match="'first', which must stand beside it"):
        average_preset(borrower, new, preset / "elsewhere/none", share=0.5)
    assert not (preset / "none").exists() and not (preset / "elsewhere").exists()
