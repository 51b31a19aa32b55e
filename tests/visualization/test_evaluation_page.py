"""The page shows the right hands, says n/a where there is nothing, and escapes what it is given."""

from dataclasses import replace

import numpy as np
import pytest
from tests.evaluation.test_protocols import SAMPLES, perfect_pose, predictions_for

from twohands.evaluation.comparison import Protocol, compare
from twohands.evaluation.summary import BUDGET_COLUMNS, is_number, markdown_table, summarise
from twohands.skeleton import LEFT, RIGHT
from twohands.types import HandPose, HandSample, TwoHandPose
from twohands.visualization.evaluation_page import Case, case_picture, render_page, typical_images, worst_hands

pytest.importorskip("matplotlib")


def system(sample: HandSample) -> TwoHandPose:
    """Sample 0: left 3 cm too far to the right; sample 2: right missed; sample 3: a left hand invented."""
    pose = perfect_pose(sample)
    if sample.source == "00000":
        return replace(pose, left=replace(pose.left, joints_m=np.add(pose.left.joints_m, [0.03, 0, 0])))
    if sample.source == "00002":
        return replace(pose, right=HandPose(present=False))
    return replace(pose, left=perfect_pose(SAMPLES[0]).left) if sample.source == "00003" else pose


COMPARISON = compare(predictions_for(system), SAMPLES)


def test_worst_hands() -> None:
    found = worst_hands(COMPARISON, 1)
    assert [(index, side) for index, side, _ in found] == [(0, LEFT), (2, RIGHT), (3, LEFT)]
    assert found[0][2].startswith("left: CS-MPJPE 30 mm") and found[1][2] == "right: missed"
    assert found[2][2] == "left: found, but there is none"
    assert len(worst_hands(COMPARISON, 9)) == 6  # four measured hands, one missed, one invented


def test_typical_images_have_all_hands() -> None:
    assert [index for index, _ in typical_images(COMPARISON)] in ([1, 0], [0, 1])  # 2 misses one, 3 has none
    assert typical_images(COMPARISON)[-1][0] == 0
    empty = compare(predictions_for(samples=SAMPLES[3:]), SAMPLES[3:])
    assert typical_images(empty) == [] and worst_hands(empty, 3) == []


def test_the_estimate_is_drawn_where_the_hand_is() -> None:
    """On a black picture every lit pixel of the cut-out lies within the hand's box; another hand is not drawn."""
    sample = SAMPLES[0]
    case = Case(sample, perfect_pose(sample), "", LEFT)
    picture = case_picture(case)
    assert picture.shape == (480, 480, 3) and picture.any()
    joints = sample.joints_px[LEFT]
    alone = replace(
        case, sample=replace(sample, present=np.array([True, False])), pose=replace(case.pose, right=HandPose(False))
    )
    np.testing.assert_array_equal(case_picture(alone), picture)
    assert np.ptp(joints, axis=0).max() > 50


@pytest.mark.parametrize("side", [LEFT, RIGHT, None])
def test_hands_without_labels_that_nobody_found_are_shown_as_the_whole_picture(side) -> None:
    sample = SAMPLES[0]
    unlabelled = replace(
        sample,
        joints_px=np.full((2, 21, 2), np.nan),
        joints_m=np.full((2, 21, 3), np.nan),
        valid=np.zeros((2, 21), bool),
    )
    nobody = TwoHandPose(HandPose(False), HandPose(False), sample.camera)
    picture = case_picture(Case(unlabelled, nobody, "", side))
    empty = replace(unlabelled, present=np.array([False, False]))
    np.testing.assert_array_equal(picture, case_picture(Case(empty, nobody, "", None)))


def test_page_and_markdown_with_two_systems() -> None:
    predictions = predictions_for(system)
    blind = predictions_for(lambda sample: TwoHandPose(HandPose(False), HandPose(False), sample.camera))
    systems = [("a <b>", predictions, COMPARISON), ("blind", blind, compare(blind, SAMPLES))]
    summary = summarise("ego3dhands", systems, Protocol(), notes=("1 < 2",))
    page = render_page(summary, [Case(SAMPLES[0], system(SAMPLES[0]), "typical")], [])
    assert "a &lt;b&gt;" in page and "1 &lt; 2" in page and "<b>" not in page
    assert ">nan<" not in page and ">n/a<" in page
    text = summary.to_markdown()
    line = next(line for line in text.splitlines() if line.startswith("| CS-MPJPE |"))
    cells = [cell.strip() for cell in line.split("|")]
    assert float(cells[3]) == pytest.approx(5)  # left (30 + 0 + 0) / 3, right 0: mean 5
    assert cells[4:6] == ["n/a", "4 / 0"]
    assert summary.common_table() == []  # no hand was found by both


def test_fewer_images_of_the_budget_are_told_of_in_the_page() -> None:
    errors = dict.fromkeys((*BUDGET_COLUMNS, "missed"), 0.0)
    row = {"study": "s", "estimated": "nothing", "stage": "global", "against": None}
    predictions = predictions_for(system)
    summary = summarise("stb", [("a", predictions, COMPARISON)], Protocol())
    for images, told in ((2, 1), (4, 0)):
        rows = [row | {"metrics": {"fitted": errors, "keybone": errors}}]
        page = render_page(replace(summary, budget={"images": images, "rows": rows}), [], [])
        assert page.count("<p>Over the first 2 images.</p>") == told and page.count("<h2>Error budget</h2>") == 1


def test_common_hands() -> None:
    """Over the hands that both found, a system gains nothing by missing the difficult one."""
    shy = predictions_for(
        lambda sample: (
            replace(perfect_pose(sample), left=HandPose(False)) if sample.source == "00000" else perfect_pose(sample)
        )
    )
    bold = predictions_for(system)
    systems = [("bold", bold, COMPARISON), ("shy", shy, compare(shy, SAMPLES))]
    table = summarise("stb", systems, Protocol()).common_table()
    row = next(row for row in table if row[0] == "CS-MPJPE")
    assert (
        row[-1] == "3" and float(row[2]) == pytest.approx(0, abs=1e-3) and float(row[3]) == pytest.approx(0, abs=1e-3)
    )


@pytest.mark.parametrize(
    ("text", "number"), [("1.5", True), ("+3 / n/a", True), ("-", True), ("", False), ("mm", False), ("1 mm", False)]
)
def test_is_number(text: str, number: bool) -> None:
    assert is_number(text) is number


def test_markdown_cells_cannot_break_the_table() -> None:
    assert markdown_table([["a|b", "c"], ["x", "1"]]) == ["| a/b | c |", "| --- | ---: |", "| x | 1 |"]
