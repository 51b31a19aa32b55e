"""The pictures that `benchmarks.real_people` runs over: where they lie, what is known about each, in which order.

Everything lies below one folder beside the checkout, `../shared`, none of it is ours to pass on::

    data/real_dev/people/*.jpg, reference.json      photographs of people, and the hands that MediaPipe found in them
    data/real_dev/clips/*, reference.json           videos, and the same of every second frame
    data/real_dev/ge2019/                           labelled crops (`benchmarks.real_hands`)
    data/real_dev/stills/                           to look at
    data/real_train/digits/                         right hands before white paper; a fifth of the persons is held out
    data/official/ego3dhands/                       the authors' samples
    data/backgrounds/research/images/               photographs without hands
    tools/score_people.py                           how hands are matched with reference hands
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import cv2
import numpy as np
from benchmarks.real_hands import PHOTO_FOV, list_photos, read_ge2019, typical_hand_length_m

from twohands.datasets.digits import LABELS_FILE, Digits
from twohands.datasets.ego3dhands import Ego3DHands
from twohands.datasets.files import existing_folder, read_json
from twohands.datasets.opening import open_dataset
from twohands.errors import InputError
from twohands.formats.pictures import list_images, read_image
from twohands.inference.known import assumed_camera
from twohands.skeleton import N_JOINTS, SIDES
from twohands.types import HandSample, PinholeCamera

SHARED = Path(__file__).resolve().parents[2] / "shared"
"""Where the pictures are looked for if nothing else is said: beside the checkout."""
QUICK_STRIDE = 4
"""Every so many reference frames of a clip are looked at in the quick run."""
QUICK_DIGITS = 60

Reference = dict[str, dict[str, Any]]
"""Picture's name -> {"left": [[u, v] x 21] or None, "right": the same}, as `score_people.py` reads it."""


@dataclass(frozen=True)
class Part:
    """Pictures of one kind.

    Attributes:
        name: of the part.
        samples: reads the pictures in order; labels are absent where there are none.
        reference: the hands that are known to be in them; None where none are, or where `samples` have labels.
        real_joints: whether wrist and knuckles of reference or labels are where anatomists have them
            (`geometry.anatomy`); else where our generator has them.
        length_m: hand length of all hands, metres, in the skeleton of the labels; None for each label's own, and
            0.10 in ours where there is none.
        video: whether the pictures of each folder of the sources are the frames of a video.
    """

    name: str
    samples: Callable[[], Iterable[HandSample]]
    reference: Reference | None = None
    real_joints: bool = True
    length_m: float | None = None
    video: bool = False


def people(shared: Path) -> Part:
    """20 photographs of dressed people showing a hand."""
    folder = existing_folder(shared / "data/real_dev/people")
    reference = read_json(folder / "reference.json", dict)
    return Part("people", lambda: (unlabelled(read_image(folder / name), name) for name in reference), reference)


def clips(shared: Path) -> Part:
    """All frames of all clips as the frames of videos; those of one clip have no reference."""
    folder = existing_folder(shared / "data/real_dev/clips")
    paths = sorted(path for path in folder.iterdir() if path.suffix in (".mkv", ".mp4"))

    def samples() -> Iterator[HandSample]:
        for path in paths:
            for number, image in enumerate(frames(path)):
                yield unlabelled(image, frame_name(path.name, number))

    return Part("clips", samples, clips_reference(folder), video=True)


def some_frames(shared: Path, stride: int = QUICK_STRIDE) -> Part:
    """Every so many of the clips' reference frames, each as a photograph of its own."""
    folder = existing_folder(shared / "data/real_dev/clips")
    rows = read_json(folder / "reference.json", dict)
    reference = clips_reference(folder)
    names = list(reference)[::stride]

    def samples() -> Iterator[HandSample]:
        for clip in rows:
            for number, image in enumerate(frames(folder / clip)):
                if (name := frame_name(clip, number)) in wanted:
                    yield unlabelled(image, name)

    wanted = {name: reference[name] for name in names}
    return Part("frames", samples, wanted)


def stills(shared: Path) -> Part:
    """Photographs to look at: nothing is known about them."""
    paths = list_images(existing_folder(shared / "data/real_dev/stills"))
    return Part("stills", lambda: (unlabelled(read_image(path), path.name) for path in paths))


def ge2019(shared: Path) -> Part:
    """Labelled crops of one person's left hand."""
    samples = read_ge2019(shared / "data/real_dev/ge2019")
    return Part("ge2019", lambda: samples, length_m=typical_hand_length_m(samples))


def digits(shared: Path, count: int | None = None) -> Part:
    """Held-out right hands before white paper, `count` of them evenly chosen, or all."""
    dataset = Digits(shared / "data/real_train/digits", "held-out")
    labels = read_json(dataset.root / LABELS_FILE, dict)
    chosen = np.linspace(0, len(dataset) - 1, min(count or len(dataset), len(dataset))).astype(int)
    names = [dataset.names[i] for i in chosen]
    reference = {name: {"left": None, "right": labels[name]["joints_px"]} for name in names}
    images = dataset.root / "images"
    return Part("digits", lambda: (unlabelled(read_image(images / name), name) for name in names), reference)


def official(shared: Path) -> Part:
    """The authors' samples of Ego3DHands."""
    dataset = Ego3DHands(shared / "data/official/ego3dhands")
    return Part("official", lambda: (dataset[i] for i in range(len(dataset))), real_joints=False)


def research(shared: Path) -> Part:
    """Photographs that show no hand."""
    folder = shared / "data/backgrounds/research/images"
    paths = list_photos(folder)

    def samples() -> Iterator[HandSample]:
        for path in paths:
            sample = unlabelled(read_image(path), path.relative_to(folder).as_posix())
            camera = PinholeCamera.from_fov(PHOTO_FOV, sample.camera.width, sample.camera.height)
            yield replace(sample, camera=camera)

    return Part("research", samples)


def generated(folder: Path, name: str) -> Part:
    """A generated test set."""
    dataset = open_dataset(folder).samples
    return Part(name, lambda: (dataset[i] for i in range(len(dataset))), real_joints=False)


def unlabelled(image: np.ndarray, source: str) -> HandSample:
    """A picture of which nothing is known; its camera is the one that `twohands track` assumes."""
    return HandSample(
        image=image,
        camera=assumed_camera(image.shape[1], image.shape[0]),
        present=np.zeros(2, bool),
        joints_px=np.full((2, N_JOINTS, 2), np.nan),
        joints_m=np.full((2, N_JOINTS, 3), np.nan),
        valid=np.zeros((2, N_JOINTS), bool),
        source=source,
    )


def reference_of(sample: HandSample) -> dict[str, Any]:
    """The labelled hands of a sample as reference hands; one with a joint that is not labelled is left out."""
    known = [there and bool(np.isfinite(j).all()) for there, j in zip(sample.present, sample.joints_px, strict=True)]
    return {side: sample.joints_px[i].tolist() if known[i] else None for i, side in enumerate(SIDES)}


def frame_name(clip: str, number: int) -> str:
    """Name of a frame, counted from 0: clips are folders of frames."""
    return f"{clip}/{number:05d}"


def clips_reference(folder: Path) -> Reference:
    """Reference hands of the clips by `frame_name`."""
    rows = read_json(folder / "reference.json", dict)
    return {frame_name(clip, row["frame"]): {side: row[side] for side in SIDES} for clip in rows for row in rows[clip]}


def frames(path: Path) -> Iterator[np.ndarray]:
    """All frames of a video, (H, W, 3) uint8 RGB.

    Raises:
        InputError: it cannot be opened, or holds none.
    """
    video = cv2.VideoCapture(str(path))
    count = 0
    try:
        while True:
            there, image = video.read()
            if not there:
                break
            count += 1
            yield cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
    finally:
        video.release()
    if not count:
        raise InputError(f"{path}: not a video that can be read")


@cache
def score_people(shared: Path) -> ModuleType:
    """The module `tools/score_people.py`, loaded from where it lies.

    Raises:
        InputError: it is not there.
    """
    path = shared / "tools/score_people.py"
    spec = importlib.util.spec_from_file_location("score_people", path)
    if not path.is_file() or spec is None or spec.loader is None:
        raise InputError(f"{path}: no such file")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
