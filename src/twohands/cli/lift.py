"""Both hands in metres from another hand tracker's results: MediaPipe, WiLoR, HaMeR, OpenPose, MMPose, rtmlib.

Needs the camera and one length of the hand; runs no network and needs no picture. Writes hands.json, a .npz of
arrays or a .csv table, by the ending of --out.
"""

from __future__ import annotations

import json
import math
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from twohands.cli.known import known_by
from twohands.cli.output import write_file
from twohands.errors import DataFormatError, InputError
from twohands.formats.structured import parse_json, read_bytes
from twohands.geometry.lifting import View
from twohands.inference.known import Known
from twohands.inference.range_sigma import with_sources
from twohands.inference.records import from_dict, to_dict
from twohands.inference.tables import csv_text, npz_bytes, to_arrays
from twohands.inference.tracker import HandTracker
from twohands.lifting.mediapipe import Names
from twohands.lifting.placing import place_hands, sides_word, surplus
from twohands.lifting.reading import Hints, Kind, read_hands
from twohands.plausibility import camera_doubts, hand_length_doubts, warn
from twohands.skeleton import SIDES
from twohands.types import PinholeCamera, TwoHandPose

ENDINGS = (".json", ".npz", ".csv")


def option(metavar: str) -> Any:
    """An option that need not be given; its help text says what happens then."""
    return tyro.conf.arg(metavar=metavar, help_behavior_hint="")


@dataclass(frozen=True)
class LiftArgs:
    """Arguments of `twohands lift`."""

    input: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="INPUT")]
    """Results of a tracker: .json, .jsonl, .npz, .csv, or a folder with a .json file for each picture."""
    out: Annotated[Path, tyro.conf.arg(metavar="FILE")]
    """Where metres go: .json (hands.json), .npz or .csv."""
    camera: Annotated[Path | None, option("FILE")] = None
    """Camera file of the pictures: JSON with fx, fy, cx, cy, width, height[, distortion], or OpenCV's YAML."""
    fov: Annotated[float | None, option("DEG")] = None
    """Instead of --camera, with --size: horizontal field of view."""
    size: Annotated[tuple[int, int] | None, option("WIDTH HEIGHT")] = None
    """Size of the pictures in pixels, for --fov."""
    hand_length: Annotated[float | None, option("CM")] = None
    """As for `track`: about 0.6 times the length from the wrist's crease to the tip of the middle finger; 10 if not
    given. What the tracker takes for wrist and knuckle is allowed for."""
    profile: Annotated[str | None, option("NAME")] = None
    """Camera and hand length that `twohands calibrate` has kept under this name; other options count before it."""
    bone_length: Annotated[float | None, option("CM")] = None
    """Instead of --hand-length: the distance from wrist to middle knuckle where the tracker itself puts them."""
    kind: Annotated[Kind | None, option("KIND")] = None
    """Whose results they are: mediapipe, mano (WiLoR, HaMeR), openpose, mmpose (and rtmlib), twohands; found out by
    their keys if not given."""
    side: Annotated[Literal["left", "right"] | None, option("SIDE")] = None
    """Which hand, where the model sees single hands and says nothing of it (MMPose, rtmlib)."""
    names: Annotated[Names | None, option("WHOSE")] = None
    """What MediaPipe's "Left" means, own or mirrored; if not given, mirrored for the legacy solution (mp.solutions,
    @mediapipe/hands), own for the Tasks API and tasks-vision."""
    view: Annotated[View | None, option("VIEW")] = None
    """Whose axes the shapes have, centred (a camera that looks at the hand) or camera; known for each tracker."""
    pose: Annotated[Path | None, option("FILE")] = None
    """For trackers that know the picture alone (OpenPose, MMPose, rtmlib): hands.json of `twohands track` on the same
    pictures, whose hands' shapes are used."""
    mirrored: Annotated[bool, tyro.conf.arg(help_behavior_hint="")] = False
    """The pictures were mirrored, as webcams show them: everything is turned back."""
    smooth: Annotated[bool, tyro.conf.arg(help_behavior_hint="")] = False
    """The frames are a video's: smooth the ranges, and carry hands on that leave the picture."""
    overwrite: Annotated[bool, tyro.conf.arg(help_behavior_hint="")] = False
    """Replace an existing FILE."""


def run(args: LiftArgs) -> int:
    """Carry out `twohands lift`."""
    _check_out(args)
    known = known_by(args.camera, args.fov, args.hand_length, args.profile)
    camera = _camera(args, known)
    poses = None if args.pose is None else _poses(args.pose)
    hints = Hints(args.kind, None if args.side is None else SIDES.index(args.side), args.names, args.view)
    foreign = read_hands(args.input, camera, hints)
    length_m = _bone_length_m(args, known, foreign.bone_ratio)
    warn(hand_length_doubts(length_m / foreign.bone_ratio) + camera_doubts(camera))
    placed = place_hands(foreign, camera, length_m, poses=poses, mirrored=args.mirrored)
    scale_source = "typed" if args.bone_length is not None else known.scale_source
    placed = [with_sources(pose, scale_source, known.camera_source or "file") for pose in placed]
    if args.smooth:
        tracker = HandTracker()
        placed = [tracker.update(pose) for pose in placed]
    if args.bone_length is None:
        _say(
            f"{foreign.system}: wrist and middle knuckle taken to be {100 * length_m:.1f} cm apart, "
            f"{foreign.bone_ratio:.2f} of the hand length (--bone-length CM says it yourself)"
        )
    if left_out := surplus(foreign):
        _say(f"{left_out} hands left out: another of the same side in the same picture was more certain")
    names = [frame.file for frame in foreign.frames]
    files = [name or "" for name in names] if any(names) else None
    write_file(args.out, _content(args, placed, camera, foreign.system, length_m, files))
    print(f"{len(placed)} pictures, {sides_word(placed)} hands placed; written to {args.out}")
    return 0


def _content(
    args: LiftArgs,
    poses: list[TwoHandPose],
    camera: PinholeCamera,
    system: str,
    length_m: float,
    files: list[str] | None,
) -> bytes:
    if args.out.suffix == ".csv":
        return csv_text(poses, files).encode(errors="backslashreplace")
    if args.out.suffix == ".npz":
        return npz_bytes(
            to_arrays(poses, camera, source=str(args.input), weights=system, hand_length_m=length_m, files=files)
        )
    named = None if files is None else {pose.index: name for pose, name in zip(poses, files, strict=True)}
    record = to_dict(poses, source=str(args.input), weights=system, hand_length_m=length_m, files=named)
    return (json.dumps(record) + "\n").encode()


def _check_out(args: LiftArgs) -> None:
    if args.out.suffix not in ENDINGS:
        raise InputError(f"--out {args.out}: an ending {', '.join(ENDINGS)} expected")
    if args.out.exists() and not args.overwrite:
        raise InputError(f"output {args.out} exists; choose another --out, or allow it with --overwrite")


def _camera(args: LiftArgs, known: Known) -> PinholeCamera:
    if known.camera is not None:
        return known.camera
    if known.fov_deg is None:
        raise InputError("give --camera FILE, or --fov DEG with --size WIDTH HEIGHT, or a --profile with a camera")
    if args.size is None or min(args.size) < 1:
        raise InputError("--fov needs the pictures' size in pixels: --size WIDTH HEIGHT")
    return PinholeCamera.from_fov(known.fov_deg, *args.size)


def _bone_length_m(args: LiftArgs, known: Known, bone_ratio: float) -> float:
    """From the tracker's wrist to its middle knuckle, metres."""
    if args.bone_length is not None and args.hand_length is not None:
        raise InputError("give --hand-length or --bone-length, not both")
    if args.bone_length is not None:
        return _metres("--bone-length", args.bone_length)
    for line in known.assumptions():
        _say(line)
    return bone_ratio * known.hand_length_m


def _metres(name: str, length_cm: float) -> float:
    if not (math.isfinite(length_cm) and length_cm > 0):
        raise InputError(f"{name} must be a positive number of cm, got {length_cm}")
    return length_cm / 100


def _poses(path: Path) -> list[TwoHandPose]:
    try:
        return from_dict(parse_json(read_bytes(path, "hands.json")))
    except InputError as error:
        raise InputError(f"--pose {error}") from None
    except DataFormatError as error:
        raise DataFormatError(f"--pose {path}: {error}") from None


def _say(message: str) -> None:
    """One line on stderr; stdout is for results."""
    print(f"twohands: {message}", file=sys.stderr)
