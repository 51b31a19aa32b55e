"""What counts: visibility, hands without labels, hands that are never there, parts of a data set, video."""

from dataclasses import replace

import numpy as np
import pytest
from tests.evaluation.test_protocols import SAMPLES, make_sample, perfect_pose, predictions_for

from twohands.errors import InputError
from twohands.evaluation.breakdown import breakdowns
from twohands.evaluation.comparison import Protocol, compare, covered_share, sequences
from twohands.evaluation.curves import pck_curves
from twohands.evaluation.protocols import evaluate, metrics_of
from twohands.skeleton import LEFT, RIGHT, ROOT, WRIST, part_label
from twohands.types import HandPose, HandSample, TwoHandPose

NAN = np.nan


def one_joint_off(sample: HandSample) -> TwoHandPose:
    """The left index finger's tip is 8 px (at 960 px width) and 21 mm off."""
    pose = perfect_pose(sample)
    joints_px, joints_m = np.array(pose.left.joints_px), np.array(pose.left.joints_m)
    joints_px[8, 0] += 8
    joints_m[8, 0] += 0.021
    return replace(pose, left=replace(pose.left, joints_px=joints_px, joints_m=joints_m))


def test_visible_only() -> None:
    hidden = np.ones((2, 21), bool)
    hidden[LEFT, 8] = False
    sample = replace(SAMPLES[0], visible=hidden)
    predictions = predictions_for(one_joint_off, [sample])
    every, visible = (evaluate(predictions, [sample], Protocol(visible_only=v)) for v in (False, True))
    assert every["error_2d_mean"].left == pytest.approx(4 / 21)
    assert every["cs_mpjpe"].left == pytest.approx(21 / 21)
    assert visible["error_2d_mean"].left == 0 and visible["cs_mpjpe"].left == 0
    assert visible["range_median"].count == 2  # the root counts whether it is seen or not
    assert visible.protocol["visible_only"] is True


def test_boxes_end_at_the_edge_of_the_picture() -> None:
    """Named case: the true box of a hand that reaches far outside was once larger than any system can say."""
    sample = SAMPLES[0]
    inside = np.array([[10.0 * k + 3, 5.0 * k + 200] for k in range(21)])
    outside = inside.copy()
    outside[12] = [-5000, 5000]
    hands = np.stack([outside, sample.joints_px[1]])
    pose = perfect_pose(sample)

    def estimate(_: HandSample) -> TwoHandPose:
        box_px = np.array([0.0, 200.0, 203.0, sample.camera.height])
        return replace(pose, left=replace(pose.left, box_px=box_px))

    cut = replace(sample, joints_px=hands)
    compared = compare(predictions_for(estimate, [cut]), [cut])
    np.testing.assert_allclose(compared.box_iou[0], 1, atol=1e-6)
    # Named case: what a system says of a hand's place outside was held against it.
    whole = replace(pose, left=replace(pose.left, box_px=np.array([-5000.0, 200.0, 203.0, 5000.0])))
    compared = compare(predictions_for(lambda _: whole, [cut]), [cut])
    np.testing.assert_allclose(compared.box_iou[0], 1, atol=1e-6)


@pytest.mark.parametrize("found", [True, False])
def test_a_hand_that_is_not_labelled_whole_has_no_box(found: bool) -> None:
    """Named case: a right box was held against the small one of the only finger with labels. A right hand that is
    labelled whole and one that is not there still have theirs."""
    valid = SAMPLES[0].valid.copy()
    valid[LEFT] = np.arange(21) >= 17
    samples = [replace(SAMPLES[0], valid=valid), SAMPLES[3]]

    def estimate(sample: HandSample) -> TwoHandPose:
        pose = perfect_pose(SAMPLES[0] if sample is samples[0] else sample)
        return pose if found else replace(pose, left=HandPose(present=False))

    comparison = compare(predictions_for(estimate, samples), samples)
    assert comparison.boxed.tolist() == [[False, True], [True, True]]
    metrics = {metric.key: metric for metric in metrics_of(comparison)}
    assert (metrics["box_accuracy"].value, metrics["box_accuracy"].count) == (1, 3)
    assert metrics["presence_accuracy"].count == 4


def test_a_hand_out_of_the_picture_has_no_box() -> None:
    sample = replace(SAMPLES[0], joints_px=SAMPLES[0].joints_px - [[[5000, 0]], [[0, 0]]])
    comparison = compare(predictions_for(samples=[sample]), [sample])
    assert comparison.boxed.tolist() == [[False, True]]


def test_a_hidden_root_still_has_a_range() -> None:
    sample = replace(SAMPLES[0], visible=np.zeros((2, 21), bool))
    report = evaluate(predictions_for(samples=[sample]), [sample], Protocol(visible_only=True))
    assert report["range_median"].count == 2 and report["range_median"].value == pytest.approx(0, abs=1e-9)
    assert report["epe_2d_mean"].count == 0 and np.isnan(report["epe_2d_mean"].value)


@pytest.mark.parametrize("joint", [WRIST, ROOT])
def test_without_a_hand_length_the_canonical_pose_does_not_count(joint: int) -> None:
    """Named case: a hand that was found counted as missed in the 3D PCK where its wrist or root was not labelled."""
    valid = SAMPLES[0].valid.copy()
    valid[LEFT, joint] = False
    sample = replace(SAMPLES[0], valid=valid)
    comparison = compare(predictions_for(lambda _: perfect_pose(SAMPLES[0]), [sample]), [sample])
    for errors in (comparison.spherical_mm, comparison.cartesian_mm, comparison.procrustes_mm, comparison.bones_mm):
        assert np.isnan(errors[0, LEFT]).all() and np.isfinite(errors[0, RIGHT]).all()
    metrics = {metric.key: metric for metric in metrics_of(comparison)}
    for key in ("auc_20_50_spherical", "auc_20_50_cartesian", "auc_zb_spherical"):
        assert np.isnan(metrics[key].left) and metrics[key].value == metrics[key].right and metrics[key].count == 1, key
    assert metrics["epe_2d_mean"].count == metrics["cs_mpjpe"].count == 2  # its other joints still do
    panel = next(curve for curve in pck_curves(comparison) if curve.panel.key == "3d")
    assert panel.shares[-1] == 1


def test_hands_without_label_may_be_found() -> None:
    """Sample 1 has a left hand only; the system finds a right one as well."""

    def estimate(sample: HandSample) -> TwoHandPose:
        return replace(perfect_pose(sample), right=perfect_pose(SAMPLES[0]).right)

    predictions = predictions_for(estimate, [SAMPLES[1]])
    strict, lenient = (evaluate(predictions, [SAMPLES[1]], Protocol(all_hands_labelled=a)) for a in (True, False))
    assert (strict["false"].value, strict["presence_accuracy"].value) == (1, 1 / 2)
    assert np.isnan(lenient["false"].value) and lenient["false"].count == 0
    assert (lenient["presence_accuracy"].value, lenient["presence_accuracy"].count) == (1, 1)
    assert lenient["box_accuracy"].value == 1


def test_a_hand_that_is_never_there_is_not_applicable() -> None:
    """No zero and no one for a side of which there is nothing to measure."""
    samples = [make_sample(index, (True, False)) for index in range(3)]
    report = evaluate(predictions_for(samples=samples), samples)
    for metric in report.metrics:
        if metric.key in ("presence_accuracy", "box_accuracy", "false"):
            assert metric.right is not None and not np.isnan(metric.right), metric.key  # it could have been invented
        elif metric.right is not None:
            assert np.isnan(metric.right), metric.key
    assert report["missed"].left == 0 and report["epe_2d_mean"].value == pytest.approx(0, abs=1e-9)
    assert np.isnan(report["mrrpe"].value) and report["mrrpe"].count == 0
    assert "| hands missed | 0 | 0 | n/a | hands | 3 |" in report.to_markdown()


def test_no_hand_at_all() -> None:
    samples = [make_sample(index, (False, False)) for index in range(2)]
    report = evaluate(predictions_for(samples=samples), samples)
    assert report["presence_accuracy"].value == 1 and report["false"].value == 0
    measured = {metric.key for metric in report.metrics if not np.isnan(metric.value)}
    assert measured == {"presence_accuracy", "box_accuracy", "false", "miou", "iou_background"}


def test_covered_share() -> None:
    """Left 2 x 2 at the origin, right 4 x 2 from (1, 0): they share 1 x 2, half of the left, a quarter of the right."""
    boxes = np.array([[[0, 0, 2, 2], [1, 0, 5, 2]], [[0, 0, 1, 1], [5, 5, 6, 6]], [[0, 0, 1, 1], [NAN] * 4]])
    np.testing.assert_array_equal(covered_share(boxes), [[1 / 2, 1 / 4], [0, 0], [0, NAN]])


def test_parts_add_up() -> None:
    """Hands at 0.4 m and 0.5 m: every hand is in one part, and a part's number is its hands'."""

    def estimate(sample: HandSample) -> TwoHandPose:
        pose = perfect_pose(sample)
        return pose if pose.left.joints_px is None else replace(pose, left=HandPose(present=False))

    comparison = compare(predictions_for(estimate), SAMPLES)
    by_distance, by_overlap, by_view, by_side = breakdowns(comparison)
    for table in (by_distance, by_overlap, by_view, by_side):
        assert sum(part.hands for part in table.parts) == 5
        assert np.nansum([part.values["missed"] for part in table.parts]) == 3
    assert [part.name for part in by_side.parts] == ["left", "right"]
    assert [(part.name, part.hands) for part in by_distance.parts] == [("40-50 cm", 3), ("50-60 cm", 2)]
    assert by_distance.parts[0].values["missed"] == 3 and np.isnan(by_distance.parts[0].values["cs_mpjpe"])
    assert by_distance.parts[1].values["cs_mpjpe"] == pytest.approx(0, abs=1e-9)
    assert {part.name for part in by_overlap.parts} >= {"alone in the picture"}


def test_parts_by_joints_in_view() -> None:
    """Sample 0's left hand keeps 10 of its joints' pixels, its right hand all; without part labels nothing is known."""
    sample = SAMPLES[0]
    labels = np.full((540, 960), part_label(RIGHT, 1), np.uint8)
    row = np.stack([np.arange(21), np.zeros(21)], axis=-1)
    joints_px = np.array([[100.5, 100.5], [600.5, 300.5]])[:, None] + row
    labels[100, 100:110] = part_label(LEFT, 3)
    cut = replace(sample, joints_px=joints_px, labels=labels)
    comparison = compare(predictions_for(samples=[cut]), [cut])
    np.testing.assert_allclose(comparison.visible_share, [[10 / 21, 1]])
    table = next(table for table in breakdowns(comparison) if table.key == "joints in view")
    assert [(part.name, part.hands) for part in table.parts] == [("25-50 %", 1), ("over 75 %", 1)]
    unlabelled = replace(cut, labels=None)
    comparison = compare(predictions_for(lambda _: perfect_pose(cut), [unlabelled]), [unlabelled])
    assert "joints in view" not in [table.key for table in breakdowns(comparison)]


def test_all_hands_kept_changes_no_hand_metric() -> None:
    comparison = compare(predictions_for(one_joint_off, SAMPLES[:1]), SAMPLES)
    everything = {metric.key: metric.value for metric in metrics_of(comparison)}
    kept = {metric.key: metric.value for metric in metrics_of(comparison.of_hands(np.ones((1, 2), bool)))}
    assert kept["cs_mpjpe"] == everything["cs_mpjpe"] > 0
    assert "miou" not in kept and np.isnan(kept["mrrpe"])
    none = {metric.key: metric for metric in metrics_of(comparison.of_hands(np.zeros((1, 2), bool)))}
    assert all(np.isnan(metric.value) for metric in none.values())


def test_video() -> None:
    """Two folders of three frames; the left hand jumps 1 cm away from the camera in one middle frame.

    Radial error 2 x 0.01 m x 100 = 2 m/s2 there and 0 in the other folder's: mean 1.
    """
    samples = [replace(SAMPLES[0], source=f"{folder}/{frame}") for folder in "ab" for frame in range(3)]

    def estimate(sample: HandSample) -> TwoHandPose:
        pose = perfect_pose(sample)
        if sample.source != "a/1":
            return pose
        joints = np.array(pose.left.joints_m)
        return replace(pose, left=replace(pose.left, joints_m=joints * (1 + 0.01 / np.linalg.norm(joints[9]))))

    report = evaluate(predictions_for(estimate, samples), samples, Protocol(fps=10))
    assert report["acceleration_radial"].left == pytest.approx(1)
    assert report["acceleration_tangential"].left == pytest.approx(0, abs=1e-9)
    assert report["acceleration_radial"].count == 4
    with pytest.raises(KeyError):
        evaluate(predictions_for(estimate, samples), samples)["acceleration_radial"]


def test_sequences_are_folders() -> None:
    assert sequences(("s1/0", "s2/0", "s1/1", "x")) == [[0, 2], [1], [3]]
    for fps in (-1, 0, float("inf"), float("nan")):
        with pytest.raises(InputError, match="above 0"):
            Protocol(fps=fps)


def test_sides_are_not_mixed() -> None:
    """Swapping the system's hands ruins the scores: nothing is matched behind the user's back."""

    def estimate(sample: HandSample) -> TwoHandPose:
        pose = perfect_pose(sample)
        return replace(pose, left=pose.right, right=pose.left)

    report = evaluate(predictions_for(estimate, SAMPLES[:1]), SAMPLES)
    assert report["cs_mpjpe"].value > 100 and report["box_accuracy"].value == 0
    assert report["presence_accuracy"].value == 1
