"""The published encoder: its shape, its weights under our normalisation, and how it learns."""

import dataclasses

import numpy as np
import pytest
import torch
from tests.tflite_files import tflite_file
from torch import nn
from torch.nn import functional

from twohands.errors import CheckpointError, InputError
from twohands.models.blocks import freeze_batch_norm
from twohands.models.checkpoint import save_network
from twohands.models.efficientnet import (
    HANDS,
    LANDMARK_CROP,
    MOVED_HANDS,
    DepthwiseConv2d,
    EfficientNet,
    EndPaddedConv2d,
    encoder_of,
    load_landmarks,
    load_published,
    published_weights,
)
from twohands.models.hand_seg_net import HandSegNet, HandSegNetConfig
from twohands.models.pose_net_2d import PoseNet2D, PoseNet2DConfig
from twohands.models.presets import SLIM
from twohands.models.tflite import read_convolutions, read_layer
from twohands.training.config import recipe, with_override
from twohands.training.pose_stages import Pose3DStage
from twohands.training.stages import build_stage
from twohands.training.state import build_optimizer

SMALL = HandSegNetConfig("efficientnet-lite0", height=64, width_px=96)


@pytest.fixture(scope="module")
def published():
    encoder = EfficientNet()
    load_published(encoder)
    return encoder.eval()


def stage_of(*settings):
    config = recipe("ours", "hand_seg_net")
    config = dataclasses.replace(config, networks=dataclasses.replace(SLIM, hand_seg_net=SMALL))
    return build_stage(with_override(config, *settings))


def test_levels_halve_the_picture_and_have_the_published_channels(published):
    encoded = published(torch.zeros(2, 3, 64, 96))
    assert [tuple(level.shape) for level in encoded] == [
        (2, 16, 32, 48),
        (2, 24, 16, 24),
        (2, 40, 8, 12),
        (2, 112, 4, 6),
        (2, 320, 2, 3),
    ]


def test_our_normalisation_is_the_published_one_to_its_first_layer(published):
    """Grey values x as (x - 128) / 256 to our stem are what (x - 127) / 128 are to the published one."""
    given = torch.load(published_weights(), weights_only=True)
    picture = torch.randint(0, 256, (1, 3, 16, 16), generator=torch.Generator().manual_seed(0)).float()
    theirs = functional.conv2d((picture - 127) / 128, given["_conv_stem.weight"], stride=2, padding=1)
    names = ("running_mean", "running_var", "weight", "bias")
    theirs = functional.batch_norm(theirs, *(given[f"_bn0.{name}"] for name in names), eps=1e-3).clamp(0, 6)
    ours = published.stem((picture - 128) / 256)
    # At the border zeros are padded, which are not the same grey value.
    torch.testing.assert_close(ours[..., 1:, 1:], theirs[..., 1:, 1:], atol=1e-4, rtol=1e-4)


@pytest.fixture(scope="module")
def hands_file(tmp_path_factory):
    """A file with the convolutions of `hand_landmark_full.tflite`, of random weights."""
    rng = np.random.default_rng(0)
    kernels = [part.weight.shape for part in EfficientNet(HANDS).modules() if isinstance(part, nn.Conv2d)]
    layers = [(rng.normal(size=s).astype(np.float16), rng.normal(size=s[0]).astype(np.float16)) for s in kernels]
    for name in ("conv_world_landmarks", "conv_landmarks"):
        weights, biases = rng.normal(size=(63, 1152)), rng.uniform(0, LANDMARK_CROP, 63)
        layers.append((weights.astype(np.float16), biases.astype(np.float16), name))
    layers.append((rng.normal(size=(1, 1152)).astype(np.float16), np.ones(1, np.float16), "conv_handflag"))
    path = tmp_path_factory.mktemp("hands") / "hand_landmark_full.tflite"
    path.write_bytes(tflite_file(layers))
    return path


def test_the_encoder_that_knows_hands_ends_with_its_widened_channels():
    encoded = EfficientNet(HANDS).eval()(torch.zeros(2, 3, 64, 96))
    assert [tuple(level.shape[1:]) for level in encoded] == [
        (16, 32, 48),
        (24, 16, 24),
        (40, 8, 12),
        (112, 4, 6),
        (1152, 2, 3),
    ]


def test_the_encoder_that_knows_hands_takes_their_kernels_and_our_grey_values(hands_file):
    encoder = EfficientNet(HANDS)
    card = load_published(encoder, hands_file)
    assert card["licence"] == "Apache-2.0" and "mediapipe" in card["source"]
    stored = read_convolutions(hands_file)
    picture = torch.randint(0, 256, (1, 3, 16, 16), generator=torch.Generator().manual_seed(0)).float()
    theirs = functional.conv2d(functional.pad(picture / 255, (0, 1, 0, 1)), *stored[0], stride=2).clamp(0, 6)
    ours = encoder.eval().stem((picture - 128) / 256)
    torch.testing.assert_close(ours[..., :-1, :-1], theirs[..., :-1, :-1], atol=1e-4, rtol=1e-4)
    last = encoder.stages[-1][0]
    x = torch.rand(1, 192, 6, 6, generator=torch.Generator().manual_seed(1))
    wide = functional.conv2d(x, *stored[-2]).clamp(0, 6)
    theirs = functional.conv2d(wide, *stored[-1], padding=1, groups=1152).clamp(0, 6)
    torch.testing.assert_close(last(x), theirs, atol=1e-3, rtol=1e-3)


@pytest.mark.parametrize("kernel", [3, 5])
def test_where_maps_are_halved_a_cell_looks_at_the_second_of_its_pixels(kernel):
    """As TensorFlow pads; padded on both sides it would look at the first."""
    halving = EndPaddedConv2d(1, 1, kernel, stride=2, bias=False)
    with torch.no_grad():
        halving.weight.zero_()
        halving.weight[0, 0, kernel // 2, kernel // 2] = 1
    picture = torch.arange(64.0).view(1, 1, 8, 8)
    torch.testing.assert_close(halving(picture), picture[..., 1::2, 1::2])


def test_the_two_ways_of_padding_have_the_same_weights(hands_file):
    pads_end, both = EfficientNet(HANDS), EfficientNet(MOVED_HANDS)
    load_published(pads_end, hands_file)
    load_published(both, hands_file)
    assert all(torch.equal(value, both.state_dict()[name]) for name, value in pads_end.state_dict().items())
    assert sum(isinstance(part, EndPaddedConv2d) for part in pads_end.modules()) == 5
    assert not any(isinstance(part, EndPaddedConv2d) for part in both.modules())


def test_the_published_landmark_layer_without_its_depths(hands_file, tmp_path):
    layer = nn.Linear(1152, 43)
    load_landmarks(layer, hands_file)
    assert torch.equal(layer.weight[42:], read_layer(hands_file, "conv_handflag")[0]) and layer.bias[42] == 1
    weights, biases = read_layer(hands_file, "conv_landmarks")
    for joint in range(21):
        for axis in range(2):
            assert torch.equal(layer.weight[2 * joint + axis], weights[3 * joint + axis])
            assert layer.bias[2 * joint + axis] == biases[3 * joint + axis]
    with pytest.raises(InputError, match=r"landmark_spread needs .* --set encoder=FILE"):
        load_landmarks(layer, "")
    other = tmp_path / "other.tflite"
    wrong = [
        (np.ones((6, 8), np.float16), np.zeros(6, np.float16), name) for name in ("conv_landmarks", "conv_handflag")
    ]
    other.write_bytes(tflite_file(wrong))
    with pytest.raises(CheckpointError, match=r"other\.tflite does not hold the expected layer"):
        load_landmarks(layer, other)


GUIDED = PoseNet2DConfig(
    "mediapipe-hands", 128, stages=1, activation="softmax", judge=True, cues=2, surround=32, landmark_spread=2.0
)


def test_maps_are_of_the_middle_of_a_crop_with_surroundings():
    """Every level begins where its cells look at the last pixel before the middle."""
    net = PoseNet2D(dataclasses.replace(GUIDED, landmark_spread=0.0)).eval()
    assert (net.config.seen_size, net.config.map_size) == (64, 16)
    maps, hand_logit = net.judged(torch.zeros(2, 3, 128, 128))
    assert maps[0].shape == (2, 23, 16, 16) and hand_logit is not None and hand_logit.shape == (2, 1)
    looked_at = [torch.arange(step - 1, 128, step).expand(1, 1, 128 // step, -1) for step in (2, 4, 8, 16, 32)]
    for level, step in zip(net._seen(looked_at), (2, 4, 8, 16, 32), strict=True):
        assert level.shape[-2:] == (64 // step, 64 // step)
        assert level[0, 0, 0].tolist() == list(range(31, 95, step))


def test_joints_are_near_to_where_the_published_layer_sees_them():
    """Layers that see all joints at (54, 78) of the crop, cell (5, 11) of the maps: a cell two from there is less
    likely by exp(-1/2). They also say that there is a hand."""
    net = PoseNet2D(GUIDED).eval()
    with torch.no_grad():
        net.landmarks.weight.zero_()
        net.landmarks.bias.copy_(torch.tensor([*([54.0, 78.0] * 21), 3.0]))
    picture = torch.rand(1, 3, 128, 128, generator=torch.Generator().manual_seed(0)) - 0.5
    (guided,), judged = net.judged(picture)
    (alone,), judge = net.judged(picture, guided=False)
    assert judged is not None and judge is not None
    assert torch.equal(judged[:, :1], judge) and judged[:, 1].tolist() == [3.0]
    off = (guided - alone)[0]
    assert torch.equal(off[21:], torch.zeros(2, 16, 16)), "cues are no joints"
    torch.testing.assert_close(off[:21, 11, 5], torch.zeros(21), atol=1e-5, rtol=0)
    torch.testing.assert_close(off[:21, 11, 7], torch.full((21,), -0.5), atol=1e-5, rtol=0)
    torch.testing.assert_close(off[:21, 8, 5], torch.full((21,), -9 / 8), atol=1e-5, rtol=0)


@pytest.mark.parametrize(
    "wrong",
    [{"surround": 16}, {"surround": 64}, {"surround": -32}, {"landmark_spread": -1.0}, {"variant": "encoder-decoder"}],
)
def test_surroundings_that_cannot_be_are_refused(wrong):
    with pytest.raises(InputError, match="surround"):
        dataclasses.replace(GUIDED, **wrong)


def guided_stage(hands_file, *settings, weights=()):
    config = recipe("ours", "pose_net_2d")
    config = dataclasses.replace(
        config, networks=dataclasses.replace(SLIM, pose_net_2d=GUIDED), encoder=str(hands_file)
    )
    return build_stage(with_override(config, *settings), weights)


def test_a_run_takes_the_published_layer_and_leaves_it(hands_file, tmp_path):
    """Also one that goes on from weights without it; one that has it keeps its own."""
    expected = torch.cat([read_layer(hands_file, "conv_landmarks")[1].view(21, 3)[:, :2].flatten(), torch.ones(1)])
    fresh = guided_stage(hands_file)
    assert torch.equal(fresh.net.landmarks.bias, expected) and not fresh.net.landmarks.weight.requires_grad
    for spread, kept in ((0.0, False), (2.0, True)):
        before = PoseNet2D(dataclasses.replace(GUIDED, landmark_spread=spread))
        save_network("pose_net_2d", before, tmp_path / "before.safetensors")
        after = guided_stage(hands_file, weights=[tmp_path / "before.safetensors"])
        assert torch.equal(after.net.landmarks.bias, before.landmarks.bias if kept else expected)


def test_a_network_with_published_layers_does_not_learn_along():
    config = dataclasses.replace(recipe("ours", "pose_net_3d"), networks=dataclasses.replace(SLIM, pose_net_2d=GUIDED))
    with pytest.raises(InputError, match=r"set optim\.along_rate=0"):
        Pose3DStage(config, PoseNet2D(GUIDED))
    frozen = Pose3DStage(with_override(config, "optim.along_rate=0"), PoseNet2D(GUIDED))
    assert not any(parameter.requires_grad for parameter in frozen.net_2d.parameters())


def test_the_encoder_that_knows_hands_needs_its_file(hands_file, tmp_path):
    with pytest.raises(InputError, match=r"hand_landmark_full\.tflite of the wheel mediapipe .* --set encoder=FILE"):
        load_published(EfficientNet(HANDS))
    other = tmp_path / "other.tflite"
    other.write_bytes(tflite_file([(np.ones((8, 3, 3, 3), np.float16), np.zeros(8, np.float16))]))
    with pytest.raises(CheckpointError, match=r"other\.tflite does not hold the expected weights"):
        load_published(EfficientNet(HANDS), other)


@pytest.mark.parametrize("variant", ["efficientnet-lite0", "mediapipe-hands"])
def test_both_networks_can_stand_on_it_and_judge(variant):
    config = PoseNet2DConfig(variant, 64, stages=1, activation="softmax", judge=True, cues=8)
    net = PoseNet2D(config).eval()
    maps, hand_logit = net.judged(torch.zeros(2, 3, 64, 64))
    assert maps[0].shape == (2, 29, 16, 16) and hand_logit is not None and hand_logit.shape == (2, 1)
    assert not any(
        name.startswith("judge_trunk") for name in PoseNet2D(dataclasses.replace(config, judge=False)).state_dict()
    )
    segmentation, energy = HandSegNet(SMALL).eval()(torch.zeros(1, 3, 64, 96))
    assert segmentation.shape == (1, 3, 64, 96) and energy.shape == (1, 2, 64, 96)


def test_frozen_statistics_give_what_evaluation_gives_grouped_convolutions_too(published):
    frozen = EfficientNet()
    frozen.load_state_dict(published.state_dict())
    freeze_batch_norm(frozen)
    picture = torch.rand(1, 3, 32, 32, generator=torch.Generator().manual_seed(1)) - 0.5
    for ours, theirs in zip(frozen.train()(picture), published(picture), strict=True):
        torch.testing.assert_close(ours, theirs, atol=1e-4, rtol=1e-4)


def test_a_run_starts_from_the_published_weights_unless_told_otherwise(published):
    for settings, same in (((), True), (("pretrained=false",), False)):
        encoder = encoder_of(stage_of(*settings).net)
        assert encoder is not None
        name = "stages.3.0.expand.0.weight"
        assert torch.equal(encoder.state_dict()[name], published.state_dict()[name]) is same


def one_step(stage):
    optimizer = build_optimizer(stage, stage.config.optim)
    for group in optimizer.param_groups:
        group["lr"] = 1e-3 * group["share"]
    stage.train()
    segmentation, energy = stage.net(torch.rand(2, 3, 64, 96) - 0.5)
    (segmentation.square().mean() + energy.square().mean()).backward()
    optimizer.step()


def test_frozen_levels_stay_and_statistics_of_all_stay():
    stage = stage_of("optim.frozen_levels=2")
    before = {name: value.clone() for name, value in stage.net.state_dict().items()}
    one_step(stage)
    after = stage.net.state_dict()
    moved = {name for name, value in after.items() if not torch.equal(value, before[name])}
    encoder = {name.removeprefix("net.encoder.") for name in moved if name.startswith("net.encoder.")}
    assert encoder and not any("running" in name for name in encoder)
    assert not any(name.startswith(("stem.", "stages.0.", "stages.1.")) for name in encoder)
    assert any(name.startswith("stages.2.") for name in encoder)


def test_the_encoder_is_a_group_of_its_own_with_its_own_rate():
    stage = stage_of("optim.encoder_rate=0.25")
    own, theirs = stage.parameter_groups()
    assert (own.share, own.pretrained, theirs.share, theirs.pretrained) == (1.0, False, 0.25, True)
    optimizer = build_optimizer(stage, stage.config.optim)
    named = {id(p) for p in theirs.parameters}
    assert {id(p) for g in optimizer.param_groups for p in g["params"]} == {id(p) for p in stage.net.parameters()}
    for group in optimizer.param_groups:
        assert not (group.get("muon") and any(id(p) in named for p in group["params"]))


def test_a_network_without_such_an_encoder_has_none():
    assert encoder_of(nn.Identity()) is None and encoder_of(HandSegNet(HandSegNetConfig(width=0.1))) is None


def test_levels_to_freeze_are_checked():
    with pytest.raises(InputError, match=r"frozen_levels must lie in 0..5, got 6"):
        with_override(recipe("ours", "hand_seg_net"), "optim.frozen_levels=6")


@pytest.mark.parametrize("stride", [1, 2])
def test_depthwise_filters_learn_in_float32_under_bfloat16(stride):
    layer = DepthwiseConv2d(4, 4, 5, stride, 2, groups=4, bias=False)
    x = torch.rand(1, 4, 8, 8, generator=torch.Generator().manual_seed(0))
    layer(x).square().sum().backward()
    exact = layer.weight.grad
    assert exact is not None
    layer.weight.grad = None
    with torch.autocast("cpu", dtype=torch.bfloat16):
        y = layer(x)
    y.square().sum().backward()
    assert y.dtype == x.dtype
    torch.testing.assert_close(layer.weight.grad, exact, rtol=1e-6, atol=1e-6)  # bfloat16 would be off by 1e-2
    with torch.no_grad(), torch.autocast("cpu", dtype=torch.bfloat16):
        assert layer(x).dtype == torch.bfloat16
