"""What gives pictures to put behind the hands, and what mixes and changes them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from twohands.synth.backgrounds.panoramas import Surroundings
from twohands.types import PinholeCamera


@dataclass(frozen=True, slots=True, eq=False)
class Background:
    """What is behind the hands.

    Attributes:
        picture: (H, W, 3) uint8 RGB, as large as the camera's.
        surroundings: the light from all directions, where the picture is a view into a panorama.
    """

    picture: np.ndarray
    surroundings: Surroundings | None = None


class Backgrounds(Protocol):
    """Anything that gives backgrounds."""

    @property
    def name(self) -> str:
        """Identifies the source in manifests."""
        ...

    @property
    def unreadable(self) -> Sequence[str]:
        """A line for every picture that was skipped so far, because it cannot be read."""
        ...

    def sample(self, rng: np.random.Generator, camera: PinholeCamera) -> Background:
        """A random background for a camera."""
        ...


class MixedBackgrounds:
    """Draws from several sources at random, each with its weight."""

    def __init__(self, sources: tuple[Backgrounds, ...], weights: tuple[float, ...]) -> None:
        self.sources = sources
        self._cumulative = np.cumsum(np.asarray(weights, float) / np.sum(weights))
        self.name = " + ".join(source.name for source in sources)

    @property
    def unreadable(self) -> list[str]:
        """See `Backgrounds.unreadable`."""
        return [line for source in self.sources for line in source.unreadable]

    def sample(self, rng: np.random.Generator, camera: PinholeCamera) -> Background:
        """A random background for a camera."""
        choice = min(int(np.searchsorted(self._cumulative, rng.random())), len(self.sources) - 1)
        return self.sources[choice].sample(rng, camera)


class ChangedBackgrounds:
    """Changes a share of another source's backgrounds; subclasses say how.

    Args:
        source: gives the backgrounds.
        share: 0..1, of the backgrounds that are changed.
    """

    change = "changed"
    """What the name says of it."""

    def __init__(self, source: Backgrounds, share: float) -> None:
        self.source, self.share = source, share
        self.name = f"{source.name} + {self.change} {share:g}"

    @property
    def unreadable(self) -> Sequence[str]:
        """See `Backgrounds.unreadable`."""
        return self.source.unreadable

    def sample(self, rng: np.random.Generator, camera: PinholeCamera) -> Background:
        """A random background for a camera."""
        background = self.source.sample(rng, camera)
        if rng.random() >= self.share:
            return background
        return Background(self.changed(background.picture, rng, camera), background.surroundings)

    def changed(self, picture: np.ndarray, rng: np.random.Generator, camera: PinholeCamera) -> np.ndarray:
        """The picture (H, W, 3) uint8 RGB after the change; the given one stays as it is."""
        raise NotImplementedError
