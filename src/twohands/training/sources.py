"""Where training pictures come from: one function that turns a `DataConfig` into training and held-out pictures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from twohands.datasets.digits import Digits
from twohands.errors import InputError
from twohands.training.batches import IndexRange, Joined, Picked, SampleSource
from twohands.training.config import DataConfig

if TYPE_CHECKING:
    from twohands.synth.backgrounds.base import Backgrounds

SYNTHETIC = "synthetic"
"""Name of the built-in source that renders its pictures on the fly."""
SYNTHETIC_SIZE = 1_000_000
"""Instances of the built-in source: more than a run will see."""
SYNTHETIC_FRAME = (480, 270)
"""Picture size of the built-in source: quick, but crops of distant hands are enlarged."""


def open_source(spec: DataConfig) -> tuple[SampleSource, SampleSource]:
    """Training and held-out pictures.

    Args:
        spec: `source` names folders, of instances, of tar shards, of cached frames or of photographed digits
            (`datasets.digits`), or is "synthetic". A folder named twice is drawn from twice as often, and held out
            once. Photographed hands are put before the backgrounds and on the people of the cached frames named beside.

    Returns:
        (training, validation); the validation pictures come from the end of every source, at most a tenth of it, and
        share no frame with the training pictures. Those of photographed digits show the people that `Digits` holds out.

    Raises:
        InputError: no such source, it is empty, or there are backgrounds for pictures that all have theirs.
        DataFormatError: the folder is damaged or not finished.
    """
    if spec.source == SYNTHETIC:
        return split(_synthetic(spec), spec.validation)
    names = [name.strip() for name in spec.source.split(",")]
    folders = dict.fromkeys(names)
    share, behind = spec.validation // len(folders), cache(lambda: backgrounds_of(spec))
    digits = [name for name in folders if Digits.is_at(name)]
    opened = {name: _open_folder(name, spec, share, behind) for name in folders if name not in digits}
    frames = [parts for name, parts in opened.items() if _is_cache(Path(name))]
    if spec.backgrounds and not (frames or digits):
        raise InputError(
            f"backgrounds '{spec.backgrounds}' go behind cached frames, photographed digits and '{SYNTHETIC}' pictures "
            f"alone, not behind those of {', '.join(folders)}: leave them out"
        )
    for name in digits:
        opened[name] = _open_digits(Path(name), spec, share, behind(), frames)
    training = tuple(opened[name][0] for name in names)
    return Joined(training), Joined(tuple(opened[name][1] for name in folders))


def _open_folder(
    name: str, spec: DataConfig, validation: int, behind: Callable[[], Backgrounds]
) -> tuple[SampleSource, SampleSource]:
    """Training and held-out pictures of one folder; all folders share the backgrounds, which keep decoded pictures."""
    folder = Path(name)
    if not name or not folder.is_dir():
        raise InputError(f"training data '{name}': expected a folder or '{SYNTHETIC}'")

    if _is_cache(folder):
        from twohands.synth.sets.cache import FrameCache

        backgrounds = behind()
        frames = len(FrameCache(folder).indices)
        cut = frames - min(validation, frames // 10)
        return (
            FrameCache(folder, backgrounds, (0, cut), variants=spec.variants, empty_rate=spec.empty),
            FrameCache(folder, backgrounds, (cut, frames)),
        )

    from twohands.datasets.shards import open_ego3dhands
    from twohands.formats import ego3dhands as fmt

    return split(open_ego3dhands(folder).leaving_out({fmt.DEPTH_FILE}), validation)


def _open_digits(
    folder: Path,
    spec: DataConfig,
    validation: int,
    backgrounds: Backgrounds,
    frames: Sequence[tuple[SampleSource, SampleSource]],
) -> tuple[SampleSource, SampleSource]:
    """Training and held-out pictures of photographed hands, before training and held-out people."""
    from twohands.synth.sets.cache import FrameCache
    from twohands.training.cutouts import CutoutScenes

    def scenes(part: Literal["training", "held-out"], people: Sequence[SampleSource], variants: int) -> CutoutScenes:
        caches = [source for source in people if isinstance(source, FrameCache) and len(source)]
        return CutoutScenes(Digits(folder, part), backgrounds, caches, seed=spec.seed, variants=variants)

    training = scenes("training", [shown for shown, _ in frames], spec.variants)
    held_out = scenes("held-out", [kept for _, kept in frames], 1)
    return training, Picked.evenly(held_out, min(validation, len(held_out)))


def _is_cache(folder: Path) -> bool:
    """Whether a folder holds cached frames."""
    from twohands.synth.sets.cache import FrameCache

    return FrameCache.is_cache(folder)


def split(source: SampleSource, validation: int) -> tuple[IndexRange, IndexRange]:
    """Cut a source in two: everything before, and the last `validation` pictures, at most a tenth of all."""
    total = len(source)
    cut = total - min(validation, total // 10)
    return IndexRange(source, 0, cut), IndexRange(source, cut, total)


def _synthetic(spec: DataConfig) -> SampleSource:
    from twohands.synth.scene.config import SynthConfig
    from twohands.synth.sets.seeds import stream_seed
    from twohands.synth.sets.stream import SyntheticStream

    width, height = SYNTHETIC_FRAME
    config, seed = SynthConfig(width=width, height=height), stream_seed(spec.seed, "stream")
    return SyntheticStream(config, seed, SYNTHETIC_SIZE, backgrounds_of(spec))


def backgrounds_of(spec: DataConfig) -> Backgrounds:
    """What to put behind rendered hands."""
    from twohands.synth.backgrounds.base import MixedBackgrounds
    from twohands.synth.backgrounds.clutter import ClutteredBackgrounds
    from twohands.synth.backgrounds.photographs import BackgroundFolder
    from twohands.synth.backgrounds.procedural import ProceduralBackgrounds
    from twohands.synth.backgrounds.remix import RemixedBackgrounds
    from twohands.synth.backgrounds.rooms import RoomBackgrounds

    backgrounds: Backgrounds = MixedBackgrounds((ProceduralBackgrounds(), RoomBackgrounds()), (0.5, 0.5))
    folders = [BackgroundFolder(Path(name.strip())) for name in spec.backgrounds.split(",") if name.strip()]
    if folders:
        share = (1 - spec.procedural) / len(folders)
        backgrounds = MixedBackgrounds((*folders, backgrounds), (*[share] * len(folders), spec.procedural))
    if spec.remixed:
        backgrounds = RemixedBackgrounds(backgrounds, spec.remixed)
    return ClutteredBackgrounds(backgrounds, spec.clutter) if spec.clutter else backgrounds
