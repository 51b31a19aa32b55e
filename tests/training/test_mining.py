"""`scripts/mine_backgrounds.py`, whose looking is the pipeline's: what it cannot begin with."""

import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("moderngl")

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--out", "full"], "output full is not empty"),
        (["--out", "new", "--backgrounds", "full"], "full"),
        (["--out", "new", "--backgrounds", "a,b"], "with a comma in its path"),
        (["--out", "new", "--data", "full"], "full"),
        (["--out", "new", "--workers", "0"], "worker"),
    ],
)
def test_mistakes_are_one_line_and_leave_nothing(words, message, tmp_path):
    """Named case: tracebacks for a taken output folder and for one without pictures."""
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "notes.txt").touch()
    script = [sys.executable, str(ROOT / "scripts" / "mine_backgrounds.py"), "--count", "1", *words]
    run = subprocess.run(script, cwd=tmp_path, check=False, capture_output=True, text=True)
    assert run.returncode == 2
    assert run.stderr.startswith("error: ") and message in run.stderr and run.stderr.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["full"]
