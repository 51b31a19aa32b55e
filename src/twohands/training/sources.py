"""Where training pictures come from: one function that turns a `DataConfig` into training and held-out pictures."""

from __future__ import annotations

from pathlib import Path

from twohands.errors import InputError
from twohands.training.batches import IndexRange, SampleSource
from twohands.training.config import DataConfig

SYNTHETIC = "synthetic"
"""Name of the built-in source that renders its pictures on the fly."""


def open_source(spec: DataConfig) -> tuple[SampleSource, SampleSource]:
    """Training and held-out pictures.

    Args:
        spec: `source` is a folder in the Ego3DHands layout, a folder of cached frames, or "synthetic".

    Returns:
        (training, validation); the validation pictures are the last `spec.validation` of the source, at most a tenth.

    Raises:
        InputError: no such source, or it is empty.
    """
    return split(_open(spec), spec.validation)


def split(source: SampleSource, validation: int) -> tuple[SampleSource, SampleSource]:
    """Cut a source in two: everything before, and the last `validation` pictures, at most a tenth of all."""
    total = len(source)
    held_out = min(validation, total // 10)
    return IndexRange(source, 0, total - held_out), IndexRange(source, total - held_out, total)


def _open(spec: DataConfig) -> SampleSource:
    if spec.source == SYNTHETIC:
        from twohands.synth.config import SynthConfig
        from twohands.synth.stream import SyntheticStream

        return SyntheticStream(SynthConfig(), seed=spec.seed)
    folder = Path(spec.source)
    if not spec.source or not folder.is_dir():
        raise InputError(f"training data '{spec.source}': expected a folder or '{SYNTHETIC}'")
    from twohands.synth.cache import FrameCache

    if FrameCache.is_cache(folder):
        return FrameCache(folder)
    from twohands.datasets.ego3dhands import Ego3DHands

    dataset = Ego3DHands(folder)
    if len(dataset) == 0:
        raise InputError(f"{folder} holds no pictures: no folder below it has a location_2d.npy")
    return dataset
