"""The dynamic set (paper section 3.2) as a production: sequences of frames.

One person, one set of lights and one background clip per sequence; only the arms and the view of the clip move. Of
whole people, in the share `config.people`, the camera stands still (`sets.people_sequences`). Frame k of sequence i is
a pure function of (config, motion, seed, i, k, frames, fps) and of the background files.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property, lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from twohands.errors import InputError
from twohands.formats.ego3dhands import instance_name
from twohands.skeleton import LEFT, RIGHT
from twohands.synth.backgrounds.clip_sources import ClipAssignment, ClipSource, assign_clips
from twohands.synth.backgrounds.clips import Clip, open_clip
from twohands.synth.production.manifest import environment
from twohands.synth.production.produce import Made
from twohands.synth.render.choice import Renderer, RendererName, open_fabrics, open_renderer, renderer_version
from twohands.synth.render.compositing import compose_frame
from twohands.synth.render.lighting import lit_by, lit_inside
from twohands.synth.render.sensor import expose, sample_sensor
from twohands.synth.scene.appearance import (
    sample_clothes,
    sample_lighting,
    sample_shape,
    sample_skin,
    sample_skin_detail,
    woven,
)
from twohands.synth.scene.body import BONES_PER_SIDE, Body, forward_kinematics, load_asset, posed_joints
from twohands.synth.scene.config import SynthConfig
from twohands.synth.scene.fabrics import FabricFolder
from twohands.synth.scene.motion import Arm, HandMotion, MotionConfig, in_picture, plan_motion
from twohands.synth.scene.pose import ArmAnatomy
from twohands.synth.scene.sampling import sample_belongings, sample_camera, worn_on_the_head
from twohands.synth.scene.spec import SceneSpec, moved, viewed
from twohands.synth.scene.things import Thing
from twohands.synth.sets.instances import arms_alone, check_drawn
from twohands.synth.sets.people_sequences import PeopleSequence
from twohands.synth.sets.presence import taken
from twohands.synth.sets.seeds import Split, instance_rng, sequence_rng, stream_seed
from twohands.synth.sets.writer import encode_instance
from twohands.types import RenderedFrame

BYTES_PER_PIXEL = 1.4
"""All files of a frame together, on the average."""


@dataclass(frozen=True)
class SequenceSet:
    """What defines a dynamic set, down to the last byte; a `produce.Production`.

    Attributes:
        config: distributions of person, light and hand box; `drop_rate` does not apply, hands leave and return.
        motion: distributions of the motion.
        seed: of the set.
        sequences: number of sequences.
        frames: frames per sequence.
        fps: frames per second.
        backgrounds: folder of videos, frames, panoramas and stills; procedural rooms if None.
        split: part of the set; no two splits share a sequence, whatever their seeds.
        renderer: who draws.
        fabrics: folder of tileable pictures for sleeves and gloves; plain and striped ones if None.
    """

    config: SynthConfig = field(default_factory=SynthConfig)
    motion: MotionConfig = field(default_factory=MotionConfig)
    seed: int = 0
    sequences: int = 100
    frames: int = 500
    fps: float = 30.0
    backgrounds: Path | None = None
    split: Split = "train"
    renderer: RendererName = "raster"
    fabrics: Path | None = None

    def __post_init__(self) -> None:
        if self.sequences < 1 or self.frames < 1:
            raise InputError(f"sequences and frames must be at least 1, got {self.sequences} and {self.frames}")
        if not 1 <= self.fps <= 1000:
            raise InputError(f"fps must lie in [1, 1000], got {self.fps}")
        check_drawn(self.config, self.renderer)

    @cached_property
    def clips(self) -> ClipAssignment:
        """The background of every sequence.

        Raises:
            InputError: the folder is missing or holds nothing that can be read.
        """
        return assign_clips(self.backgrounds, instance_rng(self.scene_seed, 0, "clips"), self.sequences)

    @cached_property
    def cloths(self) -> FabricFolder | None:
        """The user's fabrics.

        Raises:
            InputError: their folder is missing, unreadable or empty, or the renderer draws none.
        """
        return open_fabrics(self.fabrics, self.renderer)

    @property
    def scene_seed(self) -> int:
        """What the random numbers of this split of the set come from."""
        return stream_seed(self.seed, "dynamic", self.split)

    def __len__(self) -> int:
        return self.sequences * self.frames

    def instance_name(self, index: int) -> str:
        """Folder of the sequence and of the frame in it, five digits each."""
        sequence, frame = divmod(index, self.frames)
        return f"{instance_name(sequence)}/{instance_name(frame)}"

    def identity(self) -> dict[str, Any]:
        """See `produce.Production`; the number of sequences may grow."""
        return {
            "kind": "dynamic",
            "split": self.split,
            "renderer": self.renderer,
            "seed": self.seed,
            "frames": self.frames,
            "fps": self.fps,
            "backgrounds": self.clips.name,
            "fabrics": self.cloths.name if self.cloths else None,
            "config": json.loads(json.dumps(asdict(self.config))),
            "motion": json.loads(json.dumps(asdict(self.motion))),
        }

    def made_with(self) -> dict[str, str]:
        """See `produce.Production`."""
        return environment(renderer_version(self.renderer))

    def expected_bytes(self) -> int:
        """See `produce.Production`."""
        return round(BYTES_PER_PIXEL * self.config.width * self.config.height)

    def open(self) -> Callable[[int], Made]:
        """See `produce.Production`."""
        return partial(_make, SequenceRenderer(self))


class Sequence:
    """One sequence: everything that stays, and how the rest moves.

    Args:
        sequence_set: the set.
        index: of the sequence.

    Raises:
        InputError: no motion fits the hand box.
    """

    def __init__(self, sequence_set: SequenceSet, index: int) -> None:
        self.set, self.index = sequence_set, index
        config = sequence_set.config
        rng = sequence_rng(sequence_set.scene_seed, index, "look")
        self.shape = sample_shape(config, rng)
        self.skin, self.lighting = sample_skin(config, rng), sample_lighting(config, rng)
        own = sequence_rng(sequence_set.scene_seed, index, "fabric")
        self.clothes = woven(sample_clothes(config, rng), sequence_set.cloths, own)
        self.camera, self.view = sample_camera(config, rng)
        self.lighting = replace(self.lighting, positions=moved(self.view, self.lighting.positions))
        self.skin = replace(self.skin, detail=sample_skin_detail(config, rng))
        self._worn = replace(config, objects=0.0)  # what a moving hand would have to grasp and let go
        rng = sequence_rng(sequence_set.scene_seed, index, "camera")
        self.takes_background_light = bool(rng.random() < config.background_light)
        self.sensor = sample_sensor(config.sensor, rng)
        body = load_asset().body(self.shape)
        self.scale = 1.0 if config.hand_length is None else config.hand_length / body.hand_length_m
        self._body = body
        self.arms = (Arm(body, ArmAnatomy(body, LEFT)), Arm(body, ArmAnatomy(body, RIGHT)))

    def __len__(self) -> int:
        return self.set.frames

    @property
    def body(self) -> Body:
        """The person at rest."""
        return self._body

    @property
    def times(self) -> np.ndarray:
        """(frames,) seconds."""
        return np.arange(self.set.frames) / self.set.fps

    @cached_property
    def motion(self) -> tuple[HandMotion, HandMotion]:
        """(LEFT, RIGHT), planned when first needed; about a second for 500 frames.

        A camera before or beside the person would still see the upper arm of a hand that has left: there, none leaves.
        """
        settings = self.set.motion if worn_on_the_head(self.view) else replace(self.set.motion, leave_rate=0.0)
        rng = sequence_rng(self.set.scene_seed, self.index, "motion")
        return plan_motion(self.set.config, settings, self.arms, self.camera, self.view, self.times, rng)

    def scene(self, frame: int) -> SceneSpec:
        """What to render for one frame; nothing has to be rendered before it.

        A hand is present while any of its 21 joints is in the picture; an absent one is not drawn.

        Raises:
            IndexError: there is no such frame.
        """
        if not 0 <= frame < self.set.frames:
            raise IndexError(f"frame {frame} of {self.set.frames}")
        rotations = np.tile(np.eye(3), (2 * BONES_PER_SIDE, 1, 1))
        for arm, motion in zip(self.arms, self.motion, strict=True):
            posed, reached = arm.rotations(motion.states(self.times[frame : frame + 1])[0])
            if not reached:
                raise RuntimeError(f"sequence {self.index}: the wrist is out of reach in frame {frame}")
            first = arm.anatomy.first
            rotations[first : first + BONES_PER_SIDE] = posed
        transforms = forward_kinematics(self._body, rotations)
        joints = posed_joints(self._body, transforms)
        seen = moved(self.view, joints)
        present = in_picture(seen[:, 1:], self.camera)
        return SceneSpec(
            camera=self.camera,
            shape=self.shape,
            transforms=viewed(self.view, transforms),
            scale=self.scale,
            joints_m=np.where(present[:, None, None], seen * self.scale, np.nan),
            present=present,
            skin=self.skin,
            lighting=self.lighting,
            index=frame,
            view=self.view,
            clothes=self.clothes,
            things=self._things(transforms, joints, present),
        )

    def _things(self, transforms: np.ndarray, joints: np.ndarray, present: np.ndarray) -> tuple[Thing, ...]:
        """The same draws in every frame."""
        rng = sequence_rng(self.set.scene_seed, self.index, "things")
        return sample_belongings(
            self._worn, self._body, transforms, joints, present, self.view, self.skin, self.clothes, rng
        )

    def clip(self, source: ClipSource) -> Clip:
        """The background in motion.

        Raises:
            InputError: the source cannot be read.
        """
        rng = sequence_rng(self.set.scene_seed, self.index, "clip")
        return open_clip(source, rng, self.set.frames, self.set.fps, self.camera)


def open_sequence(sequence_set: SequenceSet, index: int) -> Sequence | PeopleSequence:
    """A sequence of whole people in the share `config.people`, else of two arms.

    Raises:
        InputError: no motion fits the hand box, or no camera of this configuration sees a hand.
    """
    config, seed = sequence_set.config, sequence_set.scene_seed
    if config.people > 0:
        if sequence_rng(seed, index, "kind").random() < config.people:
            motion, frames, fps = sequence_set.motion, sequence_set.frames, sequence_set.fps
            return PeopleSequence(config, motion, seed, index, frames, fps, sequence_set.cloths)
        sequence_set = replace(sequence_set, config=arms_alone(config))
    return Sequence(sequence_set, index)


class SequenceRenderer:
    """Frames of a dynamic set; keeps the last sequence at hand.

    Raises (on the first frame):
        MissingExtraError, RendererError: no renderer on this machine.
    """

    def __init__(self, sequence_set: SequenceSet) -> None:
        self.set = sequence_set
        self._opened = lru_cache(maxsize=1)(self._open)

    @cached_property
    def renderer(self) -> Renderer:
        """One per process, made when first needed."""
        return open_renderer(self.set.renderer, self.set.config.width, self.set.config.height)

    def _open(self, index: int) -> tuple[Sequence | PeopleSequence, Clip]:
        sequence = open_sequence(self.set, index)
        return sequence, sequence.clip(self.set.clips.sources[index])

    def frame(self, sequence: int, frame: int) -> tuple[RenderedFrame, np.ndarray]:
        """The hands, and (H, W, 3) uint8 the picture with its background."""
        planned, clip = self._opened(sequence)
        scene, config = planned.scene(frame), self.set.config
        if planned.takes_background_light:
            # Lamps of a panorama stay where they are while the head turns.
            around = clip.surroundings(frame)
            if around is None:
                lighting = lit_by(scene.lighting, clip.frame(0), scene.camera)
            else:
                lighting = lit_inside(scene.lighting, around)
            scene = replace(scene, lighting=lighting)
        rendered = self.renderer.render(scene)
        if config.amodal:
            rendered = replace(rendered, amodal=self.renderer.amodal(scene))
        rendered = taken(rendered, scene)
        noise = sequence_rng(self.set.scene_seed, sequence, "noise", frame)
        return rendered, expose(compose_frame(rendered, clip.frame(frame)), planned.sensor, noise)


def _make(renderer: SequenceRenderer, index: int) -> Made:
    rendered, image = renderer.frame(*divmod(index, renderer.set.frames))
    cloths = renderer.set.cloths
    return Made(encode_instance(rendered, image), tuple(cloths.unreadable) if cloths else ())
