"""Cameras, frames and the global projection: pure functions, no files, no networks.

One source serves numpy arrays and torch tensors (array API); every function takes any leading batch dimensions, keeps
the dtype it was given, lets gradients through, and never changes its inputs. Conventions: docs/conventions.md.

Modules: `camera` (pixels and rays), `rotation` (the spherical angles), `canonical` (the pose the networks learn),
`projection` (from canonical pose and pixels to metres), `boxes` (boxes, crops, warping), `heatmaps` (joints and boxes
as maps, and back), `composition` (the picture of one hand as the networks see it).
"""
