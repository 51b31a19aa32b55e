"""Somebody ready to be posed, and how they sit or stand."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from twohands.skeleton import LEFT, RIGHT
from twohands.synth.scene.body import Body
from twohands.synth.scene.outline import Outline
from twohands.synth.scene.people import BODY_BONES, body_bone, body_transforms, load_people
from twohands.synth.scene.pose import ArmAnatomy, rotation_about
from twohands.synth.scene.views import Viewpoint
from twohands.synth.scene.wardrobe import Someone

CLOTH_M: Final = 0.014
"""Thickness of what is worn, for the outline."""
SEATED: Final = {"webcam": 0.8, "selfie": 0.3, "room": 0.35, "shoulder": 0.9, "above": 1.0}
WITH_TABLE: Final = {"webcam": 0.35, "selfie": 0.1, "room": 0.3, "shoulder": 0.8, "above": 1.0}
"""Shares of people who sit, and of those at a table, by the style of the view."""
LOWEST_OVER_TABLE_M: Final = 0.3
"""A camera farther below the eyes would look at the table from beneath."""
X, Y, Z = np.eye(3)
"""Axes of the person's frame."""


@dataclass(frozen=True, eq=False)
class Figure:
    """Somebody ready to be posed.

    Attributes:
        someone: who.
        body: their arms at rest.
        anatomy: (LEFT, RIGHT).
        heads: (28, 3) of the body's bones at rest.
        outline: of the naked, standing body with some cloth.
    """

    someone: Someone
    body: Body
    anatomy: tuple[ArmAnatomy, ArmAnatomy]
    heads: np.ndarray
    outline: Outline


@dataclass(frozen=True, slots=True, eq=False)
class Posture:
    """How somebody sits or stands.

    Attributes:
        turns: (28, 3, 3) of the body's bones.
        lean: (3, 3) rotation from the person's frame to axes with gravity along y.
        seated: whether they sit.
        table_y: how far below the eyes a table is; None without one.
    """

    turns: np.ndarray
    lean: np.ndarray
    seated: bool
    table_y: float | None


@lru_cache(maxsize=1)
def _trunk_rows() -> np.ndarray:
    """Rows of the asset's points on the skin of trunk, head and legs."""
    asset = load_people()
    skin = np.unique(asset.skin_source)
    return skin[asset.weights[skin][:, len(BODY_BONES) :].sum(1) < 0.5]


def figure(someone: Someone) -> Figure:
    """The person, ready to be posed."""
    asset = load_people()
    body = asset.arms_body(someone.shape)
    anatomy = ArmAnatomy(body, LEFT), ArmAnatomy(body, RIGHT)
    skin = asset.points(someone.shape)[_trunk_rows()]
    return Figure(someone, body, anatomy, asset.heads(someone.shape), Outline.of(skin, CLOTH_M))


def sample_posture(view: Viewpoint, rng: np.random.Generator) -> Posture:
    """Sits or stands as the view makes likely, leans a little, turns and tilts the head."""
    seated = bool(rng.random() < SEATED[view.style])
    at_table = seated and rng.random() < WITH_TABLE[view.style] and view.place[1] < LOWEST_OVER_TABLE_M
    lean, aside = np.radians(rng.normal(-4 if seated else 0, 7 if seated else 4)), np.radians(rng.normal(0, 3))
    turns = np.tile(np.eye(3), (len(BODY_BONES), 1, 1))
    nod, turn, tilt = np.radians(rng.normal([-25 if view.style == "above" else -3, 0, 0], [8, 12, 6]))
    if view.style in ("webcam", "selfie", "room") and view.place[2] > 0 and rng.random() < 0.65:  # into the lens
        turn += 0.8 * np.clip(np.arctan2(view.place[0], view.place[2]), -0.7, 0.7)
        nod -= 0.6 * np.clip(np.arctan2(view.place[1], np.hypot(view.place[0], view.place[2])), -0.5, 0.5) + lean
    for name, share in (("neck01", 0.2), ("neck03", 0.3), ("head", 0.5)):
        turns[body_bone(name)] = (
            rotation_about(Y, share * turn) @ rotation_about(X, share * nod) @ rotation_about(Z, share * tilt)
        )
    # The chest stays; what is below it turns against it, so that hips and legs keep to gravity.
    bend = 0.6 * lean
    for name in ("spine02", "spine03", "spine04"):
        turns[body_bone(name)] = rotation_about(X, bend / 3) @ rotation_about(Z, 0.25 * aside)
    thigh = np.radians(rng.uniform(78, 92) if seated else 0.0) - 0.4 * lean
    for letter, sign in (("L", -1), ("R", 1)):
        spread = np.radians(rng.uniform(0, 14 if seated else 3)) * sign
        turns[body_bone(f"upperleg01.{letter}")] = rotation_about(Y, spread if seated else 0.0) @ rotation_about(
            X, thigh
        )
        turns[body_bone(f"lowerleg01.{letter}")] = rotation_about(
            X, -np.radians(rng.uniform(70, 100)) if seated else 0.0
        )
    table = rng.uniform(0.40, 0.5) if at_table else None
    return Posture(turns, rotation_about(X, lean) @ rotation_about(Z, aside), seated, table)


def outline_of(person: Figure, posture: Posture) -> Outline:
    """The body's, with the thighs of who sits."""
    if not posture.seated:
        return person.outline
    transforms = body_transforms(person.heads, posture.turns)
    ends = [[body_bone(f"{name}.{letter}") for name in ("upperleg01", "lowerleg01")] for letter in "LR"]
    thighs = (transforms[ends][..., :3] @ person.heads[ends][..., None])[..., 0] + transforms[ends][..., 3]
    return dataclasses.replace(person.outline, thighs=thighs)
