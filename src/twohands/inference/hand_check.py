"""What HandCheck says of candidates: whether they are hands, and whose."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from twohands.geometry.boxes import upright_crop, warp_image
from twohands.geometry.network_input import network_input
from twohands.geometry.palm import Palm
from twohands.inference.weights import WeightsCard


def checked(
    network: Callable[[np.ndarray], np.ndarray],
    card: WeightsCard,
    image: np.ndarray,
    joints_px: np.ndarray,
    palms: Sequence[Palm] = (),
) -> np.ndarray:
    """Log-odds that candidates are hands, and that they are left ones.

    Args:
        network: HandCheck.
        card: of its weights.
        image: (H, W, 3) uint8 RGB.
        joints_px: (B, 21, 2) pixels, where they were seen.
        palms: P of them, which are looked at, too.

    Returns:
        (B + P, 2).
    """
    size = card.check_size
    places = [upright_crop(one, size=size, margin=card.check_margin) for one in joints_px]
    places += [palm.square(size) for palm in palms]
    return network(network_input(np.stack([warp_image(image, place, size) for place in places])))
