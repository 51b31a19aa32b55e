"""What the hands of people are to do: how often each gesture is made, by how somebody sits or stands."""

from __future__ import annotations

from typing import Final

import numpy as np

from twohands.skeleton import LEFT
from twohands.synth.scene import gestures, pair_gestures
from twohands.synth.scene.figures import Posture
from twohands.synth.scene.gestures import Gesture
from twohands.synth.scene.pair_gestures import Pair
from twohands.synth.scene.views import Viewpoint

SHOWING: Final[tuple[tuple[Gesture, float], ...]] = (
    (gestures.shown, 0.26),
    (gestures.open_palm, 0.09),
    (gestures.signing, 0.2),
    (gestures.talking, 0.09),
    (gestures.pointing, 0.07),
    (gestures.thumb_up, 0.06),
    (gestures.at_face, 0.08),
    (gestures.chin_rest, 0.03),
    (gestures.at_ear, 0.03),
    (gestures.at_head, 0.02),
    (gestures.on_chest, 0.03),
    (gestures.holding, 0.05),
    (gestures.holding_flat, 0.03),
    (gestures.reading_phone, 0.04),
)
AT_TABLE: Final[tuple[tuple[Gesture, float], ...]] = (
    (gestures.on_table, 0.5),
    (gestures.writing, 0.16),
    (gestures.holding, 0.12),
    (gestures.reading_phone, 0.08),
    (gestures.holding_flat, 0.06),
    (gestures.talking, 0.08),
)
STANDING: Final[tuple[tuple[Gesture, float], ...]] = (
    (gestures.hanging, 0.6),
    (gestures.in_pocket, 0.12),
    (gestures.behind_back, 0.12),
    (gestures.on_hip, 0.1),
    (gestures.on_chest, 0.06),
)
SITTING: Final[tuple[tuple[Gesture, float], ...]] = (
    (gestures.on_lap, 0.45),
    (gestures.reaching_down, 0.4),
    (gestures.hanging, 0.15),
)
TOGETHER: Final[tuple[tuple[Pair, float], ...]] = (
    (pair_gestures.praying, 0.13),
    (pair_gestures.clapping, 0.14),
    (pair_gestures.clasped, 0.16),
    (pair_gestures.steepled, 0.08),
    (pair_gestures.stacked, 0.13),
    (pair_gestures.framing, 0.14),
    (pair_gestures.folded, 0.09),
    (pair_gestures.both_at_face, 0.05),
    (pair_gestures.holding_between, 0.08),
)
MOVABLE: Final = frozenset(
    gesture.__name__
    for gesture in (
        *(gestures.shown, gestures.open_palm, gestures.signing, gestures.talking, gestures.pointing, gestures.thumb_up),
        *(pair_gestures.clapping, pair_gestures.framing, gestures.hanging, gestures.at_face, pair_gestures.stacked),
    )
)
"""Names of gestures in which arms may move."""


def choose(rng: np.random.Generator, options: tuple[tuple[Gesture, float], ...]) -> Gesture:
    """One of the gestures, as often as its weight says."""
    weights = np.array([weight for _, weight in options])
    return options[int(rng.choice(len(options), p=weights / weights.sum()))][0]


def sample_plan(
    viewpoint: Viewpoint, posture: Posture, handless: bool, rng: np.random.Generator
) -> tuple[tuple[Gesture, Gesture] | Pair, tuple[bool, bool]]:
    """What the hands are to do, and which of them must be seen."""
    resting = SITTING if posture.seated else STANDING
    if viewpoint.side >= 0:
        own = choose(rng, resting if handless else SHOWING)
        holds = gestures.holds_camera
        if viewpoint.side == LEFT:
            return (holds, own), (False, not handless)
        return (own, holds), (not handless, False)
    if handless:
        return (choose(rng, resting), choose(rng, resting)), (False, False)
    table = posture.table_y is not None and (viewpoint.style in ("above", "shoulder") or rng.random() < 0.35)
    if rng.random() < 0.32:
        pairs = np.array([weight for _, weight in TOGETHER])
        return TOGETHER[int(rng.choice(len(TOGETHER), p=pairs / pairs.sum()))][0], (True, True)
    options = AT_TABLE if table else SHOWING
    first = choose(rng, options)
    kind = rng.random()
    second = (
        choose(rng, options) if kind < 0.28 else first if kind < 0.42 else choose(rng, AT_TABLE if table else resting)
    )
    right = rng.random() < 0.58
    both = kind < 0.42
    return ((second, first), (both, True)) if right else ((first, second), (True, both))
