"""Moving backgrounds, one clip per sequence: videos, folders of frames, and views into panoramas, stills or a room.

A clip answers for any frame number by itself: asking for frame 200 alone gives the same picture as playing up to it.
Colour, crop and mirroring are drawn once and stay for the whole clip.
"""

from __future__ import annotations

import hashlib
import re
from collections import defaultdict
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Literal, Protocol

import cv2
import numpy as np

from twohands.errors import InputError
from twohands.synth.backgrounds.panoramas import (
    ASPECT,
    Surroundings,
    is_panorama,
    light_file,
    light_of,
    rays,
    turn,
    turned,
    unreadable_light,
    view,
)
from twohands.synth.backgrounds.photographs import Background, Look, procedural_picture
from twohands.synth.backgrounds.pictures import IMAGE_SUFFIXES, decode_whole
from twohands.types import PinholeCamera

VIDEO_SUFFIXES = (".mp4", ".mov", ".avi", ".mkv", ".webm", ".m4v", ".mpg", ".mpeg")
MIN_VIDEO_FPS, MIN_VIDEO_SECONDS = 8.0, 1.5
"""Slower or shorter videos are slide shows, not motion."""
MAX_START_SECONDS = 120.0
"""Videos are decoded from their first frame, for seeking is not exact; a clip starts no later than this."""
MIN_FOLDER_FRAMES = 30
SIMILAR_FRAMES = 20.0
"""Mean difference of neighbouring frames' thumbnails, of 255, above which numbered pictures are not a film."""
MAX_PANORAMA_WIDTH = 4096
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


class Clip(Protocol):
    """A background in motion."""

    def frame(self, index: int) -> np.ndarray:
        """(height, width, 3) uint8 RGB of one frame of the sequence."""
        ...

    def surroundings(self, index: int) -> Surroundings | None:
        """Light from all directions in one frame; None where the clip knows only what it shows."""
        ...


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


def assign_clips(folder: Path | None, seed: int, count: int) -> ClipAssignment:
    """Gives every sequence its own clip as long as there are enough.

    Videos, folders of frames and panoramas come first, in random order; then stills; then all again, seen differently.

    Args:
        folder: searched with its subfolders; None for procedural rooms.
        seed: of the set.
        count: number of sequences. A larger count leaves the earlier ones as they are.

    Raises:
        InputError: the folder does not exist or holds nothing that can be read.
    """
    if folder is None:
        return ClipAssignment((ClipSource("room"),) * count, (), "procedural rooms")
    found = find_clips(folder)
    digest = hashlib.sha256("\n".join(f"{s.kind} {s.path}" for s in _relative(found, folder)).encode()).hexdigest()[:12]
    rng = np.random.default_rng(np.random.SeedSequence(entropy=seed, spawn_key=(1 << 44,)))
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
    return decode_whole(path, cv2.IMREAD_REDUCED_COLOR_8) is not None


def open_clip(source: ClipSource, rng: np.random.Generator, frames: int, fps: float, camera: PinholeCamera) -> Clip:
    """The clip behind one sequence.

    Args:
        source: where it comes from.
        rng: draws the start, crop, mirroring, colour, and camera path.
        frames: length of the sequence.
        fps: frames per second of the sequence; videos and camera paths keep their speed.
        camera: of the hands; its size is that of the frames, and views of panoramas and rooms have its intrinsics.

    Raises:
        InputError: the source cannot be read.
    """
    look = Look(rng)
    size = (camera.width, camera.height)
    if source.path is None:
        return _Room(rng, fps, camera, look)
    if source.kind == "video":
        return _Film(_VideoReader(source.path), rng, frames, fps, size, look)
    if source.kind == "frames":
        return _Film(_FolderReader(source.path), rng, frames, fps, size, look)
    picture = _read_picture(source.path)
    if source.kind == "panorama":
        return _PanoramaView(picture, source.path, rng, fps, camera, look)
    return _StillView(picture, rng, fps, size, look)


class _Wander:
    """Smooth random path about a centre: three sinusoids per coordinate.

    Args:
        rng: draws it.
        amplitude: (n,) largest distance from the centre.
        speed: (n,) largest speed, units of the amplitude per second.
        fps: frames per second.
    """

    def __init__(self, rng: np.random.Generator, amplitude: np.ndarray, speed: np.ndarray, fps: float) -> None:
        share = rng.dirichlet(np.full(3, 1.5), len(amplitude)).T  # (3, n)
        self.amplitude = share * amplitude
        # Each wave peaks at its share of the speed.
        self.omega = np.asarray(speed) / np.maximum(amplitude, 1e-9) * rng.uniform(0.3, 1.0, share.shape)
        self.phase = rng.uniform(0, 2 * np.pi, share.shape)
        self.fps = fps

    def at(self, index: int) -> np.ndarray:
        return (self.amplitude * np.sin(self.omega * (index / self.fps) + self.phase)).sum(0)


class _VideoReader:
    """Frames of a video by number, decoded in order from the first one."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._open()
        self.fps = float(self._capture.get(cv2.CAP_PROP_FPS))
        self.count = max(int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT)), 1)

    def _open(self) -> None:
        self._capture, self._next = cv2.VideoCapture(str(self.path)), 0
        self._last: np.ndarray | None = None

    def read(self, index: int) -> np.ndarray:
        """(H, W, 3) RGB; a video that ends before its header says stays on its last frame."""
        index = min(index, self.count - 1)
        if index < self._next - 1:
            self._open()
        while self._next <= index:
            if not self._capture.grab():
                if self._next == 0:
                    raise InputError(f"{self.path}: cannot be decoded")
                self.count, last = self._next, self._next - 1
                self._open()
                return self.read(last)
            self._next += 1
            if self._next > index:
                ok, picture = self._capture.retrieve()
                self._last = picture if ok else None
        if self._last is None:
            raise InputError(f"{self.path}: frame {index} cannot be decoded")
        return cv2.cvtColor(self._last, cv2.COLOR_BGR2RGB)


class _FolderReader:
    """Numbered pictures as the frames of a film of 30 frames a second."""

    fps = 30.0

    def __init__(self, folder: Path) -> None:
        self.files = numbered(folder)
        self.count = len(self.files)

    def read(self, index: int) -> np.ndarray:
        return _read_picture(self.files[index])


class _Film:
    """A film at its own speed, from a random start, to and fro where it is shorter than the sequence."""

    def __init__(
        self,
        reader: _VideoReader | _FolderReader,
        rng: np.random.Generator,
        frames: int,
        fps: float,
        size: tuple[int, int],
        look: Look,
    ) -> None:
        self.reader, self.size, self.look = reader, size, look
        self.step = reader.fps / fps
        self.count = reader.count  # as announced: what the reader finds out later must not change earlier frames
        room = self.count - int(np.ceil(frames * self.step))
        start, self.zoom, self.centre = rng.random(), rng.uniform(0.8, 1.0), rng.random(2)
        self.start = int(start * min(room, MAX_START_SECONDS * reader.fps)) if room > 0 else 0
        self._kept: dict[int, np.ndarray] | None = {} if room < 0 else None

    def frame(self, index: int) -> np.ndarray:
        position = self.start + int(index * self.step + 1e-6)
        span = max(self.count - 1, 1)
        position = span - abs(span - position % (2 * span))  # to and fro
        position = min(position, self.count - 1)
        return self.look.apply(self._crop(self._read(position)))

    def surroundings(self, index: int) -> None:
        return None

    def _read(self, position: int) -> np.ndarray:
        """Short films are kept in memory, compressed, so that going backwards costs no decoding from the start."""
        if self._kept is None:
            return self.reader.read(position)
        if position not in self._kept:
            for earlier in range(position + 1):
                if earlier not in self._kept:
                    picture = _shrunk(self.reader.read(earlier), self.size)
                    ok, data = cv2.imencode(".png", picture, [cv2.IMWRITE_PNG_COMPRESSION, 1])
                    if not ok:
                        raise InputError("a background frame could not be kept")
                    self._kept[earlier] = data
        return np.asarray(cv2.imdecode(self._kept[position], cv2.IMREAD_COLOR))

    def _crop(self, picture: np.ndarray) -> np.ndarray:
        height, width = picture.shape[:2]
        scale = min(width / self.size[0], height / self.size[1]) * self.zoom
        w, h = max(int(self.size[0] * scale), 1), max(int(self.size[1] * scale), 1)
        x, y = int((width - w) * self.centre[0]), int((height - h) * self.centre[1])
        shrink = cv2.INTER_AREA if scale > 1 else cv2.INTER_LINEAR
        return cv2.resize(np.ascontiguousarray(picture[y : y + h, x : x + w]), self.size, interpolation=shrink)


class RoomBackgrounds:
    """Single views into procedural rooms, such as are behind sequences: every one another room."""

    name = "rooms"
    unreadable = ()

    def sample(self, rng: np.random.Generator, camera: PinholeCamera) -> Background:
        """A random background for a camera."""
        return Background(_Room(rng, 1.0, camera, Look(rng)).frame(0))


class _StillView:
    """A camera that slowly moves over a still."""

    def __init__(
        self, picture: np.ndarray, rng: np.random.Generator, fps: float, size: tuple[int, int], look: Look
    ) -> None:
        height, width = picture.shape[:2]
        zoom = rng.uniform(0.5, 0.7)
        scale = min(width / size[0], height / size[1]) * zoom  # picture's pixels per pixel of the view
        if scale > 1:
            picture = cv2.resize(picture, None, fx=1 / scale, fy=1 / scale, interpolation=cv2.INTER_AREA)
            height, width, scale = *picture.shape[:2], 1.0
        self.picture, self.size, self.scale, self.look = picture, size, scale, look
        room = (np.array([width, height]) - np.array(size) * scale) / 2
        self.room = np.maximum(room, 0.0)
        pace = rng.uniform(0.10, 0.30) * size[0] * scale
        amplitude = self.room * 0.95
        self.path = _Wander(rng, amplitude, np.minimum(pace, amplitude), fps)
        self.breath = _Wander(rng, np.array([0.04]), np.array([0.02]), fps)

    def frame(self, index: int) -> np.ndarray:
        height, width = self.picture.shape[:2]
        # Zooming in by up to 8 %, never out: the view stays inside the picture.
        scale = self.scale * (0.96 + float(self.breath.at(index)[0]))
        corner = np.array([width, height]) / 2 + self.path.at(index) - np.array(self.size) * scale / 2
        # warpAffine counts from pixel centres, we count from outer corners.
        shift = corner + (scale - 1) / 2
        matrix = np.array([[scale, 0, shift[0]], [0, scale, shift[1]]])
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        view = cv2.warpAffine(self.picture, matrix, self.size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
        return self.look.apply(view)

    def surroundings(self, index: int) -> None:
        return None


class _PanoramaView:
    """A turning head in an equirectangular panorama, seen through the camera of the hands."""

    def __init__(
        self, picture: np.ndarray, path: Path, rng: np.random.Generator, fps: float, camera: PinholeCamera, look: Look
    ) -> None:
        if picture.shape[1] > MAX_PANORAMA_WIDTH:
            scale = MAX_PANORAMA_WIDTH / picture.shape[1]
            picture = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        self.picture, self.rays, self.look = picture, rays(camera), look
        self.light = light_of(picture, path)
        self.head = _Head(rng, fps)

    def frame(self, index: int) -> np.ndarray:
        return self.look.apply(view(self.picture, self.rays, self.head.rotation(index)))

    def surroundings(self, index: int) -> Surroundings:
        return self.look.surroundings(self.light, self.head.rotation(index))


class _Room:
    """A head that turns and moves in a box-shaped room with six procedural walls: a background with parallax where no
    folder is given."""

    def __init__(self, rng: np.random.Generator, fps: float, camera: PinholeCamera, look: Look) -> None:
        self.rays, self.look = rays(camera), look
        self.head = _Head(rng, fps)
        self.half = rng.uniform([1.5, 1.1, 1.5], [3.5, 1.6, 3.5]).astype(np.float32)
        amplitude = rng.uniform(0.1, 0.5, 3) * [1.0, 0.2, 1.0]
        self.place = _Wander(rng, amplitude, amplitude * 0.8, fps)
        size = max(int(0.8 * camera.width), 32)
        shade = np.array([0.85, 0.95, 0.6, 1.1, 1.0, 0.9], np.float32) * rng.uniform(0.85, 1.1, 6)  # -x +x -y +y -z +z
        greys = np.arange(256, dtype=np.float32)
        tiles = [cv2.LUT(_wall(rng, size), np.clip(greys * s, 0, 255).astype(np.uint8)) for s in shade]
        # Pixels are repeated around every tile, so that no tile bleeds into the next one.
        self.atlas = np.concatenate(
            [cv2.copyMakeBorder(tile, 2, 2, 2, 2, cv2.BORDER_REPLICATE) for tile in tiles], axis=1
        )

    def frame(self, index: int) -> np.ndarray:
        toward = turned(self.rays, self.head.rotation(index))
        place = self.place.at(index).astype(np.float32)
        # Distance along the ray to the wall it meets on each axis, were there no other.
        reach = [
            np.where(ray < 0, -half - start, half - start) / np.where(ray == 0, np.float32(1e-9), ray)
            for ray, half, start in zip(toward, self.half, place, strict=True)
        ]
        nearest = np.minimum(np.minimum(reach[0], reach[1]), reach[2])
        on_x, on_y = reach[0] == nearest, reach[1] == nearest
        # -1..1 on the wall: it is spanned by z and y, by x and z, or by x and y.
        hit = [(start + ray * nearest) / half for ray, half, start in zip(toward, self.half, place, strict=True)]
        across, down = np.where(on_x, hit[2], hit[0]), np.where(on_y & ~on_x, hit[2], hit[1])
        positive = np.where(on_x, toward[0], np.where(on_y, toward[1], toward[2])) > 0
        tile = 2 * np.where(on_x, 0, np.where(on_y, 1, 2)) + positive
        half_size = np.float32(self.atlas.shape[0] / 2 - 2)
        column = tile.astype(np.float32) * (2 * half_size + 4) + (np.clip(across, -1, 1) + 1) * half_size
        row = (np.clip(down, -1, 1) + 1) * half_size
        shift = np.float32(2 - 0.5)  # the tile's rim, and from outer corners to pixel centres
        view = cv2.remap(self.atlas, column + shift, row + shift, cv2.INTER_LINEAR)
        return self.look.apply(view)

    def surroundings(self, index: int) -> None:
        return None


def _wall(rng: np.random.Generator, size: int) -> np.ndarray:
    """(size, size, 3) uint8: a procedural picture with smaller ones hung on it, for detail at all scales."""
    wall = procedural_picture(rng, size, size).copy()
    for _ in range(int(rng.integers(2, 7))):
        width, height = (int(n) for n in rng.integers(size // 12, size // 3, 2))
        x, y = int(rng.integers(0, size - width)), int(rng.integers(0, size - height))
        wall[y : y + height, x : x + width] = procedural_picture(rng, width, height)
    return wall


class _Head:
    """Orientation of a head that looks about: it turns at up to 35 degrees a second, nods and tilts a little."""

    def __init__(self, rng: np.random.Generator, fps: float) -> None:
        self.yaw = rng.uniform(-np.pi, np.pi)
        self.pitch = np.radians(rng.normal(-12, 8))  # at their hands people look down: negative is down
        amplitude = np.radians(rng.uniform([10, 3, 1], [70, 10, 4]))
        speed = np.minimum(np.radians([35.0, 12.0, 6.0]), amplitude * 1.5)
        self.path = _Wander(rng, amplitude, speed, fps)

    def rotation(self, index: int) -> np.ndarray:
        """(3, 3) R_world_from_camera; the world's y axis points down."""
        yaw, pitch, roll = self.path.at(index) + np.array([self.yaw, self.pitch, 0.0])
        return turn(yaw, pitch, roll)


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
        picture = cv2.imread(str(path), cv2.IMREAD_REDUCED_COLOR_4)
        if picture is None:
            return False
        small.append(cv2.resize(picture, (48, 27), interpolation=cv2.INTER_AREA).astype(float))
    return all(np.abs(a - b).mean() < SIMILAR_FRAMES for a, b in pairwise(small))


def _is_panorama(path: Path) -> bool:
    """Whether a picture's own size is that of a panorama; one that is clearly none is read small, for that is quick."""
    small = cv2.imread(str(path), cv2.IMREAD_REDUCED_COLOR_8)
    if small is None or abs(small.shape[1] / small.shape[0] - ASPECT) > DOUBTFUL_ASPECT:
        return False
    picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
    return picture is not None and is_panorama(*picture.shape[1::-1])


def _relative(sources: list[ClipSource], folder: Path) -> list[ClipSource]:
    return [ClipSource(s.kind, s.path.relative_to(folder)) for s in sources if s.path is not None]


def _read_picture(path: Path) -> np.ndarray:
    picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if picture is None:
        raise InputError(f"{path}: not a picture that can be read")
    return cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)


def _shrunk(picture: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """The picture, no larger than needed to fill `size`."""
    scale = max(size[0] / picture.shape[1], size[1] / picture.shape[0])
    if scale >= 1:
        return picture
    return cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
