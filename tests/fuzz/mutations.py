"""Seeded damage to what users bring, and commands that must take it: one line and exit 2, or results and exit 0.

`tests/fuzz/test_fuzz.py` runs 800 of them in CI, `scripts/fuzz.py` as many as one likes.
"""

from __future__ import annotations

import contextlib
import io
import json
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

import cv2
import numpy as np
from tests.datasets import fakes
from tests.motion.moving import moving_hands, write_jsonl
from tests.oracles import write_tiny_weights

from twohands.cli import track
from twohands.cli.main import main
from twohands.datasets.ego3dhands import Ego3DHands
from twohands.inference.estimator import HandEstimator
from twohands.skeleton import SIDES

MOST_SECONDS = 10.0
"""Of processor time, so that a machine with much to do finds nothing that is not there; of wall time, six times as
much."""
MOST_BYTES = 2 << 30
"""Of this process, whatever the file says of its size."""
EXTREMES = (
    "1e308", "-1e308", "1e-308", "99999999999999999999", "-1", "0", "true", "null", "NaN", "Infinity", "1e999", '"x"',
    "[]", "{}", "[1, 2]", "2147483648", "65536", "1e5", "0.5", '"\\ud800"', "[[[[1]]]]", "", "1" * 5000,
)  # fmt: skip
SIZE = (96, 64)
MOTIONS = (
    ("openxr", "hands.jsonl"), ("bvh", "hands.bvh"), ("glb", "hands.glb"), ("gltf", "hands.gltf"), ("rosbag", "bag")
)  # fmt: skip
"""What clips are exported to, and what they are called then."""


@dataclass(frozen=True, slots=True)
class Attempt:
    """One damaged file and what came of it.

    Attributes:
        kind: of file.
        name: of the undamaged one.
        seed: of the damage.
        problem: what was wrong with the program's answer; None for nothing.
    """

    kind: str
    name: str
    seed: int
    problem: str | None


class Workshop:
    """Undamaged files of every kind in a folder, and a place to damage copies of them.

    Args:
        folder: empty.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.originals = folder / "originals"
        self.originals.mkdir(parents=True)
        rng = np.random.default_rng(0)
        small = rng.integers(0, 256, (SIZE[1] // 8, SIZE[0] // 8, 3), dtype=np.uint8)
        picture = cv2.resize(small, SIZE, interpolation=cv2.INTER_CUBIC)
        self.pictures = {}
        for suffix in (".png", ".jpg", ".webp", ".bmp", ".tiff", ".avif"):
            if cv2.haveImageWriter(suffix):
                self.pictures[suffix] = cv2.imencode(suffix, picture)[1].tobytes()
        self.picture = self.originals / "picture.png"
        self.picture.write_bytes(self.pictures[".png"])
        self.cameras = {name: text.encode() for name, text in _cameras().items()}
        self.weights = write_tiny_weights(self.originals / "weights")
        self.estimator = HandEstimator.from_preset(self.weights)
        self.dataset = self.originals / "dataset"
        for name in ("0", "1"):
            fakes.write_instance(self.dataset / name)
        valid = np.array([[True, True], [True, False], [False, True], [True, True]])
        self.motion = write_jsonl(moving_hands(4, valid=valid), self.originals / "hands.jsonl")
        self.predictions = _predictions(self.dataset, self.originals)

    def attempt(self, kind: str, seed: int) -> Attempt:
        """Damages a copy of one file and gives it to the command that reads it."""
        rng = np.random.default_rng([seed, list(KINDS).index(kind)])
        work = self.folder / "work"
        shutil.rmtree(work, ignore_errors=True)
        work.mkdir()
        name, arguments = KINDS[kind](self, rng, work)
        before = _files(work)
        problem = self._run(arguments, work, before, cached=kind != "weights")
        return Attempt(kind, name, seed, problem)

    def _run(self, arguments: list[str], work: Path, before: set[Path], *, cached: bool) -> str | None:
        """What is wrong with the answer to a command; None for nothing."""
        temporary = work / "tmp"
        temporary.mkdir()
        out, errors = io.StringIO(), io.StringIO()
        started, peak_before = time.process_time(), _peak_bytes()
        with contextlib.ExitStack() as stack:
            stack.enter_context(mock.patch.object(tempfile, "tempdir", str(temporary)))
            stack.enter_context(mock.patch.object(track, "_write_views", lambda *_: True))
            if cached:
                stack.enter_context(mock.patch.object(HandEstimator, "from_preset", lambda *_, **__: self.estimator))
            stack.enter_context(contextlib.redirect_stdout(out))
            stack.enter_context(contextlib.redirect_stderr(errors))
            stack.enter_context(_time_limit())
            try:
                code = main(arguments)
            except BaseException:
                return f"traceback: {traceback.format_exc()}"
        said = errors.getvalue().splitlines()
        left = _files(work) - before - _files(work / "out")
        hidden = [path for path in _files(work) if path.name.startswith(".") or path.name.endswith(".partial")]
        if code not in (0, 2) and not (code == 1 and arguments[0] == "inspect"):  # 1: it found the damage
            return f"exit code {code}: {said}"
        if code == 2 and sum(line.startswith("twohands: error: ") for line in said) != 1:
            return f"not one line of error: {said}"
        if strange := [line for line in said if not line.startswith("twohands: ")]:
            return f"lines of others: {strange[:3]}"
        if left or hidden:
            return f"left behind: {sorted(map(str, left | set(hidden)))}"
        if (seconds := time.process_time() - started) > MOST_SECONDS:
            return f"{seconds:.1f} s"
        if (peak := _peak_bytes()) > max(MOST_BYTES, peak_before):  # other tests of this process may have needed more
            return f"{peak >> 20} MiB"
        return None


def _peak_bytes() -> int:
    """The most memory that this process has held so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def _files(folder: Path) -> set[Path]:
    return {path for path in folder.rglob("*") if path.is_file()}


@contextlib.contextmanager
def _time_limit() -> Iterator[None]:
    """Raises TimeoutError in the main thread after a while; native code that never returns is the caller's to see."""

    def stop(number: int, frame: object) -> None:
        raise TimeoutError(f"more than {6 * MOST_SECONDS:g} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(int(6 * MOST_SECONDS))
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def damaged_bytes(data: bytes, rng: np.random.Generator) -> bytes:
    """Bits turned, parts cut out, doubled, or set to all ones, or the end cut off: one to three such things."""
    content = bytearray(data)
    for _ in range(rng.integers(1, 4)):
        at, length = int(rng.integers(max(len(content), 1))), int(rng.integers(1, 40))
        how = rng.integers(6)
        if how == 0 and content:
            content[at] ^= 1 << int(rng.integers(8))
        elif how == 1:
            del content[at : at + length]
        elif how == 2:
            content[at:at] = content[at : at + length]
        elif how == 3:
            content[at : at + 4] = b"\xff" * len(content[at : at + 4])
        elif how == 4:
            content[at : at + length] = rng.bytes(length)
        else:
            del content[at:]
    return bytes(content)


def damaged_text(data: bytes, rng: np.random.Generator) -> bytes:
    """A number or word made extreme, a line taken out or doubled, two lines exchanged, or damaged as bytes."""
    if rng.integers(5) == 0:
        return damaged_bytes(data, rng)
    text = data.decode()
    for _ in range(rng.integers(1, 3)):
        values = list(re.finditer(r"-?\d+(\.\d*)?([eE][-+]?\d+)?|\"[^\"]*\"", text))
        lines = text.splitlines(keepends=True)
        how = rng.integers(4)
        if how <= 1 and values:
            value = values[int(rng.integers(len(values)))]
            text = text[: value.start()] + EXTREMES[int(rng.integers(len(EXTREMES)))] + text[value.end() :]
        elif lines:
            one, other = (int(rng.integers(len(lines))) for _ in range(2))
            if how == 2:
                lines[one : one + 1] = [lines[one]] * int(rng.choice([0, 2]))
            else:
                lines[one], lines[other] = lines[other], lines[one]
            text = "".join(lines)
    return text.encode("utf-8", "surrogatepass")


def _picture(shop: Workshop, rng: np.random.Generator, work: Path) -> tuple[str, list[str]]:
    suffix = str(rng.choice(sorted(shop.pictures)))
    path = work / f"damaged{suffix}"
    path.write_bytes(damaged_bytes(shop.pictures[suffix], rng))
    return suffix, ["track", str(path), "--out", str(work / "out"), "--fov", "70", "--hand-length", "10"]


def _camera(shop: Workshop, rng: np.random.Generator, work: Path) -> tuple[str, list[str]]:
    name = str(rng.choice(sorted(shop.cameras)))
    path = work / name
    path.write_bytes(damaged_text(shop.cameras[name], rng))
    return name, ["track", str(shop.picture), "--camera", str(path), "--out", str(work / "out"), "--hand-length", "10"]


def _prediction(shop: Workshop, rng: np.random.Generator, work: Path) -> tuple[str, list[str]]:
    original = shop.predictions[int(rng.integers(len(shop.predictions)))]
    path = work / original.name
    damage = damaged_text if path.suffix == ".json" else damaged_bytes
    path.write_bytes(damage(original.read_bytes(), rng))
    (work / "out").mkdir()
    return path.name, ["eval", "import", str(path), str(shop.dataset), "--out", str(work / "out" / "theirs.npz")]


def _dataset(shop: Workshop, rng: np.random.Generator, work: Path) -> tuple[str, list[str]]:
    folder = work / "dataset"
    shutil.copytree(shop.dataset, folder)
    path = sorted(_files(folder))[int(rng.integers(len(_files(folder))))]
    damage = damaged_text if path.suffix == ".json" else damaged_bytes
    path.write_bytes(damage(path.read_bytes(), rng))
    name = path.relative_to(folder).as_posix()
    (work / "out").mkdir()
    return name, ["eval", "predict", str(folder), "--out", str(work / "out" / "ours.npz")]


def _weights(shop: Workshop, rng: np.random.Generator, work: Path) -> tuple[str, list[str]]:
    folder = work / "weights"
    shutil.copytree(shop.weights, folder)
    path = sorted(_files(folder))[int(rng.integers(len(_files(folder))))]
    path.write_bytes((damaged_text if path.suffix == ".json" else damaged_bytes)(path.read_bytes(), rng))
    arguments = ["--fov", "70", "--hand-length", "10", "--out", str(work / "out"), "--weights", str(folder)]
    return path.name, ["track", str(shop.picture), *arguments]


def _motion(shop: Workshop, rng: np.random.Generator, work: Path) -> tuple[str, list[str]]:
    to, name = MOTIONS[int(rng.integers(len(MOTIONS)))]
    path = work / shop.motion.name
    path.write_bytes(damaged_text(shop.motion.read_bytes(), rng))
    return to, ["export-motion", str(path), "--to", to, "--out", str(work / "out" / name)]


KINDS: dict[str, Callable[[Workshop, np.random.Generator, Path], tuple[str, list[str]]]] = {
    "camera": _camera,
    "dataset": _dataset,
    "picture": _picture,
    "prediction": _prediction,
    "weights": _weights,
    "motion": _motion,
}
"""New ones at the end: a kind's place is part of its seeds."""


def _cameras() -> dict[str, str]:
    """One camera in five programs' words."""
    width, height = SIZE
    matrix = [70.0, 0.0, width / 2 - 0.5, 0.0, 70.0, height / 2 - 0.5, 0.0, 0.0, 1.0]
    lens = [0.01, -0.02, 0.0005, -0.0003, 0.0]
    ours = {"fx": 70.0, "fy": 70.0, "cx": width / 2, "cy": height / 2, "width": width, "height": height}
    storage = {"rows": 3, "cols": 3, "dt": "d", "data": matrix}
    return {
        "ours.json": json.dumps(ours | {"distortion": lens}, indent=1),
        "storage.json": json.dumps(
            {"image_width": width, "image_height": height, "camera_matrix": storage, "dist_coeffs": [lens]}, indent=1
        ),
        "opencv.yaml": f"%YAML:1.0\n---\nimage_width: {width}\nimage_height: {height}\ncamera_matrix: !!opencv-matrix\n"
        f"   rows: 3\n   cols: 3\n   dt: d\n   data: {matrix}\ndistortion_coefficients: !!opencv-matrix\n   rows: 1\n"
        f"   cols: 5\n   dt: d\n   data: {lens}\n",
        "kalibr.yaml": f"cam0:\n  camera_model: pinhole\n  distortion_coeffs: {lens[:4]}\n  distortion_model: radtan\n"
        f"  intrinsics: [70.0, 70.0, {matrix[2]}, {matrix[5]}]\n  resolution: [{width}, {height}]\n",
        "opencv.xml": '<?xml version="1.0"?>\n<opencv_storage>\n<cameraResolution>\n'
        f'  {width} {height}</cameraResolution>\n<cameraMatrix type_id="opencv-matrix">\n<rows>3</rows>\n'
        f"<cols>3</cols>\n<dt>d</dt>\n<data>\n{' '.join(map(str, matrix))}</data></cameraMatrix>\n</opencv_storage>\n",
        "cameras.txt": f"# Camera list\n1 OPENCV {width} {height} 70 70 {width / 2} {height / 2} 0.01 -0.02 0.0005 0\n",
    }


def _predictions(dataset: Path, folder: Path) -> list[Path]:
    """Another system's predictions of a dataset, as JSON and as npz; they are the truth."""
    samples = list(Ego3DHands(dataset))
    images = []
    for sample in samples:
        said = [{"joints_m": np.round(joints, 4).tolist(), "score": 0.9} for joints in sample.joints_m]
        hands = {name: said[side] if sample.present[side] else None for side, name in enumerate(SIDES)}
        images.append({"source": sample.source} | hands)
    as_json, as_npz = folder / "theirs.json", folder / "theirs.npz"
    as_json.write_text(json.dumps({"version": 1, "system": "theirs", "images": images}, indent=1))
    np.savez(
        as_npz,
        version=1,
        sources=[sample.source for sample in samples],
        present=np.array([sample.present for sample in samples]),
        joints_m=np.array([sample.joints_m for sample in samples]),
    )
    return [as_json, as_npz]


if __name__ == "__main__":
    sys.exit("run scripts/fuzz.py")
