"""Weights survive a round trip, and never end up in another network."""

import resource
import signal

import pytest
import torch

from twohands.errors import CheckpointError, InputError
from twohands.models.checkpoint import (
    load_network,
    network_name,
    read_note,
    same_weights,
    save_network,
    save_tensors,
)
from twohands.models.pose_net_2d import PoseNet2D, PoseNet2DConfig
from twohands.models.pose_net_3d import PoseNet3D, PoseNet3DConfig

CONFIG = PoseNet3DConfig(width=0.125, fc_relu=True)


@pytest.fixture
def saved(tmp_path):
    torch.manual_seed(0)
    network = PoseNet3D(CONFIG)
    network(torch.rand(2, 21, 32, 32))  # moves the batch statistics
    path = tmp_path / "folder" / "net.safetensors"
    save_network("pose_net_3d", network, path, note={"seed": 3})
    return network, path


def test_round_trip_is_bitwise(saved):
    network, path = saved
    loaded = load_network("pose_net_3d", path)
    assert loaded.config == CONFIG
    assert same_weights(network, loaded)
    assert not loaded.training
    assert read_note(path) == {"seed": 3}
    assert network_name(path) == "pose_net_3d"
    assert [file.name for file in path.parent.iterdir()] == ["net.safetensors"]


def test_weights_are_as_readable_as_any_other_file(saved, tmp_path):
    """Named case: safetensors made them private, whatever the umask."""
    (tmp_path / "other").touch()
    assert saved[1].stat().st_mode == (tmp_path / "other").stat().st_mode


def test_what_cannot_be_written_is_one_line_and_leaves_the_old_file(saved):
    """Named case: a full disk ended a training in a traceback. Files larger than a limit stand for it."""
    network, path = saved
    before = path.read_bytes()
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limit[1]))
    try:
        with pytest.raises(InputError, match="cannot be written") as caught:
            save_network("pose_net_3d", network, path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
        signal.signal(signal.SIGXFSZ, handler)
    assert "\n" not in str(caught.value)
    assert path.read_bytes() == before and [file.name for file in path.parent.iterdir()] == [path.name]


def test_a_file_in_place_of_a_folder_is_one_line(saved):
    with pytest.raises(InputError, match="cannot be written"):
        save_network("pose_net_3d", saved[0], saved[1] / "inside.safetensors")


def test_same_weights_sees_one_changed_number(saved):
    network, path = saved
    loaded = load_network("pose_net_3d", path)
    loaded.regressor[0].bias.data[0] += 1e-6
    assert not same_weights(network, loaded)


def test_another_network_is_refused_in_one_line(saved):
    with pytest.raises(CheckpointError, match=r"holds weights of 'pose_net_3d', but 'pose_net_2d'") as caught:
        load_network("pose_net_2d", saved[1])
    assert "\n" not in str(caught.value)


def test_saving_under_another_name_is_refused(tmp_path):
    net = PoseNet2D(PoseNet2DConfig("encoder-decoder", crop_size=128, stages=1, width=0.1))
    with pytest.raises(CheckpointError, match="PoseNet2D as 'pose_net_3d'"):
        save_network("pose_net_3d", net, tmp_path / "x.safetensors")


def test_missing_damaged_and_foreign_files(saved, tmp_path):
    with pytest.raises(CheckpointError, match="no weights at"):
        load_network("pose_net_3d", tmp_path / "none.safetensors")
    half = tmp_path / "half.safetensors"
    half.write_bytes(saved[1].read_bytes()[:1000])
    with pytest.raises(CheckpointError, match="half"):
        load_network("pose_net_3d", half)
    foreign = tmp_path / "foreign.safetensors"
    save_tensors({"a": torch.zeros(1)}, {}, foreign)
    with pytest.raises(CheckpointError, match="not a twohands checkpoint"):
        load_network("pose_net_3d", foreign)


def test_tensors_that_do_not_fit_the_configuration_are_refused(saved, tmp_path):
    network, _ = saved
    network.config = PoseNet3DConfig(width=0.25)
    save_network("pose_net_3d", network, tmp_path / "x.safetensors")
    with pytest.raises(CheckpointError, match="do not fit") as caught:
        load_network("pose_net_3d", tmp_path / "x.safetensors")
    assert "\n" not in str(caught.value)
