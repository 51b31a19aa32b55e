"""Peaks measured in a preset's own pipeline."""

import json

from tests.builders import make_samples
from tests.oracles import write_tiny_weights

from twohands.export.calibration import NETWORKS, add_int8
from twohands.inference.estimator import HandEstimator


def test_peaks_join_the_card_and_nothing_else_changes(tmp_path):
    folder = write_tiny_weights(tmp_path / "tiny")
    before = json.loads((folder / "card.json").read_text())
    pictures = make_samples(2)
    add_int8(folder, pictures)
    after = json.loads((folder / "card.json").read_text())
    assert set(after.pop("int8")) == set(NETWORKS)
    assert after == before
    assert not list(folder.glob("*.partial"))
    HandEstimator.from_preset(folder).estimate(pictures[0].image, pictures[0].camera)
