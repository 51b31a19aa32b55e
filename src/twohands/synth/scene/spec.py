"""What a scene is: everything that a renderer needs for one picture."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from twohands.synth.scene.body import Body, load_asset
from twohands.synth.scene.fabrics import Fabric
from twohands.synth.scene.looks import PersonSpec
from twohands.synth.scene.people import load_people
from twohands.synth.scene.things import Thing
from twohands.types import PinholeCamera

PATTERNS = 16
"""Different patterns of veins, creases and spots; painting one takes longer than drawing a picture, so renderers keep
them."""


@dataclass(frozen=True, slots=True)
class SkinDetail:
    """Small things on one person's skin; strengths are 0 (none) to 1.

    Attributes:
        veins: on the back of the hand and on the forearm.
        creases: of palm, fingers and knuckles.
        freckles, moles: on the back of the hand and on the forearm.
        pattern: which pattern of all these, 0 to PATTERNS - 1.
    """

    veins: float
    creases: float
    freckles: float
    moles: float
    pattern: int


@dataclass(frozen=True, slots=True, eq=False)
class Skin:
    """Look of one person's skin; colours are linear RGB albedo.

    Attributes:
        albedo: (3,) back of the hand.
        palm_albedo: (3,).
        nail_albedo: (3,).
        roughness: 0.25 (moist) to 0.7 (dry).
        mottle: strength of the blotchy variation, 0..1.
        seed: (3,) offset into the noise field.
        detail: veins, creases and freckles; None for smooth skin.
    """

    albedo: np.ndarray
    palm_albedo: np.ndarray
    nail_albedo: np.ndarray
    roughness: float
    mottle: float
    seed: np.ndarray
    detail: SkinDetail | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Clothes:
    """What covers the arms; colours are linear RGB albedo.

    Attributes:
        sleeve_from: where sleeves begin, on the way from the wrist (0) to the elbow (1); infinite without sleeves.
        glove_until: where gloves end on the same scale; minus infinity without gloves.
        sleeve_albedo, glove_albedo: (3,).
        pattern: (3,) strength, period in metres and direction (radians) of the sleeve's stripes.
        thickness_m: of the fabric.
        fabric: whose pattern sleeves and gloves have; None for plain or striped ones.
    """

    sleeve_from: float
    glove_until: float
    sleeve_albedo: np.ndarray
    glove_albedo: np.ndarray
    pattern: np.ndarray
    thickness_m: float
    fabric: Fabric | None = None


BARE = Clothes(np.inf, -np.inf, np.zeros(3), np.zeros(3), np.array([0.0, 0.01, 0.0]), 0.0)
"""Short sleeves, no gloves."""


@dataclass(frozen=True, slots=True, eq=False)
class Lighting:
    """Point lights and an ambient hemisphere, linear RGB.

    Attributes:
        positions: (L, 3) camera frame, metres.
        colours: (L, 3) radiant intensity; the fall-off is quadratic.
        sky, ground: (3,) ambient light from above and below.
    """

    positions: np.ndarray
    colours: np.ndarray
    sky: np.ndarray
    ground: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class ArmMotion:
    """How an arm turns while the shutter is open, as rotation vectors (3,) in the camera frame, radians.

    Attributes:
        shoulder: (3,) place of the shoulder, camera frame, scaled metres.
        swing: of the whole arm about the shoulder.
        bend: of the forearm and hand about the elbow, besides.
    """

    shoulder: np.ndarray
    swing: np.ndarray
    bend: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class SceneSpec:
    """Everything a renderer needs for one picture.

    Attributes:
        camera: intrinsics.
        shape: shape coefficients of the person.
        transforms: (48, 3, 4) rest-to-posed transforms of the bones, before scaling.
        scale: factor from the body's metres to the scene's (`SynthConfig.hand_length`).
        joints_m: (2, 22, 3) camera frame, scaled metres; NaN for an absent hand.
        present: (2,) bool.
        skin: the person's.
        lighting: lights.
        index: number of the instance.
        view: (3, 4) from the frame between the eyes (docs/generator.md) to the camera, before scaling.
        clothes: sleeves and gloves.
        things: what the hands hold and wear, in the frame between the eyes, before scaling.
        people: whole people, drawn instead of the arms alone; the first is the one that all else here is about, and
            whose arms have labels.
        motion: of the left and right arm of the first of them; None for arms that are still.
    """

    camera: PinholeCamera
    shape: np.ndarray
    transforms: np.ndarray
    scale: float
    joints_m: np.ndarray
    present: np.ndarray
    skin: Skin
    lighting: Lighting
    index: int
    view: np.ndarray = field(default_factory=lambda: np.eye(3, 4))
    clothes: Clothes = BARE
    things: tuple[Thing, ...] = ()
    people: tuple[PersonSpec, ...] = ()
    motion: tuple[ArmMotion | None, ArmMotion | None] = (None, None)

    @property
    def body(self) -> Body:
        """The person at rest."""
        shape = tuple(self.shape.tolist())
        return arms_of(shape) if self.people else body_of(shape)


@lru_cache(maxsize=16)
def body_of(shape: tuple[float, ...]) -> Body:
    """The person at rest with these shape coefficients; the last few are kept."""
    return load_asset().body(np.array(shape) if shape else None)


@lru_cache(maxsize=16)
def arms_of(shape: tuple[float, ...]) -> Body:
    """The arms of a whole person at rest with these shape coefficients; the last few are kept."""
    return load_people().arms_body(np.array(shape))


def moved(view: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (..., 3) after the rigid transform `view` (3, 4)."""
    return points @ view[:, :3].T + view[:, 3]


def viewed(view: np.ndarray, transforms: np.ndarray) -> np.ndarray:
    """Transforms (N, 3, 4), each followed by `view` (3, 4)."""
    return np.concatenate([view[:, :3] @ transforms[..., :3], moved(view, transforms[..., 3])[..., None]], axis=-1)
