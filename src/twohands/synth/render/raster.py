"""OpenGL renderer (moderngl on EGL, extra `synth`): a few milliseconds a frame in software, less on a GPU.

Two passes over the same triangles: one multi-sampled for colour and coverage, one single-sampled for exact labels
and depth. Skinning runs in the vertex shader.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from twohands.errors import MissingExtraError, RendererError
from twohands.synth.body import BONE_NAMES, load_asset
from twohands.synth.collision import capsules
from twohands.synth.render.shaders import (
    COLOUR_FRAGMENT,
    COLOUR_VERTEX,
    LABEL_FRAGMENT,
    LABEL_VERTEX,
    MAX_CAPSULES,
    MAX_LIGHTS,
)
from twohands.synth.render.surface import surface, vertex_normals
from twohands.synth.scene import SceneSpec
from twohands.types import PinholeCamera, RenderedFrame

NEAR_M, FAR_M = 0.01, 4.0
NOWHERE = 1e6
"""Stands for infinity in shaders."""


def create_context() -> Any:
    """An OpenGL 3.3 context without a window.

    Raises:
        MissingExtraError: moderngl is not installed.
        RendererError: the system has no EGL driver.
    """
    try:
        import moderngl
    except ImportError as error:
        raise MissingExtraError("rendering", "synth") from error
    try:
        settings: dict[str, Any] = {"backend": "egl", "require": 330}
        return moderngl.create_standalone_context(**settings)
    except Exception as error:  # moderngl raises bare Exception for a missing driver
        raise RendererError(
            f"no OpenGL context ({error}); on Debian or Ubuntu: apt-get install libegl1 libgl1-mesa-dri"
        ) from error


def renderer_name() -> str:
    """Name and version of the OpenGL driver, which pictures depend on in their last bits.

    Raises:
        MissingExtraError, RendererError: nothing can be rendered here.
    """
    context = create_context()
    try:
        return f"{context.info['GL_RENDERER']}, {context.info['GL_VERSION']}"
    finally:
        context.release()


class RasterRenderer:
    """Renders scenes of one image size.

    Args:
        width, height: image size in pixels.
        samples: multi-sampling of the colour pass.

    Raises:
        MissingExtraError: moderngl is not installed.
        RendererError: no OpenGL context can be made.
    """

    def __init__(self, width: int, height: int, samples: int = 4) -> None:
        self.width, self.height = width, height
        self.ctx = ctx = create_context()
        asset, attributes = load_asset(), surface()
        self._first_face = attributes.first_face
        self._face_count = len(attributes.faces)
        self._rest_weight = (1 - asset.bone_weight.sum(1)).astype(np.float32)

        static = np.concatenate(
            [
                asset.bone_index[:, :8].astype(np.float32),
                asset.bone_weight[:, :8].astype(np.float32),
                self._rest_weight[:, None],
                attributes.label[:, None],
                attributes.palmar[:, None],
                attributes.flush[:, None],
                attributes.nail,
                attributes.along[:, None],
            ],
            axis=1,
        )
        self._shape_key: tuple[float, ...] | None = None
        self._shape_buffer = ctx.buffer(reserve=asset.n_vertices * 6 * 4)
        static_buffer = ctx.buffer(np.ascontiguousarray(static, np.float32).tobytes())
        index_buffer = ctx.buffer(attributes.faces.tobytes())
        self._colour = ctx.program(vertex_shader=COLOUR_VERTEX, fragment_shader=COLOUR_FRAGMENT)
        self._label = ctx.program(vertex_shader=LABEL_VERTEX, fragment_shader=LABEL_FRAGMENT)
        names = ("bones_a", "bones_b", "weights_a", "weights_b", "surface", "nail", "along")
        self._arrays = []
        for program in (self._colour, self._label):
            content = [
                (self._shape_buffer, "3f 3f", "position", "normal"),
                (static_buffer, "4f 4f 4f 4f 4f 3f 1f", *names),
            ]
            self._arrays.append(ctx.vertex_array(program, content, index_buffer, skip_errors=True))

        size = (width, height)
        samples = min(samples, ctx.max_samples)
        self._multisampled = ctx.framebuffer(
            [ctx.renderbuffer(size, 4, samples=samples)], ctx.depth_renderbuffer(size, samples=samples)
        )
        self._resolved = ctx.framebuffer([ctx.renderbuffer(size, 4)])
        self._labelled = ctx.framebuffer([ctx.renderbuffer(size, 2, dtype="f4")], ctx.depth_renderbuffer(size))
        ctx.enable(ctx.DEPTH_TEST | ctx.CULL_FACE)

    def render(self, scene: SceneSpec) -> RenderedFrame:
        """Renders one scene.

        Args:
            scene: its camera must have this renderer's image size.

        Returns:
            Colour, alpha, labels and depth; a pixel has a label exactly where it has depth and alpha (SPEC 1.1).
        """
        if (scene.camera.width, scene.camera.height) != (self.width, self.height):
            raise ValueError(f"scene is {scene.camera.width}x{scene.camera.height}, not {self.width}x{self.height}")
        self._upload_shape(scene)
        palette = _palette(scene)
        projection = _projection(scene.camera)
        for program in (self._colour, self._label):
            program["bones"].write(palette)
            program["projection"].write(projection)
            program["sleeve_from"].value = min(scene.clothes.sleeve_from, NOWHERE)
            program["glove_until"].value = max(scene.clothes.glove_until, -NOWHERE)
            program["thickness"].value = scene.clothes.thickness_m
        self._write_look(scene)
        self._write_occluders(scene)

        self._multisampled.use()
        self.ctx.clear(0.0, 0.0, 0.0, 0.0)
        self._draw(self._arrays[0], scene.present)
        self.ctx.copy_framebuffer(self._resolved, self._multisampled)
        self._labelled.use()
        self.ctx.clear(0.0, 0.0, 0.0, 0.0)
        self._draw(self._arrays[1], scene.present)

        shape = (self.height, self.width)
        colour = np.frombuffer(self._resolved.read(components=4), np.uint8).reshape(*shape, 4)
        planes = np.frombuffer(self._labelled.read(components=2, dtype="f4"), np.float32).reshape(*shape, 2)
        return _frame(colour[::-1], planes[::-1], scene)

    def _draw(self, array: Any, present: np.ndarray) -> None:
        bounds = (*self._first_face, self._face_count)
        for side in np.flatnonzero(present):
            array.render(first=3 * bounds[side], vertices=3 * (bounds[side + 1] - bounds[side]))

    def _upload_shape(self, scene: SceneSpec) -> None:
        key = tuple(scene.shape.tolist())
        if key == self._shape_key:
            return
        vertices = scene.body.vertices
        # The camera frame keeps Anny's handedness, so its triangles stay counter-clockwise from outside.
        data = np.concatenate([vertices, vertex_normals(vertices, load_asset().faces)], axis=1)
        self._shape_buffer.write(np.ascontiguousarray(data, np.float32).tobytes())
        self._shape_key = key

    def _write_look(self, scene: SceneSpec) -> None:
        program, skin, light = self._colour, scene.skin, scene.lighting
        positions, colours = np.zeros((MAX_LIGHTS, 3)), np.zeros((MAX_LIGHTS, 3))
        positions[: len(light.positions)] = light.positions
        colours[: len(light.colours)] = light.colours
        # Lights stand in the body's metres, so that scaling the world leaves the picture as it is.
        program["light_position"].write((positions * scene.scale).astype("f4").tobytes())
        program["light_colour"].write((colours * scene.scale**2).astype("f4").tobytes())
        clothes = scene.clothes
        for name, value in (
            ("sleeve_albedo", clothes.sleeve_albedo),
            ("glove_albedo", clothes.glove_albedo),
            ("pattern", clothes.pattern),
            ("sky", light.sky),
            ("ground", light.ground),
            ("albedo", skin.albedo),
            ("palm_albedo", skin.palm_albedo),
            ("nail_albedo", skin.nail_albedo),
            ("noise_offset", skin.seed),
        ):
            program[name].value = tuple(float(v) for v in value)
        program["light_count"].value = len(light.positions)
        program["roughness"].value = skin.roughness
        program["mottle"].value = skin.mottle

    def _write_occluders(self, scene: SceneSpec) -> None:
        starts, ends, radii = capsules(scene.body, scene.joints_m[scene.present])
        buffers = np.zeros((2, MAX_CAPSULES, 4), np.float32)
        count = len(radii)
        buffers[0, :count] = np.concatenate([starts, radii[:, None] * scene.scale], axis=1)
        buffers[1, :count, :3] = ends
        self._colour["capsule_from"].write(buffers[0].tobytes())
        self._colour["capsule_to"].write(buffers[1].tobytes())
        self._colour["capsule_count"].value = count


def _palette(scene: SceneSpec) -> bytes:
    """Bone transforms with the scene's scale, and the resting torso last, as mat4x3 columns."""
    transforms = np.concatenate([scene.transforms, scene.view[None]]) * scene.scale
    if len(transforms) != len(BONE_NAMES) + 1:
        raise ValueError(f"expected {len(BONE_NAMES)} bones, got {len(transforms) - 1}")
    rows = np.zeros((len(transforms), 3, 4), np.float32)
    rows[:] = transforms
    return rows.tobytes()


def _projection(camera: PinholeCamera) -> bytes:
    """OpenGL clip matrix of a pinhole camera looking along +z with y down, column-major bytes."""
    a = (FAR_M + NEAR_M) / (FAR_M - NEAR_M)
    b = -2 * FAR_M * NEAR_M / (FAR_M - NEAR_M)
    matrix = np.array(
        [
            [2 * camera.fx / camera.width, 0, 2 * camera.cx / camera.width - 1, 0],
            [0, -2 * camera.fy / camera.height, 1 - 2 * camera.cy / camera.height, 0],
            [0, 0, a, b],
            [0, 0, 1, 0],
        ],
        np.float32,
    )
    return np.ascontiguousarray(matrix.T).tobytes()


def _frame(colour: np.ndarray, planes: np.ndarray, scene: SceneSpec) -> RenderedFrame:
    """Turns read-back planes (premultiplied colour; label and z) into a RenderedFrame with one common mask."""
    labels = planes[..., 0].astype(np.uint8)
    mask = (labels > 0).view(np.uint8)
    # Both passes clear to zero, so depth is already zero off the mask; coverage is made to agree with the labels.
    depth = np.ascontiguousarray(planes[..., 1])
    alpha = np.maximum(colour[..., 3], 1) * mask
    rgb = colour[..., :3] * mask[..., None]
    partial = (alpha > 0) & (alpha < 255)
    if partial.any():
        # Where some samples missed the hand, the resolved colour is darkened by the empty ones.
        straight = rgb[partial].astype(np.float32) * 255 / alpha[partial, None].astype(np.float32)
        rgb[partial] = np.clip(straight + 0.5, 0, 255).astype(np.uint8)
    return RenderedFrame(rgb, alpha, depth, labels, scene.joints_m, scene.present, scene.camera)
