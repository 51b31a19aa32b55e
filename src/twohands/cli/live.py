"""A page that shows both hands in metres while they move: webcam of the browser, a dropped video, or --camera 0.

The same lines go to any program over a WebSocket (docs/stream.md). Ctrl-C ends it. Needs the extra live.
"""

from __future__ import annotations

import os
import sys
import webbrowser
from collections.abc import Iterable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import tyro

from twohands.batch.estimators import opened
from twohands.cli.known import known_by
from twohands.cli.process import EndedBySignal
from twohands.cli.track import option
from twohands.errors import InputError
from twohands.formats.profiles import IntrinsicsSource
from twohands.inference.frames import CAMERA_PREFIX, Frame, open_frames
from twohands.inference.weights import DEFAULT_PRESET
from twohands.live.clip import LiveClip
from twohands.live.door import LOOPBACK, Door, check_door
from twohands.live.messages import Settings
from twohands.motion.vmc import VmcSender
from twohands.types import PinholeCamera
from twohands.visualization.view_page import live_page, view_policy


@dataclass(frozen=True)
class LiveArgs:
    """Arguments of `twohands live`."""

    camera: Annotated[str | None, option("N")] = None
    """Camera of this machine, 0 for the first one; the browser sends pictures if not given."""
    camera_file: Annotated[Path | None, option("FILE")] = None
    """Intrinsics, as the --camera of track: JSON with fx, fy, cx, cy, width, height, or a calibration tool's file."""
    fov: Annotated[float | None, option("DEG")] = None
    """Horizontal field of view, where there is no camera file; 60 along the longer side if not given. The page can
    change it."""
    hand_length: Annotated[float | None, option("CM")] = None
    """As track's; 10 if not given. The page can change it."""
    profile: Annotated[str | None, option("NAME")] = None
    """Camera and hand length that `twohands calibrate` has kept under this name; other options count before it."""
    mirrored: Annotated[bool, tyro.conf.arg(help_behavior_hint="")] = False
    """Pictures are mirrored; they are turned back first. The page can change it."""
    weights: Annotated[str, tyro.conf.arg(metavar="NAME")] = DEFAULT_PRESET
    """Preset that ships with the package, or a weights folder."""
    estimator: Literal["ours", "mediapipe"] = "ours"
    """Who finds the hands: our networks, or MediaPipe, whose hands we place in metres (docs/video.md)."""
    peer_python: Annotated[Path | None, option("FILE")] = None
    """Interpreter of the environment that holds mediapipe; this one if not given."""
    mediapipe_model: Annotated[Path | None, option("FILE")] = None
    """hand_landmarker.task, which mediapipe needs from 0.10.30 on."""
    port: Annotated[int, option("N")] = 8765
    """Where the page is; 0 for any free port. 8765 if not given."""
    host: Annotated[str, option("ADDRESS")] = LOOPBACK
    """Address that others reach; needs --token. This machine alone if not given."""
    token: Annotated[str | None, option("WORD")] = None
    """What everybody must say to come in: at least 8 letters and digits."""
    allow_origin: Annotated[tuple[str, ...], option("ORIGIN")] = ()
    """Pages of yours that may open the stream, such as http://localhost:3000; all others are refused."""
    osc: Annotated[str | None, option("HOST:PORT")] = None
    """Send hand and finger bones to an avatar's program as well, by the VMC protocol: 127.0.0.1:39539 is where such
    programs listen. Needs the extra motion."""
    open: Annotated[bool, tyro.conf.arg(help_behavior_hint="")] = True
    """Do not open the page in a browser."""


def run(args: LiveArgs) -> int:
    """Carry out `twohands live`."""
    from twohands.live.server import LiveServer, listen  # the extra: help needs none

    check_door(args.host, args.token, args.allow_origin)
    if args.camera_file is not None and args.fov is not None:
        raise InputError("give --camera-file or --fov, not both")
    known = known_by(args.camera_file, args.fov, args.hand_length, args.profile)
    number = _camera_number(args.camera)
    name = None if number is None else f"{CAMERA_PREFIX}{number}"
    settings = Settings(name or "stream", known.hand_length_m, args.fov, args.mirrored, known.scale_source)
    avatar = None if args.osc is None else VmcSender(*_host_and_port(args.osc))
    with ExitStack() as stack:
        listening = stack.enter_context(listen(args.host, args.port))
        frames: tuple[str, Iterable[Frame]] | None = None
        if name is not None:
            frames = name, stack.enter_context(open_frames(name))
        found = opened(stack, args.estimator, args.weights, args.peer_python, args.mediapipe_model)
        port = listening.getsockname()[1]

        def camera_for(fov_deg: float | None, width: int, height: int) -> tuple[PinholeCamera, IntrinsicsSource]:
            return replace(known, fov_deg=fov_deg).camera_of(width, height)

        clip = LiveClip(found.estimate, camera_for, found.weights, found.more, settings, avatar, found.decision)
        page = live_page(
            {
                "camera": name,
                "hand_length_cm": round(100 * known.hand_length_m, 4),
                "fov_deg": args.fov,
                "mirrored": args.mirrored,
                "camera_file": known.camera is not None,
                "scale_source": known.scale_source,
                "ours": args.estimator == "ours",
            }
        )
        server = LiveServer(clip, Door(port, args.token, args.allow_origin), page, view_policy(live=True), frames)
        address = _address(args, port)
        try:
            server.run(listening, lambda: _say_where(address, args.open))
        except EndedBySignal:
            raise
        except KeyboardInterrupt:
            print("\ntwohands: live has ended", file=sys.stderr)
    return 0


def _camera_number(given: str | None) -> int | None:
    """Of this machine's camera; None where none is wanted."""
    if given is None:
        return None
    digits = given.removeprefix(CAMERA_PREFIX)
    if not (digits.isascii() and digits.isdecimal() and len(digits) < 4):
        raise InputError(f"--camera {given}: a number expected, 0 for the first; intrinsics go to --camera-file")
    return int(digits)


def _host_and_port(given: str) -> tuple[str, int]:
    host, _, port = given.rpartition(":")
    if not (host and port.isascii() and port.isdecimal() and 0 < int(port) < 1 << 16):
        raise InputError(f"--osc {given}: HOST:PORT expected, such as 127.0.0.1:39539")
    return host, int(port)


def _address(args: LiveArgs, port: int) -> str:
    """Of the page."""
    host = f"[{args.host}]" if ":" in args.host else args.host
    query = "" if args.token is None else f"?token={args.token}"
    return f"http://{host}:{port}/{query}"


def _say_where(address: str, wanted: bool) -> None:
    """Print the page's address, and open it where there is a screen."""
    print(f"live at {address} (Ctrl-C ends)", flush=True)
    screen = sys.platform in ("win32", "darwin") or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if wanted and screen:
        webbrowser.open(address)
