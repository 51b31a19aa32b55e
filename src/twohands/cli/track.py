"""Both hands in metres from a video, a camera, an image, or many of them.

Of images prints a table and writes hands.json, an overlay and the three-view figure of each. Of a video, a stream or
camera:0 writes hands.jsonl while it runs, and an overlay, arrays and a table (extra video). Of a folder, a pattern or a
bucket of videos a folder for each of them, and manifest.jsonl.
"""

from __future__ import annotations

import glob
import json
import os
import sys
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import cv2
import numpy as np
import tyro

from twohands.batch.clip import ClipJob, sourced
from twohands.batch.estimators import opened
from twohands.batch.stores import is_remote
from twohands.batch.tracker import ClipTracker
from twohands.cli.known import camera_assumption, known_by
from twohands.cli.output import check_output_folder, write_file
from twohands.cli.track_clip import check_look_ahead, check_times, default_out, track_clip
from twohands.cli.track_clips import Crew, absolute, are_clips, default_out_of, existing_of, track_many
from twohands.errors import InputError, MissingExtraError, TwoHandsError
from twohands.formats.pictures import list_images, look_through, natural_key, read_image
from twohands.formats.profiles import IntrinsicsSource, ScaleSource
from twohands.inference.estimator import HandEstimator
from twohands.inference.frames import is_video, load_av, open_frames
from twohands.inference.known import Known
from twohands.inference.range_sigma import with_sources
from twohands.inference.records import to_dict
from twohands.inference.weights import DEFAULT_PRESET
from twohands.skeleton import SIDES
from twohands.types import PinholeCamera, TwoHandPose
from twohands.visualization.overlay import draw_overlay

KEEP_EVERY_S = 10.0
"""How often hands.json of a folder is written while it is worked on."""
VIDEO_OPTIONS = ("start", "end", "stride", "mirrored", "smooth", "look_ahead", "overlay", "estimator")
MANY_OPTIONS = ("workers", "engine", "ray_address", "resume")
MAX_NAME_BYTES = 200
"""Of a result's file name, without its ending; file systems take 255."""


def option(metavar: str) -> Any:
    """An option that need not be given; its help text says what happens then."""
    return tyro.conf.arg(metavar=metavar, help_behavior_hint="")


@dataclass(frozen=True)
class TrackArgs:
    """Arguments of `twohands track`."""

    input: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="INPUT")]
    """Image (PNG, JPEG, WebP, BMP, TIFF, AVIF; HEIC with the extra heic), video file, folder or quoted pattern of
    either ('*.jpg'), bucket ('s3://bucket/*.mp4', extra remote), address of a stream (rtsp://...), or camera:0."""
    out: Annotated[str | None, option("DIR")] = None
    """Folder or bucket for the results; out/track/NAME-OF-INPUT if not given."""
    camera: Annotated[Path | None, option("FILE")] = None
    """Camera file: JSON with fx, fy, cx, cy, width, height[, distortion], or a calibration tool's (docs/inputs.md)."""
    fov: Annotated[float | None, option("DEG")] = None
    """Horizontal field of view of the upright pictures, where there is no camera file; if not given, what a picture's
    EXIF notes, else 60 along the longer side."""
    hand_length: Annotated[float | None, option("CM")] = None
    """About 0.6 times the length from the wrist's crease to the tip of the middle finger; ranges scale with it; 10 if
    not given."""
    profile: Annotated[str | None, option("NAME")] = None
    """Camera and hand length that `twohands calibrate` has kept under this name; other options count before it."""
    weights: Annotated[str, tyro.conf.arg(metavar="NAME")] = DEFAULT_PRESET
    """Preset that ships with the package, or a weights folder."""
    json: Annotated[bool, tyro.conf.arg(help_behavior_hint="")] = False
    """Print hands.json instead of the table."""
    overwrite: Annotated[bool, tyro.conf.arg(help_behavior_hint="")] = False
    """Write into a folder that already holds something."""
    start: Annotated[float, option("SECONDS")] = 0.0
    """Video: first time that is wanted."""
    end: Annotated[float | None, option("SECONDS")] = None
    """Video: last time that is wanted."""
    stride: Annotated[int, option("N")] = 1
    """Video: every how many frames one is wanted."""
    mirrored: Annotated[bool, tyro.conf.arg(help_behavior_hint="")] = False
    """Video: the frames are mirrored, as webcams show them; they are turned back first."""
    smooth: Annotated[bool, tyro.conf.arg(help_behavior_hint="")] = True
    """Video: leave ranges as they are estimated, and drop hands the moment they leave the picture."""
    look_ahead: Annotated[float, option("SECONDS")] = 0.0
    """Video: so much of what comes after a frame counts for its range as well; less noise and no lag, for files."""
    overlay: Annotated[bool, tyro.conf.arg(help_behavior_hint="")] = True
    """Video: write no overlay.mp4."""
    estimator: Literal["ours", "mediapipe"] = "ours"
    """Video: who finds the hands: our networks, or MediaPipe, whose hands we place in metres (docs/lift.md)."""
    peer_python: Annotated[Path | None, option("FILE")] = None
    """Interpreter of the environment that holds mediapipe; this one if not given."""
    mediapipe_model: Annotated[Path | None, option("FILE")] = None
    """hand_landmarker.task, which mediapipe needs from 0.10.30 on; its older solution with built-in models if not
    given."""
    workers: int = 0
    """Many clips: processes, one core and one clip each; 0 takes all cores, of the machine or of the cluster."""
    engine: Literal["local", "ray"] = "local"
    """Many clips: who tracks them: processes of this machine, or a Ray cluster, with the same bytes (extra
    'cluster')."""
    ray_address: Annotated[str | None, option("ADDRESS")] = None
    """HOST:PORT of a running Ray cluster's head, "auto" for the cluster that this machine belongs to; if not given, one
    is started on this machine (ray)."""
    resume: Annotated[bool, tyro.conf.arg(help_behavior_hint="")] = False
    """Many clips: go on with a run of the same settings that was killed; only what is missing is tracked."""


@dataclass(frozen=True, slots=True)
class Picture:
    """One picture to work on.

    Attributes:
        path: its file.
        index: its position among the input's files.
        image: (H, W, 3) uint8 RGB.
        camera: intrinsics at this size.
        camera_source: how they are known.
    """

    path: Path
    index: int
    image: np.ndarray
    camera: PinholeCamera
    camera_source: IntrinsicsSource


def run(args: TrackArgs) -> int:
    """Carry out `twohands track`."""
    known = known_by(args.camera, args.fov, args.hand_length, args.profile)
    if not args.input:
        raise InputError("INPUT is empty: an image, a folder, a video or a camera is needed")
    if are_clips(args.input, args.out):
        return _track_clips(args, known)
    _refuse_options(args, MANY_OPTIONS, "many clips: a folder, a pattern or a bucket of videos")
    if is_video(args.input):
        return _track_clip(args, known)
    _refuse_options(args, VIDEO_OPTIONS, "videos, streams and cameras")
    source = Path(args.input)
    folder = os.path.isdir(source)  # Path.is_dir raises for names too long for a file
    matching = [] if os.path.lexists(source) else _matching(args.input)
    files = list_images(source) if folder else matching or [source]
    if folder:
        for line in look_through(source).left_out():
            _say(_printable(line))
    several = folder or bool(matching)
    pictures = _readable(files, known) if several else [_open(source, 0, known)]
    name = files[0].resolve().parent.name if matching else source.resolve().name if folder else source.stem
    out = Path(args.out) if args.out else Path("out") / "track" / name
    if several and os.path.isdir(out) and os.path.samefile(out, files[0].parent):
        raise InputError(
            f"output {out} is the folder of the images, some of which it might replace; choose another --out"
        )
    check_output_folder(out, overwrite=args.overwrite)
    estimator = HandEstimator.from_preset(args.weights)
    for line in known.assumptions():
        _say(line)
    record = track_pictures(
        pictures,
        estimator,
        hand_length_m=known.hand_length_m,
        out=out,
        files=files,
        source=args.input,
        skip=several,
        scale_source=known.scale_source,
    )
    if skipped := len(files) - len(record["frames"]):
        _say(f"{skipped} of {len(files)} images skipped")
    if not record["frames"]:
        raise InputError(f"{args.input}: none of its {len(files)} images can be used")
    if args.json:
        print(json.dumps(record))
    else:
        print_table(record)
        print(f"written to {out}")
    return 0


def _matching(pattern: str) -> list[Path]:
    """Files that a pattern such as 'pictures/*.jpg' names, in natural order; none where it is no pattern.

    Raises:
        InputError: it is a pattern and names no file.
    """
    if not any(sign in pattern for sign in "*?["):
        return []
    files = [Path(name) for name in glob.glob(pattern) if os.path.isfile(name)]
    if not files:
        raise InputError(f"{pattern}: no file matches this pattern")
    return sorted(files, key=lambda path: natural_key(path.name))


def _refuse_options(args: TrackArgs, names: Sequence[str], whose: str) -> None:
    """Of options that mean nothing for this input."""
    unused = TrackArgs(args.input)
    for name in names:
        if getattr(args, name) != getattr(unused, name):
            option_name = f"--no-{name}" if getattr(unused, name) is True else f"--{name.replace('_', '-')}"
            raise InputError(f"{option_name} is for {whose}; {args.input} is none")


def _track_clips(args: TrackArgs, known: Known) -> int:
    """Many videos, or one from or to a bucket."""
    _refuse_options(args, ("json",), "a single clip")
    start_s, end_s = check_times(args.start, args.end)
    existing = existing_of(args.resume, args.overwrite)
    if args.out is not None and "://" in args.out and not is_remote(args.out):
        raise InputError(f"--out {args.out}: a folder or a bucket expected")
    _say_assumptions(known)
    tracker = ClipTracker(
        absolute(args.out or default_out_of(args.input)),
        camera=known.camera,
        fov_deg=known.fov_deg,
        hand_length_m=None if known.scale_source == "assumed" else known.hand_length_m,
        scale_source=known.scale_source,
        camera_source=known.camera_source,
        weights=absolute(args.weights) if os.path.isdir(args.weights) else args.weights,
        start_s=start_s,
        end_s=end_s,
        stride=args.stride,
        mirrored=args.mirrored,
        smooth=args.smooth,
        look_ahead_s=args.look_ahead,
        overlay=args.overlay,
        estimator=args.estimator,
        peer_python=_file_or_name(args.peer_python),
        mediapipe_model=_file_or_name(args.mediapipe_model),
    )
    return track_many(tracker, args.input, Crew(args.engine, args.workers, args.ray_address), existing)


def _file_or_name(place: Path | None) -> str | None:
    """A file as seen from any working folder; what is no file, a command perhaps, as it is."""
    return None if place is None else str(place.absolute() if place.is_file() else place)


def _track_clip(args: TrackArgs, known: Known) -> int:
    """A video, a stream or a camera."""
    start_s, end_s = check_times(args.start, args.end)
    look_ahead_s = check_look_ahead(args.look_ahead)
    out = Path(args.out) if args.out else default_out(args.input)
    check_output_folder(out, overwrite=args.overwrite)
    with ExitStack() as stack:
        frames = stack.enter_context(open_frames(args.input, start_s=start_s, end_s=end_s, stride=args.stride))
        if args.overlay:
            load_av()
        found = opened(stack, args.estimator, args.weights, args.peer_python, args.mediapipe_model)
        _say_assumptions(known)
        job = ClipJob(
            args.input,
            out,
            lambda width, height: known.camera_of(width, height)[0],
            known.hand_length_m,
            args.mirrored,
            args.smooth,
            look_ahead_s,
            args.overlay,
            found.weights,
            found.more,
            found.decision,
        )
        estimate = sourced(found.estimate, known.scale_source, known.camera_source or "assumed")
        return track_clip(job, frames, estimate, lines=args.json)


def _say_assumptions(known: Known) -> None:
    """What is assumed of a clip."""
    if known.camera is None and known.fov_deg is None:
        _say(camera_assumption("assumed") or "")
    for line in known.assumptions():
        _say(line)


def track_pictures(
    pictures: Iterable[Picture],
    estimator: HandEstimator,
    *,
    hand_length_m: float,
    out: Path,
    files: list[Path],
    source: str,
    skip: bool = False,
    scale_source: ScaleSource = "typed",
) -> dict[str, Any]:
    """Estimate every picture and write overlay, three-view figure and, now and then and at whatever end, hands.json.

    Args:
        pictures: what to work on.
        estimator: the pipeline.
        hand_length_m: |wrist - middle knuckle|, metres.
        out: folder for the results.
        files: the source's files, by `Picture.index`.
        source: named in hands.json.
        scale_source: how the hand length is known.
        skip: name and leave out pictures that cannot be used with their camera.

    Returns:
        The content of hands.json.
    """
    names = _result_names(files)
    poses: list[TwoHandPose] = []
    with_views = True
    assumed: set[str] = set()
    kept = time.monotonic()

    def record() -> dict[str, Any]:
        return to_dict(
            poses,
            source=source,
            weights=estimator.card.name,
            config=estimator.settings(),
            hand_length_m=hand_length_m,
            files=[path.name for path in files],
        )

    def keep() -> None:
        write_file(out / "hands.json", (json.dumps(record()) + "\n").encode())

    try:
        for picture in pictures:
            line = camera_assumption(picture.camera_source)
            if line is not None and line not in assumed:
                assumed.add(line)
                _say(line)
            try:
                pose = estimator.estimate(picture.image, picture.camera, hand_length_m, index=picture.index)
                pose = with_sources(pose, scale_source, picture.camera_source)
            except InputError as error:
                if not skip:
                    raise
                _say(f"skipped {picture.path}: {error}")
                continue
            poses.append(pose.without_masks())  # before its drawings, for which the disk may be too small
            name = names[picture.index]
            write_file(out / f"{name}_overlay.png", _png(draw_overlay(picture.image, pose)))
            if with_views:
                with_views = _write_views(out / f"{name}_views.png", picture, pose)
            if time.monotonic() - kept > KEEP_EVERY_S:  # for an end that lets nothing more be done
                keep()
                kept = time.monotonic()
    finally:
        if poses:
            keep()
    return record()


def print_table(record: dict[str, Any]) -> None:
    """Print one row per hand."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(title=Text(f"weights {record['weights']}"), title_justify="left", title_style="dim")
    table.add_column("image", overflow="fold")
    for name in ("hand", "present"):
        table.add_column(name)
    for name in ("range cm", "theta deg", "phi deg", "score"):
        table.add_column(name, justify="right", no_wrap=True)
    for frame in record["frames"]:
        for i, side in enumerate(SIDES):
            hand = frame["hands"][side]
            table.add_row(
                Text(_printable(frame["file"]) if i == 0 else ""),
                side,
                "yes" if hand["present"] else "no",
                _cell(hand["range_m"], 100.0),
                _cell(hand["theta_deg"]),
                _cell(hand["phi_deg"]),
                _cell(hand["score"], digits=2),
                end_section=i == 1,
            )
    Console().print(table)


def _printable(name: str) -> str:
    """A file's name as text; its bytes need not be any."""
    return name.encode("utf-8", "replace").decode()


def _cell(value: float | None, factor: float = 1.0, digits: int = 1) -> str:
    return "-" if value is None else f"{factor * value:.{digits}f}"


def _open(path: Path, index: int, known: Known) -> Picture:
    """Read one picture and fit the camera to its size."""
    image = read_image(path)
    return Picture(path, index, image, *known.camera_of(image.shape[1], image.shape[0], path))


def _readable(files: list[Path], known: Known) -> Iterator[Picture]:
    """Pictures of a folder one by one, with progress; those that cannot be used are named."""
    from rich.console import Console
    from rich.progress import track

    console = Console(stderr=True)
    for index, path in enumerate(track(files, "tracking", console=console, disable=not console.is_terminal)):
        try:
            picture = _open(path, index, known)
        except TwoHandsError as error:
            _say(f"skipped {error}")
            continue
        yield picture


def _result_names(files: list[Path]) -> list[str]:
    """Beginning of each result's file name, all different: the stem, with the suffix where two files share a stem, with
    its number where that is still not enough; shortened where the file system would refuse the result's."""
    stems = Counter(path.stem.casefold() for path in files)  # some file systems do not tell A from a
    shared = [stems[path.stem.casefold()] > 1 for path in files]
    names = [
        os.fsdecode(os.fsencode(path.name.replace(".", "_") if twice else path.stem)[:MAX_NAME_BYTES])
        for path, twice in zip(files, shared, strict=True)
    ]
    if len({name.casefold() for name in names}) == len(names):
        return names
    return [f"{index:04d}_{name}" for index, name in enumerate(names)]


def _write_views(path: Path, picture: Picture, pose: TwoHandPose) -> bool:
    """Write the three-view figure; False, and one message, without matplotlib, or a place for its cache."""
    from twohands.visualization.views import render_views

    try:
        content = render_views(picture.image, pose, title=_printable(picture.path.name))
    except (MissingExtraError, OSError) as error:
        _say(f"no three-view figure: {error}")
        return False
    write_file(path, content)
    return True


def _png(image: np.ndarray) -> bytes:
    """(H, W, 3) RGB uint8 as the bytes of a PNG file."""
    return cv2.imencode(".png", cv2.cvtColor(image, cv2.COLOR_RGB2BGR))[1].tobytes()


def _say(message: str) -> None:
    """One line on stderr; stdout is for results."""
    print(f"twohands: {message}", file=sys.stderr)
