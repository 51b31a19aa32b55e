"""What a synthetic scene may look like: every distribution of the generator, with its default."""

from __future__ import annotations

from dataclasses import dataclass

from twohands.errors import InputError


@dataclass(frozen=True)
class SynthConfig:
    """Distributions of the static egocentric set (paper section 3.1). Lengths are metres, angles degrees."""

    width: int = 960
    """Image width in pixels; the paper's files are 960x540."""
    height: int = 540
    """Image height in pixels."""
    drop_rate: float = 0.1
    """Probability that a hand is missing; never both."""
    body_variation: float = 0.0
    """Spread of body and hand shape about the average adult: 0 is the paper's single character, 1 the
    spread of the sampled adults."""
    hand_length: float | None = 0.10
    """Scale the world so that wrist to middle knuckle has this length in metres (the paper: 0.10); None keeps the
    body's own size."""
    box_min: tuple[float, float, float] = (-0.28, -0.14, 0.22)
    """Lower corner of the box that holds the root joints, camera frame, before scaling; x is for the left hand and
    mirrored for the right."""
    box_max: tuple[float, float, float] = (0.12, 0.20, 0.50)
    """Upper corner of that box."""
    image_margin: float = 0.02
    """All 21 joints of a hand stay this fraction of the image away from its border."""
    skin_tones: tuple[float, float] = (0.0, 1.0)
    """Range of skin tone, drawn evenly: 0 the lightest of the Monk scale, 1 the darkest."""
    lights: int = 4
    """Point lights with slightly random colour, brightness and position."""

    def __post_init__(self) -> None:
        if self.width < 32 or self.height < 32:
            raise InputError(f"image must be at least 32x32 pixels, got {self.width}x{self.height}")
        if not 0 <= self.drop_rate < 1:
            raise InputError(f"drop_rate must lie in [0, 1), got {self.drop_rate}")
        if not 0 <= self.body_variation <= 1:
            raise InputError(f"body_variation must lie in [0, 1], got {self.body_variation}")
        if self.hand_length is not None and not 0.02 <= self.hand_length <= 0.5:
            raise InputError(f"hand_length must lie in [0.02, 0.5] metres, got {self.hand_length}")
        if not all(a < b for a, b in zip(self.box_min, self.box_max, strict=True)) or self.box_min[2] <= 0:
            raise InputError(f"hand box is empty or behind the camera: {self.box_min} to {self.box_max}")
        if not 0 <= self.skin_tones[0] <= self.skin_tones[1] <= 1:
            raise InputError(f"skin_tones must be an ordered pair in [0, 1], got {self.skin_tones}")
        if not 0 <= self.image_margin < 0.4:
            raise InputError(f"image_margin must lie in [0, 0.4), got {self.image_margin}")
        if not 1 <= self.lights <= 8:
            raise InputError(f"lights must be 1 to 8, got {self.lights}")
