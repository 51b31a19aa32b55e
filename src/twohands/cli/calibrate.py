"""Camera and hand length: what ranges rest on, measured with a printed board or a tape.

  twohands calibrate board.pdf                  the board, to print on A4 at 100 %
  twohands calibrate camera CLIP_OR_PICTURES    intrinsics and lens, from the board seen from all sides
  twohands calibrate hand PICTURES              hand length, from a hand that lies flat beside the board
  twohands calibrate hand --at 50cm CLIP        hand length, from a hand at that distance of the lens

--profile NAME keeps the result; track takes it from there by the same option.
"""

from __future__ import annotations

import dataclasses
import glob
import json
import math
import os
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final

import cv2
import numpy as np
import tyro

from twohands.calibration.board import BoardView, board_pdf, find_board
from twohands.calibration.camera import MOST_VIEWS, CameraFit, fit_camera, is_new, usable
from twohands.calibration.coverage import coverage_picture
from twohands.calibration.hand import length_on_board
from twohands.calibration.tape import fit_tape, focal_spread, length_spread, ranges, zoomed
from twohands.cli.known import camera_assumption, known_by
from twohands.cli.output import write_file
from twohands.errors import InputError, TwoHandsError
from twohands.formats.pictures import list_images, natural_key, read_image
from twohands.formats.profiles import IntrinsicsSource, Profile, ScaleSource, camera_record, profile_bytes, profile_path
from twohands.formats.profiles import read_profile as kept_profile
from twohands.inference.estimator import DEFAULT_HAND_LENGTH_M, HandEstimator
from twohands.inference.frames import is_video, open_frames
from twohands.inference.known import Known
from twohands.inference.weights import DEFAULT_PRESET
from twohands.plausibility import camera_doubts, hand_length_doubts, warn
from twohands.types import HandPose, PinholeCamera

EVERY_S: Final = 0.2
"""Of a clip, so often a frame is looked at."""
MOST_HAND_FRAMES: Final = 60
RULE_CM: Final = 10.0
RULE_RANGE_CM: Final = (5.0, 20.0)
_DISTANCE: Final = re.compile(r"(\d+(?:\.\d+)?|\.\d+)\s*(mm|cm|m|in)")
_METRES: Final = {"mm": 0.001, "cm": 0.01, "m": 1.0, "in": 0.0254}


def option(metavar: str) -> Any:
    """An option that need not be given; its help text says what happens then."""
    return tyro.conf.arg(metavar=metavar, help_behavior_hint="")


@dataclass(frozen=True)
class CalibrateArgs:
    """Arguments of `twohands calibrate`."""

    what: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="WHAT")]
    """camera, hand, or the name of a .pdf file for the board."""
    input: Annotated[tyro.conf.Positional[str | None], tyro.conf.arg(metavar="INPUT", help_behavior_hint="")] = None
    """Picture, folder or quoted pattern of pictures, video file, or camera:0 (ends with Ctrl-C)."""
    at: Annotated[str | None, option("DISTANCE")] = None
    """hand: taped distance from the lens to the middle knuckle: 50cm, 0.5m, 500mm, 20in."""
    out: Annotated[Path | None, option("FILE")] = None
    """camera: the camera file to write, with FILE_coverage.png beside it; camera.json if not given."""
    profile: Annotated[str | None, option("NAME")] = None
    """Keep the result under this name, in twohands/profiles of $XDG_CONFIG_HOME or ~/.config."""
    camera: Annotated[Path | None, option("FILE")] = None
    """hand: camera file; the profile's if not given."""
    fov: Annotated[float | None, option("DEG")] = None
    """hand: horizontal field of view, where there is no camera file."""
    rule: Annotated[float, option("CM")] = RULE_CM
    """hand: length of the printed 10 cm rule, where the printer has scaled it."""
    weights: Annotated[str, tyro.conf.arg(metavar="NAME")] = DEFAULT_PRESET
    """hand: preset that ships with the package, or a weights folder."""
    overwrite: Annotated[bool, tyro.conf.arg(help_behavior_hint="")] = False
    """Replace an existing file."""


def run(args: CalibrateArgs) -> int:
    """Carry out `twohands calibrate`."""
    if args.what.lower().endswith(".pdf"):
        return _print_board(args)
    if args.what not in ("camera", "hand"):
        raise InputError(f"calibrate {args.what}: camera, hand, or a name that ends in .pdf (the board) expected")
    if args.input is None:
        raise InputError(f"calibrate {args.what}: give a picture, a folder of pictures or a clip")
    if args.profile is not None:
        profile_path(args.profile)  # refuses what is no name, before any work is done
    return _camera(args, args.input) if args.what == "camera" else _hand(args, args.input)


def _print_board(args: CalibrateArgs) -> int:
    path = Path(args.what)
    if args.input is not None:
        raise InputError(f"calibrate {args.what}: the board needs no input, got {args.input}")
    _refuse_existing(path, args.overwrite)
    write_file(path, board_pdf())
    print(f"{path}: print it on A4 at 100 %, measure the 10 cm rule, keep it flat")
    return 0


def _camera(args: CalibrateArgs, source: str) -> int:
    if args.at is not None or args.camera is not None or args.fov is not None:
        raise InputError("--at, --camera and --fov are for calibrate hand")
    out = args.out or Path("camera.json")
    coverage = out.with_name(f"{out.stem}_coverage.png")
    for path in (out, coverage):
        _refuse_existing(path, args.overwrite)
    views: list[BoardView] = []
    seen = total = 0
    for image, _ in _images(source):
        total += 1
        view = find_board(image)
        if view is None or not usable(view):
            continue
        seen += 1
        if is_new(view, views):
            views.append(view)
        if len(views) == MOST_VIEWS:
            break
    try:
        fit = fit_camera(views)
    except InputError as error:
        raise InputError(f"{source}: {error} ({seen} of {total} pictures show the board well)") from None
    warn(camera_doubts(fit.camera))
    picture = cv2.imencode(".png", cv2.cvtColor(coverage_picture(fit), cv2.COLOR_RGB2BGR))[1].tobytes()
    write_file(out, (json.dumps(_camera_file(fit), indent=1) + "\n").encode())
    write_file(coverage, picture)
    _say_fit(fit)
    print(f"written to {out} and {coverage}")
    if args.profile is not None:
        _keep(args.profile, camera=fit.camera, intrinsics_source="board")
    return 0


def _hand(args: CalibrateArgs, source: str) -> int:
    if args.out is not None:
        raise InputError("--out is for calibrate camera; a hand length goes to --profile")
    if not RULE_RANGE_CM[0] <= args.rule <= RULE_RANGE_CM[1]:
        raise InputError(f"--rule {args.rule:g}: 5 to 20 cm expected, as measured on the printed 10 cm rule")
    distance_m = None if args.at is None else _distance_m(args.at)
    known = known_by(args.camera, args.fov, None, _existing(args.profile))
    estimator = HandEstimator.from_preset(args.weights)
    if distance_m is None:
        lengths, (camera, camera_source) = _lengths_on_board(source, estimator, known, args.rule / RULE_CM)
        length, scale_source = float(np.median(lengths)), "board"
    else:
        hands, (camera, camera_source) = _hands(source, estimator, known)
        said = [distance_m] * len(hands)
        fit = fit_tape(
            hands,
            camera,
            said,
            DEFAULT_HAND_LENGTH_M,
            focal_spread=focal_spread(camera_source),
            length_spread=length_spread("assumed"),
        )
        camera, length, scale_source = zoomed(camera, fit.focal_scale), fit.hand_length_m, "distance"
        lengths = [length * distance_m / value for value in ranges(hands, camera, length)]
    if line := camera_assumption(camera_source):
        _say(line)
    spread = f", {100 * min(lengths):.1f} to {100 * max(lengths):.1f} over {len(lengths)} pictures"
    print(f"hand length {100 * length:.1f} cm{spread if len(lengths) > 1 else ''}: --hand-length {100 * length:.1f}")
    if scale_source == "distance":
        print(
            f"it holds together with this camera alone, of {camera.hfov_deg:.1f} degrees: --fov {camera.hfov_deg:.1f}; "
            f"ranges are right to about {100 * math.hypot(fit.sigma, fit.sigma):.0f} %"
        )
    warn(hand_length_doubts(length))
    if args.profile is not None:
        _keep(args.profile, camera, camera_source, length, scale_source)
    return 0


def _lengths_on_board(
    source: str, estimator: HandEstimator, known: Known, scale: float
) -> tuple[list[float], tuple[PinholeCamera, IntrinsicsSource]]:
    """Hand lengths of the pictures that show a hand and the board."""
    lengths: list[float] = []
    used, boards, hands, total = None, 0, 0, 0
    for image, path in _images(source):
        total += 1
        view = find_board(image)
        if view is None:
            continue
        boards += 1
        camera = known.camera_of(image.shape[1], image.shape[0], path)
        pose = estimator.estimate(image, camera[0])
        for hand in pose.hands:
            if hand.joints_px is not None:
                hands += 1
                lengths.append(length_on_board(hand.joints_px, view, camera[0], scale=scale))
                used = used or camera
        if len(lengths) >= MOST_HAND_FRAMES:
            break
    if used is None:
        raise InputError(
            f"{source}: no picture shows both the board and a hand (the board is in {boards} of {total}); lay the hand "
            "flat beside the board, seen from above"
        )
    return lengths, used


def _hands(
    source: str, estimator: HandEstimator, known: Known
) -> tuple[list[HandPose], tuple[PinholeCamera, IntrinsicsSource]]:
    """The one hand that is in the pictures, in each of them, as estimated with `DEFAULT_HAND_LENGTH_M`."""
    hands: list[HandPose] = []
    used, several = None, 0
    for image, path in _images(source):
        camera = known.camera_of(image.shape[1], image.shape[0], path)
        if used is not None and camera[0] != used[0]:
            raise InputError(f"{source}: pictures of one camera and size are needed at a taped distance")
        pose = estimator.estimate(image, camera[0])
        found = [hand for hand in pose.hands if hand.valid]
        several += len(found) > 1
        if len(found) == 1:
            hands.append(found[0])
            used = used or camera
        if len(hands) >= MOST_HAND_FRAMES:
            break
    if used is None:
        reason = f"two hands in {several} pictures; show" if several else "no hand was found; show"
        raise InputError(f"{source}: {reason} one hand at the taped distance")
    return hands, used


def _images(source: str) -> Iterator[tuple[np.ndarray, Path | None]]:
    """Pictures (H, W, 3) uint8 RGB with their files, or frames of a clip, one every `EVERY_S`. Pictures that cannot be
    read are named and left out, unless there is one alone."""
    if is_video(source):
        next_s = -math.inf
        with open_frames(source) as frames:
            for frame in frames:
                if frame.time_s >= next_s:
                    next_s = frame.time_s + EVERY_S
                    yield frame.image, None
        return
    path = Path(source)
    if os.path.isdir(path):
        files = list_images(path)
    else:
        matching = [] if os.path.lexists(path) else [Path(name) for name in glob.glob(source) if os.path.isfile(name)]
        files = sorted(matching, key=lambda file: natural_key(file.name)) or [path]
    for file in files:
        try:
            image = read_image(file)
        except TwoHandsError as error:
            if len(files) == 1:
                raise
            _say(f"skipped {error}")
            continue
        yield image, file


def _distance_m(words: str) -> float:
    """A taped distance in metres."""
    match = _DISTANCE.fullmatch(words.strip().lower())
    distance = 0.0 if match is None else float(match[1]) * _METRES[match[2]]
    if not 0.1 <= distance <= 5:
        raise InputError(f"--at {words}: a distance of 10 cm to 5 m with its unit expected, such as 50cm, 0.5m or 20in")
    return distance


def _camera_file(fit: CameraFit) -> dict[str, Any]:
    return camera_record(fit.camera) | {
        "calibration_tool": "twohands calibrate camera",
        "number_of_views": len(fit.views),
        "reprojection_error_px": round(fit.rms_px, 4),
        "std_focal_percent": round(100 * fit.focal_sigma, 4),
    }


def _say_fit(fit: CameraFit) -> None:
    camera = fit.camera
    left_out = f", {fit.left_out} left out that disagree" if fit.left_out else ""
    print(
        f"fx {camera.fx:.1f}, fy {camera.fy:.1f} (+- {100 * fit.focal_sigma:.2g} %), cx {camera.cx:.1f}, "
        f"cy {camera.cy:.1f} at {camera.width}x{camera.height}: {len(fit.views)} views{left_out}, reprojection error "
        f"{fit.rms_px:.2f} px"
    )
    if fit.rms_px > 1:
        _say("warning: more than a pixel of error: is the board flat, the focus fixed, the shutter fast?")
    if fit.unseen:
        _say(f"warning: the board was never seen here: {', '.join(fit.unseen)}; the lens is a guess there")


def _existing(name: str | None) -> str | None:
    """A profile's name where it is there already."""
    return name if name is not None and profile_path(name).is_file() else None


def _keep(
    name: str,
    camera: PinholeCamera,
    intrinsics_source: IntrinsicsSource,
    hand_length_m: float | None = None,
    scale_source: ScaleSource | None = None,
) -> None:
    """Puts what was measured into a profile, beside what it holds already."""
    before = kept_profile(name) if _existing(name) else Profile()
    kept = dataclasses.replace(before, camera=camera, intrinsics_source=intrinsics_source)
    if hand_length_m is not None:
        kept = dataclasses.replace(kept, hand_length_m=hand_length_m, scale_source=scale_source)
        if scale_source == "board" and intrinsics_source in ("assumed", "exif"):  # a length that needs no camera
            kept = dataclasses.replace(kept, camera=before.camera, intrinsics_source=before.intrinsics_source)
    elif before.scale_source == "distance":
        _say(f"profile '{name}': its hand length came from a taped distance with another camera and is dropped")
        kept = dataclasses.replace(kept, hand_length_m=None, scale_source=None)
    write_file(profile_path(name), profile_bytes(kept))
    print(f"kept as profile '{name}': twohands track INPUT --profile {name}")


def _refuse_existing(path: Path, overwrite: bool) -> None:
    if path.exists() and not overwrite:
        raise InputError(f"{path} exists; choose another name, or allow it with --overwrite")


def _say(message: str) -> None:
    """One line on stderr; stdout is for results."""
    print(f"twohands: {message}", file=sys.stderr)
