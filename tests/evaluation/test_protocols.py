"""From poses to the table: who is scored, how misses count, and that scoring needs the same data."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.datasets.facts import huge_png

from twohands.errors import DataFormatError, InputError
from twohands.evaluation.predictions import Predictions, load_predictions, predict, save_predictions
from twohands.evaluation.protocols import evaluate
from twohands.geometry.boxes import box_from_points
from twohands.geometry.camera import project
from twohands.geometry.canonical import canonical_from_camera
from twohands.skeleton import LEFT, RIGHT, ROOT, WRIST
from twohands.types import HandPose, HandSample, PinholeCamera, TwoHandPose

CAMERA = PinholeCamera.ego3dhands(960, 540)  # twice the reference width


def make_sample(index: int, present: tuple[bool, bool] = (True, True)) -> HandSample:
    """Random hands of 10 and 8 cm before the camera; labels in the top rows, the left hand's above the right's."""
    rng = np.random.default_rng(index)
    joints = rng.normal(scale=0.05, size=(2, 21, 3))
    joints -= joints[:, ROOT : ROOT + 1]
    joints *= (np.array([0.10, 0.08]) / np.linalg.norm(joints[:, WRIST], axis=-1))[:, None, None]
    joints += np.array([[-0.1, 0.02, 0.4], [0.1, -0.03, 0.5]])[:, None]
    joints[~np.array(present)] = np.nan
    labels = np.zeros((540, 960), np.uint8)
    labels[:10] = 1 if present[LEFT] else 0
    labels[10:30] = 8 if present[RIGHT] else 0
    return HandSample(
        image=np.zeros((540, 960, 3), np.uint8),
        camera=CAMERA,
        present=np.array(present),
        joints_px=project(joints, CAMERA),
        joints_m=joints,
        valid=np.isfinite(joints).all(axis=-1),
        labels=labels,
        source=f"{index:05d}",
    )


def perfect_pose(sample: HandSample) -> TwoHandPose:
    hands = []
    for side in (LEFT, RIGHT):
        if not sample.present[side]:
            hands.append(HandPose(present=False, score=0.1))
            continue
        hands.append(
            HandPose(
                present=True,
                score=0.9,
                box_px=np.asarray(box_from_points(sample.joints_px[side])),
                joints_px=sample.joints_px[side],
                joint_scores=np.ones(21),
                canonical=np.asarray(canonical_from_camera(sample.joints_m[side]).joints),
                joints_m=sample.joints_m[side],
                valid=True,
            )
        )
    assert sample.labels is not None
    masks = np.uint8(sample.labels > 0) + np.uint8(sample.labels > 7)
    return TwoHandPose(hands[0], hands[1], sample.camera, masks)


SAMPLES = [make_sample(0), make_sample(1, (True, False)), make_sample(2), make_sample(3, (False, False))]


def predictions_for(estimate=perfect_pose, samples=SAMPLES) -> Predictions:
    return predict(samples, estimate, dataset="made", weights="none@0", settings={"a": [1, "b"]})


def test_perfect_predictions_are_perfect() -> None:
    report = evaluate(predictions_for(), SAMPLES)
    for key in ("presence_accuracy", "box_accuracy", "miou", "iou", "iou_background"):
        assert report[key].value == 1.0, key
    for metric in report.metrics:
        if metric.key.startswith(("auc", "range_auc", "theta_auc")) or metric.key.endswith(("cm", "deg")):
            if metric.unit == "" and "cartesian" not in metric.key:
                assert metric.value == pytest.approx(1.0, abs=0.006), metric.key  # 1e-17 m exceeds the threshold 0
        elif metric.unit in ("mm", "px", "cm", "deg", "hands") and "cartesian" not in metric.key:
            assert metric.value == pytest.approx(0.0, abs=1e-9), metric.key
    # without the rotation even a perfect canonical pose is off (docs/paper-map.md: about 1 cm)
    assert 1 < report["epe_3d_cartesian_mean"].value < 50
    assert report["presence_accuracy"].count == 8
    assert report["epe_2d_mean"].count == 5
    assert report["mrrpe"].count == 2
    assert report.images == 4


def shifted_left(sample: HandSample) -> TwoHandPose:
    """Left hand 6 px right of the truth at 960 px width and 4 cm too far along its ray; right hand never found."""
    pose = perfect_pose(sample)
    left = pose.left
    if left.present:
        root = sample.joints_m[LEFT, ROOT]
        ray = root / np.linalg.norm(root)
        left = replace(left, joints_px=left.joints_px + np.array([6, 0]), joints_m=left.joints_m + 0.04 * ray)
    return replace(pose, left=left, right=HandPose(present=False))


def test_errors_and_misses() -> None:
    """Left: hands of samples 0, 1, 2, found. Right: hands of 0 and 2, missed."""
    report = evaluate(predictions_for(shifted_left), SAMPLES)
    assert report["presence_accuracy"].value == pytest.approx(6 / 8)
    assert (report["presence_accuracy"].left, report["presence_accuracy"].right) == (1.0, 0.5)
    assert (report["missed"].value, report["missed"].left, report["missed"].right) == (2, 0, 2)
    assert report["box_accuracy"].value == pytest.approx(6 / 8)
    # 6 px at 960 are 3 px at 480; missed hands do not enter an error, and are failures of a share
    assert report["epe_2d_mean"].value == pytest.approx(3)
    assert report["error_2d_median"].value == pytest.approx(3)
    assert report["epe_2d_mean"].count == 3
    assert np.isnan(report["epe_2d_mean"].right or 0.0)
    assert report["auc_2d"].right == 0 and report["auc_2d"].count == 5
    assert 0.88 < (report["auc_2d"].left or 0) < 0.92  # 1 from 3 px to 30 px
    assert report["range_median"].value == pytest.approx(4)
    assert (report["range_3cm"].left, report["range_5cm"].left, report["range_5cm"].right) == (0, 1, 0)
    assert report["range_5cm"].value == pytest.approx(1 / 2)
    assert report["direction_median"].value == pytest.approx(0, abs=1e-6)
    assert (report["direction_1deg"].left, report["direction_1deg"].right) == (1, 0)
    assert report["cs_mpjpe"].value == pytest.approx(40)
    assert report["mrrpe"].count == 0 and np.isnan(report["mrrpe"].value)
    # alignment takes the true root: the canonical pose of the left hand is still perfect
    assert report["epe_3d_spherical_mean"].value == pytest.approx(0, abs=1e-9)
    assert report["auc_20_50_spherical"].value == pytest.approx(1 / 2)


def test_relative_range_and_invalid_hands() -> None:
    def estimate(sample: HandSample) -> TwoHandPose:
        pose = perfect_pose(sample)
        left = replace(pose.left, joints_m=None if pose.left.joints_m is None else 1.1 * pose.left.joints_m)
        right = replace(pose.right, valid=False)  # even with joints: not to be used
        return replace(pose, left=left, right=right)

    report = evaluate(predictions_for(estimate), SAMPLES)
    assert report["range_relative_median"].value == pytest.approx(10)  # %
    assert (report["invalid"].value, report["missed"].value) == (2, 0)
    assert report["range_10cm"].right == 0  # without a range, a failure
    assert report["epe_2d_mean"].count == 5  # but still found in the image


def test_scale_comes_from_the_true_hand() -> None:
    """A canonical pose stretched by 1.2 about the root is off by 0.2 of every joint's distance from it."""

    def estimate(sample: HandSample) -> TwoHandPose:
        pose = perfect_pose(sample)
        hands = [h if h.canonical is None else replace(h, canonical=1.2 * h.canonical) for h in pose.hands]
        return replace(pose, left=hands[0], right=hands[1])

    report = evaluate(predictions_for(estimate, SAMPLES[:1]), SAMPLES)
    joints = SAMPLES[0].joints_m
    distance_mm = 1e3 * np.linalg.norm(joints - joints[:, ROOT : ROOT + 1], axis=-1)
    expected = 0.2 * distance_mm.mean(axis=1)
    assert report["epe_3d_spherical_mean"].left == pytest.approx(expected[LEFT])
    assert report["epe_3d_spherical_mean"].value == pytest.approx(expected.mean())
    assert report["pa_mpjpe"].value == pytest.approx(0, abs=1e-9)
    assert report["bone_length"].value > 1


def test_false_hand_and_wrong_mask() -> None:
    def estimate(sample: HandSample) -> TwoHandPose:
        pose = perfect_pose(sample)
        assert pose.masks is not None
        masks = pose.masks.copy()
        masks[10:20] = 0
        return replace(pose, right=perfect_pose(SAMPLES[0]).right, masks=masks)

    report = evaluate(predictions_for(estimate, SAMPLES[:2]), SAMPLES)
    assert (report["false"].right, report["missed"].value) == (1, 0)
    assert report["presence_accuracy"].value == pytest.approx(3 / 4)
    # image 0: left 1, right 10 of 20 rows; image 1: left 1, right absent in both
    assert report["miou"].value == pytest.approx(((1 + 1 / 2) / 2 + 1) / 2)
    assert report["iou"].right == pytest.approx(1 / 2)
    assert report["epe_2d_mean"].count == 3  # a hand that is not there has no error


def test_labels_of_a_hand_marked_absent_do_not_count() -> None:
    sample = replace(SAMPLES[0], present=np.array([True, False]))
    report = evaluate(predictions_for(samples=[sample]), [sample])
    assert report["epe_2d_mean"].count == report["auc_2d"].count == report["cs_mpjpe"].count == 1


def test_joints_marked_invalid_do_not_count() -> None:
    """The little finger of the left hand is marked as unlabelled, and wrong."""
    valid = SAMPLES[0].valid.copy()
    valid[LEFT, 17:] = False

    def estimate(sample: HandSample) -> TwoHandPose:
        pose = perfect_pose(SAMPLES[0])
        joints_px = sample.joints_px[LEFT].copy()
        joints_px[17:] += 100
        return replace(pose, left=replace(pose.left, joints_px=joints_px))

    samples = [replace(SAMPLES[0], valid=valid)]
    assert evaluate(predictions_for(estimate, samples), samples)["epe_2d_mean"].value == 0
    assert evaluate(predictions_for(estimate, SAMPLES[:1]), SAMPLES)["epe_2d_mean"].left == pytest.approx(
        4 / 21 * np.hypot(100, 100) / 2
    )


def test_file_round_trip(tmp_path: Path) -> None:
    predictions = predictions_for()
    save_predictions(tmp_path / "p.npz", predictions)
    loaded = load_predictions(tmp_path / "p.npz")
    assert evaluate(loaded, SAMPLES).to_dict() == evaluate(predictions, SAMPLES).to_dict()
    assert loaded.settings == {"a": [1, "b"]} and loaded.sources == predictions.sources
    assert [p.name for p in tmp_path.iterdir()] == ["p.npz"]
    with pytest.raises(InputError, match="exists already"):
        save_predictions(tmp_path / "p.npz", predictions)
    save_predictions(tmp_path / "p.npz", predictions, overwrite=True)
    with pytest.raises(InputError, match=r"must end in .npz"):
        save_predictions(tmp_path / "p.json", predictions)
    with pytest.raises(InputError, match="does not exist"):
        save_predictions(tmp_path / "no" / "p.npz", predictions)


def test_predictions_without_masks(tmp_path: Path) -> None:
    predictions = predictions_for(lambda sample: replace(perfect_pose(sample), masks=None))
    save_predictions(tmp_path / "p.npz", predictions)
    report = evaluate(load_predictions(tmp_path / "p.npz"), SAMPLES)
    with pytest.raises(KeyError):
        report["miou"]


def test_damaged_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "p.npz"
    with pytest.raises(InputError, match="no such file"):
        load_predictions(path)
    save_predictions(path, predictions_for())
    data = path.read_bytes()
    for content in (b"", b"hello", data[: len(data) // 2]):
        path.write_bytes(content)
        with pytest.raises(DataFormatError, match=r"p\.npz"):
            load_predictions(path)
    np.savez(path, header=np.array(json.dumps({"version": 2})))
    with pytest.raises(DataFormatError, match="version 1, got 2"):
        load_predictions(path)
    np.savez(path, header=np.array(json.dumps({"version": 1})), present=np.zeros((1, 2), bool))
    with pytest.raises(DataFormatError, match="lacks box_px"):
        load_predictions(path)


def test_files_of_other_types_are_refused(tmp_path: Path) -> None:
    """Named cases: each came out as an error of the interpreter's or numpy's own, or later than here."""
    path = tmp_path / "p.npz"
    save_predictions(path, predictions_for())
    with np.load(path) as archive:
        whole = dict(archive)
    header = json.loads(str(whole["header"]))
    others = [
        ("header", np.array("[]"), "header is no JSON object"),
        *(
            ("header", np.array(json.dumps({k: v for k, v in header.items() if k != name})), f"header .* lacks {name}")
            for name in ("dataset", "dataset_id", "weights", "settings")
        ),
        ("header", np.array(json.dumps(header | {"settings": 3})), "settings, or it is no dict"),
        ("present", whole["present"].astype(float), "present is float64 of shape"),
        ("joints_m", whole["joints_m"].astype(str), "joints_m is <U.* expected kind 'f'"),
        ("joints_m", whole["joints_m"][:2], r"joints_m .* expected kind 'f' of shape \(4, 2, 21, 3\)"),
        ("sources", np.array("one"), r"sources is <U3 of shape \(\)"),
        ("sources", np.arange(4), "sources is int64"),
        ("masks_end", whole["masks_end"][None], r"masks_end is int64 of shape \(1, 4\)"),
        ("masks_end", whole["masks_end"].astype(float), "masks_end is float64"),
        ("masks_end", whole["masks_end"][:3], "masks of the predictions file are damaged"),
    ]
    for name, values, message in others:
        np.savez(path, **whole | {name: values})
        with pytest.raises(DataFormatError, match=rf"p\.npz: .*{message}") as caught:
            load_predictions(path)
        assert "\n" not in str(caught.value)
    np.savez(path, **whole)
    assert len(load_predictions(path)) == 4


def test_a_mask_that_says_to_be_huge_is_named() -> None:
    predictions = predictions_for()
    masks = (huge_png(predictions.masks_png[0]), *predictions.masks_png[1:])
    with pytest.raises(DataFormatError, match="a mask of the predictions file is damaged"):
        replace(predictions, masks_png=masks).mask(0)


def test_other_data_is_refused() -> None:
    predictions = predictions_for()
    with pytest.raises(InputError, match="expected '00000' at position 0, found '00001'"):
        evaluate(predictions, SAMPLES[1:])
    with pytest.raises(InputError, match="end of the dataset"):
        evaluate(predictions, SAMPLES[:3])
    moved = replace(SAMPLES[2], joints_px=SAMPLES[2].joints_px + 1e-9)
    with pytest.raises(InputError, match="made for labels"):
        evaluate(predictions, [*SAMPLES[:2], moved, SAMPLES[3]])


def test_report_as_json_and_markdown() -> None:
    report = evaluate(predictions_for(shifted_left), SAMPLES)
    content = json.loads(json.dumps(report.to_dict(), allow_nan=False))
    assert content["version"] == 1 and content["weights"] == "none@0" and content["images"] == 4
    by_key = {metric["key"]: metric for metric in content["metrics"]}
    assert by_key["epe_2d_mean"]["right"] is None and by_key["epe_2d_mean"]["value"] == pytest.approx(3)
    assert len(by_key) == len(report.metrics)  # keys are unique
    table = report.to_markdown().splitlines()
    assert "| range error, median | 4.000 | 4.000 | n/a | cm | 3 |" in table
    assert "| hands missed | 2 | 0 | 2 | hands | 5 |" in table
    assert "| --- | ---: | ---: | ---: | --- | ---: |" in table
