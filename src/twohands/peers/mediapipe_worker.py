"""Runs MediaPipe Hands for `mediapipe_hands.MediaPipeHands`, in an environment of its own.

This file is run as a script by another interpreter and must import nothing but the standard library, numpy and
mediapipe. It reads pictures from standard input and answers each with one line of JSON on standard output:

    in:  one line {"height": H, "width": W}, then H x W x 3 bytes RGB
    out: [{"label": "Left", "score": 0.97, "joints": [[x, y], ...], "world_m": [[x, y, z], ...]}, ...]

x and y of "joints" are fractions of the picture. The first line of the answer, before any picture, is {"version": ...}.
"""

from __future__ import annotations

import json
import sys


def main(argv: list[str]) -> int:
    """Args: model complexity 0 or 1, least detection confidence 0..1."""
    try:
        import mediapipe  # pyright: ignore[reportMissingImports]
        import numpy as np
    except ImportError as error:
        sys.stdout.write(json.dumps({"error": str(error)}) + "\n")
        return 3
    hands = mediapipe.solutions.hands.Hands(
        static_image_mode=True,
        max_num_hands=2,
        model_complexity=int(argv[0]),
        min_detection_confidence=float(argv[1]),
    )
    sys.stdout.write(json.dumps({"version": mediapipe.__version__}) + "\n")
    sys.stdout.flush()
    while line := sys.stdin.buffer.readline():
        size = json.loads(line)
        shape = (size["height"], size["width"], 3)
        image = np.frombuffer(sys.stdin.buffer.read(shape[0] * shape[1] * 3), np.uint8).reshape(shape)
        found = hands.process(image)
        answer = [
            {
                "label": side.classification[0].label,
                "score": side.classification[0].score,
                "joints": [[joint.x, joint.y] for joint in joints.landmark],
                "world_m": [[joint.x, joint.y, joint.z] for joint in world.landmark],
            }
            for side, joints, world in zip(  # noqa: B905 - this file also runs on Python 3.9
                found.multi_handedness or [], found.multi_hand_landmarks or [], found.multi_hand_world_landmarks or []
            )
        ]
        sys.stdout.write(json.dumps(answer) + "\n")
        sys.stdout.flush()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
