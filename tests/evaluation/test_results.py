"""One page from finished reports: the paper's numbers in their column, nothing lost on the way through JSON."""

import json
from dataclasses import replace

import numpy as np
import pytest
from tests.evaluation.test_protocols import SAMPLES, perfect_pose, predictions_for

from twohands.errors import InputError
from twohands.evaluation.comparison import Protocol, compare
from twohands.evaluation.results import comparison_table, headlines, inserted, results_page, sweep_findings, sweep_table
from twohands.evaluation.summary import BUDGET_COLUMNS, BUDGET_TEXT, Summary, summarise

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


def test_a_metric_that_the_first_system_lacks_keeps_its_row() -> None:
    """Named case: beside a first system without masks, the IoU of all others was left out; the order is theirs then."""
    blind = predictions_for(lambda sample: replace(perfect_pose(sample), masks=None))
    whole = predictions_for(perfect_pose)
    systems = {"blind": (blind, compare(blind, SAMPLES)), "ours": (whole, compare(whole, SAMPLES))}
    tables = [
        comparison_table(summarise("ego3dhands", [(name, *systems[name]) for name in names], Protocol()))
        for names in (("blind", "ours"), ("ours", "blind"))
    ]
    rows = [{row[0]: row for row in table} for table in tables]
    assert rows[0].keys() == rows[1].keys()
    assert rows[0]["mIoU (per image)"][2:] == ["n/a", "0.955 (static); 0.962 (dynamic)", "1", "0 / 4"]
    assert [row[0] for row in tables[1]] == [row[0] for row in comparison_table(summary_of())]


def test_fewer_images_of_the_budget_are_told_of_in_every_report() -> None:
    """Named case: only the page of results said so."""
    errors = dict.fromkeys((*BUDGET_COLUMNS, "missed"), 0.0)
    row = {
        "study": "s", "estimated": "nothing", "stage": "global", "against": None,
        "metrics": {"fitted": errors, "keybone": errors},
    }  # fmt: skip
    for images, told in ((2, 1), (4, 0)):
        summary = replace(summary_of(), budget={"images": images, "rows": [row]})
        for text in (summary.to_markdown(), results_page([summary])):
            assert text.count("Over the first 2 images.") == told and text.count(BUDGET_TEXT) == 1


def test_common_hands_have_a_range() -> None:
    """A system without any range leaves none, and the heading says what is asked for."""
    predictions = predictions_for(perfect_pose)
    flat = predictions_for(
        lambda sample: replace(
            perfect_pose(sample),
            left=replace(perfect_pose(sample).left, valid=False),
            right=replace(perfect_pose(sample).right, valid=False),
        )
    )
    ours, unplaced = (("a", p, compare(p, SAMPLES)) for p in (predictions, flat))
    assert summarise("stb", [ours, unplaced], Protocol()).common_table() == []
    both = summarise("stb", [ours, ("b", *ours[1:])], Protocol())
    for text in (both.to_markdown(), results_page([both])):
        assert "# Over the hands that every system found, with a range\n" in text


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


def test_headlines_have_a_row_for_each_system_of_each_set() -> None:
    lines = headlines([summary_of(), summary_of("stb")]).splitlines()
    assert len(lines) == 2 + 2 * 2  # no budget was measured
    dataset = summary_of().systems[0].report
    assert lines[2].startswith(f"| {dataset.dataset}, {dataset.images} images | ours | 1 | 1 | 0 |")
    assert lines[3].startswith("|  | MediaPipe | 1 |") and lines[3].endswith("| 0 |")


class TestInsertion:
    """Text between markers of a document that people write."""

    BEGIN, END = "<!-- x -->", "<!-- /x -->"

    def test_below_the_title_where_there_are_no_markers(self) -> None:
        expected = f"# Title\n\n{self.BEGIN}\n\nT\n\n{self.END}\n\nText.\n"
        assert inserted("# Title\n\nText.\n", "T", "x") == expected

    def test_between_the_markers_and_nowhere_else(self) -> None:
        once = inserted(inserted("# Title\n\nText.\n", "other", "y"), "T", "x")
        assert inserted(once, "T", "x") == once
        assert inserted(once, "U", "x") == once.replace("\nT\n", "\nU\n")

    @pytest.mark.parametrize("text", [f"a\n{BEGIN}\n", f"{END} {BEGIN}", END])
    def test_half_a_pair_is_refused(self, text: str) -> None:
        with pytest.raises(InputError, match="later"):
            inserted(text, "T", "x")
