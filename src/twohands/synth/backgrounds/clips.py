"""Moving backgrounds, one clip per sequence: videos, folders of frames, and views into panoramas, stills or a room.

A clip answers for any frame number by itself: asking for frame 200 alone gives the same picture as playing up to it.
Colour, crop and mirroring are drawn once and stay for the whole clip.
"""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import cv2
import numpy as np

from twohands.errors import InputError
from twohands.formats.pictures import read_pixels
from twohands.synth.backgrounds.clip_sources import ClipSource, numbered
from twohands.synth.backgrounds.panoramas import Surroundings, light_of, rays, view
from twohands.synth.backgrounds.photographs import Look
from twohands.synth.backgrounds.rooms import Room
from twohands.synth.backgrounds.wandering import Head, Wander
from twohands.types import PinholeCamera

MAX_START_SECONDS = 120.0
"""Videos are decoded from their first frame, for seeking is not exact; a clip starts no later than this."""
MAX_PANORAMA_WIDTH = 4096


class Clip(Protocol):
    """A background in motion."""

    def frame(self, index: int) -> np.ndarray:
        """(height, width, 3) uint8 RGB of one frame of the sequence."""
        ...

    def surroundings(self, index: int) -> Surroundings | None:
        """Light from all directions in one frame; None where the clip knows only what it shows."""
        ...


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
        return Room(rng, fps, camera, look)
    if source.kind == "video":
        return _Film(_VideoReader(source.path), rng, frames, fps, size, look)
    if source.kind == "frames":
        return _Film(_FolderReader(source.path), rng, frames, fps, size, look)
    picture = _read_picture(source.path)
    if source.kind == "panorama":
        return _PanoramaView(picture, source.path, rng, fps, camera, look)
    return _StillView(picture, rng, fps, size, look)


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
        self.path = Wander(rng, amplitude, np.minimum(pace, amplitude), fps)
        self.breath = Wander(rng, np.array([0.04]), np.array([0.02]), fps)

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
        self.head = Head(rng, fps)

    def frame(self, index: int) -> np.ndarray:
        return self.look.apply(view(self.picture, self.rays, self.head.rotation(index)))

    def surroundings(self, index: int) -> Surroundings:
        return self.look.surroundings(self.light, self.head.rotation(index))


def _read_picture(path: Path) -> np.ndarray:
    picture = read_pixels(path, cv2.IMREAD_COLOR)
    if picture is None:
        raise InputError(f"{path}: not a picture that can be read")
    return cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)


def _shrunk(picture: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """The picture, no larger than needed to fill `size`."""
    scale = max(size[0] / picture.shape[1], size[1] / picture.shape[0])
    if scale >= 1:
        return picture
    return cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
