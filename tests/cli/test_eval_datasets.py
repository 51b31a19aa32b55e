"""`twohands eval` on every data set: with ground truth in every stage, all of them score perfectly by one code path."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.datasets import fakes, test_freihand, test_interhand, test_rhd, test_stb
from tests.oracles import write_tiny_weights

from twohands.cli.main import main
from twohands.datasets.opening import DatasetOptions, detect_kind, open_dataset
from twohands.errors import InputError

STAGES = ["presence", "boxes", "joints-2d", "heatmaps", "canonical"]


def _rhd(root: Path) -> None:
    masks = {12: test_rhd.mask_of(5, 4), 3: test_rhd.mask_of(0, 9)}
    test_rhd.write_rhd(root, {number: test_rhd.annotation() for number in masks}, masks)


def _ego(root: Path) -> None:
    fakes.write_instance(root / "0")


WRITERS: dict[str, Callable[[Path], None]] = {
    "ego3dhands": _ego,
    "stb": test_stb.write_stb,
    "rhd": _rhd,
    "freihand": test_freihand.write_freihand,
    "interhand": lambda root: test_interhand.write_interhand(root, test_interhand.content()),
}


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_tiny_weights(tmp_path_factory.mktemp("weights") / "tiny")


def scores(data: Path, weights: Path, report: Path, *options: str) -> dict[str, dict]:
    arguments = ["eval", "run", str(data), "--weights", str(weights), "--report", str(report), "--truth", *STAGES]
    assert main([*arguments, *options]) == 0
    return {metric["key"]: metric for metric in json.loads(report.read_text())["metrics"]}


def check_perfect(metrics: dict[str, dict], hands: int) -> None:
    for key in ("presence_accuracy", "box_accuracy", "direction_1deg", "range_3cm", "auc_20_50_spherical"):
        assert metrics[key]["value"] == pytest.approx(1), key
    for key in ("error_2d_mean", "error_3d_spherical_mean", "pa_mpjpe", "bone_length", "range_mean", "cs_mpjpe"):
        assert metrics[key]["value"] == pytest.approx(0, abs=2e-3), key
        assert metrics[key]["count"] == hands, key
    assert metrics["missed"]["value"] == 0 and metrics["failure_100mm"]["value"] == 0


@pytest.mark.parametrize(
    ("kind", "hands"), [("ego3dhands", 2), ("stb", 4), ("rhd", 2), ("freihand", 2), ("interhand", 2)]
)
def test_ground_truth_is_perfect(kind: str, hands: int, tmp_path: Path, weights: Path) -> None:
    (tmp_path / "data").mkdir(exist_ok=True)
    WRITERS[kind](tmp_path / "data")
    assert detect_kind(tmp_path / "data") == kind
    check_perfect(scores(tmp_path / "data", weights, tmp_path / "r.json"), hands)


class TestTrueSamples:
    def test_ego3dhands(self, shared_data: Path, tmp_path: Path, weights: Path) -> None:
        check_perfect(scores(shared_data / "official" / "ego3dhands", weights, tmp_path / "r.json"), 2)

    def test_interhand(self, shared_data: Path, tmp_path: Path, weights: Path) -> None:
        source = shared_data / "official" / "interhand2.6m"
        folder = tmp_path / "data" / "annotations" / "test"
        folder.mkdir(parents=True)
        for what in ("data", "camera", "joint_3d"):
            name = f"InterHand2.6M_test_{what}.json"
            (folder / name).symlink_to(source / f"test_interhand2.6m_{what}.json")
        (tmp_path / "data" / "images").mkdir()
        (tmp_path / "data" / "images" / "test").symlink_to(source, target_is_directory=True)
        check_perfect(scores(tmp_path / "data", weights, tmp_path / "r.json"), 6)


def test_rules_follow_the_data_set(tmp_path: Path) -> None:
    _rhd(tmp_path / "rhd")
    one, both = (open_dataset(tmp_path / "rhd", DatasetOptions(hands=h)) for h in ("evaluated", "both"))
    assert (one.all_hands_labelled, one.visible_only) == (False, True)
    assert both.all_hands_labelled and both.visible_only
    test_stb.write_stb(tmp_path / "stb", frames=1)
    stb = open_dataset(tmp_path / "stb")
    assert (stb.kind, stb.all_hands_labelled, stb.visible_only) == ("stb", True, False)
    assert len(stb.samples) == 2 and stb.samples.name == "STB test"


def test_rhd_scores_visible_joints_unless_asked_otherwise(tmp_path: Path, weights: Path) -> None:
    _rhd(tmp_path / "data")
    for options, visible in (((), True), (("--joints", "all"), False)):
        scores(tmp_path / "data", weights, tmp_path / "r.json", "--overwrite", *options)
        assert json.loads((tmp_path / "r.json").read_text())["protocol"]["visible_only"] is visible


def test_unknown_and_ambiguous_folders(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such folder"):
        detect_kind(tmp_path / "none")
    with pytest.raises(InputError, match=r"no dataset of a known layout .* --kind ego3dhands\|stb"):
        detect_kind(tmp_path)
    _rhd(tmp_path)
    test_freihand.write_freihand(tmp_path)
    with pytest.raises(InputError, match="files of rhd and freihand"):
        detect_kind(tmp_path)
    assert open_dataset(tmp_path, DatasetOptions(kind="freihand")).kind == "freihand"
    with pytest.raises(InputError, match="expected training or evaluation"):
        open_dataset(tmp_path, DatasetOptions(kind="rhd", split="test"))
    _ego(tmp_path / "ego")
    with pytest.raises(InputError, match="no --split"):
        open_dataset(tmp_path / "ego", DatasetOptions(split="test"))
