"""A picture as a network's input: which form it takes, how it is fitted in, and its values.

Source: paper section 4.1; docs/paper-map.md for what the paper leaves open.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

LETTERBOX_GREY = 128
"""What surrounds a picture that does not fill a network's input: 0 once it is normalised."""
STRIDE = 32
"""What both sides of HandSegNet's input are multiples of."""
FORMS = (4 / 3, 1.0, 3 / 4, 9 / 16)
"""Width over height of the inputs that take the place of the network's own for pictures of other forms."""
LEAST_GAIN = 0.05
"""Another form must show a picture so much larger."""
STRETCH = 0.05
"""Pictures whose aspect ratio is this close to the network's input are stretched to fill it."""


@dataclass(frozen=True, slots=True)
class Letterbox:
    """Where a picture lies inside a network's input of another aspect ratio.

    Attributes:
        top, left, height, width: the picture's rectangle as fractions of the input's height and width.
    """

    top: float
    left: float
    height: float
    width: float

    def content(self, maps: np.ndarray) -> np.ndarray:
        """The part of (..., h, w) maps of any resolution that shows the picture; a view."""
        rows, columns = maps.shape[-2:]
        top, left = round(self.top * rows), round(self.left * columns)
        bottom, right = round((self.top + self.height) * rows), round((self.left + self.width) * columns)
        return maps[..., top:bottom, left:right]


def canvas_size(image_size: tuple[int, int], network_size: tuple[int, int]) -> tuple[int, int]:
    """The form of a network's input in which a picture is largest, for the same work.

    A fixed input of 16:9 shows a portrait at half the scale that its cells allow. A network of convolutions takes any
    form; few are used (`FORMS`), for a runtime prepares each.

    Args:
        image_size: (H, W) of the picture.
        network_size: (height, width) of the input, multiples of `STRIDE`; the result has at most as many cells.

    Returns:
        (height, width), multiples of `STRIDE`; `network_size` itself where no form shows more.
    """
    cells = network_size[0] * network_size[1]

    def scale(form: tuple[int, int]) -> float:
        return min(form[0] / image_size[0], form[1] / image_size[1])

    forms = [network_size]
    for aspect in FORMS:
        rows = max(1, round((cells / aspect) ** 0.5 / STRIDE)) * STRIDE
        forms.append((rows, max(1, cells // rows // STRIDE) * STRIDE))
    best = max((form for form in forms if form[0] * form[1] <= cells), key=scale)
    return best if scale(best) > scale(network_size) * (1 + LEAST_GAIN) else network_size


def letterbox(image: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, Letterbox]:
    """Fit a picture into a network's input without stretching it.

    A picture of nearly the input's own aspect ratio fills it. Any other is centred, so that hands keep the shape that
    the network has learned, with a border of the grey that the network sees as 0, which is what its first convolution
    takes to be outside a picture.

    Args:
        image: (H, W, 3) uint8.
        size: (height, width) of the network's input.

    Returns:
        (height, width, 3) uint8, and where the picture lies in it.
    """
    height, width = size
    scale_v, scale_u = height / image.shape[0], width / image.shape[1]
    scale = min(scale_u, scale_v)
    rows, columns = height, width
    if abs(scale_u / scale_v - 1) > STRETCH:
        rows, columns = max(1, round(image.shape[0] * scale)), max(1, round(image.shape[1] * scale))
    interpolation = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    resized = cv2.resize(image, (columns, rows), interpolation=interpolation)
    top, left = (height - rows) // 2, (width - columns) // 2
    canvas = np.full((height, width, 3), LETTERBOX_GREY, np.uint8)
    canvas[top : top + rows, left : left + columns] = resized
    return canvas, Letterbox(top / height, left / width, rows / height, columns / width)


def network_input(images: np.ndarray) -> NDArray[np.float32]:
    """Normalise pictures for a network.

    Args:
        images: (B, H, W, 3) uint8.

    Returns:
        (B, 3, H, W) float32, (value - 128) / 256; black is -0.5 (docs/conventions.md).
    """
    planes = np.ascontiguousarray(np.moveaxis(images, 3, 1)).astype(np.float32)  # bytes are moved seven times as fast
    planes -= 128.0
    planes /= 256.0
    return planes
