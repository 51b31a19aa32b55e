"""Joints and boxes as maps, and back.

Map coordinates are continuous like pixels: (0, 0) is the outer corner of the first cell, cell i's centre is i + 0.5,
so that crop pixels become map cells by the plain product map_size / crop_size.
"""

from __future__ import annotations

import math
from typing import Any, Literal

from twohands.geometry._arrays import float_arrays
from twohands.types import Array

CUTOFF = 0.0099
"""Heatmap values below this are set to 0, as in the code the authors' networks descend from (docs/paper-map.md)."""

WINDOW_RADIUS = 6
"""Half side, in map cells, of the window round the peak: three to four times the target's sigma of 1.5 to 2 cells."""

ENERGY_SPREAD = 0.32
"""Standard deviation of an energy blob as a share of the box's side: the value for which Otsu's threshold (0.29) gives
the box back (docs/paper-map.md, *HandSegNet and detection*)."""


def encode_heatmaps(
    joints_crop_px: Array,
    *,
    crop_size: int,
    map_size: int = 32,
    sigma: float = 2.0,
    z: Array | None = None,
    mode: Literal["spread", "amplitude"] = "spread",
    cutoff: float = CUTOFF,
) -> Array:
    """One Gaussian per joint; with depths, the paper's z-heatmaps.

    Args:
        joints_crop_px: (..., N, 2) pixels (u, v) of the crop; NaN for unknown joints.
        crop_size: side of the crop in pixels.
        map_size: side of the maps in cells.
        sigma: standard deviation at z = 0, in cells.
        z: (..., N) canonical depth, negative = closer to the camera than the root, clipped to -2..2; NaN counts as 0.
            None gives plain heatmaps.
        mode: how depth shows. "spread": the exponent is multiplied by 2^z, so the width is sigma * 2^(-z/2), sigma/2 to
            2 sigma. "amplitude": the value is multiplied by 0.75 - z/8, 0.5 to 1.
        cutoff: values below become 0.

    Returns:
        (..., N, map_size, map_size), 0..1, axes (row, column); all 0 for unknown joints.

    Source: paper section 4.2. It only says "stronger heatmap energy for closer joints"; both formulas are ours. Unlike
    the code the paper's descends from, the centre keeps its sub-cell place.
    """
    xp, joints = float_arrays(joints_crop_px)
    known = xp.all(xp.isfinite(joints), axis=-1)  # (..., N)
    centre = xp.where(known[..., None], joints, xp.zeros_like(joints)) * (map_size / crop_size)
    exponent = xp.full_like(centre[..., 0], -0.5 / sigma**2)
    amplitude = xp.astype(known, joints.dtype)
    if z is not None:
        _, depth, _ = float_arrays(z, joints)
        depth = xp.clip(xp.where(xp.isfinite(depth), depth, xp.zeros_like(depth)), -2.0, 2.0)
        if mode == "spread":
            exponent = exponent * 2.0**depth
        else:
            amplitude = amplitude * (0.75 - depth / 8)
    cells = _cell_centres(xp, map_size, centre)
    along_u = xp.exp(exponent[..., None] * (cells - centre[..., 0:1]) ** 2)  # (..., N, map)
    along_v = xp.exp(exponent[..., None] * (cells - centre[..., 1:2]) ** 2) * amplitude[..., None]
    maps = along_v[..., :, None] * along_u[..., None, :]
    return xp.where(maps < cutoff, 0.0, maps)


def decode_argmax(maps: Array) -> tuple[Array, Array]:
    """Centre of each map's highest cell. Exact to half a cell: mean error 3.1 px of a 256 px crop on 32x32 maps.

    Args:
        maps: (..., H, W).

    Returns:
        points: (..., 2) map coordinates (u, v) of the first highest cell's centre.
        peaks: (...) the value there; a map without anything in it has peak 0 and a point that means nothing.
    """
    xp, maps = float_arrays(maps)
    row, column, peaks = _peak(xp, maps)
    return xp.stack([xp.astype(column, maps.dtype), xp.astype(row, maps.dtype)], axis=-1) + 0.5, peaks


def decode_subpixel(maps: Array) -> tuple[Array, Array]:
    """Vertex of the parabola through the logarithm of the peak and its neighbours, along each axis.

    Exact for a Gaussian of any width. On the border of the map the parabola goes through the three outermost cells.
    Where the neighbours leave no parabola (not positive, not concave): a quarter cell towards the larger one. The
    result stays inside the highest cell.

    Args:
        maps: (..., H, W), at least 3x3.

    Returns:
        points: (..., 2) map coordinates (u, v).
        peaks: (...) value of the highest cell.

    Source: ours; the paper is silent, and one pixel costs 0.7 cm of range (docs/paper-map.md, *All joints*).
    """
    xp, maps = float_arrays(maps)
    row, column, peaks = _peak(xp, maps)
    height, width = maps.shape[-2:]
    along_u = xp.take_along_axis(maps, xp.broadcast_to(row[..., None, None], (*row.shape, 1, width)), axis=-2)
    along_v = xp.take_along_axis(maps, xp.broadcast_to(column[..., None, None], (*row.shape, height, 1)), axis=-1)
    u = _vertex(xp, along_u[..., 0, :], column)
    v = _vertex(xp, along_v[..., :, 0], row)
    return xp.stack([u, v], axis=-1), peaks


def decode_softargmax(probs: Array) -> tuple[Array, Array]:
    """Mean of each map taken as a distribution over cells; differentiable.

    Args:
        probs: (..., H, W), not negative; a common factor does not matter.

    Returns:
        points: (..., 2) map coordinates (u, v); (0, 0) for a map without anything in it.
        peaks: (...) value of the highest cell.
    """
    xp, probs = float_arrays(probs)
    height, width = probs.shape[-2:]
    over_u, over_v = xp.sum(probs, axis=-2), xp.sum(probs, axis=-1)  # (..., W), (..., H)
    total = xp.clip(xp.sum(over_u, axis=-1), xp.finfo(probs.dtype).tiny, None)
    u = xp.sum(over_u * _cell_centres(xp, width, probs), axis=-1) / total
    v = xp.sum(over_v * _cell_centres(xp, height, probs), axis=-1) / total
    return xp.stack([u, v], axis=-1), xp.max(probs, axis=(-2, -1))


def decode_windowed(probs: Array) -> tuple[Array, Array]:
    """Mean of each map within a window round its peak; differentiable, the window aside.

    Args:
        probs: (..., M, M), not negative where it matters; a common factor does not matter.

    Returns:
        points: (..., 2) map coordinates (u, v); (0, 0) for a map without anything in it.
        shares: (...) 0..1, the share of the map's mass inside the window.

    Source: ours. The mean over the whole map is drawn towards the crop's centre by any stray mass. Near the border the
    window is cut: networks that learn from the mean allow for the tail that a wide map misses there.
    """
    xp, probs = float_arrays(probs)
    mass = xp.clip(probs, 0.0, None)
    size = mass.shape[-1]
    rows, columns, _ = _peak(xp, mass)
    cells = xp.arange(size, device=mass.device)
    near_u, near_v = (xp.abs(cells - peak[..., None]) <= WINDOW_RADIUS for peak in (columns, rows))  # (..., M)
    inside = xp.where(near_u[..., None, :] & near_v[..., :, None], mass, 0.0)
    held = xp.sum(inside, axis=(-2, -1))
    total = xp.clip(held, 1e-12, None)
    centres = _cell_centres(xp, size, mass)
    u = xp.sum(inside, axis=-2) @ centres / total
    v = xp.sum(inside, axis=-1) @ centres / total
    shares = held / xp.clip(xp.sum(mass, axis=(-2, -1)), 1e-12, None)
    return xp.stack([u, v], axis=-1), shares


def encode_energy(box_px: Array, present: Array, height: int, width: int) -> Array:
    """Where each hand is, hidden parts included: a Gaussian that fills its box.

    Args:
        box_px: (..., 4) u0, v0, u1, v1 in pixels of a (height, width) image; tight around the 21 joints.
        present: (...) bool; absent hands and boxes that are not finite give a map of zeros.
        height, width: size of the map.

    Returns:
        (..., height, width), 0..1. Cutting it at Otsu's threshold gives the box back.

    Source: ours; the paper has no formula (docs/paper-map.md, *HandSegNet and detection*).
    """
    xp, box = float_arrays(box_px)
    usable = xp.astype(present, xp.bool) & xp.all(xp.isfinite(box), axis=-1)
    box = xp.where(usable[..., None], box, xp.zeros_like(box))
    along_u = _blob(xp, box[..., 0], box[..., 2], width)
    along_v = _blob(xp, box[..., 1], box[..., 3], height) * xp.astype(usable, box.dtype)[..., None]
    return along_v[..., :, None] * along_u[..., None, :]


def _blob(xp: Any, low: Array, high: Array, size: int) -> Any:
    deviation = xp.clip(ENERGY_SPREAD * (high - low), ENERGY_SPREAD, None)  # a box has at least one pixel
    offset = _cell_centres(xp, size, low) - ((low + high) / 2)[..., None]
    return xp.exp(-0.5 * (offset / deviation[..., None]) ** 2)


def _cell_centres(xp: Any, size: int, like: Array) -> Any:
    return xp.arange(size, dtype=like.dtype, device=like.device) + 0.5


def _peak(xp: Any, maps: Array) -> tuple[Any, Any, Any]:
    width = maps.shape[-1]
    flat = xp.reshape(maps, (*maps.shape[:-2], math.prod(maps.shape[-2:])))
    index = xp.argmax(flat, axis=-1)
    return index // width, index % width, xp.max(flat, axis=-1)


def _vertex(xp: Any, line: Array, index: Array) -> Any:
    """Sub-cell place of the peak of lines of cells (..., W) whose highest cell is `index` (...)."""
    last = line.shape[-1] - 1
    tiny = xp.finfo(line.dtype).tiny

    def value(at: Array) -> Any:
        return xp.take_along_axis(line, at[..., None], axis=-1)[..., 0]

    middle = xp.clip(index, 1, last - 1)
    triple = [value(middle - 1), value(middle), value(middle + 1)]
    left, centre, right = (xp.log(xp.clip(t, tiny, None)) for t in triple)
    curvature = left - 2 * centre + right
    fits = (triple[0] > 0) & (triple[1] > 0) & (triple[2] > 0) & (curvature < 0)
    vertex = 0.5 * (left - right) / xp.where(fits, curvature, -xp.ones_like(curvature))
    vertex = vertex + xp.astype(middle - index, line.dtype)  # from the peak, not from the triple's middle
    quarter = 0.25 * xp.sign(value(xp.clip(index + 1, 0, last)) - value(xp.clip(index - 1, 0, last)))
    return xp.astype(index, line.dtype) + 0.5 + xp.clip(xp.where(fits, vertex, quarter), -0.5, 0.5)
