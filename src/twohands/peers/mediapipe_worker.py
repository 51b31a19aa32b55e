"""Runs MediaPipe Hands for `mediapipe_hands.MediaPipeHands`, in an environment of its own.

This file is run as a script by another interpreter and must import nothing but the standard library, numpy and
mediapipe. It reads pictures from standard input and answers each with one line of JSON on standard output:

    in:  one line {"height": H, "width": W}, then H x W x 3 bytes RGB
    out: [{"label": "Left", "score": 0.97, "joints": [[x, y], ...], "world_m": [[x, y, z], ...]}, ...]

x and y of "joints" are fractions of the picture; "label" names the person's own hand. The first line of the answer,
before any picture, is {"version": ..., "api": "legacy" or "tasks"}, or {"error": ...}.

The legacy solution (`mp.solutions.hands`, up to 0.10.21) brings its models and names hands as in a mirrored picture.
The Tasks API, all that newer releases have, needs a model file and names the person's own.
"""

from __future__ import annotations

import json
import sys

_MILLISECONDS = 33
"""Between frames of a video, as the Tasks API is told: it wants its clock to advance and asks nothing else of it."""


def main(argv: list[str]) -> int:
    """Args: one JSON object: complexity 0 or 1 (legacy), confidence 0..1, video (frames of one video), model (file of
    the Tasks API, or null)."""
    settings = json.loads(argv[0])
    try:
        import mediapipe  # pyright: ignore[reportMissingImports]
        import numpy as np
    except ImportError as error:
        return _fail(str(error))
    legacy = settings["model"] is None and hasattr(mediapipe, "solutions")
    if settings["model"] is None and not legacy:
        return _fail(f"MediaPipe {mediapipe.__version__} brings no model; give one (hand_landmarker.task)", "model")
    try:
        find = (_legacy if legacy else _tasks)(mediapipe, settings)
    except (RuntimeError, ValueError, OSError) as error:
        return _fail(f"model {settings['model']}: {error}", "model")
    _say({"version": mediapipe.__version__, "api": "legacy" if legacy else "tasks"})
    while line := sys.stdin.buffer.readline():
        size = json.loads(line)
        shape = (size["height"], size["width"], 3)
        content = sys.stdin.buffer.read(shape[0] * shape[1] * 3)
        _say(find(np.frombuffer(content, np.uint8).reshape(shape)))
    return 0


def _legacy(mediapipe, settings):
    """Finds hands by the legacy solution."""
    hands = mediapipe.solutions.hands.Hands(
        static_image_mode=not settings["video"],
        max_num_hands=2,
        model_complexity=settings["complexity"],
        min_detection_confidence=settings["confidence"],
    )
    own = {"Left": "Right", "Right": "Left"}

    def find(image):
        found = hands.process(image)
        sides = [side.classification[0] for side in found.multi_handedness or []]
        joints = [hand.landmark for hand in found.multi_hand_landmarks or []]
        world = [hand.landmark for hand in found.multi_hand_world_landmarks or []]
        return _answer([own[side.label] for side in sides], sides, joints, world)

    return find


def _tasks(mediapipe, settings):
    """Finds hands by the Tasks API."""
    from mediapipe.tasks.python import BaseOptions, vision  # pyright: ignore[reportMissingImports]

    with open(settings["model"], "rb") as file:
        model = file.read()
    options = vision.HandLandmarkerOptions(
        base_options=BaseOptions(model_asset_buffer=model),
        running_mode=vision.RunningMode.VIDEO if settings["video"] else vision.RunningMode.IMAGE,
        num_hands=2,
        min_hand_detection_confidence=settings["confidence"],
    )
    landmarker = vision.HandLandmarker.create_from_options(options)
    clock = [0]

    def find(image):
        picture = mediapipe.Image(image_format=mediapipe.ImageFormat.SRGB, data=image)
        clock[0] += _MILLISECONDS
        found = landmarker.detect_for_video(picture, clock[0]) if settings["video"] else landmarker.detect(picture)
        sides = [side[0] for side in found.handedness]
        return _answer([side.category_name for side in sides], sides, found.hand_landmarks, found.hand_world_landmarks)

    return find


def _answer(labels, sides, joints, world):
    return [
        {
            "label": label,
            "score": side.score,
            "joints": [[joint.x, joint.y] for joint in seen],
            "world_m": [[joint.x, joint.y, joint.z] for joint in shape],
        }
        for label, side, seen, shape in zip(labels, sides, joints, world)  # noqa: B905 - this file also runs on 3.9
    ]


def _say(answer) -> None:
    sys.stdout.write(json.dumps(answer) + "\n")
    sys.stdout.flush()


def _fail(reason: str, what: str = "package") -> int:
    _say({"error": " ".join(reason.split()), "what": what})
    return 3


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
