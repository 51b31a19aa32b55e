"""`twohands eval`: predict, score and run agree; stages can be replaced by ground truth."""

import json
from pathlib import Path

import numpy as np
import pytest
from tests.datasets import fakes
from tests.oracles import write_tiny_weights

from twohands.cli.eval import stage_truth
from twohands.cli.main import main
from twohands.datasets.ego3dhands import Ego3DHands
from twohands.errors import InputError
from twohands.skeleton import LEFT, RIGHT

ALL_STAGES = ["presence", "masks", "boxes", "joints-2d", "canonical"]


@pytest.fixture
def data(tmp_path: Path) -> Path:
    for index, (left, right) in enumerate([(True, True), (True, False), (False, False)]):
        fakes.write_instance(tmp_path / "data" / str(index), left=left, right=right)
    return tmp_path / "data"


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("weights")
    write_tiny_weights(folder)
    return folder


def _metrics(path: Path) -> dict[str, dict]:
    return {metric["key"]: metric for metric in json.loads(path.read_text())["metrics"]}


def test_ground_truth_in_every_stage_gives_perfect_scores(data: Path, weights: Path, tmp_path: Path) -> None:
    """The whole chain from files to the table, with nothing left to estimate but the range."""
    report = tmp_path / "report.json"
    arguments = ["eval", "run", str(data), "--weights", str(weights), "--truth", *ALL_STAGES, "--report", str(report)]
    assert main(arguments) == 0
    metrics = _metrics(report)
    for key in ("presence_accuracy", "box_accuracy", "miou", "auc_20_50_spherical", "direction_1deg", "range_3cm"):
        assert metrics[key]["value"] == pytest.approx(1), key
    for key in ("epe_2d_mean", "epe_3d_spherical_mean", "range_median", "cs_mpjpe", "mrrpe", "missed"):
        assert metrics[key]["value"] == pytest.approx(0, abs=1e-3), key
    assert metrics["epe_2d_mean"]["count"] == 3
    assert json.loads(report.read_text())["settings"]["truth"] == ALL_STAGES


def test_predict_then_score_equals_run(
    data: Path, weights: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--weights", str(weights), "--truth", "presence", "boxes"]
    predictions = str(tmp_path / "p.npz")
    assert main(["eval", "predict", str(data), "--out", predictions, *options]) == 0
    assert main(["eval", "score", predictions, str(data), "--report", str(tmp_path / "scored.json")]) == 0
    assert main(["eval", "run", str(data), *options, "--report", str(tmp_path / "run.json")]) == 0
    assert json.loads((tmp_path / "scored.json").read_text()) == json.loads((tmp_path / "run.json").read_text())
    printed = capsys.readouterr().out
    assert "presence accuracy" in printed and "CS-MPJPE" in printed
    assert main(["eval", "predict", str(data), "--out", predictions, *options]) == 2
    assert "exists already" in capsys.readouterr().err
    assert main(["eval", "score", predictions, str(data), "--report", str(tmp_path / "table.md")]) == 0
    assert "| presence accuracy | 1 | 1 | 1 |  | 6 |" in (tmp_path / "table.md").read_text()
    again = ["eval", "score", predictions, str(data), "--report", str(tmp_path / "table.md")]
    capsys.readouterr()
    assert main(again) == 2
    assert "table.md: exists already" in capsys.readouterr().err
    assert main([*again, "--overwrite"]) == 0


def test_count_takes_the_first_instances(data: Path, weights: Path, tmp_path: Path) -> None:
    report = tmp_path / "report.json"
    assert main(["eval", "run", str(data), "--weights", str(weights), "--count", "1", "--report", str(report)]) == 0
    assert json.loads(report.read_text())["images"] == 1
    assert main(["eval", "run", str(data), "--weights", str(weights), "--count", "0"]) == 2


def test_scoring_other_data_is_refused(
    data: Path, weights: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    predictions = str(tmp_path / "p.npz")
    assert main(["eval", "predict", str(data), "--out", predictions, "--weights", str(weights)]) == 0
    fakes.write_instance(tmp_path / "other" / "0")
    assert main(["eval", "score", predictions, str(tmp_path / "other")]) == 2
    assert "predictions belong to other data" in capsys.readouterr().err


def test_stage_truth_takes_only_what_is_named(data: Path) -> None:
    sample = Ego3DHands(data)[1]
    nothing = stage_truth(sample, ())
    assert all(getattr(nothing, name) is None for name in ("masks", "boxes_px", "present", "joints_px", "canonical"))
    truth = stage_truth(sample, ("masks", "boxes"))
    assert truth.present is None and truth.joints_px is None and truth.canonical is None
    assert truth.masks is not None and truth.boxes_px is not None and sample.labels is not None
    np.testing.assert_array_equal(truth.masks, (sample.labels > 0).astype(int))
    np.testing.assert_allclose(truth.boxes_px[LEFT, :2], sample.joints_px[LEFT].min(axis=0))
    np.testing.assert_allclose(truth.boxes_px[LEFT, 2:], sample.joints_px[LEFT].max(axis=0))
    assert np.isnan(truth.boxes_px[RIGHT]).all()


def test_masks_need_labels(data: Path) -> None:
    (data / "0" / "gt_seg.png").unlink()
    with pytest.raises(InputError, match="no part labels"):
        stage_truth(Ego3DHands(data)[0], ("masks",))
