"""Smooth random paths, and heads that look about on them."""

from __future__ import annotations

import numpy as np

from twohands.synth.backgrounds.panoramas import turn


class Wander:
    """Smooth random path about a centre: three sinusoids per coordinate.

    Args:
        rng: draws it.
        amplitude: (n,) largest distance from the centre.
        speed: (n,) largest speed, units of the amplitude per second.
        fps: frames per second.
    """

    def __init__(self, rng: np.random.Generator, amplitude: np.ndarray, speed: np.ndarray, fps: float) -> None:
        share = rng.dirichlet(np.full(3, 1.5), len(amplitude)).T  # (3, n)
        self.amplitude = share * amplitude
        # Each wave peaks at its share of the speed.
        self.omega = np.asarray(speed) / np.maximum(amplitude, 1e-9) * rng.uniform(0.3, 1.0, share.shape)
        self.phase = rng.uniform(0, 2 * np.pi, share.shape)
        self.fps = fps

    def at(self, index: int) -> np.ndarray:
        return (self.amplitude * np.sin(self.omega * (index / self.fps) + self.phase)).sum(0)


class Head:
    """Orientation of a head that looks about: it turns at up to 35 degrees a second, nods and tilts a little."""

    def __init__(self, rng: np.random.Generator, fps: float) -> None:
        self.yaw = rng.uniform(-np.pi, np.pi)
        self.pitch = np.radians(rng.normal(-12, 8))  # at their hands people look down: negative is down
        amplitude = np.radians(rng.uniform([10, 3, 1], [70, 10, 4]))
        speed = np.minimum(np.radians([35.0, 12.0, 6.0]), amplitude * 1.5)
        self.path = Wander(rng, amplitude, speed, fps)

    def rotation(self, index: int) -> np.ndarray:
        """(3, 3) R_world_from_camera; the world's y axis points down."""
        yaw, pitch, roll = self.path.at(index) + np.array([self.yaw, self.pitch, 0.0])
        return turn(yaw, pitch, roll)
