"""Draws whole people with OpenGL: dressed meshes, posed on the CPU, in passes for shadows, labels and colour."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, Final

import numpy as np

from twohands.synth.render.people_maps import motif_map, strand_map, wrinkle_map
from twohands.synth.render.people_shaders import (
    CARD_FRAGMENT,
    CLOTH_FRAGMENT,
    EYE_FRAGMENT,
    HAIR_FRAGMENT,
    HANDS,
    INSIDE_FRAGMENT,
    LABEL_CLOTH,
    LABEL_HAIR,
    LABEL_SKIN,
    PERSON_VERTEX,
    SHADED_VERTEX,
    SHADOW_FRAGMENT,
    SHADOW_VERTEX,
    SHADOWS,
    SKIN_FRAGMENT,
)
from twohands.synth.render.person_mesh import PARTS, UNCUT, PersonMesh, person_mesh
from twohands.synth.render.shaders import MAX_LIGHTS
from twohands.synth.scene.body import posed_joints
from twohands.synth.scene.collision import capsules
from twohands.synth.scene.looks import PLAIN, Cloth, PersonLook, PersonSpec
from twohands.synth.scene.people import N_BONES, load_people
from twohands.synth.scene.spec import Lighting, arms_of

SHADOW_SIZE: Final = 224
"""Coarse: lamps are not points."""
HAT_LINE_M: Final = -0.048
"""Hair higher than this over the eyes is not seen under a hat."""
ROWS: Final = "2f 4f 4f 3f 1f"
STILL: Final = ("uv", "traits", "more", "rest", "part")


class _Loaded:
    """A person's mesh on the graphics side."""

    def __init__(self, ctx: Any, programs: dict[str, Any], mesh: PersonMesh) -> None:
        self.mesh = mesh
        self.moving = ctx.buffer(reserve=mesh.position.size * 2 * 4)
        still, faces = ctx.buffer(mesh.still.tobytes()), ctx.buffer(mesh.faces.tobytes())
        rows = [(self.moving, "3f 3f", "position", "normal"), (still, ROWS, *STILL)]
        self.arrays = {
            name: ctx.vertex_array(program, rows, faces, skip_errors=True) for name, program in programs.items()
        }
        self.kept = [self.moving, still, faces, *self.arrays.values()]

    def release(self) -> None:
        """Gives the memory back."""
        for part in self.kept:
            part.release()

    def pose(self, spec: PersonSpec) -> np.ndarray:
        """Moves the vertices; returns where they are, (V, 3), camera frame, scaled metres."""
        mesh = self.mesh
        moves = mesh.weight @ np.ascontiguousarray(spec.transforms.reshape(N_BONES, 12), np.float32)
        moves = moves.reshape(-1, 3, 4)
        rows = np.empty((len(moves), 6), np.float32)
        rows[:, :3] = np.einsum("vab,vb->va", moves[..., :3], mesh.position) + moves[..., 3]
        rows[:, 3:] = np.einsum("vab,vb->va", moves[..., :3], mesh.normal)
        self.moving.write(rows.tobytes())
        return rows[:, :3]

    def draw(self, program: str, first_part: str, last_part: str | None = None) -> None:
        """Draws parts with one of the programs."""
        start = self.mesh.first[PARTS.index(first_part)]
        stop = self.mesh.first[PARTS.index(last_part or first_part) + 1]
        if stop > start:
            self.arrays[program].render(first=3 * int(start), vertices=3 * int(stop - start))


class PeoplePass:
    """Draws the people of scenes into the renderer's framebuffers.

    Args:
        ctx: moderngl's context.
    """

    def __init__(self, ctx: Any) -> None:
        self.ctx = ctx
        fragments = {
            "skin": SKIN_FRAGMENT, "eyes": EYE_FRAGMENT, "cloth": CLOTH_FRAGMENT, "inside": INSIDE_FRAGMENT,
            "hair": HAIR_FRAGMENT, "card": CARD_FRAGMENT, "label": LABEL_SKIN,
            "label_cloth": LABEL_CLOTH, "label_hair": LABEL_HAIR,
        }  # fmt: skip
        self.programs = {
            name: ctx.program(
                vertex_shader=SHADED_VERTEX if name in ("skin", "cloth") else PERSON_VERTEX, fragment_shader=text
            )
            for name, text in fragments.items()
        }
        self.programs["shadow"] = ctx.program(vertex_shader=SHADOW_VERTEX, fragment_shader=SHADOW_FRAGMENT)
        asset = load_people()
        skin = asset.picture("skin")
        self.mean = _typical(skin)
        brown, blue = (_flipless(asset.picture(f"eye_{name}")) for name in ("brown", "blue"))
        pictures = {
            "skin_map": skin, "eye_brown": brown, "eye_blue": blue, "brow": asset.picture("brow"),
            "wrinkles": wrinkle_map(), "motifs": motif_map(), "strands": strand_map(),
        }  # fmt: skip
        self.textures = {name: self._texture(picture) for name, picture in pictures.items()}
        self._tile = lru_cache(maxsize=32)(lambda tile: self._texture(tile.picture))
        self.shadow_maps = [self._shadow_map() for _ in range(SHADOWS)]
        self.loaded: dict[tuple[Any, ...], tuple[_Loaded, PersonLook]] = {}

    def _texture(self, picture: np.ndarray) -> Any:
        height, width, channels = picture.shape
        texture = self.ctx.texture((width, height), channels, np.ascontiguousarray(picture).tobytes(), alignment=1)
        texture.build_mipmaps()
        texture.filter = (self.ctx.LINEAR_MIPMAP_NEAREST, self.ctx.LINEAR)
        return texture

    def _shadow_map(self) -> tuple[Any, Any]:
        texture = self.ctx.depth_texture((SHADOW_SIZE, SHADOW_SIZE))
        texture.compare_func = "<="
        texture.filter = (self.ctx.LINEAR, self.ctx.LINEAR)
        texture.repeat_x = texture.repeat_y = False
        return texture, self.ctx.framebuffer(depth_attachment=texture)

    def _load(self, spec: PersonSpec) -> _Loaded:
        key = (id(spec.look), tuple(spec.shape.tolist()), tuple(spec.present.tolist()))
        if key not in self.loaded:
            while len(self.loaded) >= 6:
                self.loaded.pop(next(iter(self.loaded)))[0].release()
            mesh = person_mesh(spec.look, spec.shape, (bool(spec.present[0]), bool(spec.present[1])))
            self.loaded[key] = (_Loaded(self.ctx, self.programs, mesh), spec.look)  # the look keeps its identity
        return self.loaded[key][0]

    def prepare(
        self, people: tuple[PersonSpec, ...], lighting: Lighting, projection: bytes, things: Any, corners: int
    ) -> None:
        """Poses the people and draws shadows; leaves another framebuffer in use.

        Args:
            people: the first is labelled.
            lighting: lamps.
            projection: clip matrix of the camera.
            things: vertex array of the things in the scene for the shadow program; unused without `corners`.
            corners: number of its vertices.
        """
        self.things, self.corners = things, corners
        self.people = [(spec, self._load(spec)) for spec in people]
        places = [loaded.pose(spec) for spec, loaded in self.people]
        scale = people[0].scale
        for name, program in self.programs.items():
            if name != "shadow":
                program["projection"].write(projection)
        lamps = lighting.positions * scale
        order = self._strongest(lamps, lighting.colours * scale**2, np.concatenate([p[::7] for p in places]))
        self._shadows(lamps, order, np.concatenate([p[::5] for p in places]), scale)
        positions, colours = np.zeros((MAX_LIGHTS, 3)), np.zeros((MAX_LIGHTS, 3))
        positions[: len(lamps)], colours[: len(lamps)] = lamps, lighting.colours * scale**2
        for name in ("skin", "eyes", "cloth", "inside", "hair", "card"):
            program = self.programs[name]
            _set(program, "light_position", positions.astype("f4").tobytes())
            _set(program, "light_colour", colours.astype("f4").tobytes())
            _set(program, "light_count", len(lamps))
            _set(program, "sky", tuple(lighting.sky))
            _set(program, "ground", tuple(lighting.ground))
            _set(program, "metre", scale)
            _set(program, "shadow_from", self.shadow_matrices.tobytes())
            _set(program, "texel", tuple(self.shadow_texels))
            _set(program, "shadow_of", [int(i) for i in order])
            for index, sampler in enumerate(("shadow_a", "shadow_b")):
                _set(program, sampler, index)

    @staticmethod
    def _strongest(lamps: np.ndarray, colours: np.ndarray, points: np.ndarray) -> np.ndarray:
        """(SHADOWS,) the lamps that matter most; the same one twice where there is one."""
        power = colours.sum(1) / ((lamps - np.median(points, axis=0)) ** 2).sum(1)
        return np.resize(np.argsort(-power), SHADOWS)

    def _shadows(self, lamps: np.ndarray, order: np.ndarray, points: np.ndarray, scale: float) -> None:
        low, high = points.min(0), points.max(0)
        self.shadow_matrices = np.zeros((SHADOWS, 4, 4), np.float32)
        self.shadow_texels = np.zeros(SHADOWS)
        self.ctx.disable(self.ctx.CULL_FACE)
        for index, lamp in enumerate(order):
            matrix = _lamp_matrix(lamps[lamp], (low + high) / 2, float(np.linalg.norm(high - low)) / 2, scale)
            self.shadow_texels[index] = (
                2 * np.linalg.norm(lamps[lamp] - (low + high) / 2) / np.linalg.norm(matrix[0, :3]) / SHADOW_SIZE
            )
            self.shadow_matrices[index] = matrix.T
            _, framebuffer = self.shadow_maps[index]
            framebuffer.use()
            framebuffer.clear(depth=1.0)
            self.programs["shadow"]["projection"].write(np.ascontiguousarray(matrix.T, np.float32).tobytes())
            for _, loaded in self.people:
                loaded.draw("shadow", "skin", "hair")
            if self.corners:
                self.things.render(vertices=self.corners)
        self.ctx.enable(self.ctx.CULL_FACE)

    def draw_arm(self, side: int) -> None:
        """Labels and depth of one arm of the first person alone into the framebuffer in use."""
        self._draw_labels(self.people[:1], (1.0 + 7 * side, 7.0 + 7 * side))

    def draw_labels(self) -> None:
        """Labels and depth of everybody into the framebuffer in use."""
        self._draw_labels(self.people, (0.0, 255.0))

    def _draw_labels(self, people: list[tuple[PersonSpec, _Loaded]], shown: tuple[float, float]) -> None:
        for number, (spec, loaded) in enumerate(people):
            for name in ("label", "label_cloth", "label_hair"):
                _set(self.programs[name], "labelled", float(number == 0))
                _set(self.programs[name], "shown", shown)
            loaded.draw("label", "skin", "eyes")
            self.ctx.disable(self.ctx.CULL_FACE)
            _set(self.programs["label_cloth"], "sleeve_from", spec.look.sleeve_from)
            loaded.draw("label_cloth", "cloth")
            _set(self.programs["label_hair"], "hat_line", HAT_LINE_M if spec.look.hat else -UNCUT)
            self._use("label_hair", "strands", 2, self.textures["strands"])
            loaded.draw("label_hair", "hair")
            self.ctx.enable(self.ctx.CULL_FACE)

    def draw_colour(self) -> None:
        """Everybody into the framebuffer in use."""
        for index, (texture, _) in enumerate(self.shadow_maps):
            texture.use(index)
        for spec, loaded in self.people:
            look = spec.look
            self._write_hands(spec)
            self._write_skin(look)
            loaded.draw("skin", "skin")
            eye = self.programs["eyes"]
            _set(eye, "iris", tuple(look.iris))
            self._use("eyes", "eye_map", 2, self.textures["eye_blue" if look.blue else "eye_brown"])
            loaded.draw("eyes", "eyes")
            self._write_cloth(look)
            loaded.draw("cloth", "cloth")
            self.ctx.cull_face = "front"
            loaded.draw("inside", "cloth")
            self.ctx.cull_face = "back"
            self.ctx.disable(self.ctx.CULL_FACE)
            hair = self.programs["hair"]
            _set(hair, "hair_albedo", tuple(look.hair_albedo))
            _set(hair, "white", look.grey)
            _set(hair, "hat_line", HAT_LINE_M if look.hat else -UNCUT)
            self._use("hair", "strands", 2, self.textures["strands"])
            loaded.draw("hair", "hair")
            self._draw_brows(look, loaded)
            self.ctx.enable(self.ctx.CULL_FACE)

    def _draw_brows(self, look: PersonLook, loaded: _Loaded) -> None:
        card = self.programs["card"]
        ctx = self.ctx
        ctx.enable(ctx.BLEND)
        ctx.blend_func = (ctx.SRC_ALPHA, ctx.ONE_MINUS_SRC_ALPHA, ctx.ZERO, ctx.ONE)
        _set(card, "card_albedo", tuple(0.8 * look.hair_albedo))
        _set(card, "strength", 1.7 * look.brow_strength)
        self._use("card", "card_map", 2, self.textures["brow"])
        loaded.draw("card", "brow")
        ctx.disable(ctx.BLEND)

    def _use(self, program: str, sampler: str, unit: int, texture: Any) -> None:
        texture.use(unit)
        _set(self.programs[program], sampler, unit)

    def _write_hands(self, spec: PersonSpec) -> None:
        """The person's hands and forearms as capsules."""
        body = arms_of(tuple(spec.shape.tolist()))
        joints = posed_joints(body, spec.arms)[spec.present] * spec.scale
        starts, ends, radii = capsules(body, joints)
        along = ends - starts
        rows = np.zeros((2, HANDS, 4), np.float32)
        rows[0, : len(radii)] = np.column_stack([starts, radii * spec.scale])
        rows[1, : len(radii)] = np.column_stack([along, 1 / (along**2).sum(1)])
        for name in ("skin", "cloth"):
            _set(self.programs[name], "capsule_from", rows[0].tobytes())
            _set(self.programs[name], "capsule_along", rows[1].tobytes())
            _set(self.programs[name], "capsule_count", len(radii))

    def _write_skin(self, look: PersonLook) -> None:
        skin = self.programs["skin"]
        _set(skin, "seed", tuple(look.seed))
        _set(skin, "mean", tuple(self.mean))
        _set(skin, "skin_albedo", tuple(look.skin_albedo))
        _set(skin, "palm_albedo", tuple(look.palm_albedo))
        _set(skin, "hair_albedo", tuple(look.hair_albedo))
        _set(skin, "lips", tuple(look.lips))
        # What is red on fair skin is hardly redder than the rest on dark skin.
        dark = 1 - min(float(look.skin_albedo.mean()) / 0.3, 1.0)
        _set(
            skin, "detail", tuple(look.skin_detail * np.array([1.0 - 0.1 * dark, 1.0 - 0.3 * dark, 1.0 - 0.35 * dark]))
        )
        _set(skin, "roughness", look.skin_roughness)
        _set(skin, "flushed", look.flushed)
        _set(skin, "stubble", look.stubble)
        _set(skin, "moustache", look.moustache)
        _set(skin, "scalp", 1.0 if look.hair else 0.75)
        _set(skin, "white", look.grey)
        self._use("skin", "skin_map", 2, self.textures["skin_map"])

    def _write_cloth(self, look: PersonLook) -> None:
        cloth = self.programs["cloth"]
        fabrics = [*look.clothes]
        white = np.full(3, 0.7)
        for colour, roughness in ((look.lanyard, 0.8), (look.glasses, 0.3), (look.hat_albedo, 0.9), (white, 0.4)):
            plain = white if colour is None else colour
            fabrics.append(Cloth(plain, plain, PLAIN, 0.01, 0.0, 0.0, 0.0, roughness))
        _set(cloth, "seed", tuple(look.seed))
        for program in (cloth, self.programs["inside"]):
            _set(program, "sleeve_from", look.sleeve_from)
            _set(program, "albedo", np.array([f.albedo for f in fabrics], np.float32).tobytes())
        _set(cloth, "second", np.array([f.second for f in fabrics], np.float32).tobytes())
        _set(
            cloth, "weave", np.array([[f.kind, f.period_m, f.turn, f.contrast] for f in fabrics], np.float32).tobytes()
        )
        _set(
            cloth,
            "finish",
            np.array([[f.wrinkles, f.roughness, f.fabric is not None] for f in fabrics], np.float32).tobytes(),
        )
        self._use("cloth", "wrinkles", 2, self.textures["wrinkles"])
        _set(cloth, "tile", 3)
        self._use("cloth", "motifs", 4, self.textures["motifs"])
        own = next((f.fabric for f in fabrics if f.fabric is not None), None)
        if own is not None:
            height, width = own.tile.picture.shape[:2]
            c, s = np.cos(own.turn), np.sin(own.turn)
            tiling = np.array([[c, -s], [s * width / height, c * width / height]]) / own.period_m
            _set(cloth, "tiling", np.ascontiguousarray(tiling.T, np.float32).tobytes())
            _set(cloth, "tile_mean", tuple(own.tile.mean))
            self._tile(own.tile).use(3)


def _set(program: Any, name: str, value: Any) -> None:
    """Sets a uniform, unless the compiler found it unused."""
    if name in program:
        if isinstance(value, bytes):
            program[name].write(value)
        else:
            program[name].value = value


def _flipless(picture: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(picture)


def _typical(skin: np.ndarray) -> np.ndarray:
    """(3,) colour of plain skin on the map, by squares."""
    plain = skin[skin.max(-1) > 60].reshape(-1, 3)
    return (np.median(plain, axis=0) / 255) ** 2


def _lamp_matrix(lamp: np.ndarray, centre: np.ndarray, radius: float, scale: float) -> np.ndarray:
    """(4, 4) into the clip space of a lamp's picture that shows a ball."""
    offset = centre - lamp
    distance = float(np.linalg.norm(offset))
    forward = offset / distance
    side = np.cross([0.0, 1.0, 0.0] if abs(forward[1]) < 0.9 else [1.0, 0.0, 0.0], forward)
    side /= np.linalg.norm(side)
    turn = np.stack([side, np.cross(forward, side), forward])
    half = np.tan(min(np.arcsin(min(radius / distance, 1.0)), np.radians(55)))
    near, far = max(distance - radius, 0.08 * scale), distance + radius
    out = np.zeros((4, 4))
    out[0, :3], out[1, :3] = turn[0] / half, turn[1] / half
    out[2, :3] = turn[2] * (far + near) / (far - near)
    out[3, :3] = turn[2]
    out[:, 3] = out[:, :3] @ -lamp
    out[2, 3] -= 2 * far * near / (far - near)
    return out
