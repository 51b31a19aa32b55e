"""OpenGL renderer (moderngl on EGL, extra `synth`): a few milliseconds a frame in software, less on a GPU.

Every vertex is posed and shaded once, into a buffer; two passes draw that buffer's triangles: one multi-sampled for
colour and coverage, one single-sampled for exact labels and depth.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, lru_cache
from typing import Any

import cv2
import numpy as np

from twohands.errors import MissingExtraError, RendererError
from twohands.skeleton import N_PART_LABELS
from twohands.synth.render.chart import chart
from twohands.synth.render.compositing import partly_covered
from twohands.synth.render.markings import HIGH, LOW, on_painting, paint_markings
from twohands.synth.render.people import PeoplePass
from twohands.synth.render.shaders import (
    LABEL_FRAGMENT,
    LABEL_VERTEX,
    MAX_CAPSULES,
    MAX_LIGHTS,
    POSE_VERTEX,
    POSED,
    THING_FRAGMENT,
    THING_VERTEX,
    colour_shaders,
)
from twohands.synth.render.surface import posed_things, surface
from twohands.synth.scene.body import BONE_NAMES, load_asset
from twohands.synth.scene.collision import capsules
from twohands.synth.scene.fabrics import Tile
from twohands.synth.scene.spec import PATTERNS, SceneSpec, moved
from twohands.synth.scene.things import vertex_normals
from twohands.types import PinholeCamera, RenderedFrame

NEAR_M, FAR_M = 0.01, 4.0
PEOPLE_FAR_M = 12.0
"""Farthest distance that is drawn, without and with whole people."""
MARKINGS_UNIT, TILE_UNIT = 0, 1
"""Of textures."""
KEPT_TILES = 64
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
            f"no OpenGL context ({error}); on Debian or Ubuntu: apt-get install libegl1 libgl1-mesa-dri; "
            "or render with Blender, slowly: --renderer blender, after pip install 'twohands[blender]' (Python 3.11)"
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
        RendererError: no OpenGL context can be made, or it draws no pictures of this size.
    """

    def __init__(self, width: int, height: int, samples: int = 4) -> None:
        self.width, self.height = width, height
        self.ctx = ctx = create_context()
        largest = ctx.info["GL_MAX_RENDERBUFFER_SIZE"]
        if max(width, height) > largest:
            raise RendererError(f"OpenGL draws at most {largest} pixels a side here, got {width}x{height}")
        asset, attributes = load_asset(), surface()
        self._first_face = attributes.first_face
        self._face_count = len(attributes.faces)
        rest_weight = 1 - asset.bone_weight.sum(1, keepdims=True)
        skinning = [asset.bone_index[:, :8], asset.bone_weight[:, :8], rest_weight, attributes.along[:, None]]
        looks = [attributes.label, attributes.palmar, attributes.flush, attributes.nail, attributes.along]
        self._shape_key: tuple[float, ...] | None = None
        self._shape = ctx.buffer(reserve=asset.n_vertices * 6 * 4)
        self._posed = ctx.buffer(reserve=asset.n_vertices * 14 * 4)
        look_buffer, index_buffer = _vertex_buffer(ctx, looks), ctx.buffer(attributes.faces.tobytes())
        self._pose = ctx.program(vertex_shader=POSE_VERTEX, varyings=POSED)
        self._label = ctx.program(vertex_shader=LABEL_VERTEX, fragment_shader=LABEL_FRAGMENT)
        self._colour = lru_cache(maxsize=None)(self._colour_pass)
        self._markings = lru_cache(maxsize=PATTERNS)(self._paint)
        self._tile = lru_cache(maxsize=KEPT_TILES)(self._upload_tile)
        names = ("bones_a", "bones_b", "weights_a", "weights_b", "resting", "along")
        self._rest_array = ctx.vertex_array(
            self._pose,
            [
                (self._shape, "3f 3f", "position", "normal"),
                (_vertex_buffer(ctx, skinning), "4f 4f 4f 4f 1f 1f", *names),
            ],
        )
        self._label_array = ctx.vertex_array(
            self._label,
            [(self._posed, "3f 44x", "camera_position"), (look_buffer, "1f 24x", "part")],
            index_buffer,
        )
        self._colour_rows = [
            (self._posed, "3f 3f 3f 4f 1f", *POSED),
            (self._shape, "3f 12x", "position"),
            (look_buffer, "4x 2f 3f 1f", "look", "nail", "along"),
        ]
        painted_at = np.column_stack([on_painting(chart().vertices[:, :2]), chart().vertices[:, 2]])
        self._chart_rows = (_vertex_buffer(ctx, [painted_at]), "3f", "chart")
        self._faces = index_buffer

        self._thing_rows, self._thing_faces = ctx.buffer(reserve=44), ctx.buffer(reserve=12)
        self._thing = ctx.program(vertex_shader=THING_VERTEX, fragment_shader=THING_FRAGMENT)
        self._thing_label = ctx.program(vertex_shader=THING_VERTEX, fragment_shader=LABEL_FRAGMENT)
        row = (self._thing_rows, "3f 3f 3f 1f 1f", "position", "normal", "albedo", "roughness", "part")
        self._thing_arrays = [
            ctx.vertex_array(program, [row], self._thing_faces, skip_errors=True)
            for program in (self._thing, self._thing_label)
        ]

        size = (width, height)
        samples = min(samples, ctx.max_samples)
        self._multisampled = ctx.framebuffer(
            [ctx.renderbuffer(size, 4, samples=samples)], ctx.depth_renderbuffer(size, samples=samples)
        )
        self._resolved = ctx.framebuffer([ctx.renderbuffer(size, 4)])
        self._labelled = ctx.framebuffer(
            [ctx.renderbuffer(size, 1), ctx.renderbuffer(size, 1, dtype="f4")], ctx.depth_renderbuffer(size)
        )
        ctx.enable(ctx.DEPTH_TEST | ctx.CULL_FACE)
        ctx.front_face = "cw"  # pictures are drawn head down, so that rows are read from the top

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
        with self.ctx:  # other renderers of this process have contexts of their own
            return self._render(scene)

    @cached_property
    def _people(self) -> PeoplePass:
        return PeoplePass(self.ctx)

    @cached_property
    def _thing_shadow(self) -> Any:
        row = (self._thing_rows, "3f 32x", "position")
        return self.ctx.vertex_array(self._people.programs["shadow"], [row], self._thing_faces)

    def _render(self, scene: SceneSpec) -> RenderedFrame:
        if scene.people:
            return self._render_people(scene)
        self._upload_shape(scene)
        projection = _projection(scene.camera)
        self._pose["bones"].write(_palette(scene))
        colour, colour_array = self._colour(scene.skin.detail is not None, scene.clothes.fabric is not None)
        for program in (colour, self._label, self._thing, self._thing_label):
            program["projection"].write(projection)
        self._write_look(scene, colour)
        corners = self._write_things(scene)
        self._write_occluders(scene)
        self._labelled.use()  # before the vertices: without a complete framebuffer OpenGL draws nothing
        self._rest_array.transform(self._posed)
        self.ctx.clear(0.0, 0.0, 0.0, 0.0)
        self._draw(self._label_array, scene.present)
        if corners:
            self._thing_arrays[1].render(vertices=corners)
        return self._drawn(scene, corners, lambda: self._draw(colour_array, scene.present))

    def _render_people(self, scene: SceneSpec) -> RenderedFrame:
        projection = _projection(scene.camera, PEOPLE_FAR_M)
        for program in (self._thing, self._thing_label):
            program["projection"].write(projection)
        self._write_light(scene, (self._thing,))
        corners = self._write_things(scene)
        self._people.prepare(scene.people, scene.lighting, projection, self._thing_shadow, corners)
        self._labelled.use()
        self.ctx.clear(0.0, 0.0, 0.0, 0.0)
        self._people.draw_labels()
        if corners:
            self._thing_arrays[1].render(vertices=corners)
        return self._drawn(scene, corners, self._people.draw_colour)

    def _drawn(self, scene: SceneSpec, corners: int, draw: Callable[[], None]) -> RenderedFrame:
        """The frame whose labels have been drawn, after colour has."""
        shape = (self.height, self.width)
        labels = np.frombuffer(self._labelled.read(components=1, alignment=1), np.uint8).reshape(shape)
        depth = np.frombuffer(self._labelled.read(components=1, attachment=1, dtype="f4"), np.float32).reshape(shape)
        colour = np.zeros((*shape, 4), np.uint8)
        # Only pixels with a label keep their colour: nothing else need be cleared, drawn or resolved.
        u, v, width, height = area = cv2.boundingRect(labels)
        if width:
            self._multisampled.scissor = area  # holds for the copy too
            self._multisampled.use()
            self.ctx.clear(0.0, 0.0, 0.0, 0.0)
            draw()
            if corners:
                self._thing_arrays[0].render(vertices=corners)
            self.ctx.copy_framebuffer(self._resolved, self._multisampled)
            pixels = np.frombuffer(self._resolved.read(viewport=area, components=4), np.uint8)
            colour[v : v + height, u : u + width] = pixels.reshape(height, width, 4)
        return _frame(colour, labels, depth, scene)

    def amodal(self, scene: SceneSpec) -> np.ndarray:
        """Amodal masks of a scene that was just rendered.

        Returns:
            (2, H, W) bool, the pixels that each arm covers when it is drawn alone, with what it wears.
        """
        masks = np.zeros((2, self.height, self.width), bool)
        first_corners = np.cumsum([0, *(thing.faces.size for thing in scene.things)])
        with self.ctx:
            self._labelled.use()
            for side in np.flatnonzero(scene.present):
                self.ctx.clear(0.0, 0.0, 0.0, 0.0)
                if scene.people:
                    self._people.draw_arm(int(side))
                else:
                    self._draw(self._label_array, np.arange(2) == side)
                for first, thing in zip(first_corners, scene.things, strict=False):
                    if thing.side == side:
                        self._thing_arrays[1].render(first=int(first), vertices=thing.faces.size)
                labels = np.frombuffer(self._labelled.read(components=1, alignment=1), np.uint8)
                masks[side] = labels.reshape(self.height, self.width) > 0
        return masks

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
        self._shape.write(np.ascontiguousarray(data, np.float32).tobytes())
        self._shape_key = key

    def _colour_pass(self, detailed: bool, woven: bool) -> tuple[Any, Any]:
        """The program that draws arms in colour, and its vertices; what a scene lacks costs nothing."""
        vertex, fragment = colour_shaders(detailed=detailed, woven=woven)
        program = self.ctx.program(vertex_shader=vertex, fragment_shader=fragment)
        rows = [*self._colour_rows, self._chart_rows] if detailed or woven else self._colour_rows
        for name, unit in (("markings", MARKINGS_UNIT), ("tile", TILE_UNIT)):
            if name in program:
                program[name].value = unit
        return program, self.ctx.vertex_array(program, rows, self._faces)

    def _paint(self, pattern: int) -> Any:
        """The texture of veins and creases with this number."""
        painted = paint_markings(pattern)
        sheets, height, width, channels = painted.shape
        texture = self.ctx.texture_array((width, height, sheets), channels, painted.tobytes(), alignment=1)
        texture.build_mipmaps()
        texture.filter = (self.ctx.LINEAR_MIPMAP_NEAREST, self.ctx.LINEAR)
        texture.repeat_x = texture.repeat_y = False  # beyond the border: nothing
        return texture

    def _upload_tile(self, tile: Tile) -> Any:
        """The texture of a fabric."""
        height, width = tile.picture.shape[:2]
        texture = self.ctx.texture((width, height), 3, tile.picture.tobytes(), alignment=1)
        texture.build_mipmaps()
        texture.filter = (self.ctx.LINEAR_MIPMAP_NEAREST, self.ctx.LINEAR)
        return texture

    def _write_light(self, scene: SceneSpec, programs: tuple[Any, ...]) -> None:
        light = scene.lighting
        positions, colours = np.zeros((MAX_LIGHTS, 3)), np.zeros((MAX_LIGHTS, 3))
        positions[: len(light.positions)] = light.positions
        colours[: len(light.colours)] = light.colours
        for program in programs:
            # Lights stand in the body's metres, so that scaling the world leaves the picture as it is.
            program["light_position"].write((positions * scene.scale).astype("f4").tobytes())
            program["light_colour"].write((colours * scene.scale**2).astype("f4").tobytes())
            program["light_count"].value = len(light.positions)
            if "sky" in program:
                program["sky"].value = tuple(light.sky)
                program["ground"].value = tuple(light.ground)

    def _write_look(self, scene: SceneSpec, colour: Any) -> None:
        skin, clothes = scene.skin, scene.clothes
        self._write_light(scene, (colour, self._pose, self._thing))
        for program in (colour, self._pose):
            program["sleeve_from"].value = min(clothes.sleeve_from, NOWHERE)
            program["glove_until"].value = max(clothes.glove_until, -NOWHERE)
            program["sleeve_albedo"].value = tuple(clothes.sleeve_albedo)
            program["albedo"].value = tuple(skin.albedo)
            program["noise_offset"].value = tuple(skin.seed)
        self._pose["thickness"].value = clothes.thickness_m
        colour["palm_albedo"].value = tuple(skin.palm_albedo)
        colour["nail_albedo"].value = tuple(skin.nail_albedo)
        colour["glove_albedo"].value = tuple(clothes.glove_albedo)
        colour["pattern"].value = tuple(clothes.pattern)
        colour["roughness"].value = skin.roughness
        colour["mottle"].value = skin.mottle
        if skin.detail is not None:
            detail = skin.detail
            colour["detail"].value = detail.veins, detail.creases, detail.freckles, detail.moles
            self._markings(detail.pattern).use(MARKINGS_UNIT)
        fabric = clothes.fabric
        if fabric is not None:
            height, width = fabric.tile.picture.shape[:2]
            c, s = np.cos(fabric.turn), np.sin(fabric.turn)
            weave = np.array([[c, -s], [s * width / height, c * width / height]]) / fabric.period_m * (HIGH - LOW)
            colour["weave"].write(np.ascontiguousarray(weave.T, np.float32).tobytes())
            colour["mean"].value = tuple(fabric.tile.mean)
            self._tile(fabric.tile).use(TILE_UNIT)

    def _write_things(self, scene: SceneSpec) -> int:
        """Uploads the things; returns the number of their triangles' corners."""
        mesh = posed_things(scene)
        if mesh is None:
            return 0
        rows = np.column_stack([mesh.position, mesh.normal, mesh.albedo, mesh.roughness, mesh.label])
        for buffer, part, kind in ((self._thing_rows, rows, np.float32), (self._thing_faces, mesh.faces, np.int32)):
            data = part.astype(kind).tobytes()
            buffer.orphan(len(data))
            buffer.write(data)
        return mesh.faces.size

    def _write_occluders(self, scene: SceneSpec) -> None:
        starts, ends, radii = capsules(scene.body, scene.joints_m[scene.present])
        self._pose["bone_count"].value = len(radii)
        held = [thing.core for thing in scene.things if thing.core is not None]
        if held:
            axes = moved(scene.view, np.stack([axis for axis, _ in held])) * scene.scale
            starts, ends = np.concatenate([starts, axes[:, 0]]), np.concatenate([ends, axes[:, 1]])
            radii = np.concatenate([radii, [radius for _, radius in held]])
        along = ends - starts
        rows = np.zeros((2, MAX_CAPSULES, 4), np.float32)
        count = len(radii)
        rows[0, :count] = np.concatenate([starts, radii[:, None] * scene.scale], axis=1)
        rows[1, :count] = np.concatenate([along, 1 / (along**2).sum(1, keepdims=True)], axis=1)
        self._pose["capsule_from"].write(rows[0].tobytes())
        self._pose["capsule_along"].write(rows[1].tobytes())
        self._pose["capsule_count"].value = count


def _vertex_buffer(ctx: Any, columns: list[np.ndarray]) -> Any:
    """A buffer of float32 rows, one per vertex, from arrays of V rows or V numbers."""
    return ctx.buffer(np.column_stack(columns).astype(np.float32).tobytes())


def _palette(scene: SceneSpec) -> bytes:
    """Bone transforms with the scene's scale, and the resting torso last, as mat4x3 columns."""
    transforms = np.concatenate([scene.transforms, scene.view[None]]) * scene.scale
    if len(transforms) != len(BONE_NAMES) + 1:
        raise ValueError(f"expected {len(BONE_NAMES)} bones, got {len(transforms) - 1}")
    rows = np.zeros((len(transforms), 3, 4), np.float32)
    rows[:] = transforms
    return rows.tobytes()


def _projection(camera: PinholeCamera, far_m: float = FAR_M) -> bytes:
    """OpenGL clip matrix of a pinhole camera looking along +z with y down, row 0 lowest, column-major bytes."""
    a = (far_m + NEAR_M) / (far_m - NEAR_M)
    b = -2 * far_m * NEAR_M / (far_m - NEAR_M)
    matrix = np.array(
        [
            [2 * camera.fx / camera.width, 0, 2 * camera.cx / camera.width - 1, 0],
            [0, 2 * camera.fy / camera.height, 2 * camera.cy / camera.height - 1, 0],
            [0, 0, a, b],
            [0, 0, 1, 0],
        ],
        np.float32,
    )
    return np.ascontiguousarray(matrix.T).tobytes()


def _frame(colour: np.ndarray, labels: np.ndarray, depth: np.ndarray, scene: SceneSpec) -> RenderedFrame:
    """A RenderedFrame with one common mask, from planes that were cleared to zero and premultiplied colour."""
    mask = np.minimum(labels, 1)
    hands = cv2.inRange(labels, 1, N_PART_LABELS - 1)
    labels, depth = cv2.copyTo(labels, hands), cv2.copyTo(depth, hands)
    rgba = cv2.copyTo(colour, mask)
    rgb, alpha = cv2.cvtColor(rgba, cv2.COLOR_RGBA2RGB), np.maximum(cv2.extractChannel(rgba, 3), mask)
    # Where some samples missed the hand, the resolved colour is darkened by the empty ones.
    partial = partly_covered(alpha)
    darkened = rgb.reshape(-1, 3)[partial].astype(np.float32)
    straight = darkened * (255 / alpha.ravel()[partial, None].astype(np.float32))
    rgb.reshape(-1, 3)[partial] = np.clip(straight + 0.5, 0, 255).astype(np.uint8)
    return RenderedFrame(rgb, alpha, depth, labels, scene.joints_m, scene.present, scene.camera)
