"""Dresses people: draws who somebody is and what they look like. Pure functions of a random generator."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from twohands.synth.scene.fabrics import Fabric
from twohands.synth.scene.looks import (
    CHECK,
    DENIM,
    DOTS,
    FULL,
    KINDS,
    MELANGE,
    MOTIF,
    MOTIFS,
    PLAID,
    PLAIN,
    PRINT,
    STRIPES,
    Cloth,
    PersonLook,
)
from twohands.synth.scene.people import load_people

TONES: Final = np.array(
    [
        [0.64, 0.43, 0.34],
        [0.60, 0.38, 0.28],
        [0.55, 0.34, 0.24],
        [0.48, 0.28, 0.185],
        [0.40, 0.225, 0.14],
        [0.29, 0.15, 0.088],
        [0.20, 0.10, 0.058],
        [0.12, 0.060, 0.037],
        [0.085, 0.046, 0.031],
        [0.060, 0.034, 0.025],
    ]
)
"""Linear albedo of facial skin at the ten steps of the Monk scale, redder than the printed scale, as lit skin is."""
LONG_SLEEVES: Final = (
    "female_elegantsuit01", "male_casualsuit01", "male_casualsuit02", "male_casualsuit03", "male_casualsuit05",
    "male_elegantsuit01",
)  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Someone:
    """A person at rest, not yet dressed.

    Attributes:
        shape: (K,) coefficients of `PeopleAsset.basis`.
        gender: 0 (female) to 1 (male).
        age: Anny's, 0.62 (young adult) to 1 (old).
        ancestry: (3,) shares African, Asian, European.
    """

    shape: np.ndarray
    gender: float
    age: float
    ancestry: np.ndarray


def sample_someone(rng: np.random.Generator) -> Someone:
    """A random adult: between two sampled ones of one sex."""
    asset = load_people()
    first = int(rng.integers(len(asset.traits)))
    same = np.flatnonzero((asset.traits[:, 0] > 0.5) == (asset.traits[first, 0] > 0.5))
    second = int(rng.choice(same))
    share = rng.uniform(0.55, 1.0)
    mixed = share * asset.traits[first] + (1 - share) * asset.traits[second]
    shape = share * asset.coefficients[first] + (1 - share) * asset.coefficients[second]
    return Someone(shape, float(mixed[0]), float(mixed[1]), mixed[6:9])


def sample_look(rng: np.random.Generator, someone: Someone, fabric: Fabric | None = None) -> PersonLook:
    """Dresses a person.

    Args:
        rng: the only source of randomness.
        someone: whom; sex, age and ancestry only shift what is likely.
        fabric: of the user's, for the top; the same looks in all else without one.
    """
    male = someone.gender > 0.5
    old = float(np.clip((someone.age - 0.72) / 0.28, 0, 1))
    skin, palm = _skin(rng, someone)
    outfit = _outfit(rng, male)
    hair, hat = _hair(rng, male, old)
    albedo, grey = _hair_colour(rng, someone, old)
    bearded = male and rng.random() < 0.45
    stubble = float(bearded) * rng.choice([0.25, 0.5, 1.0], p=[0.4, 0.3, 0.3]) * rng.uniform(0.7, 1.0)
    moustache = max(stubble, float(male and rng.random() < 0.05))
    clothes = _clothes(rng, outfit, fabric)
    sleeve = FULL
    if outfit in LONG_SLEEVES and rng.random() < 0.4:
        sleeve = float(rng.choice([rng.uniform(0.05, 0.5), rng.uniform(0.7, 0.95), rng.uniform(1.25, 1.6)]))
    dark = rng.random(3) * 0.03
    return PersonLook(
        outfit=outfit,
        shoes=str(rng.choice(load_people().names("shoes"))),
        hair=hair,
        hat=hat,
        brow=str(rng.choice(load_people().names("brow"))),
        skin_albedo=skin,
        palm_albedo=palm,
        skin_detail=rng.uniform(0.9, 1.5),
        skin_roughness=rng.uniform(0.36, 0.6),
        flushed=rng.uniform(0.2, 1.4),
        hair_albedo=albedo,
        grey=grey,
        brow_strength=rng.uniform(0.55, 1.0),
        iris=np.exp(rng.normal(0, [0.2, 0.15, 0.2])) * rng.uniform(0.6, 1.3),
        blue=bool(rng.random() < 0.45 * someone.ancestry[2]),
        stubble=stubble,
        moustache=moustache,
        lips=np.array([1.0, 0.82, 0.82]) ** (0.0 if male else rng.uniform(0, 1.8)),
        clothes=clothes,
        sleeve_from=sleeve,
        lanyard=cloth_colour(rng) if rng.random() < 0.1 else None,
        glasses=(dark if rng.random() < 0.6 else cloth_colour(rng)) if rng.random() < 0.25 else None,
        hat_albedo=cloth_colour(rng) * 0.6,
        lens=np.array([rng.uniform(0.022, 0.027), rng.uniform(0.015, 0.024)]),
        seed=rng.uniform(-50, 50, 3),
    )


def _skin(rng: np.random.Generator, someone: Someone) -> tuple[np.ndarray, np.ndarray]:
    """Albedo of skin and palms: over the whole Monk scale, darker and lighter where ancestry says so."""
    african, asian, _ = someone.ancestry
    tone = rng.beta(1.1 + 3.0 * african, 1.1 + 2.0 * (1 - african)) * (len(TONES) - 1)
    low = min(int(tone), len(TONES) - 2)
    albedo = TONES[low] * (1 - tone + low) + TONES[low + 1] * (tone - low)
    undertone = rng.normal(0, 0.05) + 0.03 * asian  # towards yellow, or towards red
    albedo = albedo * np.exp(np.array([-0.3, 0.5, -0.8]) * undertone + rng.normal(0, 0.07))
    albedo = np.clip(albedo, 0.016, 0.85)
    pale = np.array([0.60, 0.36, 0.27])
    palm = albedo + (pale - albedo) * np.where(albedo < pale, 0.42, 0.12)
    return albedo, palm


def _outfit(rng: np.random.Generator, male: bool) -> str:
    names = load_people().names("outfit")
    own = [name for name in names if name.startswith("male" if male else "female")]
    return str(rng.choice(own if rng.random() < (0.95 if male else 0.55) else names))


def _hair(rng: np.random.Generator, male: bool, old: float) -> tuple[str | None, str | None]:
    short = ["short01", "short02", "short03", "short04"]
    if rng.random() < 0.07:
        return str(rng.choice(["short03", "short04"])), str(rng.choice(load_people().names("hat")))
    if male:
        if rng.random() < 0.12 + 0.2 * old:
            return None, None
        return str(
            rng.choice([*short, "afro01", "bob02", "ponytail01"], p=[0.23, 0.23, 0.21, 0.21, 0.05, 0.04, 0.03])
        ), None
    names = ["long01", "bob01", "bob02", "braid01", "ponytail01", "afro01", *short]
    return str(rng.choice(names, p=[0.24, 0.11, 0.10, 0.12, 0.19, 0.06, 0.045, 0.045, 0.045, 0.045])), None


def _hair_colour(rng: np.random.Generator, someone: Someone, old: float) -> tuple[np.ndarray, float]:
    """Linear albedo from black over brown to blond and red, and the share of grey."""
    fair = someone.ancestry[2] * rng.random()
    colours = np.array(
        [[0.012, 0.010, 0.009], [0.035, 0.020, 0.012], [0.10, 0.05, 0.025], [0.34, 0.21, 0.10], [0.55, 0.40, 0.22]]
    )
    place = np.clip(rng.beta(1.0, 2.2) * 0.6 + fair * 0.8, 0, 1) * (len(colours) - 1)
    low = min(int(place), len(colours) - 2)
    albedo = colours[low] + (colours[low + 1] - colours[low]) * (place - low)
    if rng.random() < 0.06:
        albedo = albedo * [1.9, 0.95, 0.6] + [0.02, 0, 0]
    if rng.random() < 0.03:
        albedo = cloth_colour(rng) * 0.7
    return albedo, float(np.clip(rng.normal(1.6 * old - 0.85, 0.25), 0, 1))


def cloth_colour(rng: np.random.Generator) -> np.ndarray:
    """(3,) linear albedo as wardrobes hold them: black, white, grey, dark blue often, else anything muted."""
    kind = rng.random()
    if kind < 0.18:
        grey = rng.uniform(0.012, 0.04)
    elif kind < 0.32:
        grey = rng.uniform(0.6, 0.82)
    elif kind < 0.46:
        grey = rng.uniform(0.05, 0.5)
    elif kind < 0.6:
        return np.array([0.02, 0.035, 0.09]) * np.exp(rng.normal(0, [0.5, 0.4, 0.4]))
    else:
        hue, level = rng.uniform(0, 2 * np.pi), np.exp(rng.uniform(*np.log([0.03, 0.5])))
        wheel = 0.5 + 0.5 * np.cos(hue - np.array([0.0, 2.1, 4.2]))
        pure = rng.beta(1.6, 1.6)
        return np.clip(level * ((1 - pure) + pure * wheel * 1.8), 0.01, 0.8)
    return np.clip(grey * np.exp(rng.normal(0, 0.05, 3)), 0.01, 0.85)


def _cloth(rng: np.random.Generator, kinds: list[float]) -> Cloth:
    """A fabric whose kind is drawn with these shares."""
    kind = int(rng.choice(len(KINDS), p=np.array(kinds) / np.sum(kinds)))
    albedo, second = cloth_colour(rng), cloth_colour(rng)
    if kind == DENIM:
        albedo = np.array([0.05, 0.075, 0.14]) * np.exp(rng.normal(0, [0.5, 0.45, 0.45]) + rng.normal(0, 0.4))
        second = albedo * 2.2 + 0.03
    elif rng.random() < 0.35:  # tone in tone
        second = np.clip(albedo * rng.choice([0.45, 1.8]), 0.01, 0.85)
    low, high = {
        STRIPES: (0.004, 0.05),
        CHECK: (0.004, 0.03),
        PLAID: (0.03, 0.12),
        DOTS: (0.008, 0.04),
        PRINT: (0.05, 0.2),
        MOTIF: (0.08, 0.32),
    }.get(kind, (0.002, 0.01))
    turn = 0.0
    if kind == STRIPES:
        turn = float(rng.choice([0.0, np.pi / 2]))
    elif kind == MOTIF:
        turn = float(rng.integers(MOTIFS))
    return Cloth(
        albedo,
        second,
        kind,
        float(np.exp(rng.uniform(np.log(low), np.log(high)))),
        turn,
        rng.uniform(0.4, 1.0),
        rng.uniform(0.25, 1.0),
        rng.uniform(0.7, 0.95),
    )


def _clothes(rng: np.random.Generator, outfit: str, fabric: Fabric | None) -> tuple[Cloth, ...]:
    top = _cloth(rng, [0.32, 0.14, 0.08, 0.08, 0.03, 0.12, 0.03, 0.08, 0.12])
    bottom = _cloth(rng, [0.45, 0.02, 0.03, 0.03, 0, 0.12, 0.35, 0, 0])
    over = _cloth(rng, [0.6, 0.05, 0.05, 0.05, 0.02, 0.18, 0.05, 0, 0])
    small = _cloth(rng, [1.0, 0, 0, 0, 0, 0, 0, 0, 0])
    shoes = _cloth(rng, [1.0, 0, 0, 0, 0, 0, 0, 0, 0])
    if outfit == "male_elegantsuit01" and rng.random() < 0.75:  # a suit is of one cloth
        dark = np.array([0.02, 0.022, 0.03]) * np.exp(rng.normal(0.4, 0.6)) * np.exp(rng.normal(0, 0.1, 3))
        top = Cloth(dark, dark * 1.8, int(rng.choice([PLAIN, MELANGE, STRIPES])), 0.012, 0.0, 0.35, 0.3, 0.9)
        bottom = top
    if outfit == "male_worksuit01":
        bottom = _cloth(rng, [0.5, 0, 0, 0, 0, 0.1, 0.4, 0, 0])
    if fabric is not None:
        top = Cloth(fabric.albedo, fabric.albedo, PLAIN, 0.01, 0.0, 0.0, top.wrinkles, 0.9, fabric)
    return (top, bottom, over, small, shoes)
