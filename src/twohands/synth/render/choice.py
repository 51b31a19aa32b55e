"""Which renderer draws a set, and with which of the user's fabrics."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, Protocol

import numpy as np

from twohands.errors import InputError
from twohands.synth.render import blender, raster
from twohands.synth.scene.fabrics import FabricFolder
from twohands.synth.scene.spec import SceneSpec
from twohands.types import RenderedFrame

RendererName = Literal["raster", "blender"]


class Renderer(Protocol):
    """Draws scenes of one image size."""

    def render(self, scene: SceneSpec) -> RenderedFrame:
        """Colour, alpha, labels and depth; a pixel has a label exactly where it has depth and alpha, but for things
        that are no part of a hand."""
        ...

    def amodal(self, scene: SceneSpec) -> np.ndarray:
        """(2, H, W) bool, the pixels that each arm covers when it is drawn alone, with what it wears; of the scene just
        rendered."""
        ...


def open_renderer(name: RendererName, width: int, height: int) -> Renderer:
    """The renderer of that name.

    Raises:
        MissingExtraError, RendererError: it does not run here.
    """
    return blender.BlenderRenderer(width, height) if name == "blender" else raster.RasterRenderer(width, height)


def open_fabrics(folder: Path | None, name: RendererName) -> FabricFolder | None:
    """The user's fabrics, if any, for the renderer of that name.

    Raises:
        InputError: the folder is missing, unreadable or empty, or the renderer draws none.
    """
    if folder is None:
        return None
    if name == "blender":
        raise InputError("Blender draws no fabrics: leave --fabrics out, or take --renderer raster")
    return FabricFolder(folder)


def renderer_version(name: RendererName) -> str:
    """What exactly draws, with its version: pictures depend on it in their last bits.

    Raises:
        MissingExtraError, RendererError: it does not run here.
    """
    return blender.renderer_name() if name == "blender" else raster.renderer_name()
