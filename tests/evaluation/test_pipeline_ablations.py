"""The ablations that need no training: a variant changes what it names alone; rows are those of `twohands eval`."""

import dataclasses
import json
import math

import numpy as np
import pytest
from benchmarks import pipeline_ablations as pa
from tests.builders import make_samples
from tests.datasets import fakes
from tests.oracles import UNUSED, Oracle, drawn_hands, full_truth, make_card, write_tiny_weights

from twohands.cli.main import main as twohands
from twohands.evaluation.completion import complete_hand, hand_lengths_m
from twohands.geometry.camera import project
from twohands.geometry.heatmaps import decode_argmax
from twohands.inference.engine import Networks
from twohands.inference.estimator import HandEstimator
from twohands.inference.keypoints import read_joints
from twohands.inference.tracker import moved_to_range
from twohands.skeleton import ROOT, WRIST
from twohands.studies.budget import STUDIES, solved_again
from twohands.studies.ground_truth import HeatmapTargets, TruthfulEstimator
from twohands.types import HandCrop, TwoHandPose

CARD = make_card()
CROPS = [HandCrop(np.zeros((128, 128, 3), np.uint8), np.eye(3), side, mirrored=False) for side in (0, 1)]
"""Crops whose pixels are those of the picture."""


def blobs(seed: int = 0) -> np.ndarray:
    """(2, 21, 32, 32) maps with a lump somewhere, on top of noise, none of them symmetric."""
    rng = np.random.default_rng(seed)
    centres, cells = rng.uniform(4, 28, (2, 21, 2, 1)), np.arange(32) + 0.5
    along = np.exp(-0.5 * ((cells - centres) / 1.7) ** 2)  # (2, 21, 2, 32)
    maps = along[:, :, 1, :, None] * along[:, :, 0, None, :]
    return (maps + 0.02 * rng.random(maps.shape)).astype(np.float32)


def counting(calls: list[str]) -> Networks:
    """Networks that note their calls and answer with the sum of what they get."""

    def network(name: str):
        def call(batch: np.ndarray):
            calls.append(name)
            return batch.sum(), name

        return call

    return Networks(network("seg"), network("2d"), network("3d"))


def test_networks_run_once_for_every_input_of_a_picture():
    calls: list[str] = []
    memory = pa.Memory()
    networks, others = memory.networks(counting(calls)), memory.networks(counting(calls))
    ones = np.ones((1, 3, 4, 4), np.float32)
    for _ in range(3):
        assert networks.pose_net_2d(ones.copy()) == (48, "2d")
    assert networks.hand_seg_net(ones) == (48, "seg")
    assert networks.pose_net_2d(2 * ones) == (96, "2d")
    assert calls == ["2d", "seg", "2d"]
    others.pose_net_2d(ones)  # int8 and floating point do not mix
    memory.clear()
    networks.pose_net_2d(ones)
    assert calls == ["2d", "seg", "2d", "2d", "2d"]


def test_the_mean_of_a_highest_cell_alone_is_its_centre():
    maps = blobs()
    maps[0, 0, 0, 0] = maps[1, 3, 31, 31] = 9.0  # in corners too
    np.testing.assert_array_equal(read_joints(pa.highest_cells(maps), "softargmax")[0], decode_argmax(maps)[0])


@pytest.mark.parametrize("own", ["subpixel", "softargmax"])
@pytest.mark.parametrize("decoder", ["argmax", "subpixel", "softargmax"])
def test_another_read_out_keeps_the_scores(own, decoder):
    card, maps = make_card(heatmap_decode=own), blobs()
    own_px, scores = HandEstimator(UNUSED, card).stages.read_out(maps, CROPS)
    joints_px, same_scores = pa.reading(UNUSED, card, decoder).stages.read_out(maps, CROPS)
    cells = decode_argmax(maps)[0] if decoder == "argmax" else read_joints(maps, decoder)[0]
    np.testing.assert_allclose(joints_px, 4 * cells)  # 128 pixels, 32 cells
    np.testing.assert_array_equal(same_scores, scores)
    assert np.array_equal(joints_px, own_px) == (decoder == own)


@pytest.mark.parametrize("method", ["keybone", "all-joints", "fitted"])
def test_another_solver_is_exact_too_and_takes_no_weights(method):
    sample = drawn_hands(1)
    solver, truth = pa.solving(UNUSED, CARD, method), full_truth(sample)
    for side, hand in enumerate(solver.estimate(sample.image, sample.camera, 0.1, truth).hands):
        np.testing.assert_allclose(hand.joints_m, sample.joints_m[side], atol=1e-9)
    noisy_px = sample.joints_px + np.random.default_rng(0).normal(0, 2, (2, 21, 2))
    radii = [
        solver.stages.place(truth.canonical, noisy_px, scores, sample.camera, hand_lengths_m(sample)).radius_m
        for scores in (np.ones((2, 21)), np.random.default_rng(1).random((2, 21)))
    ]
    np.testing.assert_array_equal(*radii)
    weighted = HandEstimator(UNUSED, CARD).stages.place(
        truth.canonical, noisy_px, np.ones((2, 21)), sample.camera, hand_lengths_m(sample)
    )
    assert (np.abs(radii[0] - weighted.radius_m) > 1e-4).all()


def test_the_key_bone_is_that_of_the_error_budget():
    samples = [dataclasses.replace(drawn_hands(seed), source=str(seed)) for seed in range(3)]
    rng = np.random.default_rng(0)
    noisy = {sample.source: sample.joints_px + rng.normal(0, 2, (2, 21, 2)) for sample in samples}

    def predictions(estimator):
        def estimate(sample):
            truth = dataclasses.replace(full_truth(sample), joints_px=noisy[sample.source])
            return estimator.estimate(sample.image, sample.camera, hand_lengths_m(sample), truth)

        _, found = pa.predict_all(samples, [estimate], pa.Memory(), dataset="drawn", weights="none")
        return found[estimate]

    again = solved_again(
        predictions(HandEstimator(UNUSED, CARD)),
        [sample.camera for sample in samples],
        np.array([hand_lengths_m(sample) for sample in samples]),
        "keybone",
    )
    key_bone = predictions(pa.solving(UNUSED, CARD, "keybone"))
    np.testing.assert_allclose(key_bone.joints_m, again.joints_m, atol=1e-12)


def test_drawn_all_the_way_the_joints_are_seen_where_posenet2d_says():
    """All but wrist and root."""
    drawn = ~np.isin(np.arange(21), [WRIST, ROOT])
    sample, apart = drawn_hands(4), []
    oracle = Oracle(sample, CARD)
    noise = np.random.default_rng(0).normal(0, 0.05, (2, 21, 3))

    def doubtful(maps):
        return oracle.pose_net_3d(maps) + noise

    for share in (0.0, 1.0):
        networks = dataclasses.replace(oracle.estimator.networks, pose_net_3d=doubtful)
        hands = pa.pulling(networks, CARD, share).estimate(sample.image, sample.camera).hands
        apart.append([np.abs(project(hand.joints_m, sample.camera) - hand.joints_px)[drawn].max() for hand in hands])
    assert min(apart[0]) > 1 and max(apart[1]) < 0.5  # pixels; the joints' scores are just below 1


def test_looks_at_a_picture(tmp_path):
    """The tiny networks' joints fill another box than HandSegNet's, so the rule as shipped looks twice here as well."""
    shipped = HandEstimator.from_preset(write_tiny_weights(tmp_path))
    looks: list[int] = []

    def pose_net_2d(batch):
        looks.append(len(batch))
        return shipped.networks.pose_net_2d(batch)

    networks, sample = dataclasses.replace(shipped.networks, pose_net_2d=pose_net_2d), make_samples(1)[0]
    for below, expected in ((0.0, [2]), (math.inf, [2, 2])):
        looks.clear()
        pa.viewing(networks, shipped.card, recrop_below_iou=below).estimate(sample.image, sample.camera)
        assert looks == expected


def test_looks_at_the_mirror_image(tmp_path):
    shipped = HandEstimator.from_preset(write_tiny_weights(tmp_path))
    seen: list[np.ndarray] = []

    def hand_seg_net(batch):
        seen.append(batch)
        return shipped.networks.hand_seg_net(batch)

    networks, sample = dataclasses.replace(shipped.networks, hand_seg_net=hand_seg_net), make_samples(1)[0]
    for scores, looks in (((math.inf, -math.inf), 1), ((-math.inf, math.inf), 2)):
        seen.clear()
        pa.viewing(networks, shipped.card, tta_score_range=scores).estimate(sample.image, sample.camera)
        assert len(seen) == looks
    np.testing.assert_array_equal(seen[1], seen[0][..., ::-1])


def test_tables_are_left_out_where_the_weights_do_not_have_it():
    def titles(card, floating=None):
        found = pa.ablations(TruthfulEstimator(HandEstimator(UNUSED, card)), floating)
        assert all(sum(variant.estimator.card == card for variant in a.variants.values()) >= 1 for a in found)
        return [ablation.title for ablation in found]

    views = ["Second crop", "More views of the picture", "More views of a hand"]
    always = ["Read-out of the heatmaps", "The root's place", "Joints pulled to their lines of sight", *views]
    assert titles(CARD) == always
    assert titles(make_card(hand_logit=True)) == [*always, "Hand classifier"]
    assert titles(CARD, dataclasses.replace(UNUSED, runtime="float")) == [*always, "Arithmetic"]


@pytest.mark.parametrize("own", ["subpixel", "softargmax"])
def test_every_table_has_the_pipeline_as_it_is_once(own):
    complete = TruthfulEstimator(HandEstimator(UNUSED, make_card(heatmap_decode=own, hand_logit=True)))
    found = pa.ablations(complete, dataclasses.replace(UNUSED, runtime="float"))
    studies = pa.isolated(complete, HeatmapTargets())
    for variants in (*(ablation.variants for ablation in found), studies):
        assert [variant is complete for variant in variants.values()].count(True) == 1
    assert list(studies) == [study.name for study in STUDIES]


def test_smoothing_by_hand():
    """Ranges wrong by 0, 3, 0, -3, ... cm: unsmoothed, the median error of 30 frames is between 0 and 3 cm."""
    sample = make_samples(1, seed=5)[0]
    samples = [dataclasses.replace(sample, source=f"0/{frame:05d}") for frame in range(32)]

    def estimate(sample):
        error = (0.0, 0.03, 0.0, -0.03)[int(sample.source[-5:]) % 4]
        hands = [complete_hand(sample.camera, 0.1, joints_m=sample.joints_m[side]) for side in (0, 1)]
        left, right = (moved_to_range(hand, hand.range_m + error) for hand in hands)
        return TwoHandPose(left, right, sample.camera)

    labels, found = pa.predict_all(samples, [estimate], pa.Memory(), dataset="still", weights="none")
    rows = pa.smoothing(found[estimate], labels, fps=30).rows
    off, long = rows["no smoothing"], rows["queue 20, degree 1"]
    assert off["range_median"] == pytest.approx(1.5) and off["range_3.5cm"] == 1
    assert off["range_median_added"] == 0 and off["acceleration_radial_less"] == 0
    assert long["range_median_added"] == pytest.approx(long["range_median"] - 1.5)
    share = long["acceleration_radial"] / off["acceleration_radial"]
    assert share < 0.5 and long["acceleration_radial_less"] == pytest.approx(100 * (1 - share))


def test_numbers_that_round_to_zero_and_unknown_ones():
    table = pa.Table(
        "T", "About.", {"row": {"a": -0.0001, "b": math.nan, "c": 1.23456}}, {"a": "A", "b": "B", "d": "D"}
    )
    assert table.to_markdown().splitlines()[-1] == "| row | 0 | n/a | n/a |"
    assert table.to_dict()["rows"] == [{"name": "row", "a": -0.0001, "b": None, "c": 1.23456}]


def test_the_command(tmp_path, capsys):
    """Rows of the complete pipeline are what `twohands eval run` says."""
    weights = write_tiny_weights(tmp_path / "weights")
    for index, (left, right) in enumerate([(True, True), (True, False), (False, False), (True, True)]):
        fakes.write_instance(tmp_path / "static" / str(index), left=left, right=right)
    for frame in range(4):
        fakes.write_instance(tmp_path / "dynamic" / "0" / f"{frame:05d}")
    folders = [str(tmp_path / "static"), "--dynamic", str(tmp_path / "dynamic"), "--weights", str(weights)]
    pa.main([*folders, "--limit", "3", "--out", str(tmp_path / "out" / "p")])
    text = (tmp_path / "out" / "p.md").read_text()
    assert text == capsys.readouterr().out
    content = json.loads((tmp_path / "out" / "p.json").read_text())
    assert content["static"] == "static, 3 pictures with 3 hands" and content["weights"].startswith("tiny@")
    assert content["dynamic"] == "dynamic, 3 pictures with 6 hands"
    titles = [table["title"] for table in content["tables"]]
    assert [line[3:] for line in text.splitlines() if line.startswith("## ")] == titles
    assert "Hand classifier" not in titles and "Arithmetic" not in titles and titles[-1] == "Smoothing over video"

    report = str(tmp_path / "report.json")
    assert twohands(["eval", "run", folders[0], *folders[3:], "--count", "3", "--report", report]) == 0
    expected = {
        metric["key"]: metric["value"] for metric in json.loads((tmp_path / "report.json").read_text())["metrics"]
    }
    tables = {table["title"]: {row.pop("name"): row for row in table["rows"]} for table in content["tables"]}
    for title, name in (
        ("Read-out of the heatmaps", "subpixel, parabola through the peak"),
        ("The root's place", "fitted"),
        ("Isolated and complete, static", "complete"),
        ("Static and dynamic", "static"),
    ):
        row = tables[title][name]
        assert row == {key: expected[key] for key in row}
        assert set(pa.COLUMNS) <= set(row)
    alone = tables["Isolated and complete, dynamic"]["global step alone"]
    assert alone["cs_mpjpe"] == pytest.approx(0, abs=1e-3) and alone["direction_1.5deg"] == 1


def test_too_few_pictures_for_video_are_refused(tmp_path):
    with pytest.raises(pa.InputError, match="--limit must be at least 3, got 2"):
        pa.main([str(tmp_path), "--dynamic", str(tmp_path), "--limit", "2", "--out", str(tmp_path / "p")])
