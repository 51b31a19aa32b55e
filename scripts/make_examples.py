"""Renders the example images that ship with the package (extra `synth`).

    python scripts/make_examples.py

Writes src/twohands/examples_data/ (four pictures of an unseen seed on procedural backgrounds, and their camera) and
docs/images/generated.jpg (a contact sheet of the same set).
"""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np

from twohands.synth.config import SynthConfig
from twohands.synth.stream import SyntheticStream

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "src" / "twohands" / "examples_data"
IMAGES = ROOT / "docs" / "images"
SEED = 20261121
INSTANCES = (1, 3, 11, 17)
SHEET = (0, 2, 7, 8, 9, 10, 15, 16, 18, 20, 21, 23)


def main() -> None:
    """Renders and writes."""
    stream = SyntheticStream(SynthConfig(), SEED, max(INSTANCES + SHEET) + 1)
    FOLDER.mkdir(parents=True, exist_ok=True)
    for index in INSTANCES:
        sample = stream[index]
        cv2.imwrite(str(FOLDER / f"example_{index:02d}.png"), sample.image[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])
    names = ("fx", "fy", "cx", "cy", "width", "height")
    camera = {name: getattr(sample.camera, name) for name in names}
    (FOLDER / "camera.json").write_text(json.dumps(camera, indent=2) + "\n", encoding="utf-8")
    tiles = [cv2.resize(stream[i].image, (400, 225), interpolation=cv2.INTER_AREA) for i in SHEET]
    sheet = np.concatenate([np.concatenate(tiles[row : row + 4], axis=1) for row in range(0, len(tiles), 4)])
    IMAGES.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(IMAGES / "generated.jpg"), sheet[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 90])


if __name__ == "__main__":
    main()
