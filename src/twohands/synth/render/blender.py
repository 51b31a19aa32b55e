"""Path-traced renderer (Blender's Cycles through bpy, extra `blender`): about a second a frame, with soft shadows,
light that bounces between the hands, and light under the skin.

Labels and depth come from Cycles too: a second Blender scene shows the same meshes in a material that shines with part
label and depth, one ray through the middle of every pixel.

Blender's frame is the camera frame turned half around x: x right, y up, looking along -z.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from twohands.errors import MissingExtraError, RendererError
from twohands.skeleton import LEFT, N_PART_LABELS, RIGHT
from twohands.synth.render.blender_materials import build_labels, build_skin, build_sky, build_things
from twohands.synth.render.raster import FAR_M, NEAR_M
from twohands.synth.render.surface import ThingMesh, posed_things, posed_vertices, surface
from twohands.synth.scene.body import load_asset
from twohands.synth.scene.spec import Lighting, SceneSpec
from twohands.types import PinholeCamera, RenderedFrame

BLENDER_FROM_CAMERA = np.array([1.0, -1.0, -1.0])
LAMP_RADIUS = 0.12
"""Of lamps, as a fraction of their distance from the camera: the softness of the raster renderer's shadows."""
WATTS = 4 * np.pi**2
"""Power of a Blender lamp that lights a white matte surface at 1 m to the radiance 1."""


def import_blender() -> Any:
    """The module bpy.

    Raises:
        MissingExtraError: bpy is not installed.
        RendererError: it cannot be loaded.
    """
    path = list(sys.path)
    try:
        with _silent():
            import bpy  # pyright: ignore[reportMissingImports]
    except ModuleNotFoundError as error:
        raise MissingExtraError("the Blender renderer (Python 3.11)", "blender") from error
    except ImportError as error:
        raise RendererError(
            f"Blender cannot be loaded ({error}); on Debian or Ubuntu: apt-get install libgl1 libgomp1 libsm6 libxi6 "
            "libxkbcommon0 libxrender1 libxfixes3 libxxf86vm1"
        ) from error
    # Blender puts its script folders first. They hold another module `bpy`, which a spawned process, heir to this path,
    # would find instead.
    sys.path[:] = path + [folder for folder in sys.path if folder not in path]
    return bpy


@lru_cache(maxsize=1)
def _blender() -> Any:
    """The module bpy with an empty file and factory settings; emptied once, for a process has one Blender."""
    bpy = import_blender()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return bpy


def renderer_name() -> str:
    """Name and version of the renderer, which pictures depend on.

    Raises:
        MissingExtraError, RendererError: nothing can be rendered here.
    """
    return f"Cycles, Blender {_blender().app.version_string}"


class BlenderRenderer:
    """Renders scenes of one image size.

    Args:
        width, height: image size in pixels.
        samples: paths through every pixel of the colour picture, which is denoised afterwards.

    Raises:
        MissingExtraError: bpy is not installed.
        RendererError: bpy cannot be loaded.
    """

    def __init__(self, width: int, height: int, samples: int = 16) -> None:
        self.width, self.height = width, height
        self._bpy = bpy = _blender()
        self._folder = TemporaryDirectory(prefix="twohands-")
        self._meshes = [_arm_mesh(bpy, side) for side in (LEFT, RIGHT)]
        self._arms = [bpy.data.objects.new("arm", mesh) for mesh in self._meshes]
        self._skin = _with_nodes(bpy.data.materials.new("skin"))
        for mesh in self._meshes:
            mesh.materials.append(self._skin)
        self._things = bpy.data.objects.new("things", bpy.data.meshes.new("things"))
        self._things.data.materials.append(_with_nodes(bpy.data.materials.new("things")))
        build_things(self._things.data.materials[0].node_tree)
        labels = _with_nodes(bpy.data.materials.new("labels"))
        labels.cycles.emission_sampling = "NONE"  # it lights nothing
        build_labels(labels.node_tree)
        self._camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
        self._world = _with_nodes(bpy.data.worlds.new("sky"))
        self._world.cycles.sampling_method = "NONE"  # so even a light is found by chance

        self._colour = self._scene("colour", samples)
        self._colour.world = self._world
        self._colour.cycles.pixel_filter_type = "BOX"
        self._colour.cycles.use_denoising = True
        self._colour.cycles.denoiser, self._colour.cycles.denoising_prefilter = "OPENIMAGEDENOISE", "NONE"
        self._lamps = bpy.data.collections.new("lamps")
        self._colour.collection.children.link(self._lamps)
        self._labels = self._scene("labels", 1)
        self._labels.cycles.pixel_filter_type = "BLACKMAN_HARRIS"
        self._labels.cycles.filter_width = 0.01  # the least: rays pass within 0.005 px of the pixel's middle
        self._labels.cycles.use_denoising = False
        self._labels.view_layers[0].material_override = labels

    def render(self, scene: SceneSpec) -> RenderedFrame:
        """Renders one scene.

        Args:
            scene: its camera must have this renderer's image size.

        Returns:
            Colour, alpha, labels and depth; a pixel has a label exactly where it has depth and alpha
            (docs/dataset-format.md), but for things that are no part of a hand.
        """
        if (scene.camera.width, scene.camera.height) != (self.width, self.height):
            raise ValueError(f"scene is {scene.camera.width}x{scene.camera.height}, not {self.width}x{self.height}")
        vertices, rest = posed_vertices(scene) * BLENDER_FROM_CAMERA, scene.body.vertices
        side_of = load_asset().side
        for side, mesh in enumerate(self._meshes):
            _write(mesh.attributes["position"], vertices[side_of == side])
            _write(mesh.attributes["rest"], rest[side_of == side])
            mesh.update()
        _write_things(self._things.data, posed_things(scene))
        self._show(scene.present)
        for target in (self._colour, self._labels):
            place_camera(target, scene.camera)
        build_skin(self._skin.node_tree, scene)
        build_sky(self._world.node_tree, scene.lighting)
        self._hang_lamps(scene.lighting, scene.scale)
        return _frame(self._picture(self._colour), self._picture(self._labels), scene)

    def amodal(self, scene: SceneSpec) -> np.ndarray:
        """Amodal masks of the scene that was just rendered.

        Returns:
            (2, H, W) bool, the pixels that each arm covers when it is drawn alone, with what it wears.
        """
        masks = np.zeros((2, self.height, self.width), bool)
        for side in np.flatnonzero(scene.present):
            worn = tuple(thing for thing in scene.things if thing.side == side)
            _write_things(self._things.data, posed_things(replace(scene, things=worn)))
            self._show(np.arange(2) == side)
            masks[side] = self._picture(self._labels)[..., 0] > 0.5
        return masks

    def _show(self, arms: np.ndarray) -> None:
        """Shows those of the (2,) arms alone."""
        for arm, shown in zip(self._arms, arms, strict=True):
            arm.hide_render = not shown

    def _scene(self, name: str, samples: int) -> Any:
        """A Blender scene with arms, things and camera, whose pictures are linear and exact."""
        scene = self._bpy.data.scenes.new(name)
        for shown in (*self._arms, self._things, self._camera):
            scene.collection.objects.link(shown)
        scene.camera = self._camera
        render, cycles = scene.render, scene.cycles
        render.engine = "CYCLES"
        render.resolution_x, render.resolution_y, render.resolution_percentage = self.width, self.height, 100
        render.film_transparent = True
        render.use_compositing = render.use_sequencer = False
        render.filepath, render.use_file_extension = str(Path(self._folder.name) / "picture.exr"), False
        render.image_settings.file_format = "OPEN_EXR"
        render.image_settings.color_mode, render.image_settings.color_depth = "RGBA", "32"
        render.image_settings.exr_codec = "NONE"
        cycles.samples, cycles.seed = samples, 0
        cycles.use_adaptive_sampling = False
        cycles.max_bounces = 4
        cycles.caustics_reflective = cycles.caustics_refractive = False
        return scene

    def _hang_lamps(self, lighting: Lighting, scale: float) -> None:
        """Lights stand in the body's metres, so that scaling the world leaves the picture as it is."""
        bpy = self._bpy
        for lamp in list(self._lamps.objects):
            bpy.data.lights.remove(lamp.data)
        for position, colour in zip(lighting.positions * scale, lighting.colours * scale**2, strict=True):
            light = bpy.data.lights.new("lamp", "POINT")
            light.energy, light.color = WATTS * colour.max(), (colour / colour.max()).tolist()
            light.shadow_soft_size = LAMP_RADIUS * np.linalg.norm(position)
            lamp = bpy.data.objects.new("lamp", light)
            lamp.location = (position * BLENDER_FROM_CAMERA).tolist()
            self._lamps.objects.link(lamp)

    def _picture(self, scene: Any) -> np.ndarray:
        """(H, W, 4) float32 linear, premultiplied: what a Blender scene's camera sees."""
        bpy = self._bpy
        with _silent():
            bpy.ops.render.render(scene=scene.name, write_still=True)
        image = bpy.data.images.load(scene.render.filepath)
        try:
            pixels = np.empty(self.width * self.height * 4, np.float32)
            image.pixels.foreach_get(pixels)
        finally:
            bpy.data.images.remove(image)
        return pixels.reshape(self.height, self.width, 4)[::-1]  # Blender's pictures start at the bottom


def place_camera(scene: Any, camera: PinholeCamera) -> None:
    """Gives a Blender scene's camera the intrinsics of a pinhole camera; lens distortion is left out, as everywhere in
    rendering.

    A pixel is 1 / width of the sensor's width wide and aspect_y / aspect_x times that high; a shift is a fraction of
    the sensor's width.
    """
    lens = scene.camera.data
    lens.sensor_fit = "HORIZONTAL"
    lens.lens_unit = "MILLIMETERS"
    lens.lens = camera.fx * lens.sensor_width / camera.width
    lens.clip_start, lens.clip_end = NEAR_M, FAR_M
    stretch = camera.fx / camera.fy
    scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = max(1.0, 1 / stretch), max(1.0, stretch)
    lens.shift_x = 0.5 - camera.cx / camera.width
    lens.shift_y = (camera.cy - camera.height / 2) * stretch / camera.width


def _arm_mesh(bpy: Any, side: int) -> Any:
    """One arm's triangles with the attributes of its surface; positions come with every scene."""
    asset, attributes = load_asset(), surface()
    own = asset.side == side
    number = np.cumsum(own) - 1  # of every vertex within its arm
    faces = attributes.faces[own[attributes.faces[:, 0]]]
    mesh = bpy.data.meshes.new("arm")
    mesh.from_pydata(asset.average[: asset.n_vertices][own].tolist(), [], number[faces].tolist())
    mesh.shade_smooth()
    for name in ("palmar", "flush", "along"):
        _write(mesh.attributes.new(name, "FLOAT", "POINT"), getattr(attributes, name)[own])
    _write(mesh.attributes.new("nail", "FLOAT_VECTOR", "POINT"), attributes.nail[own])
    mesh.attributes.new("rest", "FLOAT_VECTOR", "POINT")
    # A triangle has one label, its last vertex's, as in OpenGL.
    _write(mesh.attributes.new("label", "FLOAT", "FACE"), attributes.label[faces[:, 2]])
    return mesh


def _write_things(mesh: Any, things: ThingMesh | None) -> None:
    """Puts a scene's things into a Blender mesh, in place of those of the scene before."""
    mesh.clear_geometry()
    if things is None:
        return
    mesh.from_pydata((things.position * BLENDER_FROM_CAMERA).tolist(), [], things.faces.tolist())
    mesh.shade_smooth()
    _write(mesh.attributes.new("albedo", "FLOAT_VECTOR", "POINT"), things.albedo)
    _write(mesh.attributes.new("roughness", "FLOAT", "POINT"), things.roughness)
    _write(mesh.attributes.new("label", "FLOAT", "FACE"), things.label[things.faces[:, 2]])
    mesh.normals_split_custom_set_from_vertices((things.normal * BLENDER_FROM_CAMERA).tolist())


def _write(attribute: Any, rows: np.ndarray) -> None:
    """Fills a mesh attribute with N numbers or (N, 3) vectors."""
    attribute.data.foreach_set("value" if rows.ndim == 1 else "vector", np.ascontiguousarray(rows, np.float32).ravel())


def _with_nodes(block: Any) -> Any:
    block.use_nodes = True
    return block


def _frame(colour: np.ndarray, glow: np.ndarray, scene: SceneSpec) -> RenderedFrame:
    """A RenderedFrame with one common mask.

    Args:
        colour: (H, W, 4) linear, premultiplied.
        glow: (H, W, 4) of the material of `build_labels`.
        scene: what is in it.
    """
    labels = np.rint(glow[..., 0]).astype(np.uint8)
    mask, hands = labels > 0, (labels > 0) & (labels < N_PART_LABELS)
    coverage = colour[..., 3]
    straight = colour[..., :3] / np.maximum(coverage, 1e-3)[..., None]
    # The same tone curve as in `shaders.COLOUR_FRAGMENT`.
    lit = np.clip(straight, 0, None)
    rgb = np.rint(255 * srgb(np.clip(lit / (1 + 0.25 * lit), 0, 1))).astype(np.uint8)
    alpha = np.maximum(np.rint(255 * np.clip(coverage, 0, 1)).astype(np.uint8), 1)
    return RenderedFrame(
        rgb=np.where(mask[..., None], rgb, np.uint8(0)),
        alpha=np.where(mask, alpha, np.uint8(0)),
        depth_m=np.where(hands, glow[..., 1], np.float32(0)),
        part_labels=np.where(hands, labels, np.uint8(0)),
        joints_m=scene.joints_m,
        present=scene.present,
        camera=scene.camera,
    )


def srgb(linear: np.ndarray) -> np.ndarray:
    """sRGB's transfer function (IEC 61966-2-1), 0..1."""
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)


@contextmanager
def _silent() -> Iterator[None]:
    """Keeps off standard output what Blender itself reports there, and lets Python's own words (progress) pass."""
    sys.stdout.flush()
    with os.fdopen(os.dup(1), "w", buffering=1, encoding="utf-8") as kept, open(os.devnull, "w") as nowhere:
        os.dup2(nowhere.fileno(), 1)
        try:
            with redirect_stdout(kept):
                yield
        finally:
            os.dup2(kept.fileno(), 1)
