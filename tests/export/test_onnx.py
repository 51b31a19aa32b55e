"""The exported networks answer like the trained ones, for any batch size, in the runtime that users have."""

import dataclasses
import json

import numpy as np
import pytest
import torch
from onnx import ModelProto, TensorProto, helper, load, numpy_helper, save
from tests.training.tiny import NETWORKS

from twohands.errors import CheckpointError, InputError
from twohands.export import onnx
from twohands.inference.engine import OpenVinoNetwork
from twohands.inference.runtime import open_core, read_network
from twohands.inference.weights import read_card
from twohands.models.checkpoint import load_network, network_name, read_note, save_network
from twohands.models.pose_net_2d import PoseNet2D, PoseNet2DConfig
from twohands.models.presets import build_network

NAMES = ("hand_seg_net", "pose_net_2d", "pose_net_3d")
SHAPES = {"hand_seg_net": (3, 64, 96), "pose_net_2d": (3, 128, 128), "pose_net_3d": (24, 32, 32)}
OUTPUTS = {
    "hand_seg_net": ["seg_logits", "energy_logits"],
    "pose_net_2d": ["heatmaps", "hand_logit"],
    "pose_net_3d": ["canonical"],
}
NOTES = {"pose_net_2d": {"crop": {"kind": "perspective", "margin": 1.4}, "recipe": "ours"}}


def lively(name: str) -> torch.nn.Module:
    """A network whose batch statistics have moved and whose output layers are not small."""
    torch.manual_seed(1)
    network = build_network(name, getattr(NETWORKS, name))
    for parameter in network.parameters():
        parameter.data += 0.05 * torch.randn_like(parameter)
    with torch.no_grad():
        for _ in range(30):
            network(torch.rand(4, *SHAPES[name]))
    return network.eval()


@pytest.fixture(scope="module")
def networks() -> dict[str, torch.nn.Module]:
    return {name: lively(name) for name in NAMES}


@pytest.fixture(scope="module")
def checkpoints(networks, tmp_path_factory):
    folder = tmp_path_factory.mktemp("checkpoints")
    for name, network in networks.items():
        save_network(name, network, folder / f"{name}.safetensors", note=NOTES.get(name, {"seed": 4}))
    return {name: folder / f"{name}.safetensors" for name in NAMES}


@pytest.fixture(scope="module")
def preset(checkpoints, tmp_path_factory):
    """(folder, card) of the exported networks; exporting takes seconds, so it is done once."""
    folder = tmp_path_factory.mktemp("weights") / "mini"
    return folder, onnx.export_preset(checkpoints, folder, name="mini", further={"hardware": "2 cores"})


def run(path, inputs: np.ndarray) -> dict[str, np.ndarray]:
    core = open_core()
    compiled = core.compile_model(read_network(core, path), "CPU", {"INFERENCE_PRECISION_HINT": "f32"})
    result = compiled(inputs)
    return {port.get_any_name(): result[port] for port in compiled.outputs}


def answer(name: str, network: torch.nn.Module, inputs: np.ndarray) -> list[np.ndarray]:
    with torch.no_grad():
        if name == "pose_net_2d":
            maps, hand_logit = network.judged(torch.from_numpy(inputs))
            out = network.heatmaps(maps), hand_logit
        elif name == "hand_seg_net":
            out = network.coarse(torch.from_numpy(inputs))
        else:
            out = network(torch.from_numpy(inputs))
    return [o.numpy() for o in (out if isinstance(out, tuple) else (out,))]


@pytest.mark.parametrize("name", NAMES)
def test_openvino_equals_torch_for_any_batch_size(name, preset):
    rng = np.random.default_rng(0)
    network = load_network(name, preset[0] / f"{name}.onnx")
    for batch in (1, 3):
        inputs = rng.uniform(-0.5, 0.5, (batch, *SHAPES[name])).astype(np.float32)
        outputs = run(preset[0] / f"{name}.onnx", inputs)
        assert list(outputs) == OUTPUTS[name]
        for found, wanted in zip(outputs.values(), answer(name, network, inputs), strict=True):
            assert found.shape == wanted.shape
            scale = np.abs(wanted).max()
            if wanted.size == batch:  # one number per crop
                np.testing.assert_allclose(found, wanted, atol=1e-4)
                continue
            assert wanted.std() > 0.005 * scale, "a constant output would compare equal to anything"
            assert np.abs(found - wanted).max() < 1e-4 * scale


@pytest.mark.parametrize("name", NAMES)
def test_small_weights_answer_nearly_like_the_trained_ones(name, preset, networks):
    inputs = np.random.default_rng(0).uniform(-0.5, 0.5, (3, *SHAPES[name])).astype(np.float32)
    stored = load_network(name, preset[0] / f"{name}.onnx")
    for found, wanted in zip(*(answer(name, network, inputs) for network in (stored, networks[name])), strict=True):
        if wanted.size > 3:  # not one number per crop, of three crops of noise
            assert np.abs(found - wanted).mean() < 0.1 * wanted.std()  # random weights pass errors on


def test_hand_seg_net_takes_pictures_of_any_size(preset):
    rng = np.random.default_rng(0)
    stored = load_network("hand_seg_net", preset[0] / "hand_seg_net.onnx")
    file, ports = preset[0] / "hand_seg_net.onnx", {"input_channels": 3, "output_channels": (3, 2)}
    network = OpenVinoNetwork(file, **ports, any_size=True)
    for size in ((64, 96), (128, 96), (64, 192), (64, 96)):
        inputs = rng.uniform(-0.5, 0.5, (1, 3, *size)).astype(np.float32)
        wanted = answer("hand_seg_net", stored, inputs)
        for found, expected in zip(network(inputs), wanted, strict=True):
            assert found.shape == expected.shape == (1, expected.shape[1], size[0] // 2, size[1] // 2)
            assert np.abs(found - expected).mean() < 0.05 * expected.std()


@pytest.mark.parametrize("name", NAMES)
def test_training_can_go_on_from_an_exported_network(name, preset, networks):
    path = preset[0] / f"{name}.onnx"
    assert network_name(path) == name
    assert read_note(path) == NOTES.get(name, {"seed": 4})
    loaded = load_network(name, path)
    assert loaded.config == networks[name].config
    for key, wanted in networks[name].state_dict().items():
        if wanted.ndim == 4:
            step = wanted.abs().amax(dim=(1, 2, 3), keepdim=True) / 127
            assert ((loaded.state_dict()[key] - wanted).abs() <= 0.501 * step).all()
        elif not key.endswith("num_batches_tracked"):
            torch.testing.assert_close(loaded.state_dict()[key], wanted, rtol=5e-4, atol=1e-6)


@pytest.mark.parametrize("name", NAMES)
def test_no_path_of_this_machine_is_exported(name, preset):
    content = (preset[0] / f"{name}.onnx").read_bytes()
    assert b'File "' not in content and b"site-packages" not in content


def test_damaged_onnx_files_are_no_checkpoints(preset, tmp_path):
    path = tmp_path / "pose_net_3d.onnx"
    path.write_bytes((preset[0] / "pose_net_3d.onnx").read_bytes()[:5000])
    with pytest.raises(CheckpointError, match=r"pose_net_3d\.onnx"):
        load_network("pose_net_3d", path)


def test_large_weights_are_stored_small():
    rng = np.random.default_rng(0)
    kernel = rng.normal(size=(32, 16, 3, 3)).astype(np.float32)
    kernel[0] = 0
    weight = rng.normal(size=(64, 64)).astype(np.float32)
    bias = rng.normal(size=64).astype(np.float32)
    graph = helper.make_graph(
        [helper.make_node("Gemm", ["x", "weight", "bias"], ["y"]), helper.make_node("Conv", ["u", "kernel"], ["v"])],
        "tiny",
        [helper.make_tensor_value_info(n, TensorProto.FLOAT, s) for n, s in (("x", [1, 64]), ("u", [1, 16, 8, 8]))],
        [helper.make_tensor_value_info(n, TensorProto.FLOAT, s) for n, s in (("y", [1, 64]), ("v", [1, 32, 6, 6]))],
        [numpy_helper.from_array(v, n) for n, v in (("weight", weight), ("bias", bias), ("kernel", kernel))],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)])
    before = model.SerializeToString()
    small = onnx.small_weights(model)
    assert model.SerializeToString() == before
    assert len(small.SerializeToString()) < 0.4 * len(before)
    stored = {t.name: numpy_helper.to_array(t) for t in small.graph.initializer}
    assert stored["bias"].dtype == np.float32
    np.testing.assert_allclose(stored["weight_half"].astype(np.float32), weight, rtol=5e-4, atol=1e-7)
    assert stored["kernel_bytes"].dtype == np.int8
    rounded = stored["kernel_bytes"] * stored["kernel_scale"]
    steps = np.abs(kernel).max(axis=(1, 2, 3), keepdims=True) / 127  # of each output channel
    assert (np.abs(rounded - kernel) <= 0.501 * steps).all()
    twice = onnx.small_weights(onnx_model_with(model, "kernel", rounded))
    again = {t.name: numpy_helper.to_array(t) for t in twice.graph.initializer}
    np.testing.assert_array_equal(again["kernel_bytes"], stored["kernel_bytes"])  # rounding once is enough


def onnx_model_with(model: ModelProto, name: str, values: np.ndarray) -> ModelProto:
    changed = ModelProto()
    changed.CopyFrom(model)
    for tensor in changed.graph.initializer:
        if tensor.name == name:
            tensor.CopyFrom(numpy_helper.from_array(values.astype(np.float32), name))
    return changed


@pytest.mark.parametrize("name", NAMES)
def test_kernels_are_plain_constants_when_a_network_is_read(name, preset):
    path = preset[0] / f"{name}.onnx"
    model = read_network(open_core(), path)
    kernels = [op.input_value(1).get_node() for op in model.get_ordered_ops() if op.get_type_name() == "Convolution"]
    assert kernels and {node.get_type_name() for node in kernels} == {"Constant"}
    state = load_network(name, path).state_dict()
    wanted = {key: value.numpy() for key, value in state.items() if value.ndim == 4}
    found = [np.asarray(node.data) for node in kernels]
    assert len(found) == len(wanted)
    for values in wanted.values():
        assert any(values.shape == other.shape and np.array_equal(values, other) for other in found)


def test_a_kernel_without_its_scale_is_no_checkpoint(preset, tmp_path):
    model = load(preset[0] / "pose_net_3d.onnx")
    scale = next(tensor for tensor in model.graph.initializer if tensor.name.endswith("_scale"))
    scale.name = "other"
    save(model, tmp_path / "pose_net_3d.onnx")
    with pytest.raises(CheckpointError, match="scale"):
        load_network("pose_net_3d", tmp_path / "pose_net_3d.onnx")


def test_inference_understands_the_preset(preset):
    folder, written = preset
    card = read_card(folder)
    assert card.name == "mini"
    assert tuple(card.seg_input_size) == (64, 96)
    assert (card.crop_size, card.crop_kind, card.crop_margin) == (128, "perspective", 1.4)
    assert card.hand_logit and card.cues == 3
    assert card.heatmap_decode == "softargmax"
    assert written == json.loads((folder / "card.json").read_text())
    assert written["hardware"] == "2 cores" and written["training"]["hand_seg_net"]["seed"] == 4
    assert sorted(file.name for file in folder.iterdir()) == ["card.json", *(f"{name}.onnx" for name in NAMES)]


def test_exporting_leaves_the_network_as_it_was(tmp_path):
    network = lively("pose_net_3d").train()
    before = {name: tensor.clone() for name, tensor in network.state_dict().items()}
    onnx.export_network(network, tmp_path / "net.onnx")
    assert network.training
    assert all(torch.equal(before[name], tensor) for name, tensor in network.state_dict().items())


def test_a_pose_machine_is_exported_by_its_last_stage():
    network = PoseNet2D(PoseNet2DConfig("cpm9", stages=2, width=0.07)).eval()
    crop = torch.rand(1, 3, 256, 256)
    with torch.no_grad():
        assert torch.equal(onnx.HeatmapNet(network)(crop)[0], network(crop)[1])


def test_other_modules_are_refused(tmp_path):
    with pytest.raises(InputError, match="Linear"):
        onnx.export_network(torch.nn.Linear(2, 2), tmp_path / "net.onnx")


def test_linear_maps_are_read_by_sub_pixel(checkpoints, tmp_path, monkeypatch):
    config = PoseNet2DConfig("encoder-decoder", crop_size=160, stages=1, width=0.1, activation="linear", cues=3)
    linear = tmp_path / "linear.safetensors"
    save_network("pose_net_2d", PoseNet2D(config), linear, note={"crop": {"kind": "square", "margin": 1.5}})
    monkeypatch.setattr(onnx, "export_network", lambda *_: None)  # only the card matters here
    card = onnx.export_preset({**checkpoints, "pose_net_2d": linear}, tmp_path / "mini", name="mini")
    assert card["pose_net_2d"]["heatmap_decode"] == "subpixel"
    assert card["pose_net_2d"]["map_size"] == 40
    assert card["pose_net_2d"]["crop_kind"] == "square"


def test_checkpoints_that_are_swapped_unexplained_or_do_not_fit_are_refused(checkpoints, networks, tmp_path):
    """Before anything is written. Named case: networks of different cues made a preset that could not be loaded."""
    with pytest.raises(CheckpointError, match="holds weights of 'pose_net_3d'"):
        onnx.export_preset({**checkpoints, "pose_net_2d": checkpoints["pose_net_3d"]}, tmp_path / "mini", name="mini")
    save_network("pose_net_2d", networks["pose_net_2d"], tmp_path / "bare.safetensors")
    with pytest.raises(CheckpointError, match="how its crops were cut"):
        onnx.export_preset(
            {**checkpoints, "pose_net_2d": tmp_path / "bare.safetensors"}, tmp_path / "mini", name="mini"
        )
    fewer = PoseNet2D(dataclasses.replace(NETWORKS.pose_net_2d, cues=2))
    save_network("pose_net_2d", fewer, tmp_path / "fewer.safetensors", note=NOTES["pose_net_2d"])
    with pytest.raises(InputError, match="gives 2 cues, but pose_net_3d takes 3"):
        onnx.export_preset(
            {**checkpoints, "pose_net_2d": tmp_path / "fewer.safetensors"}, tmp_path / "mini", name="mini"
        )
    assert not (tmp_path / "mini").exists()
