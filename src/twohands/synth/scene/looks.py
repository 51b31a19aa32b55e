"""What one person looks like (clothes, hair, skin, eyes) and how they stand: all that a renderer needs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from twohands.synth.scene.fabrics import Fabric
from twohands.synth.scene.people import after, body_transforms, load_people

ZONES: Final = 5
"""Fabrics of a person: top, bottom, what is worn over the top, small things, shoes."""
TOP, BOTTOM, OVER, SMALL, SHOES = range(ZONES)
PLAIN, STRIPES, CHECK, PLAID, DOTS, MELANGE, DENIM, PRINT, MOTIF = range(9)
KINDS: Final = ("plain", "stripes", "check", "plaid", "dots", "melange", "denim", "print", "motif")
MOTIFS: Final = 16
"""Pictures printed on the chest."""
FULL: Final = 0.0
"""Sleeves as long as the outfit has them; larger: cut off on the way from the wrist (0) over the elbow (1) to the
shoulder (2)."""


@dataclass(frozen=True, slots=True, eq=False)
class Cloth:
    """One fabric; colours are linear RGB albedo.

    Attributes:
        albedo, second: (3,).
        kind: index into KINDS.
        period_m: of the pattern; width of a motif.
        turn: of the pattern, radians; number of a motif.
        contrast: 0..1 of the pattern.
        wrinkles: 0 (stiff, ironed) to 1.
        roughness: 0.3 (leather, satin) to 0.95.
        fabric: of the user's, instead of kind; None for none.
    """

    albedo: np.ndarray
    second: np.ndarray
    kind: int
    period_m: float
    turn: float
    contrast: float
    wrinkles: float
    roughness: float
    fabric: Fabric | None = None


@dataclass(frozen=True, slots=True, eq=False)
class PersonLook:
    """Everything about one person's looks beside shape and pose.

    Attributes:
        outfit, shoes: names in the asset.
        hair: name, or None for a shaved head.
        hat: name, or None.
        brow: name.
        skin_albedo, palm_albedo: (3,) linear RGB.
        skin_detail: 0.5 to 1.3, strength of what the photographic map shows.
        skin_roughness: 0.3 (moist) to 0.6.
        flushed: 0 to 1.5, how much blood shows on cheeks, nose, ears and knuckles.
        hair_albedo: (3,).
        grey: 0..1 share of grey hairs.
        brow_strength: 0.4 to 1.
        iris: (3,) factor of the iris' colour; blue: which of the two eye maps.
        blue: bool.
        stubble: 0 none, 0.3 unshaved, 1 a full short beard.
        moustache: 0..1.
        lips: (3,) factor of the lips' colour.
        clothes: a fabric for each of ZONES.
        sleeve_from: where sleeves end, see FULL.
        lanyard: (3,) its colour, or None.
        glasses: (3,) colour of the frame, or None.
        hat_albedo: (3,).
        lens: (2,) half width and height of a lens in metres, of glasses.
        seed: (3,) offset into noise.
    """

    outfit: str
    shoes: str
    hair: str | None
    hat: str | None
    brow: str
    skin_albedo: np.ndarray
    palm_albedo: np.ndarray
    skin_detail: float
    skin_roughness: float
    flushed: float
    hair_albedo: np.ndarray
    grey: float
    brow_strength: float
    iris: np.ndarray
    blue: bool
    stubble: float
    moustache: float
    lips: np.ndarray
    clothes: tuple[Cloth, ...]
    sleeve_from: float
    lanyard: np.ndarray | None
    glasses: np.ndarray | None
    hat_albedo: np.ndarray
    lens: np.ndarray
    seed: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class PersonSpec:
    """One whole person in a scene.

    Attributes:
        look: clothes, hair, skin.
        shape: (K,) coefficients of `PeopleAsset.basis`.
        arms: (48, 3, 4) rest-to-posed transforms of BONE_NAMES in the camera frame, before scaling.
        turns: (28, 3, 3) rotations of BODY_BONES, as of `people.body_transforms`.
        view: (3, 4) from the frame between the eyes at rest to the camera, before scaling.
        scale: factor from the body's metres to the scene's.
        present: (2,) bool, which arms are there.
    """

    look: PersonLook
    shape: np.ndarray
    arms: np.ndarray
    turns: np.ndarray
    view: np.ndarray
    scale: float
    present: np.ndarray

    @property
    def transforms(self) -> np.ndarray:
        """(76, 3, 4) rest-to-posed transforms of BODY_BONES and BONE_NAMES, camera frame, scaled metres."""
        body = body_transforms(load_people().heads(self.shape), self.turns)
        return np.concatenate([after(self.view, body), self.arms]) * self.scale
