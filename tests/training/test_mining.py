"""`scripts/mine_backgrounds.py`: what it keeps, and what it cannot begin with."""

from argparse import Namespace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

pytest.importorskip("moderngl")

from scripts.mine_backgrounds import Kept, main, mined
from tests.oracles import drawn_hands

from twohands.geometry.segmentation import HandBoxes
from twohands.synth.backgrounds.base import Background
from twohands.training.hand_views import hand_box

SAMPLE = drawn_hands(1)
NOWHERE = [np.nan] * 4
CORNER = [0.0, 0.0, 9.0, 9.0]
"""A hand that HandSegNet invents."""
TRUE = hand_box(SAMPLE, 0)


class Walls:
    """Backgrounds of one colour, another one each time."""

    name, unreadable = "walls", ()

    def __init__(self) -> None:
        self.number = 0

    def sample(self, rng, camera):
        self.number += 1
        return Background(np.full((camera.height, camera.width, 3), self.number, np.uint8))


class Frames:
    """A cache of one frame that shows a single hand before a background."""

    indices, variants = (0,), 1

    def __init__(self, backgrounds: Kept) -> None:
        self.backgrounds = backgrounds

    def __getitem__(self, number):
        self.backgrounds.sample(np.random.default_rng(number), SAMPLE.camera)
        return SAMPLE


@pytest.mark.parametrize(
    ("number", "seen", "kept"),
    [
        (0, [NOWHERE, NOWHERE], False),
        (0, [CORNER, NOWHERE], True),
        (0, [TRUE, NOWHERE], True),  # alone, a background shows no hand at all
        (1, [TRUE, NOWHERE], False),
        (1, [NOWHERE, TRUE], False),  # of whichever side it was taken for
        (1, [TRUE, CORNER], True),
    ],
)
def test_a_background_is_kept_where_a_hand_is_seen_that_is_none(number, seen, kept, tmp_path):
    """What is written is the background that was looked at, in its own colours, without the hand before it."""
    boxes_px = np.array(seen, float)
    boxes = HandBoxes(boxes_px, np.isfinite(boxes_px).all(axis=1), np.ones(2))
    estimator = SimpleNamespace(segment=lambda image: (None, boxes))
    backgrounds = Kept(Walls())
    frames = [(Frames(backgrounds), np.array([0]))]
    assert mined(Namespace(seed=1, out=tmp_path), estimator, backgrounds, frames, number) == kept
    files = list(tmp_path.iterdir())
    assert [path.name for path in files] == [f"{number:06d}.png"] * kept
    assert all((cv2.imread(str(path)) == 1).all() for path in files)


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
def test_mistakes_are_one_line_and_leave_nothing(words, message, tmp_path, monkeypatch, run_program):
    """Named case: tracebacks for a taken output folder and for one without pictures."""
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "notes.txt").touch()
    monkeypatch.chdir(tmp_path)
    code, errors = run_program(main, "--count", "1", *words)
    assert code == 2 and errors.startswith("error: ") and message in errors and errors.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["full"]
