"""Many pictures, one after the other: the memory of the process does not grow."""

from pathlib import Path

import numpy as np
import pytest
from tests.oracles import write_tiny_weights

from twohands.inference.estimator import HandEstimator
from twohands.types import PinholeCamera

STATUS = Path("/proc/self/statm")
SIZES = ((160, 96), (96, 160), (320, 240))


@pytest.mark.skipif(not STATUS.is_file(), reason="memory is read from /proc")
def test_memory_stays_flat(tmp_path, count=400):
    estimator = HandEstimator.from_preset(write_tiny_weights(tmp_path / "tiny"))
    rng = np.random.default_rng(0)
    pages = []
    for number in range(count):
        width, height = SIZES[number % len(SIZES)]
        image = rng.integers(0, 256, (height, width, 3), dtype=np.uint8)
        estimator.estimate(image, PinholeCamera.from_fov(60, width, height), index=number)
        pages.append(int(STATUS.read_text().split()[1]))
    assert (pages[-1] - pages[count // 4]) * 4096 < 20e6
