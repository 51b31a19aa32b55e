"""One page from finished reports: the paper's numbers in their column, nothing lost on the way through JSON."""

import json

import numpy as np
import pytest
from tests.evaluation.test_protocols import SAMPLES, perfect_pose, predictions_for

from twohands.evaluation.comparison import Protocol, compare
from twohands.evaluation.results import comparison_table, results_page, sweep_findings, sweep_table
from twohands.evaluation.summary import Summary, summarise

METRICS = ("range_mean", "range_median", "range_7cm", "cs_mpjpe", "acceleration_radial")


def summary_of(kind: str = "ego3dhands") -> Summary:
    predictions = predictions_for(perfect_pose)
    compared = [(name, predictions, compare(predictions, SAMPLES)) for name in ("ours", "MediaPipe")]
    return summarise(kind, compared, Protocol(), command="twohands eval report x", notes=("a note",))


def sweep() -> dict:
    rows = [
        {"name": name, "length": n, "degree": degree, "fade": fade, "metrics": dict(zip(METRICS, values, strict=True))}
        for name, n, degree, fade, values in [
            ("none at all", None, None, None, (2.0, 1.0, 0.9, 20.0, 8.0)),
            ("eight", 8, 1, 1.0, (1.5, 1.0, 0.9, 21.0, 4.0)),
            ("fifteen", 15, 2, 0.75, (1.5, 1.25, 0.95, 22.0, None)),
        ]
    ]
    return {
        "dataset": "video", "weights": "w", "frames": 9, "sequences": 3, "fps": 30.0,
        "command": "twohands eval sweep v", "rows": rows,
    }  # fmt: skip


def test_json_and_back() -> None:
    summary = summary_of()
    text = json.dumps(summary.to_dict(), allow_nan=False)
    again = Summary.from_dict(json.loads(text))
    assert again.to_markdown() == summary.to_markdown()
    np.testing.assert_array_equal(again.systems[0].curves[0].shares, summary.systems[0].curves[0].shares)
    with pytest.raises(ValueError, match="version 3, got 1"):
        Summary.from_dict(json.loads(text) | {"version": 1})


def test_ours_paper_mediapipe() -> None:
    table = comparison_table(summary_of())
    assert table[0] == ["metric", "unit", "ours", "paper", "MediaPipe", "count"]
    rows = {row[0]: row for row in table[1:]}
    assert rows["mIoU (per image)"][3] == "0.955 (static); 0.962 (dynamic)"
    assert rows["theta within 3 deg"][3] == "0.90 (static and dynamic)"  # no headline of ours, but the paper has it
    assert rows["CS-MPJPE"][2:] == ["0", "", "0", "5"]
    assert all(not row[3] for row in comparison_table(summary_of("freihand"))[1:])


def test_sweep_by_hand() -> None:
    assert sweep_table(sweep())[1:] == [
        ["off", "-", "-", "2", "1", "0.900", "20", "8"],
        ["8", "1", "1", "1.500", "1", "0.900", "21", "4"],
        ["15", "2", "0.75", "1.500", "1.250", "0.950", "22", "n/a"],
    ]
    assert sweep_findings(sweep()) == [
        "Best by range, mean (cm): eight, 1.500.",  # the first of two equal ones
        "Best by range, median (cm): none at all, 1.",
        "Best by within 7 cm: fifteen, 0.950.",
        "Best by CS-MPJPE (mm): none at all, 20.",
        "Best by acceleration error, radial (m/s2): eight, 4.",
        "The tracker's default: fifteen.",
    ]


def test_page() -> None:
    page = results_page(
        [summary_of(), summary_of("rhd")], [sweep()], command="twohands eval results a", notes=("mind",)
    )
    for part in ("twohands eval results a", "> mind", "> a note", "twohands eval report x", "twohands eval sweep v"):
        assert part in page, part
    assert page.count("## Range smoothing over video") == 1 and page.count("\n## ") == 3
    assert "- mIoU (per image): the paper does not say how it averages" in page
    assert "| Zimmermann and Brox | 3D EPE median, Cartesian alignment | 18.80 mm |" in page
