"""Frames of a video file, a stream or a camera, with the times that the source itself gives them.

Video is decoded by PyAV (extra `video`), cameras by OpenCV. A frame that cannot be decoded is left out and counted; a
file that was cut off yields all that it holds. The rotation that a telephone notes is applied.
"""

from __future__ import annotations

import contextlib
import math
import os
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from twohands.errors import InputError, MissingExtraError

CAMERA_PREFIX: Final = "camera:"
OPEN_TIMEOUT_S: Final = 5.0
"""After which a stream that does not answer is taken for dead."""
STALL_TIMEOUT_S: Final = 10.0
"""After which a stream or camera that gives nothing more has ended."""

_MOST_REFUSALS: Final = 100
"""Times in a row that a damaged file is asked for what comes next."""
_VIDEOS: Final = "3gp asf avi flv gif m2ts m4v mjpeg mjpg mkv mov mp4 mpeg mpg mts mxf ogv ts webm wmv y4m"
VIDEO_SUFFIXES: Final = frozenset(f".{name}" for name in _VIDEOS.split())


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame.

    Attributes:
        image: (H, W, 3) uint8 RGB, upright.
        index: position in the source, frames that were left out included.
        time_s: the source's own time of the frame, seconds; increases.
    """

    image: np.ndarray
    index: int
    time_s: float


def is_video(source: str) -> bool:
    """Whether an input is a camera (`camera:0`), an address (`://`) or, by its ending, a video file."""
    return source.startswith(CAMERA_PREFIX) or "://" in source or Path(source).suffix.lower() in VIDEO_SUFFIXES


class VideoFrames:
    """Frames of a video file or stream; a context manager and an iterator, for one pass.

    Args:
        source: file or address.
        start_s, end_s: first and last time that is wanted, seconds.
        stride: every how many frames one is wanted.

    Attributes:
        rate: frames a second, on average, as the file says; None where it does not.
        total: frames that the file says it has; None where it does not.
        decoded: frames so far, wanted or not.
        unreadable: frames so far that could not be decoded.

    Raises:
        InputError: no such file, nothing answers at the address, no video in it, or an unknown codec.
        MissingExtraError: PyAV is not installed.
    """

    def __init__(
        self, source: str | os.PathLike[str], *, start_s: float = 0.0, end_s: float = math.inf, stride: int = 1
    ) -> None:
        self.source: Final = os.fspath(source)
        self._wanted = _wanted(start_s, end_s, stride)
        av = load_av()
        if "://" not in self.source and not os.path.isfile(self.source):
            raise InputError(f"{self.source}: no such file")
        try:
            self._container: Any = av.open(self.source, timeout=(OPEN_TIMEOUT_S, STALL_TIMEOUT_S))
        except (av.FFmpegError, OSError, ValueError) as error:
            raise InputError(f"{self.source}: not a video that can be read ({_reason(error)})") from None
        videos = [stream for stream in self._container.streams.video if not _is_cover(stream)]
        if not videos:
            self.close()
            raise InputError(f"{self.source}: holds no video; give a video file, a picture or a folder of pictures")
        self._stream: Any = videos[0]
        if self._stream.codec_context is None:
            self.close()
            raise InputError(
                f"{self.source}: its codec is unknown to this PyAV; convert it to H.264 (ffmpeg -i IN OUT.mp4)"
            )
        self._stream.thread_type = "AUTO" if "://" not in self.source else "NONE"
        self.rate: Final[float | None] = float(self._stream.average_rate) if self._stream.average_rate else None
        self.total: Final[int | None] = self._stream.frames or None
        self.decoded = 0
        self.unreadable = 0

    def __enter__(self) -> VideoFrames:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Closes the file."""
        with contextlib.suppress(Exception):  # of a broken file nothing more is wanted
            self._container.close()

    def __iter__(self) -> Iterator[Frame]:
        start_s, end_s, stride = self._wanted
        step = 1 / self.rate if self.rate else 1 / 30
        last, taken = -math.inf, 0
        for decoded in self._decode():
            index = self.decoded - 1 + self.unreadable
            time_s = index * step if decoded.time is None else float(decoded.time)
            if not time_s > last:
                time_s = last + step  # a clock that stands still
            last = time_s
            if time_s > end_s:
                return
            if time_s >= start_s:
                if taken % stride == 0:
                    yield Frame(_upright(decoded), index, time_s)
                taken += 1

    def _decode(self) -> Iterator[Any]:
        """PyAV's frames, whole ones, in the order in which they are shown."""
        av = load_av()
        packets, refused = self._container.demux(self._stream), 0
        while True:
            try:
                packet = next(packets)
                refused = 0
            except StopIteration:
                break
            except av.error.InvalidDataError:  # damage, behind which more may come
                refused += 1
                packets = self._container.demux(self._stream)
                if refused < _MOST_REFUSALS:
                    continue
                packet = None
            except (av.FFmpegError, OSError, ValueError):  # cut off, or the stream has ended
                packet = None
            try:
                found = self._stream.decode(packet)  # None: what is still in the decoder
            except (av.FFmpegError, ValueError):
                self.unreadable += packet is not None and packet.size > 0
                found = []
            for frame in found:
                if frame.is_corrupt:
                    self.unreadable += 1
                else:
                    self.decoded += 1
                    yield frame
            if packet is None:
                break
        if self.total is not None and self.decoded + self.unreadable < self.total:
            self.unreadable = self.total - self.decoded


class CameraFrames:
    """The newest frames of a camera of this machine: those that come while one is worked on are dropped.

    Args:
        number: as OpenCV counts cameras.

    Attributes:
        rate: None; a camera's frames come when they come.
        total: None.
        decoded: frames so far, dropped ones included.
        unreadable: 0.

    Raises:
        InputError: there is no such camera.
    """

    rate = None
    total = None
    unreadable = 0

    def __init__(self, number: int) -> None:
        self.source: Final = f"{CAMERA_PREFIX}{number}"
        self._capture = cv2.VideoCapture(number)
        if not self._capture.isOpened():
            self._capture.release()
            raise InputError(f"{self.source}: no such camera; the first one of this machine is {CAMERA_PREFIX}0")
        self._capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        self.decoded = 0
        self._newest: Frame | None = None
        self._news = threading.Condition()
        self._ended = False
        self._started = time.monotonic()
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def __enter__(self) -> CameraFrames:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Lets the camera go."""
        self._ended = True
        self._thread.join(timeout=2.0)
        self._capture.release()

    def __iter__(self) -> Iterator[Frame]:
        while True:
            with self._news:
                if not self._news.wait_for(lambda: self._newest is not None or self._ended, STALL_TIMEOUT_S):
                    return
                frame, self._newest = self._newest, None
            if frame is None:
                return
            yield frame

    def _read(self) -> None:
        while not self._ended:
            good, image = self._capture.read()
            with self._news:
                if good:
                    time_s = time.monotonic() - self._started
                    self._newest = Frame(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), self.decoded, time_s)
                    self.decoded += 1
                else:
                    self._ended = True  # unplugged
                self._news.notify()


def open_frames(
    source: str, *, start_s: float = 0.0, end_s: float = math.inf, stride: int = 1
) -> VideoFrames | CameraFrames:
    """Opens a video file, a stream or a camera (`camera:0`).

    Raises:
        InputError: it cannot be opened; says why.
        MissingExtraError: PyAV is needed and not installed.
    """
    if not source.startswith(CAMERA_PREFIX):
        return VideoFrames(source, start_s=start_s, end_s=end_s, stride=stride)
    number = source.removeprefix(CAMERA_PREFIX)
    if not (number.isascii() and number.isdecimal() and len(number) < 4):
        raise InputError(f"{source}: a number after {CAMERA_PREFIX} expected, such as {CAMERA_PREFIX}0")
    return CameraFrames(int(number))


def load_av() -> Any:
    """PyAV.

    Raises:
        MissingExtraError: it is not installed.
    """
    try:
        import av
        import av.logging
    except ImportError:
        raise MissingExtraError("video", "video") from None
    av.logging.set_level(None)  # its complaints come out as counts and our one line
    return av


def _wanted(start_s: float, end_s: float, stride: int) -> tuple[float, float, int]:
    if not (start_s >= 0 and end_s > start_s):
        raise InputError(f"start and end: 0 <= start < end expected, got {start_s:g} and {end_s:g} s")
    if stride < 1:
        raise InputError(f"stride must be at least 1, got {stride}")
    return start_s, end_s, stride


def _upright(frame: Any) -> np.ndarray:
    """(H, W, 3) uint8 RGB, turned as the file says."""
    image = frame.to_ndarray(format="rgb24")
    quarters = round(getattr(frame, "rotation", 0) / 90) % 4  # counter-clockwise
    return np.ascontiguousarray(np.rot90(image, quarters)) if quarters else image


def _is_cover(stream: Any) -> bool:
    """Whether a stream is the picture on the cover of a song."""
    return "attached_pic" in str(getattr(stream, "disposition", "")).lower()


def _reason(error: BaseException) -> str:
    return " ".join(str(getattr(error, "strerror", None) or error).split()) or type(error).__name__
