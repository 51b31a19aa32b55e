"""Renders the pictures that ship with the package and those of the README (extra `synth`, and Pillow).

    python scripts/make_examples.py

Writes src/twohands/examples_data/ (four pictures of an unseen seed on procedural backgrounds, and their camera), and in
docs/images a sheet of 48 pictures and a clip of 6 seconds per preset.
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from twohands.synth.scene.config import PAPER, PRESETS, SynthConfig
from twohands.synth.sets.sequences import SequenceRenderer, SequenceSet
from twohands.synth.sets.static import StaticSet
from twohands.synth.sets.stream import SyntheticStream

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "src" / "twohands" / "examples_data"
IMAGES = ROOT / "docs" / "images"
SEED = 20261121
INSTANCES = (6, 12, 19, 22)
SHEET_SEED, CLIP_SEED = 2026, 7


def main() -> None:
    """Renders and writes."""
    write_examples()
    for name, config in PRESETS.items():
        small = dataclasses.replace(config, width=480, height=270)
        write_sheet(small, IMAGES / f"{name}.jpg")
        write_clip(small, IMAGES / f"dynamic_{name}.webp")


def write_examples() -> None:
    """The pictures of `twohands demo`."""
    stream = SyntheticStream(PAPER, SEED, max(INSTANCES) + 1)
    FOLDER.mkdir(parents=True, exist_ok=True)
    for index in INSTANCES:
        sample = stream[index]
        cv2.imwrite(str(FOLDER / f"example_{index:02d}.png"), sample.image[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])
    names = ("fx", "fy", "cx", "cy", "width", "height")
    camera = {name: getattr(sample.camera, name) for name in names}
    (FOLDER / "camera.json").write_text(json.dumps(camera, indent=2) + "\n", encoding="utf-8")


def write_sheet(config: SynthConfig, path: Path) -> None:
    """Six rows of eight pictures."""
    stream = StaticSet(config, SHEET_SEED, 48).stream()
    tiles = [cv2.resize(stream[i].image, (240, 135), interpolation=cv2.INTER_AREA) for i in range(48)]
    sheet = np.concatenate([np.concatenate(tiles[row : row + 8], axis=1) for row in range(0, 48, 8)])
    cv2.imwrite(str(path), sheet[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 86])


def write_clip(config: SynthConfig, path: Path) -> None:
    """Ninety frames, fifteen a second."""
    renderer = SequenceRenderer(SequenceSet(config, seed=CLIP_SEED, sequences=1, frames=90, fps=15.0))
    frames = [
        Image.fromarray(cv2.resize(renderer.frame(0, k)[1], (384, 216), interpolation=cv2.INTER_AREA))
        for k in range(90)
    ]
    frames[0].save(path, save_all=True, append_images=frames[1:], duration=67, loop=0, quality=60, method=4)


if __name__ == "__main__":
    main()
