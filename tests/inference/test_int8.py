"""8-bit arithmetic: peaks of activations, and that rounding changes little."""

import dataclasses
import json
import shutil

import numpy as np
import openvino
import pytest
from openvino import opset13 as opset
from tests.oracles import write_tiny_weights

from twohands.cli.demo import examples_folder
from twohands.errors import CheckpointError
from twohands.formats.pictures import list_images, read_image
from twohands.geometry.network_input import letterbox, network_input
from twohands.geometry.picture_turn import TURN_MAPS
from twohands.geometry.segmentation import masks_from_logits
from twohands.inference.engine import OpenVinoNetwork, load_networks
from twohands.inference.int8 import activation_peaks, quantise, worth_rounding
from twohands.inference.runtime import open_core, read_network
from twohands.inference.weights import DEFAULT_PRESET, preset_folder, read_card


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    return write_tiny_weights(tmp_path_factory.mktemp("weights") / "tiny")


def doubling_network():
    """x -> ReLU(2 x) -> times 3, as two 1x1 convolutions."""
    x = opset.parameter([1, 1, 2, 2], np.float32)
    doubled = opset.convolution(x, opset.constant(np.full((1, 1, 1, 1), 2, np.float32)), [1, 1], [0, 0], [0, 0], [1, 1])
    rectified = opset.relu(doubled)
    rectified.set_friendly_name("rectified")
    weight = opset.constant(np.full((1, 1, 1, 1), 3, np.float32))
    result = opset.convolution(rectified, weight, [1, 1], [0, 0], [0, 0], [1, 1])
    return openvino.Model([result], [x])  # pyright: ignore[reportGeneralTypeIssues]


def test_values_after_a_relu_are_clipped_and_rounded_to_256_levels():
    model = doubling_network()
    quantise(model, {"rectified": 51.0})  # steps of 0.2
    core = open_core()
    network = core.compile_model(model, "CPU", {"INFERENCE_PRECISION_HINT": "f32"})
    found = network([np.array([[[[1.04, -1.0], [1.06, 40.0]]]], np.float32)])[0]
    # 2.08 -> 2.0, negative -> 0, 2.12 -> 2.2, 80 -> 51; the weight 3 is its own peak, which is a level
    np.testing.assert_allclose(found.ravel(), [6.0, 0.0, 6.6, 153.0], atol=1e-3)


def test_what_is_not_rectified_is_rounded_symmetrically_and_grouped_kernels_by_channel():
    """x -> 2 x, not rectified -> each channel times its own weight -> ReLU6, as in a linear bottleneck."""
    x = opset.parameter([1, 2, 1, 1], np.float32)
    diagonal = opset.constant(np.diag([2, 2]).astype(np.float32)[..., None, None])
    doubled = opset.convolution(x, diagonal, [1, 1], [0, 0], [0, 0], [1, 1])
    doubled.set_friendly_name("linear")
    kernel = opset.constant(np.array([3.0, -0.5], np.float32).reshape(2, 1, 1, 1, 1))
    grouped = opset.group_convolution(doubled, kernel, [1, 1], [0, 0], [0, 0], [1, 1])
    clipped = opset.clamp(grouped, 0.0, 6.0)
    clipped.set_friendly_name("clipped")
    model = openvino.Model([opset.result(clipped)], [x])  # pyright: ignore[reportGeneralTypeIssues]
    quantise(model, {"linear": 12.7, "clipped": 5.1})  # steps of 0.1 to either side, and of 0.02
    network = open_core().compile_model(model, "CPU", {"INFERENCE_PRECISION_HINT": "f32"})
    found = network([np.array([0.52, -2.04], np.float32).reshape(1, 2, 1, 1)])[0]
    # 1.04 -> 1.0, times 3; -4.08 -> -4.1, times -0.5 is 2.05; to a step of the one or the other
    np.testing.assert_allclose(found.ravel(), [3.0, 2.05], atol=0.055)


def test_what_loses_by_rounding_stays_in_floating_point(tmp_path):
    """The second network's convolution takes the difference of two channels that are nearly alike: in steps of 0.4 of
    102 nothing is left of it. The first one's takes their sum."""
    x = opset.parameter([1, 2, 4, 4], np.float32)
    sums, both = np.array([[1, 1], [1, 1]], np.float32), np.array([[1, -1], [1, 1]], np.float32)
    outputs = []
    for name, kernel in (("sum", sums), ("difference", both)):
        rectified = opset.relu(x)
        rectified.set_friendly_name(name)
        weights = opset.constant(kernel[..., None, None])
        mixed = opset.convolution(rectified, weights, [1, 1], [0, 0], [0, 0], [1, 1])
        outputs.append(opset.split(mixed, 1, 2).output(0))
    path = tmp_path / "network.xml"
    model = openvino.Model(outputs, [x])  # pyright: ignore[reportGeneralTypeIssues]
    openvino.save_model(model, path, compress_to_fp16=False)
    rng = np.random.default_rng(0)
    common = rng.uniform(0, 102, (8, 1, 1, 4, 4))
    batches = [(one + [[[[0.0]], [[0.1]]]] * rng.uniform(-1, 1, (1, 2, 4, 4))).astype(np.float32) for one in common]
    peaks = activation_peaks(path, batches)
    assert set(peaks) == {"sum", "difference"}
    assert worth_rounding(path, peaks, batches) == {"sum": peaks["sum"]}


def test_peaks_are_the_largest_values_over_all_batches():
    rng, folder = np.random.default_rng(0), preset_folder(DEFAULT_PRESET)
    batches = [rng.random((2, 21 + read_card(folder).cues, 32, 32), np.float32) for _ in range(2)]
    path = folder / "pose_net_3d.onnx"
    together, apart = activation_peaks(path, batches), [activation_peaks(path, [batch]) for batch in batches]
    assert together and set(together) == set(apart[0]) | set(apart[1])
    for name, peak in together.items():
        assert peak == max(peaks.get(name, 0.0) for peaks in apart) > 0


def test_peaks_of_pictures_of_several_sizes(tiny):
    """A preset that looks at pictures in several sizes could not be averaged: its own size was all that was
    understood."""
    path, rng = tiny / "hand_seg_net.onnx", np.random.default_rng(0)
    height, width = read_card(tiny).seg_input_size
    batches = [rng.random((1, 3, rows, columns), np.float32) for rows, columns in ((height, width), (64, 96))]
    together, apart = activation_peaks(path, batches), [activation_peaks(path, [batch]) for batch in batches]
    assert together == {name: max(peaks.get(name, 0.0) for peaks in apart) for name in set(apart[0]) | set(apart[1])}


def test_unknown_activations_are_refused(tiny):
    model = read_network(open_core(), tiny / "hand_seg_net.onnx")
    with pytest.raises(CheckpointError, match="int8 names 'other'"):
        quantise(model, {"other": 1.0})


def test_shipped_masks_stay_as_they_are_in_8_bits():
    network_file = preset_folder(DEFAULT_PRESET) / "hand_seg_net.onnx"
    card = read_card(network_file.parent)
    size = card.seg_input_size
    images = [read_image(path) for path in list_images(examples_folder())]
    canvases = [network_input(letterbox(image, size)[0][None]) for image in images]
    ports = {"input_channels": 3, "output_channels": (3, 2, TURN_MAPS), "any_size": True}
    exact, rounded = (
        OpenVinoNetwork(network_file, **ports, int8_peaks=peaks) for peaks in ({}, card.int8["hand_seg_net"])
    )
    assert "int8" in rounded.arithmetic and "int8" not in exact.arithmetic
    changed = []
    for canvas in canvases:
        masks = [masks_from_logits(network(canvas)[0][0], size, np.ones(2, bool)) for network in (exact, rounded)]
        hands = (masks[0] > 0) | (masks[1] > 0)
        assert hands.sum() > 100
        changed.append((masks[0] != masks[1])[hands].mean())
    assert np.median(changed) < 0.02 and max(changed) < 0.12  # in one picture a part of an arm is in the balance


def test_the_card_decides(tmp_path):
    folder = shutil.copytree(preset_folder(DEFAULT_PRESET), tmp_path / "copy")
    inputs = np.random.default_rng(0).random((1, 21 + read_card(folder).cues, 32, 32), np.float32)
    card = json.loads((folder / "card.json").read_text())
    card["int8"] = {"pose_net_3d": activation_peaks(folder / "pose_net_3d.onnx", [inputs])}
    (folder / "card.json").write_text(json.dumps(card))
    read = read_card(folder)
    assert read.int8 == card["int8"]
    read = dataclasses.replace(read, second="")  # the second networks have a card of their own
    assert "int8" in load_networks(folder, read).runtime
    assert "int8" not in load_networks(folder, dataclasses.replace(read, int8={})).runtime
