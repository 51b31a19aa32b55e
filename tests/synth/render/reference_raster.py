"""A second route to labels and depth: every triangle against every pixel centre it may cover, in plain numpy."""

import numpy as np

from twohands.synth.render.surface import surface
from twohands.synth.scene.body import load_asset, skin


def reference_planes(scene):
    """(H, W) mask and planar depth in metres (inf where nothing is seen) of a scene, seen through pixel centres."""
    camera = scene.camera
    vertices = skin(scene.body, scene.transforms) * scene.scale
    faces = surface().faces
    faces = faces[scene.present[load_asset().side[faces[:, 0]]]]
    triangles = vertices[faces]
    triangles = triangles[(triangles[..., 2] > 1e-3).all(1)]
    px = triangles[..., :2] / triangles[..., 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy]
    depth = np.full((camera.height, camera.width), np.inf)
    for (a, b, c), z in zip(px, triangles[..., 2], strict=True):
        low = np.maximum(np.floor(np.min([a, b, c], axis=0)).astype(int), 0)
        high = np.minimum(np.ceil(np.max([a, b, c], axis=0)).astype(int), [camera.width, camera.height])
        if (low >= high).any():
            continue
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if area >= 0:  # seen from behind: y points down
            continue
        u, v = np.meshgrid(np.arange(low[0], high[0]) + 0.5, np.arange(low[1], high[1]) + 0.5)
        wa = ((b[0] - u) * (c[1] - v) - (b[1] - v) * (c[0] - u)) / area
        wb = ((c[0] - u) * (a[1] - v) - (c[1] - v) * (a[0] - u)) / area
        wc = 1 - wa - wb
        inside = (wa >= 0) & (wb >= 0) & (wc >= 0)
        seen = 1 / (wa / z[0] + wb / z[1] + wc / z[2])
        window = depth[low[1] : high[1], low[0] : high[0]]
        window[inside] = np.minimum(window[inside], seen[inside])
    return np.isfinite(depth), depth
