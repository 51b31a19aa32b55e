"""Shader nodes of the look of arms and things to Cycles, after the shaders of `shaders`, and of what carries labels."""

from __future__ import annotations

from typing import Any

import numpy as np

from twohands.synth.render.nodes import Value, add_node, attribute, noise
from twohands.synth.scene.spec import Lighting, SceneSpec

REFRACTION = 1.4
"""Of skin: 2.8 % of the light that falls straight on it is mirrored."""
MIRRORED = 0.5
"""Share of that which is seen: pores and fine hairs, which the mesh lacks, swallow the rest."""
SCATTER_M = np.array([0.0040, 0.0016, 0.0010])
"""How far light travels under skin, red, green, blue, in the body's metres."""
SCATTERED = 0.35
"""Share of the diffuse light that does."""


def build_skin(tree: Any, scene: SceneSpec) -> None:
    """Fills a material's node tree with the scene's skin and clothes.

    The mesh has the attributes of `surface.Surface` by their names, and `rest`, positions at rest in metres.
    """
    tree.nodes.clear()
    skin, clothes = scene.skin, scene.clothes
    rest = attribute(tree, "rest", triple=True)
    along = attribute(tree, "along")
    blotch, grain = (noise(rest + skin.seed, frequency) for frequency in (45.0, 500.0))
    base = attribute(tree, "palmar") * (skin.palm_albedo - skin.albedo) + skin.albedo
    base *= 1 + skin.mottle * (0.35 * blotch + 0.4 * grain)
    blood = attribute(tree, "flush") * 0.8 + skin.mottle * 0.5 * blotch
    base *= 1 + blood * np.array([0.06, -0.14, -0.16])
    on_nail, nail = _nail(tree, skin.nail_albedo)
    base = base.mixed(nail, on_nail * 0.85)
    roughness = skin.roughness + on_nail * (0.22 - skin.roughness)
    weave = 1 + 0.24 * grain + 0.25 * blotch
    skin_share = 1 - 0.85 * on_nail
    if np.isfinite(clothes.glove_until):
        glove = along < clothes.glove_until
        base, roughness = base.mixed(weave * clothes.glove_albedo, glove), roughness.mixed(0.85, glove)
        skin_share *= 1 - glove
    if np.isfinite(clothes.sleeve_from):
        sleeve = along > clothes.sleeve_from
        base, roughness = base.mixed(_sleeve(rest, along, scene) * weave, sleeve), roughness.mixed(0.85, sleeve)
        skin_share *= 1 - sleeve
    inputs = {
        "Base Color": base,
        "Roughness": roughness,
        "IOR": REFRACTION,
        "Specular IOR Level": MIRRORED / 2,
        "Subsurface Weight": SCATTERED * skin_share,
        "Subsurface Radius": SCATTER_M / SCATTER_M[0],
        "Subsurface Scale": SCATTER_M[0] * scene.scale,
    }
    # Diffusion by formula: hands look the same as with random walks, which take twice the time.
    _finish(tree, add_node(tree, "ShaderNodeBsdfPrincipled", inputs, subsurface_method="BURLEY")["BSDF"])


def build_things(tree: Any) -> None:
    """Fills a material's node tree with the look of things, whose mesh has the attributes `albedo` and `roughness`."""
    tree.nodes.clear()
    inputs = {
        "Base Color": attribute(tree, "albedo", triple=True),
        "Roughness": attribute(tree, "roughness"),
        "IOR": REFRACTION,
    }
    _finish(tree, add_node(tree, "ShaderNodeBsdfPrincipled", inputs)["BSDF"])


def build_labels(tree: Any) -> None:
    """Fills a material's node tree so that surfaces shine with (part label, planar depth in metres, 0)."""
    tree.nodes.clear()
    position = Value(tree, add_node(tree, "ShaderNodeNewGeometry", [])["Position"], True)
    depth = 0 - position.components()[2]  # Blender's cameras look along -z
    colour = add_node(tree, "ShaderNodeCombineXYZ", [attribute(tree, "label"), depth, 0.0])[0]
    _finish(tree, add_node(tree, "ShaderNodeEmission", {"Color": colour, "Strength": 1.0})[0])


def build_sky(tree: Any, lighting: Lighting) -> None:
    """Fills a world's node tree with the light of the sky, above, and of the ground, below."""
    tree.nodes.clear()
    direction = Value(tree, add_node(tree, "ShaderNodeTexCoord", [])["Generated"], True)
    light = (direction.components()[1] > 0.0) * (lighting.sky - lighting.ground) + lighting.ground
    background = add_node(tree, "ShaderNodeBackground", {"Color": light, "Strength": 1.0})[0]
    add_node(tree, "ShaderNodeOutputWorld", {"Surface": background})


def _nail(tree: Any, albedo: np.ndarray) -> tuple[Value, Value]:
    """Where nails are, 0..1, and their colour."""
    forward, across, dorsal = attribute(tree, "nail", triple=True).components()
    share = forward.smoothstep(0.38, 0.46) * (1 - forward.smoothstep(0.97, 1.0))
    share *= (1 - across.mapped("ABSOLUTE").smoothstep(0.5, 0.66)) * dorsal.smoothstep(0.25, 0.5)
    free_edge = 0.7 * forward.smoothstep(0.88, 0.93)
    return share, free_edge * (np.array([0.8, 0.74, 0.66]) - albedo) + albedo


def _sleeve(rest: Value, along: Value, scene: SceneSpec) -> Value:
    """Colour of the sleeve: stripes, and a darker hem."""
    clothes = scene.clothes
    strength, period, direction = clothes.pattern.tolist()
    x, y, _ = rest.components()
    across = (x * np.cos(direction) + y * np.sin(direction)) * (2 * np.pi / period)
    stripes = 1 - strength * across.mapped("SINE").smoothstep(-0.1, 0.1)
    hem = 0.72 + 0.28 * along.smoothstep(clothes.sleeve_from, clothes.sleeve_from + 0.012)
    return stripes * hem * clothes.sleeve_albedo


def _finish(tree: Any, shader: Any) -> None:
    """Makes a shader the surface's, seen from outside alone, as the raster renderer draws it."""
    inside = add_node(tree, "ShaderNodeNewGeometry", [])["Backfacing"]
    nothing = add_node(tree, "ShaderNodeBsdfTransparent", [])[0]
    surface = add_node(tree, "ShaderNodeMixShader", [inside, shader, nothing])[0]
    add_node(tree, "ShaderNodeOutputMaterial", {"Surface": surface})
