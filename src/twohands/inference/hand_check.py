"""What HandCheck says of candidates whose joints have been seen: whether they are hands, and whose."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from twohands.geometry.boxes import upright_crop, warp_image
from twohands.geometry.network_input import network_input
from twohands.inference.weights import WeightsCard


def checked(
    network: Callable[[np.ndarray], np.ndarray], card: WeightsCard, image: np.ndarray, joints_px: np.ndarray
) -> np.ndarray:
    """Log-odds that candidates are hands, and that they are left ones.

    Args:
        network: HandCheck.
        card: of its weights.
        image: (H, W, 3) uint8 RGB.
        joints_px: (B, 21, 2) pixels, where they were seen.

    Returns:
        (B, 2).
    """
    size = card.check_size
    crops = [warp_image(image, upright_crop(one, size=size, margin=card.check_margin), size) for one in joints_px]
    return network(network_input(np.stack(crops)))
