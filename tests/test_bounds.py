"""The lowest versions that pyproject.toml declares; `.ci/lowest-versions.sh` installs and tries them."""

import re
from pathlib import Path

import pytest

PYPROJECT = Path(__file__).parents[1] / "pyproject.toml"
BROKEN = {
    "numpy": (1, 26, 4),  # arrays have no `device`
    "openvino": (2024, 6, 0),  # has no opset13
    "tyro": (0, 9, 20),  # up to 0.9.11 no verb runs, up to 0.9.20 `eval` does not
    "rich": (13, 0, 1),  # hangs after an unexpected error
}
"""The newest release of each with which something of ours is known not to work."""


@pytest.mark.parametrize("name", BROKEN)
def test_no_version_that_is_known_to_break_is_allowed(name):
    (bound,) = re.findall(rf'^ +"{name}>=([\d.]+)",', PYPROJECT.read_text(), flags=re.MULTILINE)
    assert tuple(map(int, bound.split("."))) > BROKEN[name]


def test_no_extra_asks_for_what_the_core_cannot_use():
    """MediaPipe wants numpy 1 and lives in an environment of its own (docs/evaluation.md)."""
    assert "mediapipe" not in PYPROJECT.read_text()
