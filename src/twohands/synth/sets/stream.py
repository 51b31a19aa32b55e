"""The generator as an endless labelled data set: scenes are rendered when they are asked for, nothing touches disk."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property, lru_cache

import numpy as np

from twohands.geometry.camera import project
from twohands.synth.backgrounds.base import Background, Backgrounds
from twohands.synth.backgrounds.behind import room_behind
from twohands.synth.backgrounds.procedural import ProceduralBackgrounds
from twohands.synth.render.choice import Renderer, RendererName, open_renderer
from twohands.synth.render.compositing import compose_frame
from twohands.synth.render.lighting import lit_by, lit_inside
from twohands.synth.render.sensor import expose, sample_sensor, sample_webcam
from twohands.synth.scene.config import SynthConfig
from twohands.synth.scene.fabrics import FabricFolder
from twohands.synth.scene.views import quarter_turns
from twohands.synth.sets.instances import check_drawn, sample_scene
from twohands.synth.sets.presence import taken
from twohands.synth.sets.seeds import instance_rng
from twohands.types import HandSample, PinholeCamera, RenderedFrame


class SyntheticStream:
    """Instances of one set; item `i` is a pure function of (config, seed, i), in any process.

    Args:
        config: distributions; its width and height are the image size.
        seed: of the set.
        size: number of instances.
        backgrounds: source of backgrounds; procedural if None.
        renderer_name: who draws.
        fabrics: for sleeves and gloves.

    Raises:
        InputError: Blender is to draw whole people.

    Raises (on the first item):
        MissingExtraError, RendererError: no renderer on this machine.
    """

    def __init__(
        self,
        config: SynthConfig,
        seed: int,
        size: int,
        backgrounds: Backgrounds | None = None,
        renderer_name: RendererName = "raster",
        fabrics: FabricFolder | None = None,
    ) -> None:
        check_drawn(config, renderer_name)
        self.config, self.seed, self.size = config, seed, size
        self.renderer_name: RendererName = renderer_name
        self.backgrounds = backgrounds or ProceduralBackgrounds()
        self.fabrics = fabrics
        self.name = f"synthetic seed {seed}"

    @cached_property
    def renderer(self) -> Renderer:
        """One per process, made when first needed."""
        return open_renderer(self.renderer_name, self.config.width, self.config.height)

    @property
    def unreadable(self) -> tuple[str, ...]:
        """A line for every picture of the user's that was skipped so far."""
        return (*self.backgrounds.unreadable, *(self.fabrics.unreadable if self.fabrics else ()))

    def __getstate__(self) -> dict[str, object]:
        return {key: value for key, value in self.__dict__.items() if key not in ("renderer", "_background")}

    def __len__(self) -> int:
        return self.size

    def frame(self, index: int) -> RenderedFrame:
        """Instance `index` before compositing."""
        if not 0 <= index < self.size:
            raise IndexError(f"instance {index} of {self.size}")
        scene = sample_scene(self.config, self.seed, index, self.fabrics)
        turns = quarter_turns(scene.view) if scene.people else None
        if instance_rng(self.seed, index, "light").random() < self.config.background_light:
            behind = self.background(index, scene.camera, turns)
            if behind.surroundings is None:
                lighting = lit_by(scene.lighting, behind.picture, scene.camera)
            else:
                lighting = lit_inside(scene.lighting, behind.surroundings)
            scene = replace(scene, lighting=lighting)
        frame = self.renderer.render(scene)
        if self.config.amodal:
            frame = replace(frame, amodal=self.renderer.amodal(scene))
        return taken(frame, scene)

    def background(self, index: int, camera: PinholeCamera, turns: int | None = None) -> Background:
        """Background of instance `index`, whose camera that is; `turns` as of `RenderedFrame`."""
        return self._background(index, camera, turns)

    @cached_property
    def _background(self) -> Callable[[int, PinholeCamera, int | None], Background]:
        """Keeps the last one: it gives light, then stands behind the hands."""

        def sample(index: int, camera: PinholeCamera, turns: int | None) -> Background:
            rng = instance_rng(self.seed, index, "background")
            if turns is None:
                return self.backgrounds.sample(rng, camera)
            return room_behind(self.backgrounds, rng, camera, turns)

        return lru_cache(maxsize=1)(sample)

    def picture(self, index: int, frame: RenderedFrame) -> np.ndarray:
        """(H, W, 3) uint8, the frame of instance `index` on its background, as its camera takes it."""
        rng = instance_rng(self.seed, index, "sensor")
        sensor = (sample_sensor if frame.turns is None else sample_webcam)(self.config.sensor, rng)
        return expose(compose_frame(frame, self.background(index, frame.camera, frame.turns).picture), sensor, rng)

    def __getitem__(self, index: int) -> HandSample:
        frame = self.frame(index)
        return replace(hand_sample(frame, f"{self.name} #{index}"), image=self.picture(index, frame))


def labelled(joints_m: np.ndarray, present: np.ndarray) -> np.ndarray:
    """(2, 21) bool: joints (2, 21, 3) of present hands that are in front of the camera, so that they have a place in
    its picture plane."""
    return present[:, None] & (np.nan_to_num(joints_m[..., 2]) > 0.01)


def hand_sample(frame: RenderedFrame, source: str) -> HandSample:
    """The labels of a frame; its image is the hands on black."""
    joints = frame.joints_m[:, 1:]
    present = frame.present
    return HandSample(
        image=frame.rgb,
        camera=frame.camera,
        present=present,
        joints_px=project(joints, frame.camera),
        joints_m=joints,
        valid=labelled(joints, present),
        labels=frame.part_labels,
        depth_m=frame.depth_m,
        source=source,
    )
