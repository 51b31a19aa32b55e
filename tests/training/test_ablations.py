"""The declared ablations: settings that exist, rows that differ in what they name alone."""

import dataclasses

from benchmarks.ablations import ROWS, page, row_config

from twohands.training.trainer import TrainResult


def test_rows_are_distinct_and_start_from_earlier_2d_rows():
    assert len({row.name for row in ROWS}) == len({row.folder for row in ROWS}) == len(ROWS)
    earlier: set[str] = set()
    for row in ROWS:
        assert (row.stage == "pose_net_3d") == bool(row.start)
        assert not row.start or row.start in earlier
        earlier |= {row.name} if row.stage == "pose_net_2d" else set()


def test_a_row_changes_what_it_names_and_starts_from_fitting_networks():
    rows = {row.name: row for row in ROWS}
    for row in ROWS:
        plain = row_config(dataclasses.replace(row, settings=()), "frames")
        changed = row_config(row, "frames")
        assert (changed == plain) == (not row.settings)
        if row.start:
            start = row_config(rows[row.start], "frames")
            assert start.networks.pose_net_2d == changed.networks.pose_net_2d
            assert start.loss.z_heatmaps == changed.loss.z_heatmaps and start.crop == changed.crop
    assert len({row_config(row, "frames").iterations for row in ROWS}) == 1


def test_rows_of_pose_net_3d_train_the_losses_in_their_names_alone():
    """Named case: L_place, which entered the recipe later, was in every row."""
    three_d = [row for row in ROWS if row.stage == "pose_net_3d"]
    losses = [row_config(row, "frames").loss for row in three_d]
    assert [[loss.bone > 0, loss.projection > 0, loss.place > 0] for loss in losses] == [
        [False, False, False],
        [True, False, False],
        [True, True, False],
        [True, True, False],
    ]


def test_the_page_has_a_table_for_every_kind_of_row():
    figures = {
        "image_px_median": 1.234,
        "image_px_mean": 2,
        "canonical_median": 0.1,
        "canonical_mean": 0.2,
        "bone_mean": 0,
    }
    lines = page({row.name: TrainResult(7, 1.0, figures, {}) for row in ROWS}, "python it").splitlines()
    assert "| 2D: no segmentation | 7 | 1.23 | 2.00 |" in lines
    assert "| 3D: L_j | 7 | 10.00 | 20.00 | 0.00 |" in lines
    assert len([line for line in lines if line.startswith("## ")]) == 3
    assert all(any(line.startswith(f"| {row.name} |") for line in lines) for row in ROWS)
    assert not any("3D" in line for line in page({ROWS[0].name: TrainResult(7, 1.0, figures, {})}, "it").splitlines())
