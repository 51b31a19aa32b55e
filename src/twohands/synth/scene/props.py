"""Things of everyday life, as meshes: cups, bottles, telephones, pens, plates, books, sheets, tables and chairs.

Frame of a thing of its own: metres, z up where it stands (cups, plates), or out of its front (telephones, books).
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from twohands.skeleton import LEFT, RIGHT
from twohands.synth.scene.body import Body
from twohands.synth.scene.collision import capsules, segment_distance
from twohands.synth.scene.pose import unit
from twohands.synth.scene.prop_meshes import Mesh, lathed, merged, slab, tube
from twohands.synth.scene.things import Thing, grasped, muted_colour

CUP_REACH_M: Final = 0.024
"""A cup or bottle is at most this far from palm and fingers."""


def mug(rng: np.random.Generator, radius: float) -> Mesh:
    """With a handle towards +x, or without one: a paper cup, a glass."""
    height, wall = rng.uniform(0.085, 0.11) * max(radius, 0.03) / 0.04, 0.003
    colour, taper = muted_colour(rng), rng.uniform(0.85, 1.0)
    inside = colour if rng.random() < 0.5 else np.full(3, 0.7)
    drink = np.array([[0.05, 0.025, 0.012], [0.25, 0.12, 0.04], [0.6, 0.6, 0.6]])[rng.integers(3)]
    band = muted_colour(rng) if rng.random() < 0.4 else colour
    low, up, full = radius * taper, height / 2, height * rng.uniform(0.1, 0.35)
    profile = [(0.0, -up), (low * 0.92, -up), (low, -up + 0.003), (low + (radius - low) * 0.3, -up * 0.4)]
    profile += [(low + (radius - low) * 0.32, -up * 0.38), (radius * 0.99, up * 0.5), (radius * 0.99, up * 0.52)]
    profile += [(radius, up - 0.001), (radius - wall / 2, up), (radius - wall, up - 0.001), (radius - wall, full)]
    profile += [(radius - wall - 0.001, full - 0.001), (0.0, full - 0.001)]
    colours = np.array([colour] * 4 + [band] * 2 + [colour] * 2 + [inside] * 3 + [drink] * 2)
    body = lathed(profile, colours, rng.uniform(0.15, 0.6))
    if rng.random() < 0.35:
        return body
    turn = np.linspace(-np.pi / 2 - 0.35, np.pi / 2 + 0.35, 10)
    path = np.stack([radius * 0.97 + 0.024 * np.cos(turn), 0 * turn, 0.03 * np.sin(turn)], axis=-1)
    return merged(body, tube(path, 0.0048, colour, body.roughness))


def bottle(rng: np.random.Generator, radius: float) -> Mesh:
    """A bottle or a can."""
    colour, cap = muted_colour(rng), muted_colour(rng)
    label = muted_colour(rng)
    if radius > 0.025 and rng.random() < 0.35:
        up = 0.06
        profile = [(0.0, -up), (radius * 0.8, -up), (radius, -up + 0.008), (radius, up - 0.008), (radius * 0.85, up)]
        return lathed([*profile, (radius * 0.84, up - 0.002), (0.0, up - 0.002)], colour, 0.25)
    up = rng.uniform(0.085, 0.12)
    profile = [(0.0, -up), (radius * 0.92, -up), (radius, -up + 0.006), (radius, -up * 0.45), (radius, -up * 0.43)]
    profile += [(radius, up * 0.15), (radius, up * 0.17), (radius, up * 0.35), (radius * 0.42, up * 0.8)]
    profile += [(radius * 0.42, up * 0.86), (radius * 0.46, up * 0.87), (radius * 0.46, up), (0.0, up)]
    return lathed(profile, np.array([colour] * 4 + [label] * 2 + [colour] * 4 + [cap] * 3), rng.uniform(0.1, 0.4))


def stick(rng: np.random.Generator, radius: float, half_length: float) -> Mesh:
    """A pen, a brush, a marker, a remote."""
    colour, tip, end = muted_colour(rng), muted_colour(rng), half_length
    profile = [(0.0, -end), (radius * 0.3, -end + radius), (radius, -end + 4 * radius), (radius, -end + 4.5 * radius)]
    profile += [
        (radius, end * 0.55),
        (radius * 1.08, end * 0.56),
        (radius * 1.08, end - radius),
        (radius * 0.5, end),
        (0, end),
    ]
    return lathed(profile, np.array([tip] * 3 + [colour] * 2 + [tip] * 4), rng.uniform(0.15, 0.5), columns=12)


def plate(rng: np.random.Generator, radius: float) -> Mesh:
    """With something to eat, or empty."""
    colour = np.full(3, rng.uniform(0.5, 0.85)) if rng.random() < 0.7 else muted_colour(rng)
    food = muted_colour(rng) if rng.random() < 0.5 else colour
    profile = [(0.0, 0.0), (radius * 0.55, 0.0), (radius * 0.7, 0.006), (radius, 0.018), (radius - 0.002, 0.0205)]
    profile += [
        (radius * 0.7, 0.010),
        (radius * 0.58, 0.006),
        (radius * 0.5, 0.007 + 0.01 * rng.random()),
        (0.0, 0.012),
    ]
    return lathed(profile, np.array([colour] * 7 + [food] * 2), rng.uniform(0.15, 0.5), columns=36)


def screen(rng: np.random.Generator, rows: int = 22, columns: int = 12) -> np.ndarray:
    """(rows, columns, 3) what a display shows: dark, or windows and pictures."""
    if rng.random() < 0.3:
        return np.full((rows, columns, 3), 0.012)
    image = np.empty((rows, columns, 3))
    image[:] = rng.uniform(0.02, 0.9, 3) if rng.random() < 0.5 else rng.choice([0.05, 0.85])
    for _ in range(int(rng.integers(2, 8))):
        top, left = rng.integers(rows - 2), rng.integers(columns - 2)
        image[top : top + rng.integers(1, 6), left : left + rng.integers(2, 10)] = rng.uniform(0.02, 0.9, 3)
    return image * rng.uniform(0.5, 1.0)


def framed(image: np.ndarray, border: np.ndarray, cells: int = 1) -> np.ndarray:
    """The image (H, W, 3) with a border of so many cells in another colour (3,)."""
    out = np.empty((image.shape[0] + 2 * cells, image.shape[1] + 2 * cells, 3))
    out[:] = border
    out[cells:-cells, cells:-cells] = image
    return out


def phone(rng: np.random.Generator) -> Mesh:
    """Upright along y, its screen towards +z."""
    case = np.full(3, 0.02) if rng.random() < 0.6 else muted_colour(rng)
    size = rng.uniform(0.066, 0.078), rng.uniform(0.138, 0.162), rng.uniform(0.008, 0.011)
    return slab(size, 0.01, framed(screen(rng), np.full(3, 0.01)), case, 0.18)


def page(rng: np.random.Generator, rows: int = 34, columns: int = 20) -> np.ndarray:
    """(rows, columns, 3) lines of text, with a picture here and there."""
    image = np.empty((rows, columns, 3))
    image[:] = rng.uniform(0.55, 0.85) * np.array([1.0, 0.97, 0.9])
    if rng.random() < 0.75:
        for row in range(3, rows - 3, 2):
            image[row, 2 : 2 + int(rng.integers(columns // 2, columns - 3))] *= rng.uniform(0.35, 0.7)
    if rng.random() < 0.4:
        top = int(rng.integers(2, rows - 12))
        image[top : top + 9, 3:-3] = rng.uniform(0.05, 0.8, 3)
    return image


def tablet(rng: np.random.Generator, width: float, height: float) -> Mesh:
    """A screen, a sheet of paper, a card, a closed book or a tray of that size, towards +z."""
    kind = rng.random()
    if kind < 0.35:
        bezel = np.full(3, rng.choice([0.012, 0.5]))
        return slab((width, height, 0.008), 0.012, framed(screen(rng, 18, 24), bezel), np.full(3, 0.1), 0.2)
    if kind < 0.7:
        return slab((width, height, 0.0015), 0.002, page(rng), np.full(3, 0.75), 0.85)
    cover = muted_colour(rng)
    printed = framed(np.broadcast_to(muted_colour(rng), (4, 8, 3)), cover, 4)
    return slab((width, height, rng.uniform(0.012, 0.03)), 0.003, printed, cover, 0.6)


def book(rng: np.random.Generator, width: float, height: float) -> Mesh:
    """Open towards +z, both pages together `width` wide."""
    fold, cover = np.radians(rng.uniform(6, 24)), muted_colour(rng)
    thick, halves = rng.uniform(0.006, 0.016), []
    for sign in (-1, 1):
        half = slab((width / 2, height, thick), 0.003, page(rng, 30, 16), cover, 0.8)
        c, s = np.cos(fold), np.sin(fold) * sign
        turn = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
        vertices = half.vertices @ turn.T + [sign * width / 4 * c, 0, width / 4 * np.sin(fold)]
        halves.append(Mesh(vertices, half.normals @ turn.T, half.faces, half.colours, half.roughness))
    return merged(*halves)


def table_top(rng: np.random.Generator, width: float, depth: float) -> Mesh:
    """Its upper face towards +z, at z = 0; of wood, white, grey or any colour, or under a cloth."""
    kind = rng.random()
    base = np.array([0.32, 0.18, 0.085]) * rng.uniform(0.3, 2.0) if kind < 0.5 else np.full(3, rng.uniform(0.02, 0.8))
    base = base if kind < 0.85 else muted_colour(rng)
    grain = np.ones((40, 60, 1))
    if kind < 0.5:
        lines = cv2.resize(rng.normal(0, 1, (40, 4)), (60, 40), interpolation=cv2.INTER_LINEAR)
        grain = np.exp(0.22 * lines)[..., None]
    top = slab((width, depth, 0.03), 0.02, np.clip(base * grain, 0.01, 0.85), base * 0.8, rng.uniform(0.2, 0.8))
    return Mesh(top.vertices - [0, 0, 0.015], top.normals, top.faces, top.colours, top.roughness)


def fitted_slab(
    body: Body, hands: np.ndarray, frame: np.ndarray, centre: np.ndarray, half: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray] | None:
    """Where a flat thing lies free of the hands, near where it should.

    Args:
        body: whose hands.
        hands: (H, 22, 3) posed joints.
        frame: (3, 3) columns across, along and out of the front.
        centre: (3,).
        half: (3,) half sizes.
        rng: the only source of randomness.

    Returns:
        Its frame and centre, or None where it would enter a hand by more than flesh yields.
    """
    tries = 40
    turns = rng.normal(0, 0.16, (tries, 3))
    turns[0] = 0
    moves = rng.normal(0, 1, (tries, 3)) * [0.012, 0.008, 0.011]
    moves[0] = 0
    frames = np.stack([frame @ np.asarray(cv2.Rodrigues(turn)[0]) for turn in turns])
    centres = centre + moves @ frame.T
    lines = np.linspace(-0.92, 0.92, 7) * half[0]
    starts = centres[:, None] + frames[:, None, :, 0] * lines[:, None] - frames[:, None, :, 1] * half[1] * 0.97
    ends = starts + 2 * 0.97 * half[1] * frames[:, None, :, 1]
    a, b, radii = capsules(body, hands)
    gap = segment_distance(starts[:, :, None], ends[:, :, None], a, b) - radii
    free = gap.min((1, 2)) - half[2]
    best = int(free.argmax())
    return None if free[best] < -0.007 else (frames[best], centres[best])


def phone_in_hand(body: Body, joints: np.ndarray, side: int, up: np.ndarray, rng: np.random.Generator) -> Thing | None:
    """A telephone along the palm, its back to the palm and the fingers on its edge.

    Args:
        body, joints: whose hands (2, 22, 3).
        side: the hand that holds it.
        up: (3,) direction of the telephone's upper end.
        rng: the only source of randomness.
    """
    hand = joints[side, 1:]
    along = unit(hand[5] - hand[17])
    out = unit(np.cross(hand[9] - hand[0], along)) * (1 if side == LEFT else -1)
    along = along * (1 if along @ up > 0 else -1)
    across = np.cross(along, out)
    mesh = phone(rng)
    half = np.array([0.036, 0.075, 0.005])
    fingers = unit(hand[9] - hand[0])
    centre = hand[[5, 9, 13, 17]].mean(0) + out * 0.026 - fingers * 0.008 + along * rng.uniform(0, 0.03)
    found = fitted_slab(body, joints, np.stack([across, along, out], 1), centre, half, rng)
    return None if found is None else mesh.placed(*found)


def rod_in_hand(body: Body, joints: np.ndarray, side: int, up: np.ndarray, rng: np.random.Generator) -> Thing | None:
    """A cup, glass, bottle, can or stick as thick as the hand is open; arguments as of `phone_in_hand`."""
    rod = grasped(body, joints, np.arange(2) == side, side, rng, (0.04, 0.05), CUP_REACH_M)
    if rod is None:
        return None
    centre, axis, _, radius = rod
    axis = axis * (1 if axis @ up > 0 else -1)
    outward = centre - joints[side, 1 + 9]
    turn = rng.uniform(-1.0, 1.0)
    x = unit(outward - axis * (outward @ axis))
    y = np.cross(axis, x)
    x = np.cos(turn) * x + np.sin(turn) * y
    frame = np.stack([x, np.cross(axis, x), axis], 1)
    radius *= 0.97
    if radius < 0.017:
        return stick(rng, radius, rng.uniform(0.06, 0.09)).placed(frame, centre)
    mesh = mug(rng, radius) if radius > 0.021 and rng.random() < 0.6 else bottle(rng, radius)
    return mesh.placed(frame, centre + axis * rng.uniform(-0.01, 0.02))


def pen_in_hand(joints: np.ndarray, side: int, rng: np.random.Generator) -> Thing:
    """Between thumb and index finger, leaning on the web between them; arguments as of `phone_in_hand`."""
    hand = joints[side, 1:]
    grip, web = (hand[4] + hand[8]) / 2, (hand[5] + hand[2]) / 2
    axis = unit(web - grip + rng.normal(0, 0.006, 3))
    x = unit(np.cross(axis, [0.3, 0.5, 0.8]))
    half = rng.uniform(0.065, 0.075)
    frame = np.stack([x, np.cross(axis, x), axis], 1)
    return stick(rng, rng.uniform(0.0035, 0.005), half).placed(frame, grip + axis * (half - rng.uniform(0.022, 0.035)))


def flat_in_hand(body: Body, joints: np.ndarray, side: int, rng: np.random.Generator) -> Thing | None:
    """A sheet, book, tablet or plate, its edge between thumb and fingers; arguments as of `phone_in_hand`."""
    hand = joints[side, 1:]
    pads = hand[[7, 8, 11, 12]].mean(0)
    out = unit(hand[4] - pads)  # the thumb lies on the front
    across = unit((hand[8] + hand[12]) / 2 - hand[[5, 9]].mean(0))
    across = unit(across - out * (across @ out))
    along = np.cross(out, across)
    frame = np.stack([across, along, out], 1)
    width, height = rng.uniform(0.14, 0.24), rng.uniform(0.12, 0.28)
    grip = (hand[4] + pads) / 2
    if rng.random() < 0.3:
        radius = rng.uniform(0.09, 0.13)
        found = fitted_slab(body, joints, frame, grip + across * (radius - 0.025), np.array([radius, 0.05, 0.008]), rng)
        return None if found is None else plate(rng, radius).placed(found[0], found[1] - found[0][:, 2] * 0.015)
    mesh = tablet(rng, width, height)
    half = np.array([width / 2, height / 2, np.ptp(mesh.vertices[:, 2]) / 2])
    found = fitted_slab(body, joints, frame, grip + across * (width / 2 - 0.025), half, rng)
    return None if found is None else mesh.placed(*found)


def flat_between(joints: np.ndarray, rng: np.random.Generator) -> Thing:
    """A book, sheet, tablet, telephone or tray between both hands (2, 22, 3), as wide as they are apart."""
    hands = joints[:, 1:]
    thumbs, pads = hands[:, 4], hands[:, [7, 8, 11, 12]].mean(1)
    grips = (thumbs + pads) / 2
    across = unit(grips[RIGHT] - grips[LEFT])
    out = (thumbs - pads).mean(0)
    out = unit(out - across * (out @ across))
    along = np.cross(out, across)
    width = float(np.linalg.norm(grips[RIGHT] - grips[LEFT])) + 0.03
    frame, centre = np.stack([across, along, out], 1), grips.mean(0)
    if width < 0.19:
        mesh = slab((width, 0.074, 0.009), 0.01, framed(screen(rng, 12, 22), np.full(3, 0.01)), np.full(3, 0.02), 0.18)
    elif rng.random() < 0.5:
        mesh = book(rng, width, width * rng.uniform(0.55, 0.75))
    else:
        mesh = tablet(rng, width, width * rng.uniform(0.6, 1.4))
    return mesh.placed(frame, centre)


def furniture(table_y: float | None, seated: bool, upright: np.ndarray, rng: np.random.Generator) -> list[Thing]:
    """The table before somebody with what lies on it, and the chair they sit on.

    Args:
        table_y: how far below the eyes the table is, metres; None without one.
        seated: whether there is a chair.
        upright: (3, 3) rotation from axes with gravity along y to those of the things.
        rng: the only source of randomness.
    """
    things: list[Thing] = []
    level = upright @ np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # x right, y forward, z up

    def put(mesh: Mesh, place: list[float], turn: float = 0.0) -> None:
        c, s = np.cos(turn), np.sin(turn)
        frame = level @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        things.append(mesh.placed(frame, upright @ np.array(place)))

    if table_y is not None:
        width, depth = rng.uniform(0.9, 1.8), rng.uniform(0.5, 0.85)
        x, z = rng.uniform(-0.2, 0.2), rng.uniform(0.17, 0.22) + depth / 2
        top, leg = table_top(rng, width, depth), rng.uniform(0.04, 0.07)
        put(top, [x, table_y, z])
        for dx, dz in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
            place = [x + dx * (width / 2 - leg), table_y + 0.39, z + dz * (depth / 2 - leg)]
            put(slab((leg, leg, 0.74), 0.004, np.tile(top.colours[-1], (2, 2, 1)), top.colours[-1], 0.6), place)
        for _ in range(int(rng.integers(0, 4))):
            x, z = rng.uniform(0.28, 0.55) * rng.choice([-1, 1]), rng.uniform(0.34, 0.6)
            kind = rng.random()
            if kind < 0.35:
                put(mug(rng, rng.uniform(0.03, 0.042)), [x, table_y - 0.055, z], rng.uniform(0, 6))
            elif kind < 0.5:
                put(plate(rng, rng.uniform(0.08, 0.13)), [x, table_y - 0.001, z])
            elif kind < 0.65:
                put(phone(rng), [x, table_y - 0.006, z], rng.uniform(0, 6))
            else:
                place = [rng.uniform(-0.3, 0.3), table_y - 0.0015, rng.uniform(0.3, 0.55)]
                put(slab((0.21, 0.297, 0.001), 0.001, page(rng), np.full(3, 0.75), 0.85), place, rng.normal(0, 0.4))
    if seated and rng.random() < 0.75:
        colour = muted_colour(rng)
        rest = slab(
            (rng.uniform(0.4, 0.52), rng.uniform(0.42, 0.75), 0.06), 0.09, np.tile(colour, (6, 6, 1)), colour, 0.8
        )
        frame = upright @ np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]])
        things.append(rest.placed(frame, upright @ np.array([0.0, rng.uniform(0.45, 0.6), -0.33])))
    return things
