"""Renderers: the same SceneSpec in, the same labels out."""
