"""The networks have the paper's depth, size and shapes."""

import dataclasses
import math

import numpy as np
import pytest
import torch
from torch import nn

from twohands.errors import InputError
from twohands.geometry.segmentation import resized_maps
from twohands.models.blocks import count_blocks, fold_batch_norm, freeze_batch_norm, scaled
from twohands.models.encoder_decoder import EncoderDecoder
from twohands.models.hand_seg_net import HandSegNet, HandSegNetConfig
from twohands.models.pose_net_2d import PoseNet2D, PoseNet2DConfig
from twohands.models.pose_net_3d import PoseNet3D, PoseNet3DConfig
from twohands.models.presets import PAPER, SLIM, build_network, config_from_dict
from twohands.skeleton import ROOT

TINY_SEG = HandSegNetConfig(height=64, width_px=96, width=0.125)
TINY_2D = PoseNet2DConfig("encoder-decoder", crop_size=128, stages=1, width=0.25, activation="softmax")


def parameters(module: nn.Module) -> int:
    return sum(p.numel() for p in module.parameters())


def test_hand_seg_net_has_16_residual_blocks_in_4_down_and_4_up_layers():
    net = HandSegNet(TINY_SEG)
    assert [count_blocks(layer) for layer in net.net.down] == [2, 2, 2, 2]
    assert [count_blocks(layer) for layer in net.net.up] == [2, 2, 2, 2]
    assert count_blocks(net) == 16


@pytest.mark.parametrize("variant", ["auto-encoder", "encoder-decoder"])
def test_hand_seg_net_answers_at_input_size(variant: str):
    net = HandSegNet(dataclasses.replace(TINY_SEG, variant=variant))
    segmentation, energy = net(torch.zeros(2, 3, 64, 96))
    assert segmentation.shape == (2, 3, 64, 96)
    assert energy.shape == (2, 2, 64, 96)


def test_hand_seg_net_bottom_is_a_32nd_of_the_input():
    net = HandSegNet(TINY_SEG).eval().net
    x = net.pool(net.stem(torch.zeros(1, 3, 64, 96)))
    sizes = []
    for layer in net.down:
        x = layer(x)
        sizes.append(tuple(x.shape[2:]))
    assert sizes == [(16, 24), (8, 12), (4, 6), (2, 3)]


@pytest.mark.parametrize(("finest", "rows"), [(4, 16), (2, 32)])
def test_the_encoder_decoder_carries_detail_past_its_bottom(finest: int, rows: int):
    torch.manual_seed(0)
    net = EncoderDecoder(5, 0.25, finest).eval()
    for parameter in net.down[-1].parameters():  # cut the path through the bottom
        parameter.data.zero_()
    a, b = torch.randn(2, 1, 3, 64, 96)
    assert net(a).shape == (1, 5, rows, rows * 3 // 2)
    assert not torch.allclose(net(a), net(b))


def test_pose_net_3d_has_8_residual_blocks_and_2_fully_connected_layers_before_the_output():
    net = PoseNet3D(PoseNet3DConfig())
    assert count_blocks(net) == 8
    linear = [m for m in net.modules() if isinstance(m, nn.Linear)]
    assert [(m.in_features, m.out_features) for m in linear] == [(512, 512), (512, 512), (512, 63)]


def test_pose_net_3d_size_by_hand():
    def block(inputs: int, outputs: int) -> int:
        shortcut = inputs * outputs + 2 * outputs if inputs != outputs else 0
        return 9 * inputs * outputs + 9 * outputs * outputs + 4 * outputs + shortcut

    stem = 49 * 21 * 64 + 2 * 64
    blocks = sum(block(a, b) + block(b, b) for a, b in ((64, 64), (64, 128), (128, 256), (256, 512)))
    heads = 2 * (512 * 512 + 512) + 512 * 63 + 63
    assert parameters(PoseNet3D(PoseNet3DConfig())) == stem + blocks + heads


def test_pose_net_3d_output_is_canonical_with_the_root_at_zero():
    joints = PoseNet3D(PoseNet3DConfig(width=0.125)).eval()(torch.rand(3, 21, 32, 32))
    assert joints.shape == (3, 21, 3)
    assert torch.equal(joints[:, ROOT], torch.zeros(3, 3))


def test_cpm9_size_by_hand():
    def conv_bn(inputs: int, outputs: int, kernel: int) -> int:
        return kernel**2 * inputs * outputs + 2 * outputs

    features = conv_bn(3, 128, 9) + 2 * conv_bn(128, 128, 9)
    first = features + conv_bn(128, 32, 5) + conv_bn(32, 512, 9) + conv_bn(512, 512, 1) + 512 * 21 + 21
    shared = features + conv_bn(128, 32, 5)
    later = conv_bn(32 + 21, 128, 11) + 2 * conv_bn(128, 128, 11) + conv_bn(128, 128, 1) + 128 * 21 + 21
    with torch.device("meta"):
        assert parameters(PoseNet2D(PAPER.pose_net_2d)) == first + shared + 5 * later


def test_pose_net_3d_takes_maps_of_any_size():
    network, levels = PoseNet3D(PoseNet3DConfig(width=0.125)).eval(), torch.rand(3, 21, 1, 1)
    joints = network(levels.expand(3, 21, 32, 32))
    assert joints.std() > 0
    torch.testing.assert_close(network(levels.expand(3, 21, 40, 40)), joints)


@pytest.mark.parametrize(("variant", "cells"), [("vgg", 20), ("encoder-decoder", 40)])
def test_a_crop_of_another_size_gives_maps_of_another_size(variant, cells):
    config = PoseNet2DConfig(variant, crop_size=160, stages=1, width=0.07)
    assert config.map_size == cells
    assert PoseNet2D(config).eval()(torch.zeros(1, 3, 160, 160))[0].shape == (1, 21, cells, cells)


@pytest.mark.parametrize("variant", ["cpm9", "vgg"])
def test_pose_machine_gives_one_set_of_maps_per_stage(variant):
    net = PoseNet2D(PoseNet2DConfig(variant, stages=3, width=0.07)).eval()
    outputs = net(torch.zeros(1, 3, 256, 256))
    assert [tuple(maps.shape) for maps in outputs] == [(1, 21, 32, 32)] * 3
    assert torch.equal(net.heatmaps(outputs), outputs[-1])


@pytest.mark.parametrize("variant", ["cpm9", "vgg"])
def test_batch_norm_follows_every_convolution_but_the_stage_outputs(variant):
    def counts(batch_norm: bool) -> tuple[int, int]:
        with torch.device("meta"):
            net = PoseNet2D(PoseNet2DConfig(variant, stages=3, batch_norm=batch_norm))
        modules = list(net.modules())
        return sum(isinstance(m, nn.Conv2d) for m in modules), sum(isinstance(m, nn.BatchNorm2d) for m in modules)

    convolutions, normalisations = counts(True)
    assert normalisations == convolutions - 3
    assert counts(False) == (convolutions, 0)


def test_encoder_decoder_shape():
    net = PoseNet2D(TINY_2D).eval()
    outputs = net(torch.zeros(2, 3, 128, 128))
    assert [tuple(maps.shape) for maps in outputs] == [(2, 21, 32, 32)]


def test_only_a_judge_judges_and_its_maps_are_those_of_a_network_without():
    torch.manual_seed(0)
    judge = PoseNet2D(dataclasses.replace(TINY_2D, judge=True)).eval()
    plain = PoseNet2D(TINY_2D).eval()
    plain.load_state_dict({k: v for k, v in judge.state_dict().items() if not k.startswith("judge.")})
    x = torch.rand(3, 3, 128, 128)
    maps, hand_logit = judge.judged(x)
    assert hand_logit is not None and hand_logit.shape == (3, 1)
    assert plain.judged(x)[1] is None
    assert torch.equal(maps[-1], plain(x)[-1]) and torch.equal(maps[-1], judge(x)[-1])


def test_cues_pass_the_read_out_and_start_unheard():
    """They lie behind the joints' maps, as they left the network; a fresh PoseNet3D answers as if there were none."""
    torch.manual_seed(0)
    net = PoseNet2D(dataclasses.replace(TINY_2D, cues=4)).eval()
    outputs = net(torch.rand(3, 3, 128, 128))
    maps = net.heatmaps(outputs)
    assert maps.shape == (3, 25, 32, 32)
    assert torch.equal(maps[:, 21:], outputs[-1][:, 21:])
    assert torch.equal(maps[:, :21], PoseNet2D(TINY_2D).heatmaps([outputs[-1][:, :21]]))
    lifting = PoseNet3D(PoseNet3DConfig(width=0.125, cues=4)).eval()
    silent = maps.clone()
    silent[:, 21:] = 0
    assert torch.equal(lifting(maps), lifting(silent))
    assert not torch.allclose(lifting(maps), lifting(maps.flip(1)))


def test_softmax_heatmaps_of_a_gaussian_have_peak_1_at_z_0_and_2_to_the_z_elsewhere():
    net = PoseNet2D(TINY_2D)
    cells = torch.arange(32) + 0.5
    distance = (cells[:, None] - 16.5) ** 2 + (cells[None] - 16.5) ** 2
    for z in (-1.0, 0.0, 1.0):
        deviation = TINY_2D.sigma * 2 ** (-z / 2)
        logits = (-distance / (2 * deviation**2)).expand(1, 21, 32, 32)
        peak = net.heatmaps([logits])[0, 0, 16, 16].item()
        assert peak == pytest.approx(2.0**z, rel=0.01)


def test_probabilities_sum_to_one():
    sums = PoseNet2D(TINY_2D).probabilities(5 * torch.randn(2, 21, 32, 32)).sum(dim=(2, 3))
    assert torch.allclose(sums, torch.ones(2, 21))


def test_width_scales_the_channels():
    with torch.device("meta"):
        full, half = (parameters(PoseNet3D(PoseNet3DConfig(width=w))) for w in (1.0, 0.5))
    assert 3.5 < full / half < 4.0


def test_the_presets_can_be_built():
    with torch.device("meta"):
        for preset in (PAPER, SLIM):
            for name in ("hand_seg_net", "pose_net_2d", "pose_net_3d"):
                assert parameters(build_network(name, getattr(preset, name))) > 0


@pytest.mark.parametrize(
    ("kind", "values", "named"),
    [
        (HandSegNetConfig, {"height": 270}, "270"),
        (HandSegNetConfig, {"width": -1.0}, "-1.0"),
        (HandSegNetConfig, {"variant": "u-net"}, "u-net"),
        (PoseNet2DConfig, {"variant": "cpm7"}, "cpm7"),
        (PoseNet2DConfig, {"crop_size": 144}, "144"),
        (PoseNet2DConfig, {"crop_size": 0}, "0"),
        (PoseNet2DConfig, {"variant": "encoder-decoder", "crop_size": 128, "stages": 2}, "2"),
        (PoseNet2DConfig, {"activation": "relu"}, "relu"),
        (PoseNet2DConfig, {"judge": True}, "cpm9"),
        (PoseNet2DConfig, {"cues": 8}, "cpm9 cannot give 8"),
        (PoseNet3DConfig, {"cues": -1}, "-1"),
        (PoseNet2DConfig, {"sigma": math.nan}, "nan"),
        (PoseNet3DConfig, {"width": 0.0}, "0.0"),
    ],
)
def test_bad_shapes_are_refused_with_the_value(kind, values, named):
    with pytest.raises(InputError, match=named):
        kind(**values)


def test_config_from_dict_refuses_unknown_fields_and_networks():
    assert config_from_dict("pose_net_3d", {"width": 0.5}) == PoseNet3DConfig(width=0.5)
    with pytest.raises(InputError, match="depth"):
        config_from_dict("pose_net_3d", {"depth": 3})
    with pytest.raises(InputError, match="pose_net_4d"):
        config_from_dict("pose_net_4d", {})
    with pytest.raises(InputError, match="HandSegNetConfig"):
        build_network("pose_net_3d", TINY_SEG)


@pytest.mark.parametrize(
    ("channels", "width", "expected"),
    [(64, 1.0, 64), (64, 0.01, 8), (32, 0.7, 24), (32, 1.25, 48), (64, 1.25, 96), (192, 1.25, 256)],
)
def test_channels_come_in_multiples_that_matrix_units_take(channels: int, width: float, expected: int):
    assert scaled(channels, width) == expected


def test_folding_batch_norm_leaves_the_function_as_it_is():
    torch.manual_seed(0)
    net = EncoderDecoder(3, 0.25, 2)
    for _ in range(3):
        net(torch.randn(2, 3, 64, 64) * 2 + 1)  # statistics other than 0 and 1
    net.eval()
    x = torch.randn(1, 3, 64, 64)
    before = net(x)
    fold_batch_norm(net)
    assert not any(isinstance(module, nn.BatchNorm2d) for module in net.modules())
    torch.testing.assert_close(net(x), before, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("variant", ["auto-encoder", "encoder-decoder"])
def test_frozen_batch_norm_answers_and_learns_in_training_as_in_evaluation(variant: str):
    torch.manual_seed(0)
    net = HandSegNet(HandSegNetConfig(variant, 64, 64, width=0.125))
    for _ in range(3):
        net(torch.randn(2, 3, 64, 64) * 2 + 1)  # statistics other than 0 and 1
    net.eval()
    x = torch.randn(2, 3, 64, 64)

    def answered() -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
        net.zero_grad()
        classes, energies = net(x)
        (classes.square().mean() + energies.square().mean()).backward()
        gradients = {name: p.grad.clone() for name, p in net.named_parameters() if p.grad is not None}
        return torch.cat([classes, energies], dim=1).detach(), gradients

    answer, gradients = answered()
    state = {name: tensor.clone() for name, tensor in net.state_dict().items()}
    freeze_batch_norm(net)
    net.train()
    frozen_answer, frozen_gradients = answered()
    torch.testing.assert_close(frozen_answer, answer, rtol=1e-3, atol=1e-5)
    assert frozen_gradients.keys() == gradients.keys() == dict(net.named_parameters()).keys()
    for name, gradient in gradients.items():
        scale = float(gradient.abs().max())
        torch.testing.assert_close(frozen_gradients[name] / scale, gradient / scale, rtol=1e-3, atol=1e-3)
    torch.testing.assert_close(dict(net.state_dict()), state, rtol=0, atol=0)


@pytest.mark.parametrize(("variant", "stride"), [("encoder-decoder", 2), ("efficientnet-lite0", 4)])
def test_hand_seg_nets_maps_are_its_coarse_ones_enlarged_as_the_pipeline_does(variant, stride):
    """OpenCV and torch enlarge alike, so that shipped networks may leave it to whoever reads them."""
    torch.manual_seed(0)
    network = HandSegNet(HandSegNetConfig(variant, height=64, width_px=96, width=0.25)).eval()
    picture = torch.rand(1, 3, 64, 96)
    with torch.no_grad():
        whole, coarse = network(picture), network.coarse(picture)
    for large, small in zip(whole, coarse, strict=True):
        assert small.shape[2:] == (64 // stride, 96 // stride) and large.shape[2:] == (64, 96)
        np.testing.assert_allclose(resized_maps(small[0].numpy(), (64, 96)), large[0].numpy(), atol=1e-5)
