"""Draws what people look like and the light they are in: shape, skin, clothes, lamps."""

from __future__ import annotations

import dataclasses

import numpy as np

from twohands.synth.scene.body import load_asset
from twohands.synth.scene.config import SynthConfig
from twohands.synth.scene.fabrics import FabricFolder
from twohands.synth.scene.spec import BARE, PATTERNS, Clothes, Lighting, Skin, SkinDetail
from twohands.synth.scene.things import muted_colour

SHAPE_RANK = 24
"""Leading shape directions that random people use; the rest are below what a picture shows."""


_MONK_SRGB = np.array(
    [
        [246, 237, 228],
        [243, 231, 219],
        [247, 234, 208],
        [234, 218, 186],
        [215, 189, 150],
        [160, 126, 86],
        [130, 92, 67],
        [96, 65, 52],
        [58, 49, 42],
        [41, 36, 32],
    ]
)
"""The ten tones of the Monk Skin Tone scale (Google, CC BY 4.0), sRGB."""


def sample_skin(config: SynthConfig, rng: np.random.Generator) -> Skin:
    """Skin whose tone is even over the Monk scale, with the variation of hue that one tone covers."""
    tone = rng.uniform(*config.skin_tones) * (len(_MONK_SRGB) - 1)
    low = min(int(tone), len(_MONK_SRGB) - 2)
    srgb = (_MONK_SRGB[low] * (1 - tone + low) + _MONK_SRGB[low + 1] * (tone - low)) / 255
    albedo = srgb**2.2
    # The printed scale is paler than lit skin; blood reddens and deepens it.
    albedo = albedo * np.array([0.86, 0.60, 0.46]) ** rng.uniform(0.75, 1.5) * rng.uniform(0.9, 1.2)
    albedo = np.clip(albedo * np.exp(rng.normal(0, 0.03, 3)), 0.012, 0.9)
    pale = np.array([0.62, 0.36, 0.27])
    palm = albedo + (pale - albedo) * np.where(albedo < pale, 0.38, 0.12)
    nail = albedo + (np.array([0.75, 0.52, 0.45]) - albedo) * 0.4
    return Skin(albedo, palm, nail, rng.uniform(0.3, 0.7), rng.uniform(0.2, 1.0), rng.uniform(-100, 100, 3))


def sample_skin_detail(config: SynthConfig, rng: np.random.Generator) -> SkinDetail | None:
    """Small things on the skin: veins mostly faint, creases on everybody, freckles on three people of ten, moles on
    six."""
    if config.skin_detail == 0:
        return None
    spots = rng.uniform(0.2, 1.0, 2) * (rng.random(2) < [0.3, 0.6])
    strengths = config.skin_detail * np.array([rng.beta(1.2, 1.8), rng.uniform(0.35, 1.0), *spots])
    return SkinDetail(*strengths.tolist(), pattern=int(rng.integers(PATTERNS)))


def sample_lighting(config: SynthConfig, rng: np.random.Generator) -> Lighting:
    """Lights around and above the person, of random brightness, with slightly random colour."""
    count = config.lights
    direction = rng.normal(size=(count, 3)) * [1.0, 0.6, 1.0] + [0.0, -0.8, 0.0]
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    distance = rng.uniform(0.9, 2.2, (count, 1))
    positions = direction * distance + [0.0, 0.1, 0.35]
    warmth = rng.normal(0, 0.07)  # what a camera's white balance leaves
    tint = np.exp(np.array([warmth, 0.0, -warmth]) + rng.normal(0, 0.035, (count, 3)))
    power = rng.dirichlet(np.full(count, 1.5))[:, None] * count * distance**2
    level = np.exp(rng.normal(0, 0.3))
    ambient = level * rng.uniform(0.12, 0.45)
    sky = ambient * np.exp(np.array([warmth, 0.0, -warmth]) + rng.normal(0, 0.04, 3))
    ground = sky * rng.uniform(0.3, 0.9) * np.exp(rng.normal(0, 0.1, 3))
    return Lighting(positions, tint * power * level * rng.uniform(0.16, 0.34), sky, ground)


def sample_shape(config: SynthConfig, rng: np.random.Generator) -> np.ndarray:
    """Shape coefficients of a random person: a blend of two sampled adults, drawn towards the average."""
    if config.body_variation == 0:
        return np.zeros(0)
    coefficients = load_asset().coefficients
    a, b = coefficients[rng.integers(len(coefficients), size=2)]
    blend = rng.uniform()
    return (config.body_variation * (a * blend + b * (1 - blend)))[:SHAPE_RANK].astype(np.float64)


def sample_clothes(config: SynthConfig, rng: np.random.Generator) -> Clothes:
    """Sleeves and gloves in any colour, mostly muted, plain or striped."""
    has_sleeves, has_gloves = rng.random(2) < [config.sleeves, config.gloves]
    if not (has_sleeves or has_gloves):
        return BARE

    striped = rng.random() < 0.3
    pattern = np.array(
        [rng.uniform(0.2, 0.8) * striped, np.exp(rng.uniform(*np.log([0.003, 0.03]))), rng.uniform(0, 3)]
    )
    return Clothes(
        rng.uniform(0.02, 0.95) if has_sleeves else np.inf,
        rng.uniform(0.0, 0.25) if has_gloves else -np.inf,
        muted_colour(rng),
        muted_colour(rng),
        pattern,
        rng.uniform(0.0008, 0.006),
    )


def woven(clothes: Clothes, fabrics: FabricFolder | None, rng: np.random.Generator) -> Clothes:
    """The clothes, if there are any, made of one of the user's fabrics, if there are any."""
    if fabrics is None or clothes is BARE:
        return clothes
    fabric = fabrics.sample(rng, clothes.sleeve_albedo)
    return dataclasses.replace(
        clothes, fabric=fabric, sleeve_albedo=fabric.albedo, glove_albedo=fabric.albedo, pattern=BARE.pattern
    )
