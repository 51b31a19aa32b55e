"""Both hands in metres, from one plain RGB camera.

    from twohands import HandEstimator, PinholeCamera, read_image

    image = read_image("hands.jpg")
    camera = PinholeCamera.from_fov(60, image.shape[1], image.shape[0])
    pose = HandEstimator.from_preset().estimate(image, camera, hand_length_m=0.095)
    pose.left.joints_m  # (21, 3) metres, camera frame: x right, y down, z forward

Public names are imported when first used, so that `import twohands` costs nothing.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from twohands.version import __version__ as __version__

if TYPE_CHECKING:
    from twohands.errors import TwoHandsError
    from twohands.formats.camera_files import read_camera
    from twohands.formats.pictures import read_image
    from twohands.geometry.lifting import lift
    from twohands.inference.estimator import HandEstimator
    from twohands.inference.stages import StageTruth
    from twohands.inference.tracker import HandTracker
    from twohands.lifting.placing import lift_hands
    from twohands.types import HandPose, PinholeCamera, TwoHandPose
    from twohands.visualization.overlay import draw_overlay
    from twohands.visualization.views import draw_views

_HOME = {
    "HandEstimator": "twohands.inference.estimator",
    "HandPose": "twohands.types",
    "HandTracker": "twohands.inference.tracker",
    "PinholeCamera": "twohands.types",
    "StageTruth": "twohands.inference.stages",
    "TwoHandPose": "twohands.types",
    "TwoHandsError": "twohands.errors",
    "draw_overlay": "twohands.visualization.overlay",
    "draw_views": "twohands.visualization.views",
    "lift": "twohands.geometry.lifting",
    "lift_hands": "twohands.lifting.placing",
    "read_camera": "twohands.formats.camera_files",
    "read_image": "twohands.formats.pictures",
}

__all__ = [
    "HandEstimator",
    "HandPose",
    "HandTracker",
    "PinholeCamera",
    "StageTruth",
    "TwoHandPose",
    "TwoHandsError",
    "draw_overlay",
    "draw_views",
    "lift",
    "lift_hands",
    "read_camera",
    "read_image",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'twohands' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
