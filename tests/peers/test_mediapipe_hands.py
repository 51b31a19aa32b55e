"""The adapter against a stand-in for MediaPipe: its protocol, sides, and both ways to a place.

The stand-in answers with what is written into a file, through the true worker in a process of its own.
"""

import json
import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.builders import random_rotations
from tests.oracles import drawn_hands

from twohands.errors import DataFormatError, InputError
from twohands.evaluation.predictions import predict
from twohands.evaluation.protocols import evaluate
from twohands.geometry.camera import project
from twohands.peers.mediapipe_hands import MediaPipeHands, placed_by_pnp
from twohands.skeleton import LEFT, RIGHT, ROOT
from twohands.types import HandSample

STAND_IN = """
import json
from pathlib import Path
from types import SimpleNamespace as Space
__version__ = "0"
class Hands:
    def __init__(self, **options): pass
    def process(self, image):
        hands = json.loads((Path(__file__).parent / "answer.json").read_text())
        point = lambda p: Space(x=p[0], y=p[1], z=p[-1])
        marks = lambda key: [Space(landmark=[point(p) for p in hand[key]]) for hand in hands]
        sides = [Space(classification=[Space(label=hand["label"], score=hand["score"])]) for hand in hands]
        joints, world = marks("joints"), marks("world")
        return Space(multi_handedness=sides, multi_hand_landmarks=joints, multi_hand_world_landmarks=world)
solutions = Space(hands=Space(Hands=Hands))
"""


TASKS_STAND_IN = {
    "mediapipe/__init__.py": """
from types import SimpleNamespace as Space
__version__ = "9"
ImageFormat = Space(SRGB=1)
Image = lambda image_format, data: data
""",
    "mediapipe/tasks/__init__.py": "",
    "mediapipe/tasks/python/__init__.py": """
from types import SimpleNamespace as Space
BaseOptions = lambda **options: Space(**options)
""",
    "mediapipe/tasks/python/vision.py": """
import json
from pathlib import Path
from types import SimpleNamespace as Space
RunningMode = Space(IMAGE="image", VIDEO="video")
HandLandmarkerOptions = lambda **options: Space(**options)
class HandLandmarker:
    @staticmethod
    def create_from_options(options):
        if options.base_options.model_asset_buffer != b"model":
            raise ValueError("no flatbuffer\\nin two lines")
        landmarker = HandLandmarker()
        landmarker.last = -1 if options.running_mode == "video" else None
        return landmarker
    def detect_for_video(self, image, time):
        assert self.last is not None and time > self.last
        self.last = time
        return answer()
    def detect(self, image):
        assert self.last is None
        return answer()
def answer():
    hands = json.loads((Path(__file__).parents[3] / "answer.json").read_text())
    points = lambda key: [[Space(x=p[0], y=p[1], z=p[-1]) for p in hand[key]] for hand in hands]
    sides = [[Space(category_name=hand["label"], score=hand["score"])] for hand in hands]
    return Space(handedness=sides, hand_landmarks=points("joints"), hand_world_landmarks=points("world"))
""",
}


@pytest.fixture
def tasks_python(tmp_path: Path) -> Path:
    """An interpreter whose mediapipe has the Tasks API alone; a model file beside it."""
    for name, source in TASKS_STAND_IN.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(source)
    (tmp_path / "hand_landmarker.task").write_bytes(b"model")
    return interpreter(tmp_path)


@pytest.fixture
def python(tmp_path: Path) -> Path:
    """An interpreter whose mediapipe is the stand-in."""
    (tmp_path / "mediapipe.py").write_text(STAND_IN)
    return interpreter(tmp_path)


def interpreter(folder: Path) -> Path:
    """A Python that finds its packages in a folder first."""
    script = folder / "python"
    script.write_text(f'#!/bin/sh\nPYTHONPATH="{folder}" exec "{sys.executable}" "$@"\n')
    os.chmod(script, 0o755)
    return script


def answer(folder: Path, sample: HandSample, labels: dict[int, str], turn: bool = False) -> None:
    """What a MediaPipe would say that sees everything right; `turn` rotates its metric joints (PnP must not care)."""
    hands = []
    for side, label in labels.items():
        world = sample.joints_m[side] - sample.joints_m[side].mean(axis=0)
        if turn:
            world = world @ random_rotations(1, np.random.default_rng(side))[0].T
        joints = sample.joints_px[side] / [sample.camera.width, sample.camera.height]
        hands.append({"label": label, "score": 0.9, "joints": joints.tolist(), "world": world.tolist()})
    (folder / "answer.json").write_text(json.dumps(hands))


def report_of(peer: MediaPipeHands, sample: HandSample):
    return evaluate(predict([sample], peer, dataset="d", weights=peer.name, settings=peer.settings), [sample])


def test_pnp_places_a_rigid_shape_at_its_own_size(python: Path, tmp_path: Path) -> None:
    """Perfect metric joints need neither hand length nor orientation; "Right" is the person's left hand."""
    sample = drawn_hands(1)
    answer(tmp_path, sample, {LEFT: "Right", RIGHT: "Left"}, turn=True)
    with MediaPipeHands(python, handedness="own", placement="own-size") as peer:
        report = report_of(peer, sample)
        assert "MediaPipe Hands 0" in report.weights and report.settings["labels_used"] == []
    assert report["presence_accuracy"].value == 1
    assert report["cs_mpjpe"].value < 1e-2 and report["error_2d_mean"].value < 1e-3


def test_the_solver_uses_the_true_hand_length(python: Path, tmp_path: Path) -> None:
    """The shape seen by a camera that looks at the hand, half as large as it is: only the shape matters."""
    sample = drawn_hands(1)
    answer(tmp_path, sample, {LEFT: "Right"})
    hands = json.loads((tmp_path / "answer.json").read_text())
    from twohands.geometry.canonical import canonical_from_camera

    hands[0]["world"] = (0.05 * np.asarray(canonical_from_camera(sample.joints_m[LEFT]).joints)).tolist()
    (tmp_path / "answer.json").write_text(json.dumps(hands))
    with MediaPipeHands(python) as peer:
        report = report_of(peer, sample)
        assert len(report.settings["labels_used"]) == 2
    assert report["cs_mpjpe"].left == pytest.approx(0, abs=1e-6) and report["missed"].right == 1


def test_handedness_matched_or_own(python: Path, tmp_path: Path) -> None:
    sample = drawn_hands(1)
    answer(tmp_path, sample, {LEFT: "Left", RIGHT: "Right"})  # both wrong: it took the picture for a mirrored one
    errors = {}
    for handedness in ("matched", "own"):
        with MediaPipeHands(python, handedness=handedness, placement="own-size") as peer:
            errors[handedness] = report_of(peer, sample)["cs_mpjpe"].value
    assert errors["matched"] < 1e-2 and errors["own"] > 50


@pytest.mark.parametrize("video", [False, True])
def test_the_tasks_api_names_the_persons_own_hands(tasks_python: Path, tmp_path: Path, video: bool) -> None:
    sample = drawn_hands(1)
    answer(tmp_path, sample, {LEFT: "Left", RIGHT: "Right"})
    model = tmp_path / "hand_landmarker.task"
    with MediaPipeHands(tasks_python, handedness="own", placement="own-size", model=model, video=video) as peer:
        report = report_of(peer, sample)
        assert report_of(peer, sample)["cs_mpjpe"].value < 1e-2  # a second frame
        assert "MediaPipe Hands 9 (tasks)" in peer.name and peer.settings["api"] == "tasks"
    assert report["presence_accuracy"].value == 1 and report["cs_mpjpe"].value < 1e-2


def test_the_tasks_api_needs_a_model(tasks_python: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"MediaPipe 9 brings no model; give one.*--mediapipe-model"):
        MediaPipeHands(tasks_python)
    with pytest.raises(InputError, match="no such model file"):
        MediaPipeHands(tasks_python, model=tmp_path / "nothing.task")
    (tmp_path / "bad.task").write_bytes(b"other")
    with pytest.raises(InputError, match=r"bad.task: no flatbuffer in two lines"):
        MediaPipeHands(tasks_python, model=tmp_path / "bad.task")


def test_no_hand(python: Path, tmp_path: Path) -> None:
    sample = replace(drawn_hands(1), source="a")
    (tmp_path / "answer.json").write_text("[]")
    with MediaPipeHands(python) as peer:
        report = report_of(peer, sample)
    assert report["missed"].value == 2 and np.isnan(report["cs_mpjpe"].value)


def test_a_process_that_ends_between_two_pictures_is_an_error(tmp_path: Path) -> None:
    """Named case: closing its broken pipe replaced the error by one that means success to the command line."""
    script = tmp_path / "python"
    line = json.dumps({"version": "0", "api": "legacy"})
    script.write_text(f"#!/bin/sh\necho '{line}'\n")
    os.chmod(script, 0o755)
    with pytest.raises(DataFormatError, match="process has ended"), MediaPipeHands(script) as peer:
        peer(drawn_hands(1))


def test_an_interpreter_in_the_current_folder_is_found(python: Path, monkeypatch) -> None:
    """Named case: of ./python nothing but "python" was left, which is looked for elsewhere."""
    monkeypatch.chdir(python.parent)
    with MediaPipeHands(Path("python")) as peer:
        assert "Hands 0" in peer.name


def test_an_interpreter_without_mediapipe() -> None:
    with pytest.raises(InputError, match="has no MediaPipe Hands; make an environment"):
        MediaPipeHands("/bin/true")


def test_pnp_has_no_answer_for_what_cannot_be_seen() -> None:
    sample = drawn_hands(1)
    joints = sample.joints_m[LEFT]
    placed = placed_by_pnp(joints - joints[ROOT], np.asarray(project(joints, sample.camera)), sample.camera)
    assert placed is not None
    np.testing.assert_allclose(placed, joints, atol=1e-5)
    assert placed_by_pnp(joints, np.full((21, 2), np.nan), sample.camera) is None
