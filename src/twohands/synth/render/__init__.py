"""Draws scenes: renderers (the same SceneSpec in, the same labels out), light, sensor and compositing."""
