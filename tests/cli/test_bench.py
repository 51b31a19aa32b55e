"""`twohands bench` on the packaged examples and shipped weights."""

import json

import numpy as np
import pytest

from twohands.cli import bench
from twohands.cli.main import main
from twohands.studies.stage_times import ROWS


def test_json_and_table_name_every_stage_and_the_machine(capsys):
    assert main(["bench", "--count", "2", "--threads", "1", "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert list(record["ms"]) == [*ROWS, "total"]
    assert (record["picture"], record["frames"], record["weights"]) == ("960x540", 2, "fast")
    assert record["runtime"].startswith("OpenVINO on 1 thread in ")
    arithmetic = record["runtime"].split(" in ")[1].split(" and ")
    assert "int8" in arithmetic and set(arithmetic) <= {"int8", "f32", "bf16", "f16"}
    assert record["processor"] and record["cores"] >= 1
    medians = {name: values["median"] for name, values in record["ms"].items()}
    assert medians["letterbox, HandSegNet"] > medians["boxes, masks"] > 0
    bench.print_table(record)
    printed = capsys.readouterr().out
    assert all(name in printed for name in ROWS)
    assert record["processor"] in printed and "frames per second" in printed


def test_summary_of_known_times():
    assert bench.summary(np.arange(1.0, 12.0)) == {"median": 6.0, "p90": 10.0}


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--count", "0"], "--count must be at least 1, got 0"),
        (["--threads", "-1"], "--threads must be 0 (all cores) or more, got -1"),
        (["none.png"], "no such file"),
    ],
)
def test_mistakes_are_one_line(words, message, capsys):
    assert main(["bench", *words]) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1


def test_a_picture_without_hands_is_refused(tmp_path, capsys):
    import cv2

    cv2.imwrite(str(tmp_path / "grey.png"), np.full((270, 480, 3), 127, np.uint8))
    assert main(["bench", str(tmp_path / "grey.png")]) == 2
    assert "no picture shows both hands" in capsys.readouterr().err
