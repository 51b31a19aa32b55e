"""Labels in place of stages: only what is named, maps that read back to the labels, and a budget that adds up."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.oracles import UNUSED, Oracle, drawn_hands, make_card, true_boxes, write_tiny_weights

from twohands.errors import CheckpointError, InputError
from twohands.evaluation.completion import hand_lengths_m
from twohands.evaluation.predictions import predict
from twohands.evaluation.summary import budget_costs, budget_results
from twohands.inference.estimator import HandEstimator
from twohands.inference.keypoints import read_joints
from twohands.inference.stages import StageTruth
from twohands.skeleton import LEFT, RIGHT
from twohands.studies.budget import STUDIES, error_budget, solved_again, studies_without_masks
from twohands.studies.ground_truth import STAGES, HeatmapTargets, TruthfulEstimator, stage_truth, true_heatmaps
from twohands.types import HandSample


def test_stage_truth_takes_only_what_is_named() -> None:
    sample = replace(drawn_hands(0), present=np.array([True, False]))
    nothing = stage_truth(sample, ())
    assert all(getattr(nothing, name) is None for name in ("masks", "boxes_px", "present", "joints_px", "canonical"))
    truth = stage_truth(sample, ("masks", "boxes"))
    assert truth.present is None and truth.joints_px is None and truth.canonical is None
    assert truth.masks is not None and truth.boxes_px is not None and sample.labels is not None
    np.testing.assert_array_equal(truth.masks > 0, sample.labels > 0)
    np.testing.assert_array_equal(truth.boxes_px[LEFT], true_boxes(sample)[LEFT])
    assert np.isnan(truth.boxes_px[RIGHT]).all()


def test_masks_need_labels() -> None:
    with pytest.raises(InputError, match="no part labels"):
        stage_truth(replace(drawn_hands(0), labels=None), ("masks",))


def test_heatmaps_need_boxes() -> None:
    with pytest.raises(InputError, match="true heatmaps need true boxes"):
        TruthfulEstimator(HandEstimator(UNUSED, make_card()), ("heatmaps",))


@pytest.mark.parametrize("with_depth", [True, False])
def test_true_maps_read_back(with_depth: bool) -> None:
    """The peak is where the joint is; a nearer joint's map is wider; a joint outside the crop has none."""
    joints = np.random.default_rng(0).uniform(20, 108, (21, 2))
    joints[3] = [-1, 50]
    z = np.zeros(21)
    z[4] = -1.0
    maps = true_heatmaps(joints, z, 128, HeatmapTargets(1.5, with_depth))
    cells, _ = read_joints(maps, "subpixel")
    inside = np.arange(21) != 3
    np.testing.assert_allclose(cells[inside] * 4, joints[inside], atol=0.05)
    assert maps.shape == (21, 32, 32) and not maps[3].any()
    assert bool(maps[4].sum() > 1.5 * maps[5].sum()) is with_depth


def test_maps_of_a_softmax_network_have_one_mass() -> None:
    joints = np.full((21, 2), 64.0)
    z = np.linspace(-1, 1, 21)
    maps = true_heatmaps(joints, z, 128, HeatmapTargets(1.5, True, probabilities=True))
    np.testing.assert_allclose(maps.sum(axis=(1, 2)), 2 * np.pi * 1.5**2, rtol=1e-5)
    assert maps[0].max() < maps[-1].max()


def test_targets_from_a_card(tmp_path: Path) -> None:
    folder = write_tiny_weights(tmp_path / "w")
    assert HeatmapTargets.from_folder(folder) == HeatmapTargets(2.0, True, False, 8)
    (folder / "card.json").write_text(
        '{"pose_net_2d": {"sigma": 1.5, "activation": "softmax"},'
        ' "training": {"pose_net_2d": {"loss": {"z_heatmaps": false}}}}'
    )
    assert HeatmapTargets.from_folder(folder) == HeatmapTargets(1.5, False, True)
    (folder / "card.json").write_text("[]")
    with pytest.raises(CheckpointError, match="not a readable card"):
        HeatmapTargets.from_folder(folder)


def test_true_heatmaps_belong_to_the_pipelines_crops() -> None:
    """Read out like PoseNet2D's, right hands mirrored, they give the labelled joints; the network is not run."""
    sample = drawn_hands(2)
    networks = replace(UNUSED, pose_net_3d=lambda maps: np.zeros((len(maps), 21, 3)))
    estimate = TruthfulEstimator(HandEstimator(networks, make_card()), ("masks", "boxes", "heatmaps"))
    pose = estimate(sample)
    for side, hand in enumerate(pose.hands):
        assert hand.joints_px is not None
        np.testing.assert_allclose(hand.joints_px, sample.joints_px[side], atol=0.2)


@pytest.mark.parametrize("decode", ["subpixel", "softargmax"])
def test_what_partly_labelled_hands_do_not_tell_is_estimated(decode: str) -> None:
    """One joint of the left hand has no label, as in InterHand2.6M; nor does the whole right hand."""
    sample = drawn_hands(2)
    joints_px = np.array(sample.joints_px)
    joints_px[LEFT, 20], joints_px[RIGHT] = np.nan, np.nan
    known = np.isfinite(joints_px).all(axis=-1)
    oracle = Oracle(sample, make_card(heatmap_decode=decode), z_heatmaps=False)
    scores = oracle.estimator.estimate(sample.image, sample.camera)
    pose = oracle.estimator.estimate(sample.image, sample.camera, truth=StageTruth(joints_px=joints_px))
    for side, hand in enumerate(pose.hands):
        assert hand.valid and hand.joints_px is not None and hand.joint_scores is not None
        np.testing.assert_array_equal(hand.joints_px[known[side]], joints_px[side, known[side]])
        np.testing.assert_allclose(hand.joints_px, sample.joints_px[side], atol=0.3)
        estimated = scores.hands[side].joint_scores
        np.testing.assert_array_equal(hand.joint_scores, np.where(known[side], 1.0, estimated))


def test_a_budget_of_partly_labelled_hands() -> None:
    budget = drawn_budget(unlabelled=20)
    assert [row["study"] for row in budget["rows"]] == [study.key for study in STUDIES]
    metrics = budget["rows"][0]["metrics"]["fitted"]
    assert metrics["epe_2d_mean"] == pytest.approx(0, abs=1e-9)


def test_no_cues_come_with_true_heatmaps() -> None:
    """PoseNet3D is given as many maps as it expects, those behind the joints' empty."""
    seen = []

    def pose_net_3d(maps):
        seen.append(maps)
        return np.zeros((len(maps), 21, 3))

    networks = replace(UNUSED, pose_net_3d=pose_net_3d)
    estimator = HandEstimator(networks, replace(make_card(), cues=4))
    TruthfulEstimator(estimator, ("masks", "boxes", "heatmaps"))(drawn_hands(2))
    assert seen[0].shape[1] == 25 and not seen[0][:, 21:].any() and seen[0][:, :21].any(axis=(2, 3)).all()


def without_label(sample: HandSample, joint: int | None) -> HandSample:
    """The sample without the labels of one joint of either hand."""
    known = np.tile(np.arange(21) != joint, (2, 1))
    joints_px, joints_m = (np.where(known[..., None], each, np.nan) for each in (sample.joints_px, sample.joints_m))
    return replace(sample, joints_px=joints_px, joints_m=joints_m, valid=sample.valid & known)


def drawn_budget(count: int = 2, scale: float = 1.0, unlabelled: int | None = None):
    """PoseNet2D always says the same; PoseNet3D knows the answer and scales it; one joint may have no label."""
    complete = [replace(drawn_hands(seed), source=str(seed)) for seed in range(count)]
    samples = [without_label(sample, unlabelled) for sample in complete]
    maps = true_heatmaps(np.linspace(30, 98, 42).reshape(21, 2), np.zeros(21), 128, HeatmapTargets())

    def estimator_of(study):
        def estimate(sample):
            oracle = Oracle(complete[int(sample.source)], make_card())
            left_like = oracle.canonical * np.array([[[1, 1, 1]], [[-1, 1, 1]]])
            networks = replace(
                oracle.estimator.networks,
                pose_net_2d=lambda batch: (np.stack([maps] * len(batch)), np.zeros(len(batch))),
                pose_net_3d=lambda maps: (scale * left_like[np.flatnonzero(sample.present)]).astype(np.float32),
            )
            return TruthfulEstimator(HandEstimator(networks, make_card()), study.truth)(sample)

        return estimate

    return error_budget(iter(samples), estimator_of, dataset="drawn", weights="oracle").to_dict()


def test_the_global_step_alone_costs_nothing() -> None:
    """The paper's claim: perfect input gives a perfect place, with the key bone as fitted to all joints."""
    budget = drawn_budget()
    row = budget["rows"][0]
    assert row["study"] == "global" and set(row["truth"]) == set(STAGES)
    for method in ("keybone", "fitted"):
        for key in ("cs_mpjpe", "range_median", "direction_median", "error_3d_spherical_mean"):
            assert abs(row["metrics"][method][key]) < 1e-9, (method, key)
    assert budget_results(budget)[1] == ["global step alone", *["0.000"] * 3, *["0.000 / 0.000"] * 2, "0"]


def test_a_stage_that_errs_is_charged_and_no_other() -> None:
    """PoseNet3D makes every hand 1.1 times too large about its root; PoseNet2D is wrong, and charged in pixels only."""
    costs = {row[0]: row for row in budget_costs(drawn_budget(scale=1.1))[1:]}
    px, mm = ({stage: float(row[column]) for stage, row in costs.items()} for column in (2, 3))
    assert mm["3D pose, perfect maps"] > 3 and mm["3D pose"] == mm["3D pose, perfect maps"]
    assert px["2D joints"] > 3 and px["3D pose"] == px["3D pose, perfect maps"] == px["maps not perfect"] == 0
    assert mm["2D joints"] == mm["maps not perfect"] == mm["presence"] == 0


def test_without_part_labels_masks_are_always_estimated() -> None:
    studies = studies_without_masks()
    assert all("masks" not in study.truth for study in studies)
    keys = {study.key for study in studies}
    assert "masks" not in keys and all(study.against in keys for study in studies if study.against)
    assert len(studies) == len(STUDIES) - 1


def test_every_study_estimates_one_stage_more() -> None:
    for study in STUDIES:
        if study.against is not None:
            before = next(other for other in STUDIES if other.key == study.against)
            assert set(study.truth) < set(before.truth)


def test_solving_again_repeats_the_estimator() -> None:
    samples = [replace(drawn_hands(seed), source=str(seed)) for seed in range(2)]

    def estimate(sample):
        as_placed = make_card(ray_share=0.0)
        return TruthfulEstimator(Oracle(sample, as_placed).estimator)(sample)

    predictions = predict(samples, estimate, dataset="drawn", weights="oracle", settings={})
    cameras = [sample.camera for sample in samples]
    lengths = np.array([hand_lengths_m(sample) for sample in samples])
    again = solved_again(predictions, cameras, lengths, "fitted")
    np.testing.assert_allclose(again.joints_m, predictions.joints_m, atol=1e-12)
    noisy = replace(predictions, joints_px=predictions.joints_px + np.random.default_rng(0).normal(size=(2, 2, 21, 2)))
    every, other = (solved_again(noisy, cameras, lengths, method) for method in ("fitted", "keybone"))
    assert np.abs(other.joints_m - every.joints_m).max() > 1e-3
    assert other.valid.all() and other.mask(0) is None
