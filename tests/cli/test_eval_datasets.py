"""`twohands eval` on every data set: with ground truth in every stage, all of them score perfectly by one code path."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tests.datasets import fakes, test_freihand, test_interhand, test_rhd, test_stb
from tests.oracles import write_tiny_weights

from twohands.cli.main import main
from twohands.datasets.opening import DatasetOptions, detect_kind, open_dataset
from twohands.errors import DataFormatError, InputError
from twohands.synth.production.sinks import ShardSink

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


def check_perfect(metrics: dict[str, dict], hands: int, mm: float = 2e-3) -> None:
    for key in ("presence_accuracy", "box_accuracy", "direction_1deg", "range_3cm", "auc_20_50_spherical"):
        assert metrics[key]["value"] == pytest.approx(1), key
    for key in ("error_2d_mean", "error_3d_spherical_mean", "pa_mpjpe", "bone_length", "range_mean", "cs_mpjpe"):
        assert metrics[key]["value"] == pytest.approx(0, abs=mm), key
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

    def test_rhd(self, shared_data: Path, tmp_path: Path, weights: Path) -> None:
        """Labels are rounded, and only one hand of a picture may be labelled."""
        test_rhd.write_true_sample(shared_data / "official" / "rhd", tmp_path / "data")
        options = ["--joints", "all"]
        check_perfect(scores(tmp_path / "data", weights, tmp_path / "r.json", *options), 3, mm=0.3)

    def test_freihand(self, shared_data: Path, tmp_path: Path, weights: Path) -> None:
        """The sample has pictures and 2D labels only: here its hands lie flat, 0.6 m away, on their own rays."""
        test_freihand.write_true_sample(shared_data / "official" / "freihand", tmp_path / "data")
        check_perfect(scores(tmp_path / "data", weights, tmp_path / "r.json"), 8)

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


def test_shards_score_as_folders(tmp_path: Path, weights: Path) -> None:
    """The same instances in folders and in tar shards have one fingerprint: either scores the other's predictions."""
    for name in ("00000", "00001", "00002"):
        fakes.write_instance(tmp_path / "folders" / name, right=name != "00001")
    (tmp_path / "shards").mkdir()
    shards = ShardSink(tmp_path / "shards", ["00000", "00001", "00002"], 2)
    for name in ("00000", "00001", "00002"):
        folder = tmp_path / "folders" / name
        shards.write(name, {path.name: path.read_bytes() for path in folder.iterdir()})
    shards.close()
    assert detect_kind(tmp_path / "shards") == "ego3dhands"
    predictions = str(tmp_path / "p.npz")
    assert main(["eval", "predict", str(tmp_path / "shards"), "--weights", str(weights), "--out", predictions]) == 0
    for kind in ("shards", "folders"):
        assert (
            main(["eval", "score", predictions, str(tmp_path / kind), "--report", str(tmp_path / f"{kind}.json")]) == 0
        )
    assert (tmp_path / "shards.json").read_text() == (tmp_path / "folders.json").read_text()
    check_perfect(scores(tmp_path / "shards", weights, tmp_path / "r.json"), 5)


def test_scoring_reads_no_pictures(tmp_path: Path) -> None:
    """Labels come without picture and depth, at the picture's size; everything else is the same."""
    _ego(tmp_path / "data")
    opened = open_dataset(tmp_path / "data")
    whole, bare = opened.samples[0], opened.labels[0]
    assert bare.image.shape == whole.image.shape and not bare.image.any() and whole.image.any()
    assert bare.depth_m is None and whole.depth_m is None
    np.testing.assert_array_equal(bare.labels, whole.labels)
    np.testing.assert_array_equal(bare.joints_m, whole.joints_m)
    assert bare.camera == whole.camera
    (tmp_path / "data" / "0" / "color_new.png").write_bytes(b"")
    with pytest.raises(DataFormatError, match=r"color_new\.png: zero bytes"):
        open_dataset(tmp_path / "data").labels[0]


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
