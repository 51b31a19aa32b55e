"""A tracked clip for other programs: glTF, BVH, a ROS 2 bag, OpenXR's joints.

Reads the hands.jsonl of `twohands track` or of the live page. glTF and bags need the extra motion.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final, Literal

import numpy as np
import tyro

from twohands.cli.output import write_file
from twohands.errors import InputError
from twohands.motion.bvh import bvh_text
from twohands.motion.clip import HandMotion, read_motion
from twohands.motion.fit import FittedHand, fit_motion
from twohands.motion.gltf import gltf_file
from twohands.motion.openxr import openxr_lines
from twohands.motion.ros_bag import write_bag
from twohands.skeleton import SIDES

ENDINGS: Final = {"glb": ".glb", "gltf": ".gltf", "bvh": ".bvh", "openxr": ".jsonl"}
_BAG_LIST: Final = "metadata.yaml"


@dataclass(frozen=True)
class ExportMotionArgs:
    """Arguments of `twohands export-motion`."""

    input: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="HANDS.JSONL")]
    """Results of a clip."""
    to: Literal["glb", "gltf", "bvh", "rosbag", "openxr"]
    """glb or gltf: an animated glTF scene, binary or as JSON. bvh: a skeleton of fixed bones for animators, a file for
    each hand. rosbag: a ROS 2 bag (MCAP). openxr: OpenXR's 26 joints, a line of JSON for each frame."""
    out: Annotated[Path, tyro.conf.arg(metavar="FILE")]
    """Where it goes, ending in .glb, .gltf, .bvh (hands.bvh becomes hands_left.bvh and hands_right.bvh) or .jsonl; of a
    bag, a folder."""
    overwrite: Annotated[bool, tyro.conf.arg(help_behavior_hint="")] = False
    """Replace what is there."""


def run(args: ExportMotionArgs) -> int:
    """Carry out `twohands export-motion`."""
    ending = ENDINGS.get(args.to)
    if ending is not None and args.out.suffix != ending:
        raise InputError(f"--out {args.out}: the ending {ending} expected for --to {args.to}")
    motion = read_motion(args.input)
    targets = _targets(args, motion)
    _check_targets(args, list(targets.values()))
    fitted = fit_motion(motion)
    remarks: dict[int, str] = {}
    if args.to == "rosbag":
        _write_bag(motion, fitted, args.out)
    elif args.to == "bvh":
        made = {side: bvh_text(motion, hand) for side, hand in fitted.items()}
        for side, (text, times) in made.items():
            remarks[side] = f"; {len(times.share)} even frames, in {int(times.still.sum())} of them it stands still"
            write_file(targets[side], text.encode())
    elif args.to == "openxr":
        write_file(args.out, "".join(f"{line}\n" for line in openxr_lines(motion, fitted)).encode())
    else:
        write_file(args.out, gltf_file(motion, fitted, binary=args.to == "glb"))
    for side, hand in fitted.items():
        print(_said_of(motion, hand, side) + remarks.get(side, ""))
    print(f"written to {', '.join(map(str, dict.fromkeys(targets.values())))}")
    return 0


def _targets(args: ExportMotionArgs, motion: HandMotion) -> dict[int, Path]:
    """Where each hand goes."""
    if args.to != "bvh":
        return dict.fromkeys(motion.sides, args.out)
    return {side: args.out.with_name(f"{args.out.stem}_{SIDES[side]}{args.out.suffix}") for side in motion.sides}


def _check_targets(args: ExportMotionArgs, targets: list[Path]) -> None:
    for target in targets:
        if target.exists() and target.samefile(args.input):
            raise InputError(f"--out {target} is the input; choose another")
        if target.exists() and not args.overwrite:
            raise InputError(f"output {target} exists; choose another --out, or allow it with --overwrite")
        if target.exists() and (target.is_dir() != (args.to == "rosbag")):
            raise InputError(f"output {target}: cannot be replaced by {args.to}; choose another --out")
        if target.is_dir() and not (target / _BAG_LIST).is_file():
            raise InputError(f"output {target} is a folder, but no bag, and is left as it is; choose another --out")


def _write_bag(motion: HandMotion, fitted: Mapping[int, FittedHand], folder: Path) -> None:
    """The bag appears as a whole; an old one goes when the new one is there."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder.parent, prefix=f".{folder.name}.") as place:
        made = Path(place) / folder.name
        write_bag(motion, fitted, made)
        if folder.exists():
            shutil.rmtree(folder)
        os.replace(made, folder)


def _said_of(motion: HandMotion, hand: FittedHand, side: int) -> str:
    distance_mm = 1000 * hand.distance_m
    return (
        f"{SIDES[side]} hand: in {len(hand.rows)} of {len(motion.time_s)} frames; a skeleton of fixed bones lies "
        f"{distance_mm.mean():.1f} mm from its joints (95 % within {np.percentile(distance_mm, 95):.1f}, "
        f"at most {distance_mm.max():.1f} mm)"
    )
