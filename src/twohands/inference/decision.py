"""Every hand-tuned number of the pipeline, in three frozen records that a preset's card may override.

They calibrate particular networks, so they travel with them: `inference.weights.WeightsCard` holds one record of each
kind, and predictions and hands.json name every value with which they were made. Numbers that training must share are
not here but on the card itself (crops, input sizes) or in `twohands.geometry`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, Final, TypeVar

from twohands.errors import CheckpointError
from twohands.geometry.body import BODY_TERMS
from twohands.geometry.projection import FINGER_WEIGHT, FIT_TOLERANCE, LEAST_SCORE, ROOT_WEIGHT
from twohands.geometry.segmentation import PRESENCE_THRESHOLD, UNCERTAIN_LEAD

Config = TypeVar("Config", "DecisionConfig", "ViewConfig", "PlacementConfig")


@dataclass(frozen=True, slots=True)
class PictureView:
    """How HandSegNet is shown a picture.

    Attributes:
        size: (height, width) of the input in pixels.
        mirrored: whether it is shown the mirror image.
    """

    size: tuple[int, int]
    mirrored: bool = False


@dataclass(frozen=True, slots=True)
class ViewConfig:
    """Test-time augmentation and crops: which views of a picture, and of a hand, the networks see."""

    tta_views: tuple[PictureView, ...] = ()
    """Further views of the picture for HandSegNet, where the first leaves a score within `tta_score_range`."""
    tta_score_range: tuple[float, float] = (0.03, 0.97)
    """Scores of a hand between which HandSegNet sees `tta_views`, too; the mean of all views counts.

    Ours. It concerns three of ten pictures of scene style paper and most of wild. On 850 generated pictures with the
    rules of `inference.handedness` chosen for either, presence before a webcam was right for 93.5 instead of 90.5 % of
    the hands; two views of all pictures bring a little more, and cost twice as much.
    """
    closer_below_share: float = 0.0
    """Where arms and hands, with the room around them, take less than this share of a picture, HandSegNet sees that
    part once more by itself: a person across a room fills it then. 0 never does."""
    closer_margin: float = 1.6
    """Sides of that part over those of the box around arms and hands."""
    closer_smallest: float = 0.15
    """Least side of that part, as a share of the picture's."""
    closer_lead: float = -0.8
    """A hand's lead over the background, in logits, from which on a pixel belongs to that box."""
    tta_rolls_deg: tuple[float, ...] = ()
    """Further views of a hand for the pose networks, as cameras see it that are rolled so far about their line of
    sight; degrees. Where a preset has none, those of its second pose networks' own card count for theirs, where no
    clip has shown anything before (docs/history/journal.md, *Clips known by their joints*)."""
    upright_within_deg: float = 180.0
    """How far from up a hand's fingers may point before PoseNet2D sees it again, as a camera does that is rolled so
    that they point up; and every further crop of it is rolled so. 180: none ever is."""
    search_below_score: float = 0.0
    """Mean score of its joints below which the second pose networks see a hand in every quarter turn; 0 never
    (docs/history/journal.md, *Looked for in every quarter turn*)."""
    turns_deg: tuple[float, ...] = ()
    """Turns of which a doubtful hand is seen in the one that brings its fingers nearest to up; the view with the surer
    joints counts."""
    turn_below_score: float = 0.9
    """Mean score of its joints below which a hand is doubtful (docs/history/journal.md, *Hands upside down*)."""
    turn_lead: float = 0.05
    """By so much a turned view's mean score has to be higher than the first one's."""
    recrop_below_iou: float = 0.65
    """PoseNet2D sees a hand again, cropped to its joints, where HandSegNet's box and theirs overlap less.

    Ours; the paper crops once. It concerns a fifth of the hands. With earlier weights, on 160 test images, it brought
    the root's direction from 92 % within 1.5 degrees to 94 %, and the mean camera-space error from 18.4 to 17.5 mm; a
    second crop of all hands gives no more.
    """
    smallest_box_px: float = 8.0
    """Where the joints of a hand span less than this of the picture, there is nothing to see."""
    uncertain_lead: float = UNCERTAIN_LEAD
    """The background's lead, in logits, below which a pixel is perhaps a hand's: for masks and crops."""
    agreement_share: float = 0.04
    """How far, as a share of the hand's longer side, views see a joint from their median when they are said to agree
    half. 0.02 to 0.06 are alike (docs/history/journal.md, *Where looks agree*)."""

    def __post_init__(self) -> None:
        if len(self.tta_score_range) != 2:
            raise CheckpointError(f"card: views.tta_score_range must be [low, high], got {list(self.tta_score_range)}")
        for name in ("tta_rolls_deg", "turns_deg"):
            if not all(map(math.isfinite, angles := getattr(self, name))):
                raise CheckpointError(f"card: views.{name} must be angles, got {list(angles)}")
        if not 0 <= self.upright_within_deg <= 180:
            raise CheckpointError(f"card: views.upright_within_deg must lie in 0..180, got {self.upright_within_deg}")
        if not 0 <= self.search_below_score <= 1:
            raise CheckpointError(f"card: views.search_below_score must lie in 0..1, got {self.search_below_score}")

    @property
    def upright(self) -> bool:
        """Whether crops of hands whose joints are known are rolled so that the fingers point up."""
        return self.upright_within_deg < 180

    @property
    def looks_again(self) -> bool:
        """Whether the pose networks may see a hand more than once."""
        return bool(self.tta_rolls_deg or self.turns_deg)


FIRST_FEATURES: Final = (
    *("hand", "swapped", "energy", "energy_other", "lead", "lead_other", "share"),
    *("pose", "pose_contrast", "mirror_unseen", "joints", "joints_contrast", "check", "check_side", "check_unseen"),
    *("palm", "palm_side", "body", "body_side", "body_both"),
    *("size", "arm_outside", "arm_below", "arm_outside_below", "outside", "was_present", "held", "held_other"),
    *("merged", "merged_energy", "merged_share", "merged_pose", "merged_pose_contrast", "merged_joints"),
    *("merged_size", "merged_check", "merged_check_side"),
    *("merged_palm", "merged_palm_side", "merged_body", "merged_body_side", "merged_body_both"),
    *("both", "both_near", "both_in_one_place", "both_overlap", "both_uncrossed", "both_weaker"),
)
"""What the first decision weighs; `handedness.first_features` says what each is."""
LAST_FEATURES: Final = (
    *("hand", "first", "pose", "joints", "size", "swapped", "check_short", "check_unseen"),
    *("both", "both_near"),
)
"""What the last decision weighs; `handedness.last_features` says what each is."""


SECOND_FEATURES: Final = (
    *("second", "first_doubt", "second_doubt", "first_pose", "second_pose", "second_passed"),
    *("apart", "first_doubt_apart", "second_doubt_apart"),
)
"""What says which pair of pose networks knows a hand; `second_look.second_features` says what each is."""


@dataclass(frozen=True, slots=True)
class DecisionConfig:
    """Which hands are there, and whose (`inference.handedness`). A "logit" is log-odds.

    Raises:
        CheckpointError: a weight of no feature, or one that is not finite.
    """

    first: Mapping[str, float] = field(default_factory=dict)
    """Weight of every feature of `FIRST_FEATURES`, 0 for one that is not named; fitted together with those of `last`
    by scripts/fit_handedness.py. Without any, HandSegNet decides alone."""
    last: Mapping[str, float] = field(default_factory=dict)
    """The same of `LAST_FEATURES`, after the last view of a hand."""
    fit: Mapping[str, Any] = field(default_factory=dict)
    """How the weights were fitted, for the reader."""
    second: Mapping[str, float] = field(default_factory=dict)
    """The same of `SECOND_FEATURES`, of a preset with second pose networks; fitted by scripts/fit_second_look.py."""
    presence_threshold: float = PRESENCE_THRESHOLD
    """HandSegNet's score (`geometry.segmentation.hand_scores`) of a hand, where it decides alone."""
    candidate_threshold: float = 0.03
    """HandSegNet's score from which on PoseNet2D looks at a candidate: what it does not look at is lost."""
    mirror_below_logit: float = 3.0
    """`hand_logit` of any candidate below which PoseNet2D sees the mirror images too."""
    same_place_iou: float = 0.4
    """Two candidates whose boxes overlap this much are in one place, and also seen as one hand."""
    side_trust: float = 0.3
    """Of the log-odds of a side that a frame of a clip says, what is added to what is known: the frames of a clip err
    alike, so that they say less together than apart. A hand that is not seen loses this share with every frame."""
    side_reach: float = 0.2
    """Standard deviation of where a hand is seen from where it was expected, in sizes of its box."""
    side_limit: float = 6.0
    """No frame is believed beyond these log-odds of a side, and none becomes surer over a clip. They are also those of
    an estimator that names sides without saying how sure it is."""

    def __post_init__(self) -> None:
        for name, known in (("first", FIRST_FEATURES), ("last", LAST_FEATURES), ("second", SECOND_FEATURES)):
            weights = getattr(self, name)
            unknown = sorted(set(weights) - set(known))
            if unknown:
                raise CheckpointError(f"card: decision.{name} weighs unknown features, {', '.join(unknown)}")
            if not all(map(math.isfinite, weights.values())):
                raise CheckpointError(f"card: decision.{name} must hold finite weights")


@dataclass(frozen=True, slots=True)
class PlacementConfig:
    """Where the hands are: `inference.placement`."""

    finger_weight: float = FINGER_WEIGHT
    """Of a finger's joint beside 1 for wrist and knuckles (`geometry.projection.range_weights`)."""
    root_weight: float = ROOT_WEIGHT
    """Of the root beside the other knuckles."""
    least_score: float = LEAST_SCORE
    """Of a joint, below which its weight falls no further."""
    fit_tolerance: float = FIT_TOLERANCE
    """How far, in hand lengths, a joint is seen from where the pose puts it when the fit counts it half."""
    ray_share: float = 0.5
    """How far the joints are pulled to the lines of sight on which PoseNet2D sees them, times their score.

    Ours; the paper uses the 2D joints for the root's place alone. With earlier weights, on 1,000 test images, it
    brought the mean camera-space error from 16.8 to 16.1 mm and the canonical AUC from .947 to .952; more brings
    little, and bones of wrong length.
    """
    range_errors: tuple[float, float] | None = None
    """Standard deviations of the logarithm of an estimated range where the joints' mean score is 1, and where it is
    `lower_score`, as scripts/fit_range_errors.py finds them; None to take ranges as the projection gives them."""
    lower_score: float = 0.8
    """Mean score for which the second of `range_errors` is."""
    usual_range_m: float = 0.47
    """Towards which uncertain ranges are drawn: geometric mean over hands of all scene styles."""
    usual_spread: float = 0.5
    """Standard deviation of the logarithm of the range, over these hands."""
    correlation: float = 0.79
    """Of the logarithms of both ranges of a picture."""
    body_weights: tuple[float, ...] = ()
    """Of `Body.distance_terms`: how far hands are by the size of the person whose they are (`placement.body_ranges`);
    none: bodies say nothing of it."""
    body_spread: float = 0.2
    """Standard deviation of the logarithm of a range beside what the body makes likely."""
    body_correlation: float = 0.7
    """Of both hands of a body."""
    range_sigma: tuple[float, float, float, float] | None = None
    """How far the likely range may be off, standard deviation as a share, of a hand whose joints have the mean score
    `sigma_score` and whose palm is seen `sigma_misfit` hand lengths from where the pose has it and as wide as
    `sigma_span`; and the powers with which it goes with what is missing of the score, with the misfit and with the
    span. As scripts/fit_range_errors.py finds them; None: nothing is said."""
    sigma_score: float = 0.98
    """Mean score for which the first of `range_sigma` is."""
    sigma_misfit: float = 0.02
    """Misfit, in hand lengths, for which it is."""
    sigma_span: float = 0.36
    """Span of the palm, in hand lengths, for which it is."""

    def __post_init__(self) -> None:
        errors = self.range_errors
        if errors is not None and not (len(errors) == 2 and all(0 < error < math.inf for error in errors)):
            raise CheckpointError(f"card: placement.range_errors must be two numbers larger than 0, got {list(errors)}")
        if len(self.body_weights) not in (0, BODY_TERMS) or not all(map(math.isfinite, self.body_weights)):
            raise CheckpointError(f"card: placement.body_weights must be {BODY_TERMS} numbers, got {self.body_weights}")
        if not (0 < self.body_spread < math.inf and -1 < self.body_correlation < 1):
            raise CheckpointError("card: placement.body_spread must be above 0, body_correlation between -1 and 1")
        sigma = self.range_sigma
        if sigma is not None and not (len(sigma) == 4 and sigma[0] > 0 and all(map(math.isfinite, sigma))):
            raise CheckpointError(f"card: placement.range_sigma must be four numbers, the first above 0, got {sigma}")


def overridden(config: Config, values: Mapping[str, Any], section: str) -> Config:
    """A record with some values of a card.

    Args:
        config: what holds where the card is silent.
        values: field -> number, or list of numbers; `tta_views` ready-made.
        section: of the card, named in errors.

    Raises:
        CheckpointError: an unknown field, or a value that the record refuses.
        TypeError, ValueError: a value that is no number.
    """
    unknown = sorted(set(values) - {known.name for known in fields(config)})
    if unknown:
        raise CheckpointError(f"card: {section} names unknown settings, {', '.join(unknown)}")
    return replace(config, **{name: _plain(name, getattr(config, name), value) for name, value in values.items()})


def _plain(name: str, default: Any, value: Any) -> Any:
    """A JSON value as the field's kind: numbers by name, a number where the default is one, else a tuple or None."""
    if isinstance(default, Mapping):
        return dict(value) if name == "fit" else {str(key): float(weight) for key, weight in dict(value).items()}
    if isinstance(default, float):
        number = float(value)
        if math.isnan(number):
            raise ValueError("a setting is not a number")
        return number
    if value is None or all(isinstance(item, PictureView) for item in value):
        return None if value is None else tuple(value)
    return tuple(float(item) for item in value)
