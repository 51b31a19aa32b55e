"""Metrics against numbers computed by hand; the fractions are written out."""

import numpy as np
import pytest

from twohands.evaluation import metrics as m
from twohands.skeleton import BONES, LEFT, RIGHT

NAN, INF = np.nan, np.inf


class TestPresenceAndBoxes:
    def test_presence_counts_misses_and_false_finds_alike(self) -> None:
        truth = [[True, True], [True, False], [False, False]]
        predicted = [[True, False], [True, True], [False, False]]
        assert m.presence_accuracy(predicted, truth) == pytest.approx(4 / 6)

    def test_box_rules(self) -> None:
        #          good  poor   exactly 0.5  missed  false  absent
        iou = [0.51, 0.49, 0.5, NAN, NAN, NAN]
        truth = [True, True, True, True, False, False]
        predicted = [True, True, True, False, True, False]
        np.testing.assert_array_equal(m.box_correct(iou, predicted, truth), [True, False, False, False, False, True])

    def test_a_stale_overlap_does_not_save_a_miss(self) -> None:
        assert not m.box_correct([0.9], [False], [True])[0]
        assert not m.box_correct([0.9], [True], [False])[0]


class TestSegmentation:
    def test_overlap_counts(self) -> None:
        predicted = np.array([[0, 1, 1, 2], [0, 0, 1, 2]])
        truth = np.array([[0, 1, 2, 2], [0, 1, 1, 0]])
        intersection, union = m.class_overlaps(predicted, truth)
        np.testing.assert_array_equal(intersection, [2, 2, 1])
        np.testing.assert_array_equal(union, [4, 4, 3])
        assert m.mean_iou([intersection], [union]) == pytest.approx((2 / 4 + 1 / 3) / 2)

    def test_absent_hands(self) -> None:
        """Neither mask has it: 1. Only one of them has it: 0."""
        empty, left = np.zeros((2, 2), int), np.array([[1, 0], [0, 0]])
        nothing = m.class_overlaps(empty, empty)
        false = m.class_overlaps(left, empty)
        missed = m.class_overlaps(empty, left)
        assert m.mean_iou([nothing[0]], [nothing[1]]) == 1.0
        assert m.mean_iou([false[0]], [false[1]]) == pytest.approx((0 + 1) / 2)
        assert m.mean_iou([missed[0]], [missed[1]]) == pytest.approx((0 + 1) / 2)

    def test_per_image_and_pooled_differ(self) -> None:
        """A small perfect image and a large half-right one: 3/4 per image, 11/20 pooled."""
        intersections = [[0, 1, 1], [0, 5, 5]]
        unions = [[9, 1, 1], [9, 10, 10]]
        assert m.mean_iou(intersections, unions) == pytest.approx((1 + 5 / 10) / 2)
        np.testing.assert_allclose(m.dataset_iou(intersections, unions), [0 / 18, 6 / 11, 6 / 11])

    def test_shapes_must_agree(self) -> None:
        with pytest.raises(ValueError, match="differ in shape"):
            m.class_overlaps(np.zeros((2, 2)), np.zeros((2, 3)))


class TestJointErrors:
    def test_unknown_is_nan_and_missed_is_infinite(self) -> None:
        truth = np.zeros((3, 2, 2))
        truth[0, 1] = NAN  # unknown joint
        predicted = np.zeros((3, 2, 2))
        predicted[0, 0] = [3, 4]
        predicted[2, 0] = NAN  # found, but without this joint
        errors = m.endpoint_errors(predicted, truth, [True, False, True])
        np.testing.assert_array_equal(errors, [[5, NAN], [INF, INF], [INF, 0]])

    def test_mean_and_median_are_per_joint_first(self) -> None:
        """Joint 0: 1, 2, 9 (mean 4, median 2). Joint 1: 10 once. Pooled: 1, 2, 9, 10."""
        errors = [[1, 10], [2, NAN], [9, NAN], [INF, INF]]
        assert m.epe_mean(errors) == pytest.approx((4 + 10) / 2)
        assert m.epe_median(errors) == pytest.approx((2 + 10) / 2)
        assert m.finite_mean(errors) == pytest.approx(22 / 4)
        assert m.finite_median(errors) == pytest.approx((2 + 9) / 2)

    def test_joints_without_any_error_do_not_count(self) -> None:
        assert m.epe_mean([[2, NAN], [4, INF]]) == pytest.approx(3)
        assert np.isnan(m.epe_mean([[NAN, NAN]]))
        assert np.isnan(m.epe_median(np.empty((0, 21))))

    def test_pck_includes_its_threshold_and_counts_misses(self) -> None:
        errors = [[1, 2], [2, NAN], [INF, INF]]
        np.testing.assert_allclose(
            m.pck_curve(errors, [0.5, 1, 2, 100]),
            [(0 / 3 + 0 / 2) / 2, (1 / 3 + 0 / 2) / 2, (2 / 3 + 1 / 2) / 2, (2 / 3 + 1 / 2) / 2],
        )

    def test_auc_is_the_trapezoid_over_the_range(self) -> None:
        """Two errors 0 and 2 at thresholds 0, 1, 2, 4: shares 1/2, 1/2, 1, 1."""
        expected = (1 * (1 / 2 + 1 / 2) / 2 + 1 * (1 / 2 + 1) / 2 + 2 * 1) / 4
        assert m.pck_auc([[0.0], [2.0]], [0, 1, 2, 4]) == pytest.approx(expected)
        assert m.pck_auc([[0.0], [0.0]], m.AUC_20_50_MM) == pytest.approx(1)
        assert m.pck_auc([[50.1], [INF]], m.AUC_20_50_MM) == 0
        assert np.isnan(m.pck_auc([[NAN]], m.AUC_2D_PX))

    def test_threshold_lists(self) -> None:
        """docs/evaluation.md, *Thresholds*: 100 points, and the 8th-index quirk: 8 * 50/19 mm."""
        assert (len(m.AUC_20_50_MM), m.AUC_20_50_MM[0], m.AUC_20_50_MM[-1]) == (100, 20, 50)
        assert (len(m.AUC_0_50_MM), m.AUC_0_50_MM[0], m.AUC_0_50_MM[-1]) == (100, 0, 50)
        assert (len(m.AUC_ZB_MM), m.AUC_ZB_MM[-1]) == (12, 50)
        assert m.AUC_ZB_MM[0] == pytest.approx(8 * 50 / 19)

    def test_zb_parity(self) -> None:
        """Three frames, two joints, as its EvalUtil computes: <=, per-joint medians, normalised trapezoids."""
        errors = np.array([[10.0, 30.0], [25.0, 50.0], [60.0, 22.0]])
        assert m.epe_mean(errors) == pytest.approx(((10 + 25 + 60) / 3 + (30 + 50 + 22) / 3) / 2)
        assert m.epe_median(errors) == pytest.approx((25 + 30) / 2)
        # thresholds k * 50/19, k = 8..19. Joint 0: 1/3 for k < 10 (25 mm is k = 9.5), then 2/3.
        # Joint 1: 22 mm is k = 8.36, 30 mm is k = 11.4, 50 mm is k = 19.
        joint_0 = [1 / 3] * 2 + [2 / 3] * 10
        joint_1 = [0] + [1 / 3] * 3 + [2 / 3] * 7 + [1]
        curve = (np.array(joint_0) + np.array(joint_1)) / 2
        np.testing.assert_allclose(m.pck_curve(errors, m.AUC_ZB_MM), curve)
        assert m.pck_auc(errors, m.AUC_ZB_MM) == pytest.approx((curve.sum() - (curve[0] + curve[-1]) / 2) / 11)

    def test_accuracy_at(self) -> None:
        assert m.accuracy_at([1.0, 3.0, 3.0001, INF, NAN], 3) == pytest.approx(2 / 4)
        assert np.isnan(m.accuracy_at([NAN], 3))

    def test_median_leaves_misses_out(self) -> None:
        assert m.finite_median([1, 2, 10, INF, INF, NAN]) == 2
        assert np.isnan(m.finite_median([INF]))


def _straight_hand() -> np.ndarray:
    """(21, 3) with bones of length 1 along x, y or z, so that lengths are known."""
    joints = np.zeros((21, 3))
    axes = np.eye(3)
    for number, (parent, child) in enumerate(BONES):
        joints[child] = joints[parent] + axes[number % 3]
    return joints


class TestHandShape:
    def test_bone_lengths(self) -> None:
        truth = _straight_hand()[None]
        longer = truth.copy()
        longer[0, 4] += (longer[0, 4] - longer[0, 3]) * 0.5  # the thumb's last bone grows by 1/2; a tip ends one bone
        errors = m.bone_length_errors(longer, truth, [True])
        assert errors.shape == (1, 20)
        assert m.finite_mean(errors) == pytest.approx(0.5 / 20)
        assert errors[0, BONES.index((3, 4))] == pytest.approx(0.5)
        assert m.finite_mean(m.bone_length_errors(2 * truth, truth, [True])) == pytest.approx(1)
        shorter = m.bone_length_errors(0.5 * truth, truth, [True])
        assert m.finite_mean(shorter) == pytest.approx(0.5)  # absolute, not signed
        assert np.isinf(m.bone_length_errors(truth, truth, [False])).all()
        assert np.isnan(m.bone_length_errors(truth, truth * NAN, [True])).all()

    def test_procrustes_removes_similarity_only(self) -> None:
        rng = np.random.default_rng(0)
        truth = rng.normal(size=(21, 3))
        rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        rotation *= np.sign(np.linalg.det(rotation))
        moved = 2.5 * truth @ rotation.T + [1, 2, 3]
        np.testing.assert_allclose(m.procrustes_aligned(moved, truth), truth, atol=1e-12)
        mirrored = truth * [-1, 1, 1]
        assert np.linalg.norm(m.procrustes_aligned(mirrored, truth) - truth, axis=-1).mean() > 0.3

    def test_procrustes_by_hand(self) -> None:
        """Points -1, 0, 1 on x against -1, 0.5, 0.5: scale 0.75 gives -0.75, 0, 0.75; errors 1/4, 1/2, 1/4."""
        predicted = np.array([[-1.0, 0, 0], [0, 0, 0], [1, 0, 0]])
        truth = np.array([[-1.0, 0, 0], [0.5, 0, 0], [0.5, 0, 0]])
        errors = m.procrustes_errors(predicted[None], truth[None], [True])
        np.testing.assert_allclose(errors, [[1 / 4, 1 / 2, 1 / 4]], atol=1e-12)
        assert np.isinf(m.procrustes_errors(predicted[None], truth[None], [False])).all()
        truth[0] = NAN
        assert np.isnan(m.procrustes_errors(predicted[None], truth[None], [True])).all()

    def test_procrustes_is_the_best_similarity(self) -> None:
        """No small change of the aligned points by another similarity comes nearer in the square mean."""
        rng = np.random.default_rng(1)
        predicted, truth = rng.normal(size=(21, 3)), rng.normal(size=(21, 3))
        aligned = m.procrustes_aligned(predicted, truth)
        best = np.sum((aligned - truth) ** 2)
        centre = aligned.mean(axis=0)
        for axis in range(3):
            for angle in (-0.05, 0.05):
                turn = np.eye(3)
                i, j = [k for k in range(3) if k != axis]
                turn[[i, j, i, j], [i, j, j, i]] = np.cos(angle), np.cos(angle), -np.sin(angle), np.sin(angle)
                assert np.sum(((aligned - centre) @ turn.T + centre - truth) ** 2) > best
        for scale in (0.95, 1.05):
            assert np.sum((scale * (aligned - centre) + centre - truth) ** 2) > best


class TestCameraSpace:
    def test_relative_root(self) -> None:
        truth = np.zeros((4, 2, 3))
        truth[:, LEFT, 0], truth[:, RIGHT, 0] = -0.1, 0.1
        predicted = truth + 0.5  # a common shift costs nothing
        predicted[1, LEFT] += [0.03, 0, 0.04]
        truth[3, RIGHT] = NAN
        errors = m.relative_root_errors(predicted, truth, [[True, True]] * 2 + [[True, False]] + [[True, True]])
        np.testing.assert_allclose(errors, [0, 0.05, INF, NAN], atol=1e-12)

    def test_spherical_coordinates_by_hand(self) -> None:
        np.testing.assert_allclose(m.spherical_coordinates([0, 1, 1]), [45, 0, np.sqrt(2)], atol=1e-12)
        np.testing.assert_allclose(m.spherical_coordinates([1, 0, 1]), [0, 45, np.sqrt(2)], atol=1e-12)
        # phi is measured against hypot(y, z), not z
        np.testing.assert_allclose(m.spherical_coordinates([5, 3, 4]), [np.degrees(np.arctan(3 / 4)), 45, np.sqrt(50)])

    def test_spherical_errors_by_hand(self) -> None:
        truth = np.array([[0, 0, 1.0], [0, 0, 1.0], [0, 1.0, 1.0], [0, 0, 1.0], [NAN] * 3])
        predicted = np.array([[0, 1.0, 1.0], [1.0, 0, 1.0], [0, 0.5, 0.5], [0, 0, 1.0], [0, 0, 1.0]])
        root_2 = np.sqrt(2)
        errors = m.spherical_errors(predicted, truth, [True, True, True, False, True])
        expected = [
            [45, 0, 45, root_2 - 1, root_2 - 1],
            [0, 45, 45, root_2 - 1, root_2 - 1],
            [0, 0, 0, root_2 / 2, 1 / 2],
            [INF] * 5,
            [NAN] * 5,
        ]
        np.testing.assert_allclose(errors, expected, atol=1e-12)

    def test_great_circle_is_not_the_sum_of_the_angles(self) -> None:
        """theta and phi 45 each: directions (0, 0, 1) and (1, 1/sqrt2, 1/sqrt2) / sqrt2, cos = 1/2, 60 degrees."""
        errors = m.spherical_errors([[1, np.sqrt(0.5), np.sqrt(0.5)]], [[0, 0, 1]], [True])
        np.testing.assert_allclose(errors[0, :3], [45, 45, 60])

    def test_errors_have_no_sign(self) -> None:
        """Up and left of the truth, and nearer, costs what down and right of it, and farther, costs."""
        truth, predicted = np.array([[0.0, 0.0, 1.0]] * 2), np.array([[0, -1.0, 1.0], [-0.5, 0, 0.5]])
        errors = m.spherical_errors(predicted, truth, [True, True])
        np.testing.assert_allclose(errors[:, :3], [[45, 0, 45], [0, 45, 45]], atol=1e-12)
        np.testing.assert_allclose(errors[:, 3], [np.sqrt(2) - 1, 1 - np.sqrt(1 / 2)])

    def test_angles_wrap_around(self) -> None:
        """Just below and just above the ray straight back: 2 degrees apart, not 358."""
        angle = np.radians(179)
        errors = m.spherical_errors([[0, np.sin(angle), np.cos(angle)]], [[0, -np.sin(angle), np.cos(angle)]], [True])
        np.testing.assert_allclose(errors[0, :3], [2, 0, 2])


class TestFailureRate:
    def test_misses_fail_and_unknown_joints_do_not_count(self) -> None:
        """Means 2, 4, miss, unknown hand: of three hands, 4 and the miss are above 3."""
        errors = [[1, 3], [4, NAN], [INF, INF], [NAN, NAN]]
        assert m.failure_rate(errors, 3.0) == pytest.approx(2 / 3)
        assert m.failure_rate(errors, 4.0) == pytest.approx(1 / 3)  # equal is no failure

    def test_nothing_to_measure(self) -> None:
        assert np.isnan(m.failure_rate(np.full((2, 3), NAN), 1.0))
        assert np.isnan(m.failure_rate(np.empty((0, 3)), 1.0))
        assert m.failure_rate(np.full((2, 3), INF), 1.0) == 1.0


class TestAcceleration:
    def test_split_along_and_across_the_line_of_sight(self) -> None:
        """A resting point at (0, 0, 2); the estimate jumps by (0.03, 0.04, 0.1) in the middle frame only.

        Second difference -2 x the jump, at 10 frames a second x 100: across 200 x 0.05 = 10, along 200 x 0.1 = 20.
        """
        truth = np.tile([0.0, 0.0, 2.0], (3, 1))
        predicted = truth.copy()
        predicted[1] += [0.03, 0.04, 0.1]
        errors = m.acceleration_errors(predicted, truth, fps=10)
        np.testing.assert_allclose(errors[1], [10, 20])
        assert np.isnan(errors[[0, 2]]).all()

    def test_the_line_of_sight_is_the_true_points(self) -> None:
        """The same jump along x is across for a point straight ahead and along for one far to the side."""
        truth = np.array([[[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]] * 3)
        predicted = truth + np.array([0.0, 1.0, 0.0])[:, None, None] * [0.1, 0.0, 0.0]
        np.testing.assert_allclose(m.acceleration_errors(predicted, truth, fps=1)[1], [[0.2, 0], [0, 0.2]], atol=1e-12)

    def test_constant_offset_and_drift_cost_nothing(self) -> None:
        time = np.arange(5.0)[:, None]
        truth = np.array([0.1, 0.2, 1.0]) + 0.3 * time**2 * [1.0, 0.0, 0.0]
        errors = m.acceleration_errors(truth + 0.5 + 0.2 * time, truth, fps=30)
        np.testing.assert_allclose(errors[1:-1], 0, atol=1e-9)

    def test_gaps_and_short_videos(self) -> None:
        truth = np.tile([0.0, 0.0, 2.0], (6, 1))
        predicted = truth.copy()
        predicted[1] = NAN
        known = np.isfinite(m.acceleration_errors(predicted, truth, fps=30)).all(axis=1)
        np.testing.assert_array_equal(known, [False, False, False, True, True, False])
        assert np.isnan(m.acceleration_errors(truth[:2], truth[:2], fps=30)).all()
        with pytest.raises(ValueError, match="above 0"):
            m.acceleration_errors(truth, truth, fps=0)


def test_a_class_in_no_mask_has_no_pooled_iou() -> None:
    """Never there and never claimed is nothing to measure, not a success."""
    background, left, right = m.dataset_iou([[5, 2, 0]], [[6, 4, 0]])
    assert (background, left) == (5 / 6, 2 / 4) and np.isnan(right)
