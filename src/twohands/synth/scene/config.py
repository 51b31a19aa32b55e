"""What a synthetic scene may look like: every distribution of the generator, with its default."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import isfinite
from typing import Final, Literal, get_args

from twohands.errors import InputError
from twohands.types import PinholeCamera

PeopleView = Literal["webcam", "room", "selfie", "shoulder", "above"]
PEOPLE_VIEWS: Final[tuple[PeopleView, ...]] = get_args(PeopleView)
"""A webcam before the face; a camera in the room; a telephone in one hand; over the shoulder; from above a table."""
SHARES = (
    *("together", "sleeves", "gloves", "objects", "watches", "rings"),
    *("background_light", "sensor", "webcam", "free_view", "skin_detail", "gestures", "shown", "people"),
)
"""Settings of `SynthConfig` between 0 and 1."""
SIDE_PX = (32, 16384)
"""Range of a picture's width and height; the upper end is that of common OpenGL drivers."""


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
    skin_detail: float = 0.0
    """Strength of veins, creases, freckles and moles, which differ from person to person; 0 draws none."""
    min_inside: int = 21
    """At least this many of a hand's 21 joints lie inside the image, `image_margin` away from its border."""
    gestures: float = 0.15
    """Share of hands with some fingers stretched and the others curled, as in pointing, counting and thumbs up."""
    shown: float = 0.0
    """Share of hands that must be held up to the camera, palm or back towards it, as in signs and greetings
    (`sampling.held_up`); some of the others are so by chance."""
    lights: int = 4
    """Point lights with slightly random colour, brightness and position."""
    fov: tuple[float, float] | None = None
    """Range of the horizontal field of view, drawn evenly; None keeps the paper's focal length (104 degrees)."""
    intrinsics: tuple[float, float, float, float] | None = None
    """One camera for all pictures: fx, fy, cx, cy in pixels of `width` x `height`; `fov` must be None."""
    principal_shift: float = 0.0
    """Largest shift of the principal point from the image's centre, as a fraction of its size."""
    pitch: tuple[float, float] = (0.0, 0.0)
    """Range of the camera's pitch; positive looks down."""
    roll: tuple[float, float] = (0.0, 0.0)
    """Range of the camera's roll; positive turns the picture clockwise."""
    camera_shift: float = 0.0
    """Largest distance of the camera from the point between the eyes, per axis."""
    webcam: float = 0.0
    """Share of pictures taken from in front of the person, as by a webcam; `roll` holds, `pitch` does not."""
    free_view: float = 0.0
    """Share of pictures taken from anywhere around the hands."""
    people: float = 0.0
    """Share of pictures, and of sequences, of one to three whole, dressed people, as a webcam, a camera in the room,
    over the shoulder or above the table sees them. What is left is then seen from the head: `webcam` and `free_view`
    say something only where this is 0."""
    people_views: tuple[PeopleView, ...] = PEOPLE_VIEWS
    """From where cameras see whole people; drawn in the shares that `views.SHARES` gives them."""
    together: float = 0.0
    """Share of two-hand pictures with the hands close to each other: crossing, touching, one hiding the other."""
    sleeves: float = 0.0
    """Share of people with sleeves, which end anywhere between wrist and elbow."""
    gloves: float = 0.0
    """Share of people with gloves."""
    objects: float = 0.0
    """Share of hands that hold an object, where the fingers leave room for one."""
    watches: float = 0.0
    """Share of people with a watch on a bare wrist."""
    rings: float = 0.0
    """Share of bare hands with a ring."""
    background_light: float = 0.0
    """Share of pictures whose lights take colour, brightness and direction from the background."""
    sensor: float = 0.0
    """Strength of a camera's faults: exposure, white balance, defocus, shake, noise, compression; 0 is ideal."""

    @property
    def amodal(self) -> bool:
        """Whether more than chance hides hands, so that it is worth writing what they would cover (`gt_amodal.png`)."""
        return any((self.together, self.objects, self.webcam, self.free_view, self.people)) or self.pitch != (0.0, 0.0)

    def __post_init__(self) -> None:
        if not all(SIDE_PX[0] <= side <= SIDE_PX[1] for side in (self.width, self.height)):
            raise InputError(
                f"image must be {SIDE_PX[0]} to {SIDE_PX[1]} pixels a side, got {self.width}x{self.height}"
            )
        if not 0 <= self.drop_rate < 1:
            raise InputError(f"drop_rate must lie in [0, 1), got {self.drop_rate}")
        if not 0 <= self.body_variation <= 1:
            raise InputError(f"body_variation must lie in [0, 1], got {self.body_variation}")
        if self.hand_length is not None and not 0.02 <= self.hand_length <= 0.5:
            raise InputError(f"hand_length must lie in [0.02, 0.5] metres, got {self.hand_length}")
        if not all(a < b for a, b in zip(self.box_min, self.box_max, strict=True)) or self.box_min[2] <= 0:
            raise InputError(f"hand box is empty or behind the camera: {self.box_min} to {self.box_max}")
        if not all(map(isfinite, (*self.box_min, *self.box_max))):
            raise InputError(f"hand box must be finite: {self.box_min} to {self.box_max}")
        if not 0 <= self.skin_tones[0] <= self.skin_tones[1] <= 1:
            raise InputError(f"skin_tones must be an ordered pair in [0, 1], got {self.skin_tones}")
        if not 0 <= self.image_margin < 0.4:
            raise InputError(f"image_margin must lie in [0, 0.4), got {self.image_margin}")
        if not 0 <= self.min_inside <= 21:
            raise InputError(f"min_inside must be 0 to 21 joints, got {self.min_inside}")
        if self.fov is not None and not 10 <= self.fov[0] <= self.fov[1] <= 150:
            raise InputError(f"fov must be an ordered pair in [10, 150] degrees, got {self.fov}")
        if self.intrinsics is not None and (self.fov is not None or self.principal_shift):
            raise InputError("intrinsics leave nothing to draw: fov must be None and principal_shift 0")
        if self.intrinsics is not None:
            PinholeCamera(*self.intrinsics, self.width, self.height)  # refuses what is no camera
        if not 0 <= self.principal_shift <= 0.3:
            raise InputError(f"principal_shift must lie in [0, 0.3], got {self.principal_shift}")
        if not 0 <= self.camera_shift <= 0.15:
            raise InputError(f"camera_shift must lie in [0, 0.15] metres, got {self.camera_shift}")
        for name in ("pitch", "roll"):
            low, high = getattr(self, name)
            if not -60 <= low <= high <= 60:
                raise InputError(f"{name} must be an ordered pair in [-60, 60] degrees, got ({low}, {high})")
        for name in SHARES:
            if not 0 <= getattr(self, name) <= 1:
                raise InputError(f"{name} must lie in [0, 1], got {getattr(self, name)}")
        if not self.people_views or not set(self.people_views) <= set(PEOPLE_VIEWS):
            raise InputError(f"people_views must be some of {', '.join(PEOPLE_VIEWS)}, got {self.people_views}")
        if self.webcam + self.free_view > 1:
            raise InputError(f"webcam and free_view must not exceed 1 together, got {self.webcam} and {self.free_view}")
        if not 1 <= self.lights <= 4:
            raise InputError(f"lights must be 1 to 4, got {self.lights}")


PAPER = SynthConfig()
"""The paper's static set: one character, one camera."""

WILD = SynthConfig(
    body_variation=1.0,
    hand_length=None,
    box_min=(-0.30, -0.16, 0.16),
    box_max=(0.16, 0.24, 0.55),
    image_margin=0.0,
    skin_detail=1.0,
    min_inside=14,
    gestures=0.3,
    fov=(50.0, 110.0),
    principal_shift=0.06,
    pitch=(-15.0, 40.0),
    roll=(-12.0, 12.0),
    camera_shift=0.06,
    webcam=0.15,
    free_view=0.05,
    people=0.6,
    together=0.35,
    sleeves=0.5,
    gloves=0.06,
    objects=0.35,
    watches=0.3,
    rings=0.2,
    background_light=0.7,
    sensor=1.0,
)
"""As varied as the world: all kinds of adults, cameras, clothes; hands that meet and leave the picture."""

PEOPLE = replace(WILD, people=1.0, people_views=("webcam", "room"))
"""Whole people alone, before webcams and in rooms."""

PRESETS = {"paper": PAPER, "wild": WILD, "people": PEOPLE}
