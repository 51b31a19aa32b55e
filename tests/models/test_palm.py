"""The encoder that knows palms: its shape, its weights under our normalisation, and what it adds to HandSegNet."""

import numpy as np
import pytest
import torch
from tests.tflite_files import tflite_file
from torch import nn
from torch.nn import functional

from twohands.errors import CheckpointError, InputError
from twohands.models.checkpoint import load_network, save_network
from twohands.models.hand_seg_net import HandSegNet, HandSegNetConfig
from twohands.models.palm import HEADS, PalmEncoder
from twohands.models.tflite import read_convolutions, read_slopes
from twohands.training.config import recipe, with_override
from twohands.training.stages import build_stage

SMALL = ("networks.hand_seg_net.height=64", "networks.hand_seg_net.width_px=96")


@pytest.fixture(scope="module")
def palm_file(tmp_path_factory):
    """A file with the convolutions and slopes of `palm_detection_full.tflite`, of random weights; heads at the end."""
    rng = np.random.default_rng(0)
    layers = []
    for part in PalmEncoder().modules():
        if isinstance(part, nn.Conv2d):
            kernel = rng.normal(size=part.weight.shape) / np.sqrt(part.weight[0].numel())
            bias = np.zeros(len(kernel)) if part.groups > 1 else rng.normal(size=len(kernel))
            layers.append((kernel.astype(np.float16), bias.astype(np.float16)))
        elif isinstance(part, nn.PReLU):
            layers.append((rng.uniform(0, 0.5, part.weight.shape).astype(np.float16),))
    layers += [(np.ones((head, 4, 1, 1), np.float16), np.ones(head, np.float16)) for head in HEADS]
    path = tmp_path_factory.mktemp("palm") / "palm_detection_full.tflite"
    path.write_bytes(tflite_file(layers))
    return path


def test_levels_halve_the_picture_and_have_the_published_channels():
    levels = PalmEncoder().eval()(torch.zeros(2, 3, 64, 96))
    expected = [(32, 32, 48), (64, 16, 24), (128, 8, 12), (256, 4, 6), (256, 2, 3)]
    assert [tuple(level.shape[1:]) for level in levels] == expected
    assert tuple(level.shape[1] for level in levels) == PalmEncoder.channels


def test_it_takes_their_kernels_and_slopes_and_our_grey_values(palm_file):
    encoder = PalmEncoder()
    card = encoder.fill(palm_file)
    assert card["licence"] == "Apache-2.0" and "palm_detection_full.tflite" in card["source"]
    kernels, slopes = read_convolutions(palm_file), read_slopes(palm_file)
    picture = torch.randint(0, 256, (1, 3, 16, 16), generator=torch.Generator().manual_seed(0)).float()
    # Theirs pads an even picture by one row before it and two behind it, with black; ours with its middle grey.
    theirs = functional.conv2d(functional.pad(picture / 255, (1, 2, 1, 2)), *kernels[0], stride=2)
    theirs = functional.prelu(theirs, slopes[0])
    ours = encoder.eval().stem(functional.pad((picture - 128) / 256, (1, 2, 1, 2)))
    torch.testing.assert_close(ours[..., 1:-1, 1:-1], theirs[..., 1:-1, 1:-1], atol=1e-3, rtol=1e-3)
    x = torch.rand(1, 32, 8, 8, generator=torch.Generator().manual_seed(1))
    halving, at = encoder.stages[1][0], 1 + 2 * 4
    filtered = functional.conv2d(functional.pad(x, (1, 2, 1, 2)), *kernels[at], stride=2, groups=32)
    wider = functional.conv2d(filtered, *kernels[at + 1])
    wider[:, :32] += functional.max_pool2d(x, 2)
    torch.testing.assert_close(halving(x), functional.prelu(wider, slopes[5]), atol=1e-4, rtol=1e-4)


def test_another_file_is_refused(tmp_path):
    other = tmp_path / "other.tflite"
    other.write_bytes(tflite_file([(np.ones((32, 3, 5, 5), np.float16), np.zeros(32, np.float16))]))
    with pytest.raises(CheckpointError, match=r"other\.tflite does not hold the expected weights"):
        PalmEncoder().fill(other)
    biased = tmp_path / "biased.tflite"
    layers = [(np.ones((32, 3, 5, 5), np.float16), np.zeros(32, np.float16))]
    layers += [(np.ones((32, 1, 5, 5), np.float16), np.ones(32, np.float16))]
    biased.write_bytes(tflite_file(layers))
    with pytest.raises(CheckpointError, match=r"a bias where none is expected"):
        PalmEncoder().fill(biased)


def test_added_to_trained_weights_it_changes_nothing_until_it_has_learnt(palm_file, tmp_path):
    config = HandSegNetConfig("efficientnet-lite0", height=64, width_px=96, context=2)
    trained = HandSegNet(config).eval()
    save_network("hand_seg_net", trained, tmp_path / "trained.safetensors")
    run = recipe("ours", "hand_seg_net")
    for setting in (*SMALL, "networks.hand_seg_net.palm=true", f"encoder={palm_file}"):
        run = with_override(run, setting)
    stage = build_stage(run, [tmp_path / "trained.safetensors"])
    picture = torch.rand(1, 3, 64, 96, generator=torch.Generator().manual_seed(0)) - 0.5
    with torch.inference_mode():
        for own, before in zip(stage.eval().net(picture), trained(picture), strict=True):
            torch.testing.assert_close(own, before, atol=1e-4, rtol=1e-4)
    with pytest.raises(InputError, match=r"palm_detection_full\.tflite of .* --set encoder=FILE"):
        build_stage(with_override(run, "encoder="), [tmp_path / "trained.safetensors"])
    palm = stage.net.net.palm
    assert not any(part.requires_grad for part in palm.parameters()), "it stays as it is"
    torch.testing.assert_close(palm.stages[0][0].depthwise.weight, read_convolutions(palm_file)[1][0])
    norm = stage.net.net.palm_skip[0][1]
    stage.train()
    maps, energies = stage.net(picture.repeat(2, 1, 1, 1))
    (maps.square().mean() + energies.square().mean()).backward()
    assert norm.weight.grad.abs().max() > 0, "what is added can grow"
    save_network("hand_seg_net", stage.net, tmp_path / "both.safetensors")
    assert load_network("hand_seg_net", tmp_path / "both.safetensors").config.palm
    going_on = build_stage(with_override(run, "encoder="), [tmp_path / "both.safetensors"])
    torch.testing.assert_close(going_on.net.state_dict(), stage.net.state_dict())


def test_only_a_network_on_a_pretrained_encoder_has_it():
    with pytest.raises(InputError, match=r"encoder-decoder cannot have an encoder that knows palms"):
        HandSegNetConfig("encoder-decoder", palm=True)
