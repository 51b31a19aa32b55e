"""The examples run as they stand."""

import subprocess
import sys
from pathlib import Path

from twohands.cli.demo import examples_folder

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def output_of(*arguments: object) -> str:
    result = subprocess.run([sys.executable, *map(str, arguments)], capture_output=True, text=True, timeout=600)
    assert result.returncode == 0, result.stderr
    return result.stdout


def test_metres_from_keypoints():
    """All methods find the hand again to the last digits; noise moves the result of each."""
    lines = output_of(EXAMPLES / "metres_from_keypoints.py").splitlines()
    assert [line.split()[0] for line in lines] == ["keybone", "all-joints", "fitted"]
    for line in lines:
        assert float(line.split("error ")[1].split(" m")[0]) < 1e-9
        assert 0 < float(line.split("noise: ")[1].split(" cm")[0]) < 10


def test_track_image():
    picture = sorted(examples_folder().glob("*.png"))[0]
    lines = output_of(EXAMPLES / "track_image.py", picture, 103.87).splitlines()
    assert [line.split()[0] for line in lines] == ["left", "right"]
    assert any("cm away" in line for line in lines)


def test_every_example_is_tested():
    assert {path.name for path in EXAMPLES.glob("*.py")} <= {"metres_from_keypoints.py", "track_image.py"}
