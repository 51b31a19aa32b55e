"""One hand held at a taped distance while a clip goes on: what is said of it, and what comes of it."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from typing import Final

from twohands.calibration.tape import TapeFit, fit_tape, focal_spread, length_spread, zoomed
from twohands.errors import InputError
from twohands.formats.profiles import IntrinsicsSource
from twohands.live.messages import Settings
from twohands.types import HandPose, PinholeCamera, TwoHandPose

FRAMES: Final = 12
"""With one hand, of which the length is taken."""
MOST_FRAMES: Final = 150
"""After which it is given up."""


@dataclass(frozen=True, slots=True)
class Measured:
    """What one more frame has brought.

    Attributes:
        note: what is told to who asked, a line of JSON (docs/stream.md).
        settings: of the clip that begins now; None while frames are still to come, and where nothing came of it.
        over: whether no more frames are wanted.
    """

    note: str
    settings: Settings | None = None
    over: bool = False


class Measuring:
    """Takes a clip's estimates until there are enough of one hand; for one taped distance.

    Args:
        distance_m: from the lens to the middle knuckle.
        settings: of the clip.
    """

    def __init__(self, distance_m: float, settings: Settings) -> None:
        self._distance_m, self._settings = distance_m, settings
        self._hands: list[HandPose] = []
        self._looked = 0

    def take(self, pose: TwoHandPose, source: IntrinsicsSource) -> Measured:
        """One more frame.

        Args:
            pose: its estimate, not smoothed, and without the spread of what was assumed.
            source: how its camera is known.
        """
        self._looked += 1
        found = [hand for hand in pose.hands if hand.present]
        problem = None
        if len(found) == 1 and found[0].valid:
            self._hands.append(found[0])
        else:
            problem = "two hands are seen, show one" if len(found) > 1 else "no hand is seen"
        if len(self._hands) < FRAMES:
            over = self._looked >= MOST_FRAMES
            if over:
                problem = f"given up, {problem or 'one hand is seen too seldom'}"
            return Measured(self._note(problem, over), over=over)
        return self._fitted(pose.camera, source)

    def _fitted(self, camera: PinholeCamera, source: IntrinsicsSource) -> Measured:
        settings = self._settings
        try:
            fit = fit_tape(
                self._hands,
                camera,
                [self._distance_m] * len(self._hands),
                settings.hand_length_m,
                focal_spread=focal_spread(source),
                length_spread=length_spread(settings.scale_source),
            )
        except InputError as error:
            return Measured(self._note(str(error), True), over=True)
        fov_deg = settings.fov_deg if fit.focal_scale == 1 else round(zoomed(camera, fit.focal_scale).hfov_deg, 2)
        known = replace(settings, hand_length_m=round(fit.hand_length_m, 6), fov_deg=fov_deg, scale_source="distance")
        return Measured(self._note(None, True, fit, known), known, True)

    def _note(
        self, problem: str | None, over: bool, fit: TapeFit | None = None, settings: Settings | None = None
    ) -> str:
        record = {
            "frames": len(self._hands),
            "of": FRAMES,
            "over": over,
            "problem": problem,
            "hand_length_m": None if settings is None else settings.hand_length_m,
            "fov_deg": None if settings is None else settings.fov_deg,
            "sigma": None if fit is None else round(fit.sigma, 4),
        }
        return json.dumps({"measured": record})
