"""Averages networks of a preset with trained ones: a new preset (extras `train` and `synth`).

    python scripts/average_weights.py src/twohands/weights/fast --pose-net-2d RUN/pose_net_2d.safetensors \\
        --pose-net-3d RUN/pose_net_3d.safetensors --share 0.7 --judge 0.5 --out candidates/fast

How large activations get in 8 bits is measured anew. A preset that takes a network from another one's folder needs that
folder beside --out too. What the card says in words of data, schedule and accuracy stays; mend it by hand.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from twohands.cli.output import check_output_folder
from twohands.errors import TwoHandsError
from twohands.export.averaging import average_preset
from twohands.export.calibration import add_int8, generated_pictures
from twohands.inference.weights import NETWORK_NAMES


def main() -> int:
    """Reads the options and writes the weights folder."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("preset", type=Path, help="weights folder to start from")
    for name in NETWORK_NAMES:
        parser.add_argument(f"--{name.replace('_', '-')}", type=Path, help="trained file")
    parser.add_argument("--share", type=float, required=True, help="of the trained weights, 0 to 1")
    parser.add_argument("--judge", type=float, default=0.0, help="log-odds by which PoseNet2D's judge is raised")
    parser.add_argument("--out", type=Path, required=True, help="weights folder to write")
    options = parser.parse_args()
    checkpoints = {name: path for name in NETWORK_NAMES if (path := getattr(options, name)) is not None}
    if not checkpoints:
        parser.error("no trained file: give at least one of --hand-seg-net, --pose-net-2d, --pose-net-3d")
    try:
        check_output_folder(options.out, overwrite=False)
        average_preset(options.preset, checkpoints, options.out, share=options.share, judge=options.judge)
        add_int8(options.out, generated_pictures())
    except TwoHandsError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
