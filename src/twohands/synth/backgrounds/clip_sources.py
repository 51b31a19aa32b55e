"""Finds films, folders of frames, panoramas and stills, and gives every sequence one."""

from __future__ import annotations

import hashlib
import re
from collections import defaultdict
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Literal

import cv2
import numpy as np

from twohands.errors import InputError
from twohands.formats.pictures import IMAGE_SUFFIXES, read_pixels
from twohands.synth.backgrounds.panoramas import ASPECT, is_panorama, light_file, unreadable_light

VIDEO_SUFFIXES = (".mp4", ".mov", ".avi", ".mkv", ".webm", ".m4v", ".mpg", ".mpeg")
MIN_VIDEO_FPS, MIN_VIDEO_SECONDS = 8.0, 1.5
"""Slower or shorter videos are slide shows, not motion."""
MIN_FOLDER_FRAMES = 30
SIMILAR_FRAMES = 20.0
"""Mean difference of neighbouring frames' thumbnails, of 255, above which numbered pictures are not a film."""
DOUBTFUL_ASPECT = 0.1
"""An eighth of a panorama, 128 pixels wide or more and rounded to whole ones, is less than this from twice as wide as
high."""
Kind = Literal["video", "frames", "panorama", "still", "room"]


@dataclass(frozen=True, slots=True)
class ClipSource:
    """Where a clip comes from.

    Attributes:
        kind: "video"; "frames", a folder of numbered pictures; "panorama"; "still"; "room", procedural.
        path: file or folder; None for a room.
    """

    kind: Kind
    path: Path | None = None

    @property
    def name(self) -> str:
        """For manifests: kind and file name."""
        return self.kind if self.path is None else f"{self.kind} {self.path.name}"


@dataclass(frozen=True, slots=True)
class ClipAssignment:
    """One source per sequence.

    Attributes:
        sources: source of every sequence.
        skipped: (file or folder, reason) of what cannot be used.
        name: identifies the collection in manifests.
    """

    sources: tuple[ClipSource, ...]
    skipped: tuple[tuple[Path, str], ...]
    name: str


def assign_clips(folder: Path | None, rng: np.random.Generator, count: int) -> ClipAssignment:
    """Gives every sequence its own clip as long as there are enough.

    Videos, folders of frames and panoramas come first, in random order; then stills; then all again, seen differently.

    Args:
        folder: searched with its subfolders; None for procedural rooms.
        rng: draws their order.
        count: number of sequences. A larger count leaves the earlier ones as they are.

    Raises:
        InputError: the folder does not exist or holds nothing that can be read.
    """
    if folder is None:
        return ClipAssignment((ClipSource("room"),) * count, (), "procedural rooms")
    found = find_clips(folder)
    digest = hashlib.sha256("\n".join(f"{s.kind} {s.path}" for s in _relative(found, folder)).encode()).hexdigest()[:12]
    moving = [source for source in found if source.kind != "still"]
    stills = [source for source in found if source.kind == "still"]
    order = [group[i] for group in (moving, stills) for i in rng.permutation(len(group))]
    usable: list[ClipSource] = []
    skipped: list[tuple[Path, str]] = []
    for source in order:
        if len(usable) == count:
            break
        reason = unusable(source)
        if reason is None:
            usable.append(source)
        elif source.path is not None:
            skipped.append((source.path, reason))
    if not usable:
        raise InputError(f"no background in {folder} can be read: {skipped[0][0].name}: {skipped[0][1]}")
    sources = tuple(usable[i % len(usable)] for i in range(count))
    return ClipAssignment(sources, tuple(skipped), f"{folder.name} ({len(found)} clips and stills, {digest})")


def find_clips(folder: Path) -> list[ClipSource]:
    """All sources below a folder, by name.

    Pictures of one folder that have the same name but for a number that counts up without a gap, at least
    `MIN_FOLDER_FRAMES` of them, each like the next, are one clip; other pictures are panoramas or stills.

    Raises:
        InputError: the folder does not exist or holds neither videos nor pictures.
    """
    if not folder.is_dir():
        raise InputError(f"background folder {folder} does not exist")
    sources: list[ClipSource] = []
    pictures: dict[Path, list[Path]] = defaultdict(list)
    for path in sorted(folder.rglob("*")):
        if path.suffix.lower() in VIDEO_SUFFIXES and path.is_file():
            sources.append(ClipSource("video", path))
        elif path.suffix.lower() in IMAGE_SUFFIXES and path.is_file():
            pictures[path.parent].append(path)
    for parent, files in sorted(pictures.items()):
        if _is_film(files):
            sources.append(ClipSource("frames", parent))
        else:
            sources += [ClipSource("panorama" if _is_panorama(path) else "still", path) for path in files]
    if not sources:
        raise InputError(f"no video or picture ({', '.join(VIDEO_SUFFIXES + IMAGE_SUFFIXES)}) in {folder}")
    return sources


def unusable(source: ClipSource) -> str | None:
    """Why a source cannot be used, or None if it can."""
    if source.path is None:
        return None
    if source.kind == "video":
        capture = cv2.VideoCapture(str(source.path))
        try:
            readable, _ = capture.read()
            fps, frames = capture.get(cv2.CAP_PROP_FPS), capture.get(cv2.CAP_PROP_FRAME_COUNT)
        finally:
            capture.release()
        if not readable:
            return "not a video that can be decoded"
        if not fps >= MIN_VIDEO_FPS:
            return f"{fps:.3g} frames a second, at least {MIN_VIDEO_FPS:g} needed"
        if frames / fps < MIN_VIDEO_SECONDS:
            return f"{frames / fps:.2g} s long, at least {MIN_VIDEO_SECONDS:g} s needed"
        return None
    if source.kind == "frames":
        damaged = next((path.name for path in numbered(source.path) if not _is_readable(path)), None)
        return None if damaged is None else f"{damaged} is not a picture that can be read"
    if not _is_readable(source.path):
        return "not a picture that can be read"
    if source.kind == "panorama" and unreadable_light(source.path):
        light = light_file(source.path)
        return f"its light ({light.parent.name}/{light.name}) cannot be read"
    return None


def _is_readable(path: Path) -> bool:
    """Whether a file is a whole picture; decoded small, for that is quick."""
    return read_pixels(path, cv2.IMREAD_REDUCED_COLOR_8) is not None


def numbered(folder: Path) -> list[Path]:
    """Pictures of a folder in the order of the number in their names."""
    files = [path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES and path.is_file()]
    return sorted(files, key=lambda path: (_number(path.stem)[1], path.name))


def _number(stem: str) -> tuple[str, int]:
    """Text and value of the last number of a name; -1 without one."""
    match = re.search(r"(\d+)(\D*)$", stem)
    return (stem, -1) if match is None else (stem[: match.start(1)] + "#" + match.group(2), int(match.group(1)))


def _is_film(files: list[Path]) -> bool:
    if len(files) < MIN_FOLDER_FRAMES:
        return False
    names = {_number(path.stem)[0] + path.suffix for path in files}
    numbers = sorted(_number(path.stem)[1] for path in files)
    if len(names) != 1 or numbers != list(range(numbers[0], numbers[0] + len(numbers))) or numbers[0] < 0:
        return False
    first = sorted(files, key=lambda path: _number(path.stem)[1])[:4]
    small = []
    for path in first:
        picture = read_pixels(path, cv2.IMREAD_REDUCED_COLOR_4)
        if picture is None:
            return False
        small.append(cv2.resize(picture, (48, 27), interpolation=cv2.INTER_AREA).astype(float))
    return all(np.abs(a - b).mean() < SIMILAR_FRAMES for a, b in pairwise(small))


def _is_panorama(path: Path) -> bool:
    """Whether a picture's own size is that of a panorama; one that is clearly none is read small, for that is quick."""
    small = read_pixels(path, cv2.IMREAD_REDUCED_COLOR_8)
    if small is None or abs(small.shape[1] / small.shape[0] - ASPECT) > DOUBTFUL_ASPECT:
        return False
    picture = read_pixels(path, cv2.IMREAD_COLOR)
    return picture is not None and is_panorama(*picture.shape[1::-1])


def _relative(sources: list[ClipSource], folder: Path) -> list[ClipSource]:
    return [ClipSource(s.kind, s.path.relative_to(folder)) for s in sources if s.path is not None]
