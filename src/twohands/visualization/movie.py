"""Pictures as a video file that browsers play, also where its writer was killed."""

from __future__ import annotations

import contextlib
from fractions import Fraction
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from twohands.inference.frames import load_av

_CLOCK: Final = Fraction(1, 90000)
"""Unit of the file's times, seconds: fine enough for any rate."""


class Movie:
    """H.264 in a fragmented MP4: every second's fragment plays by itself, so half a file still does.

    A context manager.

    Args:
        path: the file; replaced if it exists.
        width, height: of the pictures; of an odd size the last row or column is left out.
        rate: frames a second, about; times are given with each picture.

    Raises:
        MissingExtraError: PyAV is not installed.
        OSError: the file cannot be written.
    """

    def __init__(self, path: Path, width: int, height: int, rate: float = 30.0) -> None:
        av = self._av = load_av()
        movflags = "frag_keyframe+empty_moov+default_base_moof"
        self._container: Any = av.open(
            str(path), "w", format="mp4", options={"movflags": movflags, "flush_packets": "1"}
        )
        nearest = Fraction(min(max(rate, 1.0), 240.0)).limit_denominator(1001)
        # On one thread: on several, the bytes would depend on the number of cores.
        options = {"preset": "ultrafast", "crf": "23", "bf": "0", "threads": "1"}
        self._stream: Any = self._container.add_stream("libx264", rate=nearest, options=options)
        self._stream.width, self._stream.height = width // 2 * 2, height // 2 * 2
        self._stream.pix_fmt = "yuv420p"
        self._stream.codec_context.time_base = _CLOCK
        self._stream.codec_context.gop_size = max(1, round(nearest))
        self._last = -1

    def __enter__(self) -> Movie:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        with contextlib.suppress(Exception) if kind is not None else contextlib.nullcontext():
            for packet in self._stream.encode():
                self._container.mux(packet)
            self._container.close()

    def write(self, image: np.ndarray, time_s: float) -> None:
        """One more picture.

        Args:
            image: (H, W, 3) uint8 RGB.
            time_s: when it is shown, seconds after the beginning; later than the last one's.
        """
        even = np.ascontiguousarray(image[: self._stream.height, : self._stream.width])
        planes = cv2.cvtColor(even, cv2.COLOR_RGB2YUV_I420)  # the encoder's own conversion takes four times as long
        frame = self._av.VideoFrame.from_ndarray(planes, format="yuv420p")
        self._last = max(self._last + 1, round(time_s / _CLOCK))
        frame.pts, frame.time_base = self._last, _CLOCK
        for packet in self._stream.encode(frame):
            self._container.mux(packet)
