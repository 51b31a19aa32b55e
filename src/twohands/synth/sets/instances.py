"""The scene of one instance of a set: a pure function of (config, seed, index)."""

from __future__ import annotations

from dataclasses import replace

from twohands.errors import InputError
from twohands.synth.render.choice import RendererName
from twohands.synth.scene.config import SynthConfig
from twohands.synth.scene.fabrics import FabricFolder
from twohands.synth.scene.sampling import draw_scene
from twohands.synth.scene.spec import SceneSpec
from twohands.synth.scene.whole_people import draw_people
from twohands.synth.sets.seeds import instance_rng


def check_drawn(config: SynthConfig, renderer: RendererName) -> None:
    """See whether the renderer draws what is asked for.

    Raises:
        InputError: Blender is to draw whole people.
    """
    if config.people > 0 and renderer == "blender":
        raise InputError("Blender draws no whole people: set --config.people 0, or take --renderer raster")


def arms_alone(config: SynthConfig) -> SynthConfig:
    """Of scenes of arms beside those of whole people, which are the ones seen from in front."""
    return replace(config, webcam=0.0, free_view=0.0)


def sample_scene(config: SynthConfig, seed: int, index: int, fabrics: FabricFolder | None = None) -> SceneSpec:
    """One random instance: of whole people in the share `config.people`, else of two arms.

    Args:
        config: distributions.
        seed: of the whole set.
        index: of the instance; the same (config, seed, index) gives the same scene anywhere.
        fabrics: for clothes; generated ones if None. Nothing else depends on them.

    Returns:
        The scene.

    Raises:
        InputError: the hand box cannot be reached or seen with this configuration.
    """
    if config.people > 0:
        if instance_rng(seed, index, "kind").random() < config.people:
            own = instance_rng(seed, index, "people")
            return draw_people(config, index, own, fabrics, instance_rng(seed, index, "fabric"))
        config = arms_alone(config)
    return draw_scene(config, index, instance_rng(seed, index), fabrics, instance_rng(seed, index, "fabric"))
