"""Renders the example images that ship with the package (extra `synth`).

    python scripts/make_examples.py

Writes src/twohands/examples_data/: four pictures of an unseen seed on procedural backgrounds, and their camera.
"""

from __future__ import annotations

import json
from pathlib import Path

import cv2

from twohands.synth.config import SynthConfig
from twohands.synth.stream import SyntheticStream

FOLDER = Path(__file__).parents[1] / "src" / "twohands" / "examples_data"
SEED = 20261121
INSTANCES = (4, 5, 11, 17)


def main() -> None:
    """Renders and writes."""
    stream = SyntheticStream(SynthConfig(), SEED, max(INSTANCES) + 1)
    FOLDER.mkdir(parents=True, exist_ok=True)
    for index in INSTANCES:
        sample = stream[index]
        cv2.imwrite(str(FOLDER / f"example_{index:02d}.png"), sample.image[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])
    names = ("fx", "fy", "cx", "cy", "width", "height")
    camera = {name: getattr(sample.camera, name) for name in names}
    (FOLDER / "camera.json").write_text(json.dumps(camera, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
