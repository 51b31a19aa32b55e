"""Small video files for the tests."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import av
import numpy as np

TIMES_S = (0.0, 0.04, 0.08, 0.2, 0.24, 0.28, 0.32, 0.5, 0.54, 0.58)
"""Of the frames of a clip: a variable rate, as after dropped frames."""


def colour_of(index: int) -> tuple[int, int, int]:
    """Each frame's own grey."""
    return (20 + 20 * index,) * 3


def write_clip(path: Path, times_s=TIMES_S, size=(64, 48), rotation: int = 0, codec: str = "mpeg4") -> Path:
    """A clip whose frames are plain, each with a white corner at the top left."""
    clock = Fraction(1, 1000)
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=25)
        stream.width, stream.height, stream.pix_fmt = *size, "yuv420p"
        stream.codec_context.time_base = clock
        if rotation:
            stream.metadata["rotate"] = str(rotation)
        for index, time_s in enumerate(times_s):
            image = np.full((size[1], size[0], 3), colour_of(index), np.uint8)
            image[: size[1] // 4, : size[0] // 4] = 255
            frame = av.VideoFrame.from_ndarray(image, format="rgb24")
            frame.pts, frame.time_base = round(1000 * time_s), clock
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path
