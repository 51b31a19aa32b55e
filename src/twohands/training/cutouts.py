"""Pictures made of photographed hands: cut out, changed, and put before grounds and on rendered people's arms.

Real hands are photographed before white paper, upright, in full light. Here they are mirrored for left hands, turned,
dimmed, tinted, lit from a side, blurred, shrunk and enlarged. A hand never ends in the air: it takes the place of a
rendered hand on its arm, or has a forearm, bare or sleeved, that leaves the picture. Ours; the paper knows no real
hands in training.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property, lru_cache

import cv2
import numpy as np

from twohands.datasets.cutting import CutOut, cut_out
from twohands.datasets.digits import Digits
from twohands.errors import InputError
from twohands.skeleton import LEFT, RIGHT, part_label
from twohands.synth.backgrounds.base import Backgrounds
from twohands.synth.render.sensor import expose, sample_sensor, sample_webcam
from twohands.synth.sets.cache import FrameCache, StoredFrame
from twohands.training.arms import cloth_strip
from twohands.training.pasting import Picture, draw_hand_and_arm, free_look, free_place, label_hand, palm_middle, paste
from twohands.training.seats import Seat, matched_look, parts_of, rendered_picture, seat_of, without
from twohands.types import HandSample, PinholeCamera

SIZES = ((640, 360), (640, 360), (640, 480), (480, 480), (360, 640))
"""Width and height of pictures without rendered people."""
FOV_DEG = (40.0, 100.0)
"""Range of their cameras' field of view along the longer side: that of the photographs is unknown."""
BEFORE_PEOPLE = 0.65
"""Share of pictures with a rendered person in them, where there are frames."""
ON_ARMS = 0.7
"""Share of these in which photographed hands take the places of rendered ones."""
BOTH = 0.45
"""Share of pictures of both hands, among those whose hands have arms of their own."""
SAME_PERSON = 0.75
"""Share of second hands that are another picture of the first one's owner."""
EXTENT_PX = (20.0, 300.0)
"""Range of the larger side of a hand's box, even in the logarithm, in a picture 640 pixels wide."""
MOST_TAKEN = 0.02
"""An arm that covers more of the picture than this is not taken away for a photographed hand with another arm: too much
of what it hides, perhaps a face, would have to be made up."""
ONE_OF_TWO = 0.25
"""Share of people with two hands of whom one hand alone is replaced."""
OWN_COLOUR = 0.3
"""Share of people whose new hands keep half of their own colour: their arms have another."""
AS_LARGE = 0.7
"""Share of hands before people that are about as large as these people's own."""
PALMS = 2.2
"""Larger side of a hand's box over the distance from wrist to middle knuckle."""
WEBCAMS = 0.5
"""Share of pictures with a webcam's faults; the others have any camera's."""
SENSOR = (0.2, 1.0)
"""Range of the strength of the camera's faults (`synth.render.sensor`)."""


class CutoutScenes:
    """Photographed hands in other places; item `i` is a pure function of (photographs, seed, i).

    Part labels tell arm and hand apart, not the fingers: all of a photographed hand is labelled as palm. Its joints in
    2D are our skeleton's, `HandSample.confidence` says how much they count; nothing is known in 3D. Where a rendered
    hand is left in a picture, it has all its labels.

    Args:
        hands: the photographs.
        backgrounds: what is behind hands and people.
        frames: rendered people; none if empty.
        seed: of all that is random.
        variants: how many pictures a photograph gives.

    Raises:
        InputError: none of the photographs can be used.
    """

    def __init__(
        self,
        hands: Digits,
        backgrounds: Backgrounds,
        frames: Sequence[FrameCache] = (),
        *,
        seed: int = 0,
        variants: int = 1,
    ) -> None:
        if not len(hands):
            raise InputError(f"{hands.root}: no photograph of the part '{hands.part}'")
        self.hands, self.backgrounds, self.frames = hands, backgrounds, tuple(frames)
        self.seed, self.variants = seed, variants
        self.name = f"{hands.name} cut out"

    def __len__(self) -> int:
        return len(self.hands) * self.variants

    def __getitem__(self, index: int) -> HandSample:
        if not 0 <= index < len(self):
            raise IndexError(f"sample {index} of {len(self)}")
        rng = np.random.default_rng([self.seed, int(self.hands.part == "training"), index])
        number = index % len(self.hands)
        if self.frames and rng.random() < BEFORE_PEOPLE:
            picture = self._with_person(number, rng)
        else:
            picture = self._without_person(number, rng)
        sensor = (sample_webcam if rng.random() < WEBCAMS else sample_sensor)(rng.uniform(*SENSOR), rng)
        return picture.sample(expose(picture.image, sensor, rng), f"{self.name} #{index}")

    def __getstate__(self) -> dict[str, object]:
        return {key: value for key, value in self.__dict__.items() if key != "_cut"}

    @cached_property
    def _cut(self) -> Callable[[int], tuple[CutOut, np.ndarray]]:
        """Cut-outs by number, kept once made."""

        def cut(number: int) -> tuple[CutOut, np.ndarray]:
            sample = self.hands[number]
            assert sample.confidence is not None
            return cut_out(sample.image, sample.joints_px[RIGHT]), sample.confidence[RIGHT]

        return lru_cache(maxsize=None)(cut)

    def _hand(self, number: int) -> tuple[CutOut, np.ndarray]:
        """The first photograph from a number on that can be used, and its labels' confidence (21,)."""
        for ahead in range(len(self.hands)):
            cut, confidence = self._cut((number + ahead) % len(self.hands))
            if not cut.flaw:
                return cut, confidence * cut.on_hand
        raise InputError(f"{self.hands.root}: none of the hands can be cut out")

    def _hand_of_same(self, number: int, rng: np.random.Generator) -> tuple[CutOut, np.ndarray]:
        """Another hand, mostly of the same person."""
        persons = self.hands.persons
        others = np.flatnonzero(persons == persons[number]) if rng.random() < SAME_PERSON else np.arange(len(persons))
        return self._hand(int(rng.choice(others)))

    def _without_person(self, number: int, rng: np.random.Generator) -> Picture:
        width, height = SIZES[rng.integers(len(SIZES))]
        focal = max(width, height) / 2 / math.tan(math.radians(rng.uniform(*FOV_DEG)) / 2)
        camera = PinholeCamera(focal, focal, width / 2, height / 2, width, height)
        picture = Picture(self.backgrounds.sample(rng, camera).picture.copy(), camera)
        self._add_with_arms(picture, number, (LEFT, RIGHT), rng)
        return picture

    def _with_person(self, number: int, rng: np.random.Generator) -> Picture:
        frames = self.frames[rng.integers(len(self.frames))]
        frame, camera = frames.stored(int(rng.integers(len(frames.indices))))
        frame = replace(frame, rgb=frame.relit(rng))
        background = frame.behind(self.backgrounds, rng, camera)
        places = [seat for side in (LEFT, RIGHT) if (seat := seat_of(frame, camera, side)) is not None]
        arms = [cv2.countNonZero(parts_of(frame.labels, [side], 0).astype(np.uint8)) for side in (LEFT, RIGHT)]
        free = [side for side in (LEFT, RIGHT) if arms[side] <= MOST_TAKEN * frame.labels.size]
        if places and (rng.random() < ON_ARMS or not free):
            return self._on_arms(frame, camera, background, places, number, rng)
        if not free:
            return self._without_person(number, rng)
        taken = free if rng.random() < 0.5 else free[-1:]
        gone = parts_of(frame.labels, taken, 0)
        kept = [side for side in (LEFT, RIGHT) if side not in taken]
        picture = rendered_picture(without(frame, gone), camera, background, kept)
        own_size = places and rng.random() < AS_LARGE
        palm_px = float(np.mean([seat.palm_px for seat in places])) if own_size else None
        self._add_with_arms(picture, number, taken, rng, palm_px)
        return picture

    def _add_with_arms(
        self,
        picture: Picture,
        number: int,
        sides: Sequence[int],
        rng: np.random.Generator,
        palm_px: float | None = None,
    ) -> None:
        """Lays one or both of the given hands into a picture, each with an arm that leaves it; about as large as a hand
        whose wrist is `palm_px` from its middle knuckle, or of any size."""
        order = [sides[i] for i in rng.permutation(len(sides))][: 2 if rng.random() < BOTH else 1]
        extent = math.exp(rng.uniform(*np.log(EXTENT_PX))) * picture.camera.width / 640
        if palm_px is not None:
            extent = PALMS * palm_px * math.exp(rng.normal(0, 0.3))
        extent = float(np.clip(extent, EXTENT_PX[0], 0.85 * min(picture.labels.shape)))
        look, sleeve = free_look(extent, rng), cloth_strip(rng)
        kind = rng.random()
        before: np.ndarray | None = None
        for i, side in enumerate(order):
            cut, confidence = self._hand(number) if i == 0 else self._hand_of_same(number, rng)
            place = free_place(cut, side, extent * math.exp(rng.normal(0, 0.1)), picture.labels.shape, before, rng)
            before = place.points(palm_middle(cut))
            draw_hand_and_arm(picture, cut, place, look, sleeve, kind, rng)
            label_hand(picture, cut, place, confidence)

    def _on_arms(
        self,
        frame: StoredFrame,
        camera: PinholeCamera,
        background: np.ndarray,
        places: Sequence[Seat],
        number: int,
        rng: np.random.Generator,
    ) -> Picture:
        """The rendered person, one or both of its hands replaced."""
        if len(places) > 1 and rng.random() < ONE_OF_TWO:
            places = [places[int(rng.integers(2))]]
        gone = parts_of(frame.labels, [seat.side for seat in places], 1)
        kept = [side for side in (LEFT, RIGHT) if side not in {seat.side for seat in places}]
        picture = rendered_picture(without(frame, gone), camera, background, kept)
        natural = rng.random() < OWN_COLOUR
        for i, seat in enumerate(places):
            cut, confidence = self._hand(number) if i == 0 else self._hand_of_same(number, rng)
            place = seat.place(cut, rng)
            look = matched_look(cut, seat, natural, place.scale, rng)
            under = picture.labels == part_label(seat.side, 0) if seat.sleeved else None
            paste(picture, cut, place, look, fade=not seat.sleeved, under=under)
            label_hand(picture, cut, place, confidence)
        return picture
