"""Bake the asset of arms, or of whole people, from Anny (extra synth-bake). The package ships both; few need this."""

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
    people: Path | None = None
    """Bake whole people instead, with the CC0 clothes, hair and textures of MakeHuman's assets in this folder; the
    shipped asset is of --count 700."""


def run(args: BakeArgs) -> int:
    """Bake and print a summary."""
    from twohands.synth.scene.bake import bake
    from twohands.synth.scene.people_bake import bake_people

    if os.path.lexists(args.out):
        raise InputError(f"{args.out}: exists already; choose another --out")
    check_output_folder(args.out.parent, overwrite=True)
    if args.people is None:
        summary = bake(args.out, count=args.count, seed=args.seed)
    else:
        summary = bake_people(args.out, args.people, count=args.count, seed=args.seed)
    for name, value in summary.items():
        print(f"{name}: {value}")
    return 0
