"""The declared ablations: settings that exist, rows that differ in what they name alone."""

import dataclasses

from benchmarks.ablations import ROWS, row_config, table

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


def test_the_table():
    results = {"row": TrainResult(7, 1.0, {"image_px_median": 1.234, "canonical_mean": 0.1}, {})}
    assert table(results).splitlines()[2] == "| row | 7 | 1.23 |  |  | 10.00 |  |"
