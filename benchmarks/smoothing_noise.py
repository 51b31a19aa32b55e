"""What smoothing the range costs and brings: noise factor and lag of the polynomial fit at its newest point.

    python -m benchmarks.smoothing_noise

Noise factor: standard deviation of the smoothed range over that of the raw range, for independent noise; exact, the
length of the fit's weights. Beside it the same measured on white noise through `RangeFilter`, the gate included. Lag:
largest error on a noise-free hand that moves to and fro once a second at 30 frames a second, as a fraction of its
amplitude. A longer queue is quieter and lags more; a higher degree the reverse.
"""

import math

import numpy as np

from twohands.inference.tracker import RangeFilter, RangeSmoothing, polynomial_weights

LENGTHS = (5, 8, 10, 12, 15, 20, 30)
DEGREES = (1, 2, 3)
FRAMES = 3_000
FPS = 30.0
RANGE_M = 0.4
NOISE_M = 0.01


def noise_factor(length: int, degree: int) -> float:
    """Exact noise factor of a full queue of evenly spaced frames."""
    return float(np.linalg.norm(polynomial_weights(np.arange(length), degree, length - 1)))


def measured_noise_factor(smoothing: RangeSmoothing, noise_m: np.ndarray) -> float:
    """The same through the filter, after its queue has filled."""
    filter_ = RangeFilter(smoothing)
    smooth = [filter_.update(i / FPS, RANGE_M + noise) for i, noise in enumerate(noise_m)]
    return float(np.std(smooth[smoothing.length :]) / np.std(noise_m))


def lag(length: int, degree: int, hertz: float = 1.0) -> float:
    """Largest error at the newest point on a sinusoid of amplitude 1; closed form over all phases."""
    times = np.arange(length) / FPS
    wave = np.exp(2j * math.pi * hertz * times)
    return float(abs(polynomial_weights(times, degree, times[-1]) @ wave - wave[-1]))


def main() -> None:
    noise_m = NOISE_M * np.random.default_rng(0).standard_normal(FRAMES)
    print("noise factor, exact / measured; lag at 1 Hz")
    print("| queue N | " + " | ".join(f"degree {degree}" for degree in DEGREES) + " |")
    print("| --- |" + " --- |" * len(DEGREES))
    for length in LENGTHS:
        cells = []
        for degree in DEGREES:
            measured = measured_noise_factor(RangeSmoothing(length, degree, fade=1.0), noise_m)
            cells.append(f"{noise_factor(length, degree):.3f} / {measured:.3f}; {100 * lag(length, degree):.1f} %")
        print(f"| {length} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
