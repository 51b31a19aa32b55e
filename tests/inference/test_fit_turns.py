"""scripts/fit_turns.py: the layer that says how a picture is turned, and what fitting it leaves alone."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("onnxscript")

from scripts import fit_turns

from twohands.geometry.picture_turn import TURN_AREAS, TURNS, area_means, turn_logits
from twohands.inference.engine import load_networks
from twohands.inference.weights import network_files, preset_folder, read_card


def test_what_can_be_told_is_told_right_and_the_prior_is_a_chance():
    rng = np.random.default_rng(0)
    turns = np.tile(np.arange(TURNS), (200, 1))
    features = rng.normal(0, 1, (200, TURNS, 6))
    features[..., :TURNS] += 4 * np.eye(TURNS)
    weights, bias = fit_turns.fit(features.astype(np.float32), turns)
    assert ((features @ weights + bias).argmax(axis=-1) == turns).mean() > 0.97
    assert np.abs(weights[TURNS:]).max() < 0.1 * np.abs(weights[:TURNS]).max()  # what says nothing weighs nothing
    assert np.exp(fit_turns.prior()).sum() == pytest.approx(1.0)


def test_without_pictures_there_is_nothing_to_fit(monkeypatch, capsys, tmp_path):
    folder = tmp_path / "fast"
    shutil.copytree(preset_folder("fast"), folder)
    monkeypatch.setattr(sys, "argv", ["fit_turns", str(folder)])
    before = (folder / "hand_seg_net.onnx").read_bytes()
    assert fit_turns.main() == 2
    assert "no pictures" in capsys.readouterr().err
    assert (folder / "hand_seg_net.onnx").read_bytes() == before


def test_a_layer_is_written_beside_outputs_that_stay(tmp_path: Path):
    """Weights of area a, channel c and turn t are those of the map of (a, t): what the file says is what was fitted."""
    folder = tmp_path / "fast"
    shutil.copytree(preset_folder("fast"), folder)
    shutil.copytree(preset_folder("fast").parent / "second", tmp_path / "second")
    path = network_files(folder, read_card(folder))["hand_seg_net"]
    picture = np.random.default_rng(0).normal(0, 0.2, (1, 3, 96, 160)).astype(np.float32)
    before = load_networks(folder, read_card(folder), threads=1).hand_seg_net(picture)
    network = fit_turns.saying_turn(path)
    channels = network.turn.in_channels
    weights, bias = np.random.default_rng(1).normal(0, 0.05, (TURN_AREAS**2 * channels, TURNS)), np.arange(4.0)
    fit_turns.write(folder, path, network, weights, bias)
    assert json.loads((folder / "card.json").read_text())["hand_seg_net"]["turn"] is True
    after = load_networks(folder, read_card(folder), threads=1).hand_seg_net(picture)
    assert np.array_equal(after[0], before[0]) and np.array_equal(after[1], before[1])
    import torch

    with torch.inference_mode():
        known = area_means(network.levels(torch.from_numpy(picture))[0][0].numpy()).ravel()
    expected = known @ weights + bias + fit_turns.prior()
    assert np.allclose(turn_logits(after[2][0]), expected, atol=0.1 * np.ptp(expected))  # arithmetic of 8 bits
