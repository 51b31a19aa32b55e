"""How fingers are held: fists, flat hands, grips, each for many candidates at once, with some variation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twohands.synth.scene.arm_goals import CANDIDATES
from twohands.synth.scene.pose import ANGLE_LIMITS, HandAngles
from twohands.synth.scene.sampling import sample_angles


def fingers(
    rng: np.random.Generator,
    mcp: float | Sequence[float],
    pip: float | Sequence[float],
    thumb: Sequence[float],
    *,
    openness: float = 0.2,
    noise: float = 5.0,
    n: int = CANDIDATES,
) -> HandAngles:
    """Hands about one shape.

    Args:
        rng: source of variation.
        mcp, pip: degrees, of all fingers or of index to little.
        thumb: (4,) degrees: radial, palmar, two flexions.
        openness: of the fingers, -0.4 close to 1 spread.
        noise: standard deviation in degrees.
        n: number of hands.
    """
    own = rng.normal(0, noise, (n, 1))
    bent = np.broadcast_to(np.asarray(mcp, float), (4,)) + own + rng.normal(0, noise / 2, (n, 4))
    middle = np.broadcast_to(np.asarray(pip, float), (4,)) + own + rng.normal(0, noise / 2, (n, 4))
    middle = np.maximum(middle, 4.0)
    spread = np.array([10.0, 2.0, -6.0, -14.0]) * (openness + rng.normal(0, 0.12, (n, 1)))
    spread = spread * np.cos(np.radians(np.clip(bent, 0, 80))) ** 2
    stacked = np.stack([spread, bent, middle, middle * rng.uniform(0.45, 0.75, (n, 1))], axis=-1)
    vector = np.zeros((n, 24))
    vector[:, 3] = rng.uniform(0, 10, n)
    vector[:, 4:8] = np.asarray(thumb) + rng.normal(0, noise, (n, 4))
    vector[:, 8:] = stacked.reshape(n, 16)
    return HandAngles.from_vector(np.clip(np.radians(vector), ANGLE_LIMITS[:, 0], ANGLE_LIMITS[:, 1]))


def relaxed(rng: np.random.Generator) -> HandAngles:
    """Hands at rest: half curled, the more so towards the little finger."""
    curl = rng.uniform(0.4, 1.3)
    return fingers(
        rng, list(curl * np.array([15, 20, 24, 28])), list(curl * np.array([28, 32, 34, 36])), [20, 20, 10, 15]
    )


def flat(rng: np.random.Generator, openness: float | None = None) -> HandAngles:
    """Open hands, fingers together or spread."""
    spread = rng.uniform(-0.3, 1.0) if openness is None else openness
    thumb = [rng.uniform(10, 50), rng.uniform(0, 25), 4, 4]
    return fingers(rng, rng.uniform(-4, 12), rng.uniform(4, 14), thumb, openness=spread, noise=4)


def straight(rng: np.random.Generator) -> HandAngles:
    """Flat hands that bend a little back, as where they press on each other."""
    return fingers(rng, -9, 4, [rng.uniform(15, 40), 6, 4, 4], openness=rng.uniform(-0.15, 0.2), noise=2)


def fist(rng: np.random.Generator) -> HandAngles:
    """Closed hands, the thumb over the fingers."""
    return fingers(rng, 72, 92, [44, 40, 38, 40], openness=0.0)


def mostly_pointing(rng: np.random.Generator) -> HandAngles:
    """The index finger out."""
    return fingers(rng, [3, 68, 72, 74], [6, 92, 92, 90], [40, 36, 30, 30])


def pinching(rng: np.random.Generator) -> HandAngles:
    """Thumb and index finger meet, as about a pen."""
    return fingers(rng, [48, 50, 54, 58], [42, 48, 52, 54], [40, 42, 22, 26], openness=0.0)


def gripping(rng: np.random.Generator) -> HandAngles:
    """About a cup or a bottle."""
    curl = rng.uniform(0.65, 1.05)
    return fingers(rng, curl * 26, curl * 48, [34, 22, 14, 10], openness=0.1, noise=3)


def cradling(rng: np.random.Generator) -> HandAngles:
    """About a telephone that lies along the palm."""
    return fingers(rng, rng.uniform(18, 32), rng.uniform(16, 28), [42, 12, 10, 10], noise=3)


def pressing(rng: np.random.Generator) -> HandAngles:
    """Fingers on one side, thumb on the other, as about a plate, a book or the edge of a screen."""
    return fingers(rng, rng.uniform(30, 48), rng.uniform(8, 22), [38, 44, 4, 8], openness=0.0, noise=3)


def sampled(rng: np.random.Generator) -> HandAngles:
    """Any shape of fingers, half of them pointing or counting."""
    return sample_angles(rng, (CANDIDATES,), 0.5)


def laced(rng: np.random.Generator) -> HandAngles:
    """Fingers bent and apart, for those of the other hand between them."""
    return fingers(rng, 52, 48, [36, 30, 10, 20], openness=0.7)
