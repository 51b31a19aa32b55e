"""Sequences of whole people in motion, for `sets.sequences`: the camera stands still, and so does the room."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Final

import cv2
import numpy as np

from twohands.skeleton import LEFT, RIGHT
from twohands.synth.backgrounds.base import Background
from twohands.synth.backgrounds.behind import room_behind
from twohands.synth.backgrounds.clip_sources import ClipSource
from twohands.synth.backgrounds.clips import Clip, open_clip
from twohands.synth.backgrounds.panoramas import Surroundings
from twohands.synth.render.sensor import sample_webcam
from twohands.synth.scene.body import bone
from twohands.synth.scene.config import SynthConfig
from twohands.synth.scene.fabrics import FabricFolder
from twohands.synth.scene.motion import MotionConfig
from twohands.synth.scene.people_motion import PeopleMotion, plan_people_motion
from twohands.synth.scene.spec import ArmMotion, SceneSpec, moved, viewed
from twohands.synth.scene.views import quarter_turns
from twohands.synth.scene.whole_people import (
    furniture_of,
    sample_people_lighting,
    sample_setting,
    sample_subject,
    worn_on_arms,
)
from twohands.synth.sets.seeds import sequence_rng
from twohands.types import PinholeCamera

EXPOSURE_S: Final = (1 / 250, 1 / 30)
"""For how long the shutter is open, and at most half of the time from frame to frame."""


class PeopleSequence:
    """One sequence of whole people: who is there, and how the first one's arms move.

    Args:
        config: distributions of the scene.
        motion: of the motion.
        seed: what the random numbers of the set come from.
        index: of the sequence.
        frames, fps: of the set.
        fabrics: the user's, for what the first person wears; generated ones if None.

    Raises:
        InputError: no camera of this configuration sees a hand.
    """

    def __init__(
        self,
        config: SynthConfig,
        motion: MotionConfig,
        seed: int,
        index: int,
        frames: int,
        fps: float,
        fabrics: FabricFolder | None,
    ) -> None:
        self.config, self.seed, self.index, self.frames, self.fps = config, seed, index, frames, fps
        self._motion_config = motion
        rng = sequence_rng(seed, index, "people")
        subject, self._first = sample_subject(config, False, rng)
        lighting = sample_people_lighting(config, subject.viewpoint, rng)
        look_rng, others_rng = rng.spawn(2)
        own = sequence_rng(seed, index, "fabric")
        self.setting = sample_setting(config, subject, lighting, fabrics, own, look_rng, others_rng)
        rng = sequence_rng(seed, index, "camera")
        self.takes_background_light = bool(rng.random() < config.background_light)
        self.sensor = sample_webcam(config.sensor, rng)
        self.exposure_s = min(float(np.exp(rng.uniform(*np.log(EXPOSURE_S)))), 0.5 / fps)

    @cached_property
    def motion(self) -> PeopleMotion:
        """Planned when first needed."""
        rng = sequence_rng(self.seed, self.index, "motion")
        seconds = self.frames / self.fps
        return plan_people_motion(self.config, self._motion_config, self.setting.subject, self._first, seconds, rng)

    def scene(self, frame: int) -> SceneSpec:
        """What to render for one frame; nothing has to be rendered before it.

        Raises:
            IndexError: there is no such frame.
        """
        if not 0 <= frame < self.frames:
            raise IndexError(f"frame {frame} of {self.frames}")
        time, half = frame / self.fps, self.exposure_s / 2
        arms = self.motion.at(time)
        scene = self.setting.scene(arms, frame)
        ends = [viewed(scene.view, self.motion.at(time + step).transforms) for step in (-half, half)]
        things_rng, worn_rng = sequence_rng(self.seed, self.index, "things").spawn(2)
        things = furniture_of(self.setting.subject.posture, things_rng)
        worn = worn_on_arms(self.config, self.setting, arms, worn_rng)
        left, right = (self._turned(side, scene, *ends) for side in (LEFT, RIGHT))
        return replace(scene, things=(*things, *worn), motion=(left, right))

    def _turned(self, side: int, scene: SceneSpec, before: np.ndarray, after: np.ndarray) -> ArmMotion:
        """How an arm turns during the exposure, the bones' transforms (48, 3, 4) before and after it."""
        upper, lower = bone("upperarm01", side), bone("lowerarm01", side)
        swing, both = (cv2.Rodrigues(after[own, :, :3] @ before[own, :, :3].T)[0][:, 0] for own in (upper, lower))
        shoulder = moved(scene.transforms[upper], self.setting.subject.person.anatomy[side].shoulder) * scene.scale
        return ArmMotion(shoulder, swing, both - swing)

    def clip(self, source: ClipSource) -> Clip:
        """The room.

        Raises:
            InputError: the source cannot be read.
        """
        rng = sequence_rng(self.seed, self.index, "clip")
        subject = self.setting.subject
        return _Standing(room_behind(_Beginning(source), rng, subject.viewpoint.camera, quarter_turns(subject.view)))


class _Beginning:
    """The first frame of a clip as a source of backgrounds."""

    unreadable = ()

    def __init__(self, source: ClipSource) -> None:
        self.source, self.name = source, str(source.path)

    def sample(self, rng: np.random.Generator, camera: PinholeCamera) -> Background:
        """See `Backgrounds.sample`."""
        clip = open_clip(self.source, rng, 1, 1.0, camera)
        return Background(clip.frame(0), clip.surroundings(0))


class _Standing:
    """A clip in which nothing moves."""

    def __init__(self, background: Background) -> None:
        self.background = background

    def frame(self, index: int) -> np.ndarray:
        """See `Clip.frame`."""
        return self.background.picture

    def surroundings(self, index: int) -> Surroundings | None:
        """See `Clip.surroundings`."""
        return self.background.surroundings
