"""`twohands eval`: predict, score and run agree; stages can be replaced by ground truth."""

import json
import os
from pathlib import Path

import pytest
from tests.datasets import fakes
from tests.oracles import write_tiny_weights

from twohands.cli.main import main
from twohands.errors import InputError
from twohands.evaluation.summary import Summary
from twohands.inference.weights import read_card

ALL_STAGES = ["presence", "masks", "boxes", "joints-2d", "heatmaps", "canonical"]


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
    settings = json.loads(report.read_text())["settings"]
    assert settings["truth"] == ALL_STAGES
    assert {name: settings["card"][name] for name in ("views", "decision", "placement")} == json.loads(
        json.dumps(read_card(weights).settings())
    )


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


def test_budget_and_report(data: Path, weights: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The isolated global step shows 0.000 in the printed table, the JSON and the report."""
    budget, ours, out = tmp_path / "budget.json", str(tmp_path / "p.npz"), tmp_path / "report"
    assert main(["eval", "budget", str(data), "--weights", str(weights), "--out", str(budget)]) == 0
    printed = capsys.readouterr().out
    assert "global" in printed and printed.count("0.000") >= 7
    first = json.loads(budget.read_text())["rows"][0]
    for method in ("keybone", "fitted"):
        assert first["metrics"][method]["cs_mpjpe"] == pytest.approx(0, abs=1e-3)  # the labels are float32 in cm
        assert first["metrics"][method]["missed"] == 0
    assert main(["eval", "predict", str(data), "--out", ours, "--weights", str(weights)]) == 0
    arguments = ["eval", "report", str(data), "--predictions", ours, "--names", "ours", "--out", str(out)]
    assert main([*arguments, "--budget", str(budget), "--note", "tiny"]) == 0
    content = json.loads((out / "report.json").read_text())
    assert content["kind"] == "ego3dhands" and content["systems"][0]["name"] == "ours" and content["notes"] == ["tiny"]
    text = (out / "report.md").read_text()
    assert "| global step alone | 0.000 | 0.000 | 0.000 | 0.000 / 0.000 | 0.000 / 0.000 | 0 |" in text
    assert "0.955" in text and "> tiny" in text
    page = (out / "report.html").read_text()
    assert page.startswith("<!DOCTYPE html>") and "<svg" in page and 'src="data:image/png' in page
    assert "http://" not in page.replace("http://www.w3.org", "").replace("http://purl.org", "")  # nothing is fetched
    assert main(arguments) == 2
    assert "is not empty" in capsys.readouterr().err


def test_report_refuses_what_does_not_fit(
    data: Path, weights: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def refused(message: str, *more: str, files: tuple[str, ...] = (str(tmp_path / "p.npz"),)) -> None:
        capsys.readouterr()
        out = str(tmp_path / "out")
        assert main(["eval", "report", str(data), "--predictions", *files, "--out", out, *more]) == 2
        assert message in " ".join(capsys.readouterr().err.split())
        assert not (tmp_path / "out").exists()

    two = (str(tmp_path / "p.npz"), str(tmp_path / "q.npz"))
    for path, options in zip(two, ([], ["--count", "2"]), strict=True):
        assert main(["eval", "predict", str(data), "--out", path, "--weights", str(weights), *options]) == 0
    refused("they must hold the same", files=two)
    refused("2 different names", "--names", "a", "a", files=(two[0], two[0]))
    (tmp_path / "b.json").write_text("{}")
    refused("not an error budget", "--budget", str(tmp_path / "b.json"))
    (tmp_path / "b.json").write_text('{"version": 9}')
    refused("budget of version 2, got 9", "--budget", str(tmp_path / "b.json"))
    assert main(["eval", "budget", str(data / "1"), "--weights", str(weights), "--out", str(tmp_path / "c.json")]) == 0
    refused("the budget is of other data", "--budget", str(tmp_path / "c.json"))
    refused("no such file", files=(str(tmp_path / "none.npz"),))
    refused("--cases must be at least 0, got -1", "--cases", "-1")


def test_a_report_that_cannot_be_written_is_noticed_before_the_work(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    no_weights = str(tmp_path / "none")  # whoever looks for them has begun already
    report = str(tmp_path / "file" / "r.json")
    assert main(["eval", "run", str(data), "--weights", no_weights, "--report", report]) == 2
    assert "is a file, not a folder" in capsys.readouterr().err


def test_import_then_score(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    images = [{"source": str(index), "left": None, "right": None} for index in range(3)]
    (tmp_path / "theirs.json").write_text(json.dumps({"version": 1, "system": "blind", "images": images}))
    imported = str(tmp_path / "p.npz")
    assert main(["eval", "import", str(tmp_path / "theirs.json"), str(data), "--out", imported]) == 0
    assert main(["eval", "score", imported, str(data), "--report", str(tmp_path / "r.json")]) == 0
    metrics = _metrics(tmp_path / "r.json")
    assert metrics["missed"]["value"] == 3 and metrics["auc_2d"]["value"] == 0 and metrics["cs_mpjpe"]["value"] is None
    assert "blind" in capsys.readouterr().out


def test_a_peer_needs_its_environment(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["eval", "predict", str(data), "--out", str(tmp_path / "p.npz"), "--peer", "mediapipe"]
    assert main([*arguments, "--peer-python", str(tmp_path / "python")]) == 2
    assert "cannot be run" in capsys.readouterr().err
    assert main([*arguments, "--truth", "boxes", "--peer-python", "/bin/false"]) == 2
    assert "a peer has none of them" in capsys.readouterr().err


def test_smoothing_changes_ranges_of_video_only(data: Path, weights: Path, tmp_path: Path) -> None:
    """Three frames of one folder: the tracker starts to smooth with the third; it is written into the settings."""
    report = tmp_path / "r.json"
    options = ["--weights", str(weights), "--smooth", "--fps", "30", "--report", str(report)]
    assert main(["eval", "run", str(data), *options]) == 0
    settings = json.loads(report.read_text())["settings"]
    assert settings["smoothed"] is True


def test_budget_of_the_first_images_and_results(data: Path, weights: Path, tmp_path: Path) -> None:
    """A budget may be about the first images only; the page says so, and shows 0.000 for the global step alone."""
    ours, budget, out = str(tmp_path / "p.npz"), str(tmp_path / "b.json"), tmp_path / "report"
    assert main(["eval", "predict", str(data), "--out", ours, "--weights", str(weights)]) == 0
    assert main(["eval", "budget", str(data), "--weights", str(weights), "--count", "2", "--out", budget]) == 0
    report = ["eval", "report", str(data), "--predictions", ours, "--names", "ours", "--out", str(out), "--fps", "30"]
    assert main([*report, "--budget", budget]) == 0
    assert main(["eval", "sweep", ours, str(data), "--lengths", "3", "--out", str(tmp_path / "s.json")]) == 0
    page = tmp_path / "results.md"
    results = ["eval", "results", str(out / "report.json"), "--sweeps", str(tmp_path / "s.json"), "--out", str(page)]
    assert main(results) == 0
    text = page.read_text()
    assert "Over the first 2 images." in text and "| global step alone | 0.000 | 0.000 | 0.000 |" in text
    assert "| off | - |" in text and "| 3 | 1 |" in text
    assert main(results) == 2  # never overwritten unasked
    page = tmp_path / "short.md"
    page.write_text("# Results\n\nText.\n")
    assert main([*results, "--overwrite", "--insert", str(page)]) == 0
    assert "What each stage costs, ours on " in page.read_text() and page.read_text().endswith("Text.\n")


def test_names_that_are_no_text(data: Path, weights: Path, tmp_path: Path) -> None:
    """Named case: a folder's name that is not UTF-8 ended every step with a traceback, after the work."""
    (data / "0").rename(data / os.fsdecode(b"0\xfd"))
    data, ours = data.rename(tmp_path / os.fsdecode(b"d\xff")), str(tmp_path / os.fsdecode(b"p\xfe.npz"))
    budget, sweep, out = str(tmp_path / "b.json"), str(tmp_path / "s.json"), tmp_path / "report"
    assert main(["eval", "predict", str(data), "--out", ours, "--weights", str(weights)]) == 0
    assert main(["eval", "score", ours, str(data), "--report", str(tmp_path / "table.md")]) == 0
    assert main(["eval", "budget", str(data), "--weights", str(weights), "--count", "1", "--out", budget]) == 0
    report = ["eval", "report", str(data), "--predictions", ours, "--budget", budget, "--out", str(out)]
    assert main([*report, "--note", os.fsdecode(b"n\xfc")]) == 0
    assert main(["eval", "sweep", ours, str(data), "--lengths", "3", "--out", sweep]) == 0
    results = str(tmp_path / "results.md")
    assert main(["eval", "results", str(out / "report.json"), "--sweeps", sweep, "--out", results]) == 0
    for page in (tmp_path / "table.md", out / "report.md", out / "report.html", tmp_path / "results.md"):
        assert "d\\udcff" in page.read_text(encoding="utf-8"), page


def test_a_report_that_cannot_be_rendered_leaves_nothing(
    data: Path, weights: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Named case: report.json was written before report.md was made."""

    def fail(_: Summary) -> str:
        raise InputError("no page")

    assert main(["eval", "predict", str(data), "--out", str(tmp_path / "p.npz"), "--weights", str(weights)]) == 0
    monkeypatch.setattr(Summary, "to_markdown", fail)
    out = tmp_path / "report"
    assert main(["eval", "report", str(data), "--predictions", str(tmp_path / "p.npz"), "--out", str(out)]) == 2
    assert not out.exists()


def test_results_refuse_what_is_no_report(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = ["--out", str(tmp_path / "r.md")]
    assert main(["eval", "results", str(tmp_path / "none.json"), *out]) == 2
    assert "no such file" in capsys.readouterr().err
    for text in ("{}", "[]", "nonsense", '{"version": 1}', "[" * 200_000):
        (tmp_path / "r.json").write_text(text)
        assert main(["eval", "results", str(tmp_path / "r.json"), *out]) == 2
        assert "not a report.json of twohands eval report" in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "r.md").exists()
