"""Fits the decision which hands are there, and whose (`inference.handedness`), to a preset's networks (extras `synth`,
`datasets`).

    python scripts/fit_handedness.py src/twohands/weights/fast --frames PEOPLE WILD PAPER --touching PEOPLE_2
        --backgrounds PHOTOS PANORAMAS --digits ../shared/data/real_train/digits --cache out/fast_evidence.npz

PEOPLE, WILD and PAPER are made by `twohands generate frames` with seeds that no network was trained on; of PEOPLE_2
those are taken that show both hands near each other, of the digits those for training, of the photographs
`--photographs` without hands; `--elsewhere` digits are cut out and put before rooms and the frames. Some frames also
come as a part of them with an arm and no hand, and every other picture as a video's next one: moved a little, with the
answer for the picture before it known.

With `--judges`, the pose networks of other weights look at the same candidates, too. Networks know the pictures that
they learned from, and generated ones like them, better than anyone's camera: who trusts PoseNet2D as much as it is
right there trusts it too much elsewhere. Weights that never saw such pictures show how much it is right about them.

Gathers evidence once, into the cache, and goes on there where it was interrupted; fits by maximum likelihood with a
quadratic penalty; prints errors by kind and a reliability table of pictures held out in turn; writes weights and what
they rest on into the card's "decision". Nothing is chosen by hand.
"""

from __future__ import annotations

import argparse
import hashlib
import io
import itertools
import json
import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import cv2
import numpy as np
from scipy.optimize import minimize
from scipy.special import logsumexp

from twohands.datasets.digits import Digits
from twohands.errors import InputError, TwoHandsError
from twohands.files import write_whole
from twohands.geometry.body import Body
from twohands.geometry.boxes import apply_homography, box_from_points
from twohands.geometry.camera import project
from twohands.geometry.segmentation import BoxEvidence
from twohands.inference.decision import FIRST_FEATURES, LAST_FEATURES, DecisionConfig
from twohands.inference.detection import Detection, HandFinder
from twohands.inference.estimator import HandEstimator
from twohands.inference.handedness import (
    ANSWERS,
    KEPT,
    Assignment,
    Before,
    Evidence,
    LastLook,
    assign_handedness,
    first_features,
    last_features,
    palm_distance,
    rescore,
    weight_vector,
)
from twohands.inference.weights import preset_folder, read_card, weights_id, write_card
from twohands.skeleton import LEFT, RIGHT, ROOT, WRIST
from twohands.types import HandSample, PinholeCamera

if TYPE_CHECKING:
    from twohands.synth.backgrounds.base import Backgrounds

RIGHTLY, WRONG_SIDE, INVENTED = 1, 2, 3
"""What a reported hand is: the true hand of its side, the other true hand, or none; 0 for one that is not reported."""
NEAR: Final = 0.4
"""A hand is a true one whose palm is nearer than this, as a share of the true one's longer side."""
PENALTY: Final = 10.0
"""Of half the square of a weight times its feature's standard deviation; 1 and 30 are alike in pictures held out."""
FEATURES: Final = {
    "bodies": tuple(name for name in FIRST_FEATURES if "body" in name),
    "palms": tuple(name for name in FIRST_FEATURES if "palm" in name),
}
"""What published networks say that a picture may show or not."""
TRUST: Final = {"body": 2.0, "merged_body": 2.0}
"""Added to the fitted weights of whether a body's hand should be there. Networks that learnt from rendered people know
these better than real ones, and networks of bodies worse (docs/history/journal.md, *Bodies*)."""
FOLDS: Final = 5
TOUCHING: Final = 0.75
"""Distance of their palms, in sides of the larger hand's box, below which two hands are near each other: people keep
theirs apart in nine frames of ten, and who fits to these alone takes two that touch for one."""
PHOTOGRAPH: Final = (640, 360)
SAVED_EVERY: Final = 25
HANDLESS_STEP: Final = 3
"""Of so many frames one is looked at once more, in a part that shows an arm and no hand."""
MOVED: Final = (0.02, 0.02, 2.0)
"""Standard deviations from one picture to the next: shift as a share of the width, scale, roll in degrees."""
BINS: Final = (0.0, 0.05, 0.2, 0.5, 0.8, 0.95, 0.99, 1.0)


class Seen(NamedTuple):
    """What the pipeline sees in one picture, whatever the decision will be.

    Attributes:
        kind: of the picture, for tables.
        scene: pictures of one scene are held out together.
        present: (2,) bool, the true hands.
        evidence: of the candidates; `before` is None.
        last: (7, 2, 3) PoseNet2D's log-odds, joints' score and size after the last view, by answer and side; NaN for
            what cannot be.
        distance: (7,) distance of the palms after it.
        boxes_px: (7, 2, 4) boxes after it.
        outcome: (7, 2) int, what every hand of every answer is.
        earlier: number of the picture before it; -1 for none.
    """

    kind: str
    scene: int
    present: np.ndarray
    evidence: Evidence
    last: np.ndarray
    distance: np.ndarray
    boxes_px: np.ndarray
    outcome: np.ndarray
    earlier: int


@dataclass(frozen=True, slots=True)
class Choices:
    """Answers of N pictures for a fit: features (N, A, F), NaN for what cannot be, and right (N, A) bool, at least one
    of each picture."""

    features: np.ndarray
    right: np.ndarray


def main() -> int:
    """Reads the options, looks, fits, prints and writes."""
    parser = argparse.ArgumentParser(description="Fits a preset's decision which hands are there, and whose.")
    parser.add_argument("preset", type=Path, help="weights folder; its card is written")
    parser.add_argument("--judges", nargs="*", default=[], help="weights folders or presets: see above")
    add_picture_options(parser, count=1000, digits=150, photographs=100)
    parser.add_argument("--cache", type=Path, required=True, help="file of evidence; read where it is there")
    parser.add_argument("--only", choices=list(FEATURES), help="fit what these say alone; all else stays as it is")
    parser.add_argument("--dry-run", action="store_true", help="leave the card alone")
    options = parser.parse_args()
    try:
        card = read_card(options.preset)
        if not card.hand_logit:
            raise InputError(f"{card.name}: its PoseNet2D has no hand classifier, there is nothing to decide by")
        judges = [preset_folder(judge) for judge in options.judges]
        folders = (options.preset, *judges)
        identity = "+".join(weights_id(folder, read_card(folder)) for folder in folders)
        pictures = gathered(options, "+".join([identity, *map(views_id, folders)]))
        config = card.decision
        fitting = fit if options.only is None else partial(fit_only, options.only)
        summary, fitted = cross_validated(pictures, config, fitting), fitting(pictures, config)
        kinds = {kind: sum(one.kind == kind for one in pictures) for kind in dict.fromkeys(p.kind for p in pictures)}
        trust = {name: TRUST[name] for name in FEATURES.get(options.only, FIRST_FEATURES) if name in TRUST}
        described = {"weights": identity, "pictures": kinds, "penalty": PENALTY, "trust": trust, **summary}
        fitted = replace(fitted, fit=described if options.only is None else {**config.fit, options.only: described})
        if not options.dry_run:
            write_decision(options.preset, fitted)
    except TwoHandsError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print_weights(fitted)
    return 0


def views_id(folder: Path) -> str:
    """Fingerprint of what decides, beside the weights, what a preset's networks are shown."""
    return hashlib.sha256(repr(read_card(folder).views).encode()).hexdigest()[:8]


def gathered(options: argparse.Namespace, identity: str) -> list[Seen]:
    """Evidence of all pictures; what the cache holds already is not looked at again."""
    cv2.setNumThreads(1)
    found = load(options.cache, identity) if options.cache.exists() else []
    plan = planned(options)
    first = found[-1].scene + 1 if found else 0
    if first == len(plan):
        return found
    own = deciding(HandEstimator.from_preset(options.preset, threads=1))
    judges = [HandEstimator.from_preset(judge, threads=1) for judge in options.judges]
    estimators = [own, *(judged_by(own, judge) for judge in judges)]
    for scene in range(first, len(plan)):
        kind, sample_of = plan[scene]
        sample, rng = sample_of(), np.random.default_rng([options.seed, scene])
        before = moved(sample, rng) if kind != "photographs" and scene % 2 else None
        for estimator in estimators:
            named_kind = kind if estimator is own else f"{kind} by {estimator.card.name}"
            earlier = -1
            if before is not None:
                found.append(seen(estimator, before, named_kind, scene, -1))
                earlier = len(found) - 1
            found.append(seen(estimator, sample, named_kind, scene, earlier))
        if scene % SAVED_EVERY == 0 or scene + 1 == len(plan):
            save(options.cache, found, identity)
            print(f"{scene + 1} of {len(plan)} scenes", file=sys.stderr, flush=True)
    return found


def add_picture_options(parser: argparse.ArgumentParser, *, count: int, digits: int, photographs: int) -> None:
    """What `planned` reads, with how many pictures of each kind there are at most."""
    parser.add_argument("--frames", type=Path, nargs="*", default=[], help="folders of cached frames")
    parser.add_argument("--touching", type=Path, nargs="*", default=[], help="others, for hands near each other alone")
    parser.add_argument("--count", type=int, default=count, help="of pictures of every folder, at most")
    parser.add_argument("--digits", type=Path, help="folder of photographed digits")
    parser.add_argument("--digits-count", type=int, default=digits)
    parser.add_argument("--elsewhere", type=int, default=0, help="pictures of these hands before rooms and the frames")
    parser.add_argument("--backgrounds", type=Path, nargs="*", default=[], help="folders of photographs and panoramas")
    parser.add_argument("--photographs", type=int, default=photographs, help="backgrounds without hands, at most")
    parser.add_argument("--seed", type=int, default=1)


def planned(options: argparse.Namespace) -> list[tuple[str, Callable[[], HandSample]]]:
    """Kind of every picture and what gives it, in an order in which any beginning is a fair sample.

    Raises:
        InputError: there is no picture.
    """
    from twohands.synth.sets.cache import FrameCache
    from twohands.training.config import DataConfig, folder_list
    from twohands.training.cutouts import CutoutScenes
    from twohands.training.hand_views import part_without_hands
    from twohands.training.sources import backgrounds_of

    plan: list[tuple[str, Callable[[], HandSample]]] = []
    behind = backgrounds_of(DataConfig(backgrounds=folder_list(options.backgrounds)))
    for folder in options.frames:
        count = min(options.count, frame_count(folder))
        cache = FrameCache(folder, behind, frames=(0, count))
        plan += [(folder.name, partial(cache.__getitem__, i)) for i in range(count)]
        parts = [part_without_hands(cache[i], np.random.default_rng(i)) for i in range(0, count, HANDLESS_STEP)]
        plan += [(f"{folder.name}, no hand", partial(_same, part)) for part in parts if not np.any(part.present)]
    for folder in options.touching:
        cache = FrameCache(folder, behind)
        stored = map(cache.stored, range(len(cache)))  # without background: this takes no time
        together = [near(frame.present, project(frame.joints_m[:, 1:], camera)) for frame, camera in stored]
        plan += [(f"{folder.name}, touching", partial(cache.__getitem__, i)) for i in np.flatnonzero(together).tolist()]
    if options.digits is not None:
        digits = Digits(options.digits, "training")
        numbers = np.linspace(0, len(digits) - 1, min(options.digits_count, len(digits))).astype(int)
        plan += [("digits", partial(digits.__getitem__, int(number))) for number in numbers]
        people = [FrameCache(folder, behind) for folder in options.frames if options.elsewhere]
        scenes = CutoutScenes(digits, behind, people, seed=options.seed, variants=1 + options.elsewhere // len(digits))
        plan += [("digits elsewhere", partial(scenes.__getitem__, i)) for i in range(options.elsewhere)]
    if options.backgrounds:
        of = partial(photograph, behind, options.seed)
        plan += [("photographs", partial(of, number)) for number in range(options.photographs)]
    if not plan:
        raise InputError("no pictures: name --frames, --digits or --backgrounds")
    return [plan[i] for i in np.random.default_rng(options.seed).permutation(len(plan))]


def near(present: np.ndarray, joints_px: np.ndarray) -> bool:
    """Whether both hands, (2,) bool, are there, with the palms of their joints (2, 21, 2) near each other
    (`TOUCHING`)."""
    return bool(present.all()) and palm_distance(joints_px, np.asarray(box_from_points(joints_px))) < TOUCHING


def _same(sample: HandSample) -> HandSample:
    return sample


def frame_count(folder: Path) -> int:
    """Frames of a cache, of which only those must be rendered that are looked at.

    Raises:
        InputError: it is none.
    """
    try:
        return len(np.load(folder / "done.npy", mmap_mode="r"))
    except (OSError, ValueError) as error:
        raise InputError(f"{folder} holds no frame cache: {error}") from error


def photograph(behind: Backgrounds, seed: int, number: int) -> HandSample:
    """A background alone."""
    rng = np.random.default_rng([seed, number])
    camera = PinholeCamera.from_fov(rng.uniform(50, 90), *PHOTOGRAPH)
    return without_hands(behind.sample(rng, camera).picture, camera)


def without_hands(image: np.ndarray, camera: PinholeCamera) -> HandSample:
    """A picture that shows none."""
    unknown = np.full((2, 21, 3), np.nan)
    no_joints = np.zeros((2, 21), bool)
    return HandSample(image, camera, np.zeros(2, bool), unknown[..., :2], unknown, no_joints)


def moved(sample: HandSample, rng: np.random.Generator) -> HandSample:
    """The same a moment earlier: seen by a camera that moved a little, in a little other light."""
    height, width = sample.image.shape[:2]
    shift, scale, roll = rng.normal(0, 1, 2) * MOVED[0] * width, 1 + rng.normal(0, MOVED[1]), rng.normal(0, MOVED[2])
    matrix = cv2.getRotationMatrix2D((width / 2, height / 2), roll, scale)
    matrix[:, 2] += shift
    image = cv2.warpAffine(sample.image, matrix, (width, height), borderMode=cv2.BORDER_REPLICATE)
    image = image * rng.uniform(0.9, 1.1) + rng.normal(0, 2, image.shape)
    joints_px = np.asarray(apply_homography(np.vstack([matrix, [0, 0, 1]]), sample.joints_px))
    return replace(sample, image=np.clip(image, 0, 255).astype(np.uint8), joints_px=joints_px, labels=None)


def deciding(estimator: HandEstimator) -> HandEstimator:
    """The same, looking at candidates whether its card is fitted yet or not."""
    decision = replace(estimator.card.decision, first={"hand": 0.0}, last={"hand": 0.0})
    return HandEstimator(estimator.networks, replace(estimator.card, decision=decision))


def judged_by(own: HandEstimator, judge: HandEstimator) -> HandEstimator:
    """Candidates and second pose networks of one preset, the first ones of another."""
    pose = ("name", "crop_size", "crop_kind", "crop_margin", "heatmap_decode", "background", "hand_logit", "cues")
    card = replace(own.card, **{name: getattr(judge.card, name) for name in pose})
    networks = replace(judge.networks, hand_seg_net=own.networks.hand_seg_net, second=own.networks.second)
    return HandEstimator(networks, card)


def seen(estimator: HandEstimator, sample: HandSample, kind: str, scene: int, earlier: int) -> Seen:
    """Looks at one picture, and at what would be left of it after every answer."""
    body = estimator.body(sample.image)
    masks, boxes = estimator.segment(sample.image, body=body)
    palms = estimator.palms(sample.image)
    finder = HandFinder(estimator.stages, estimator.card, sample.image, sample.camera, body=body, palms=palms)
    sides = np.flatnonzero(boxes.present)
    last, distance = np.full((len(ANSWERS), 2, 3), np.nan), np.full(len(ANSWERS), np.inf)
    boxes_px, outcome = np.full((len(ANSWERS), 2, 4), np.nan), np.zeros((len(ANSWERS), 2), int)
    if not len(sides):
        unseen, nothing = np.full((2, 2), np.nan), np.zeros((2, 2))
        maps = BoxEvidence(nothing, nothing, nothing, nothing)
        size = sample.image.shape[0], sample.image.shape[1]
        evidence = Evidence(size, boxes.boxes_px, maps, unseen, unseen)
        return Seen(kind, scene, sample.present, evidence, last, distance, boxes_px, outcome, earlier)
    crops = finder.crops(masks, boxes.boxes_px, sides)
    found = Detection(masks, boxes, finder.looked(masks, boxes.boxes_px, crops))
    evidence, views = finder.evidence(found, None)
    possible = np.isfinite(first_features(evidence)[:, 0])
    pairs = tuple(ANSWERS.index(pair) for pair in ((0, 1), (1, 0)))
    for answer in sorted(np.flatnonzero(possible)[1:], key=lambda number: number not in pairs):
        source, same = np.array(ANSWERS[answer]), None
        if evidence.merged_pose is None and (source < 0).any():  # as in the pair, where there is one
            alike = ((np.array(ANSWERS[pair]) == source).any() for pair in pairs)
            same = next((pair for pair, is_it in zip(pairs, alike, strict=True) if is_it and possible[pair]), None)
        if same is not None:
            there = source >= 0
            last[answer][there], boxes_px[answer][there] = last[same][there], boxes_px[same][there]
            outcome[answer][there] = outcome[same][there]
            continue
        assignment = Assignment(source, np.where(source >= 0, 0.0, np.nan))
        assigned, changed = finder.assigned(found, assignment, views)
        after = finder.recropped(assigned, changed)
        look = finder.last_look(after, assignment)
        last[answer] = np.stack([look.pose, look.joints, look.size], axis=-1)
        distance[answer], boxes_px[answer] = look.palm_distance, after.boxes.boxes_px
        outcome[answer, after.keypoints.sides] = outcomes(finder, after, assigned.boxes.boxes_px, sample)
    return Seen(kind, scene, sample.present, evidence, last, distance, boxes_px, outcome, earlier)


def outcomes(finder: HandFinder, after: Detection, boxes_px: np.ndarray, sample: HandSample) -> list[int]:
    """What the hands of an answer are, in boxes (2, 4): by their joints, or, where these are on no hand, by those of
    the second pose networks if they count. The first ones do not know all hands that others know."""
    found = [outcome_of(after.keypoints.joints_px[row], side, sample) for row, side in enumerate(after.keypoints.sides)]
    if INVENTED not in found or not np.any(sample.present):
        return found
    better = finder.seen_better(after, boxes_px).keypoints.joints_px
    hands = zip(found, better, after.keypoints.sides, strict=True)
    return [outcome_of(joints_px, side, sample) if one == INVENTED else one for one, joints_px, side in hands]


def outcome_of(joints_px: np.ndarray, side: int, sample: HandSample) -> int:
    """What a reported hand is, from its joints (21, 2)."""
    true = true_side(joints_px, sample)
    return INVENTED if true is None else RIGHTLY if true == side else WRONG_SIDE


def true_side(joints_px: np.ndarray, sample: HandSample) -> int | None:
    """Of the true hand whose palm these joints (21, 2) have; None where there is none."""
    palms_px = sample.joints_px[:, [WRIST, ROOT]].mean(axis=1)
    true_px = np.asarray(box_from_points(sample.joints_px))
    sizes_px = (true_px[:, 2:] - true_px[:, :2]).max(axis=1)
    off = np.linalg.norm(palms_px - joints_px[[WRIST, ROOT]].mean(axis=0), axis=1) / sizes_px
    off = np.where(sample.present & np.isfinite(off), off, np.inf)
    nearest = int(np.argmin(off))
    return None if off[nearest] > NEAR else nearest


def fit(pictures: Sequence[Seen], config: DecisionConfig) -> DecisionConfig:
    """The weights: first without what was before, which then comes from these; then with it."""
    alone = fitted_last([(one, None) for one in pictures], fitted_first([(one, None) for one in pictures], config))
    known = with_before(pictures, alone)
    return trusting(fitted_last(known, fitted_first(known, config)))


def fit_only(says: str, pictures: Sequence[Seen], config: DecisionConfig) -> DecisionConfig:
    """The weights of what "bodies" or "palms" say, beside all others as they are: where nobody is seen, or no palm that
    passes, decisions stay the same."""
    shown = {"bodies": lambda one: one.body is not None, "palms": lambda one: np.isfinite(one.palm).any()}[says]
    known: list[tuple[Seen, Before | None]] = [(one, None) for one in pictures if shown(one.evidence)]
    given = {name: 0.0 for name in FIRST_FEATURES} | dict(config.first) | dict.fromkeys(FEATURES[says], math.nan)
    return trusting(fitted_first(known, config, weight_vector(given, FIRST_FEATURES)), FEATURES[says])


def trusting(config: DecisionConfig, names: Sequence[str] = tuple(TRUST)) -> DecisionConfig:
    """With the features of these names trusted by `TRUST` more than the fit says."""
    trusted = {name: round(config.first[name] + TRUST[name], 4) for name in names if name in TRUST}
    return replace(config, first={**config.first, **trusted})


def with_before(pictures: Sequence[Seen], config: DecisionConfig) -> list[tuple[Seen, Before | None]]:
    """Every picture with nothing known, and those that follow another one also with what was said of that."""
    answers = {one.earlier: answered(pictures[one.earlier], None, config) for one in pictures if one.earlier >= 0}
    known: list[tuple[Seen, Before | None]] = [(one, None) for one in pictures]
    for one in pictures:
        if one.earlier >= 0:
            answer, kept, logits = answers[one.earlier]
            boxes_px = pictures[one.earlier].boxes_px[answer]
            known.append((one, Before(np.where(kept[:, None], boxes_px, np.nan), np.where(kept, logits, np.nan))))
    return known


def answered(one: Seen, before: Before | None, config: DecisionConfig) -> tuple[int, np.ndarray, np.ndarray]:
    """Number of the first answer, (2,) bool which of its hands are kept, (2,) their last log-odds."""
    assignment = assign_handedness(replace(one.evidence, before=before), config)
    answer = ANSWERS.index((int(assignment.source[LEFT]), int(assignment.source[RIGHT])))
    kept, logits = rescore(look_of(one, answer, assignment), config)
    return answer, kept, logits


def look_of(one: Seen, answer: int, assignment: Assignment) -> LastLook:
    """The last look at the hands of an answer."""
    pose, joints, size = np.moveaxis(one.last[answer], -1, 0)
    checks = one.evidence.checks(assignment.source)
    return LastLook(assignment.source, assignment.logits, pose, joints, size, float(one.distance[answer]), checks)


def fitted_first(
    known: Sequence[tuple[Seen, Before | None]], config: DecisionConfig, given: np.ndarray | None = None
) -> DecisionConfig:
    """With the weights of the first decision; `given` as of `likeliest`."""
    features = [first_features(replace(one.evidence, before=before)) for one, before in known]
    looks = zip(known, features, strict=True)
    right = [right_answers(one.outcome, np.isfinite(rows[:, 0])) for (one, _), rows in looks]
    return replace(config, first=named(likeliest(Choices(np.array(features), np.array(right)), given), FIRST_FEATURES))


def fitted_last(known: Sequence[tuple[Seen, Before | None]], config: DecisionConfig) -> DecisionConfig:
    """With the weights of the last decision, after the first one."""
    features, right = [], []
    for one, before in known:
        assignment = assign_handedness(replace(one.evidence, before=before), config)
        answer = ANSWERS.index((int(assignment.source[LEFT]), int(assignment.source[RIGHT])))
        features.append(last_features(look_of(one, answer, assignment)))
        right.append((np.array(KEPT) == (one.outcome[answer] == RIGHTLY)).all(axis=1))
    return replace(config, last=named(likeliest(Choices(np.array(features), np.array(right))), LAST_FEATURES))


def right_answers(outcome: np.ndarray, possible: np.ndarray) -> np.ndarray:
    """(7,) bool: the answers of which every hand is right, with as many hands as possible."""
    reported = np.array(ANSWERS) >= 0
    right = possible & (~reported | (outcome == RIGHTLY)).all(axis=1)
    count = np.where(right, reported.sum(axis=1), -1)
    return count == count.max()


def likeliest(choices: Choices, given: np.ndarray | None = None) -> np.ndarray:
    """(F,) weights of the largest penalised likelihood that one of the right answers is the answer; those that are
    `given`, (F,), as they are, NaN for one to be fitted; None for all."""
    given = np.full(choices.features.shape[-1], np.nan) if given is None else given
    possible = np.isfinite(choices.features[..., 0])
    open_ones = possible.sum(axis=1) > 1
    features, right, possible = choices.features[open_ones], choices.right[open_ones], possible[open_ones]
    if not len(features):
        raise InputError("no picture with a candidate: there is nothing to fit")
    spread = np.maximum(features[possible].std(axis=0), 1e-9)
    features = np.where(possible[..., None], features, 0.0)
    offset = np.where(possible, features @ np.nan_to_num(given), -np.inf)
    features = np.where(np.isnan(given), features, 0.0) / spread

    def loss(weights: np.ndarray) -> tuple[float, np.ndarray]:
        scores = features @ weights + offset
        rightly = np.where(right, scores, -np.inf)
        whole, part = logsumexp(scores, axis=1), logsumexp(rightly, axis=1)
        pull = np.exp(scores - whole[:, None]) - np.exp(rightly - part[:, None])
        value = float((whole - part).sum() + PENALTY / 2 * weights @ weights)
        return value, np.einsum("na,naf->f", pull, features) + PENALTY * weights

    found = minimize(loss, np.zeros(features.shape[-1]), jac=True, method="L-BFGS-B", options={"maxiter": 2000})
    return np.where(np.isnan(given), found.x / spread, given)


def named(weights: np.ndarray, names: Sequence[str]) -> dict[str, float]:
    """As a card holds them."""
    return {name: round(float(weight), 4) for name, weight in zip(names, weights, strict=True)}


def cross_validated(
    pictures: Sequence[Seen],
    config: DecisionConfig,
    fitting: Callable[[Sequence[Seen], DecisionConfig], DecisionConfig] = fit,
) -> dict[str, object]:
    """Prints errors by kind and a reliability table, every scene by weights fitted to other scenes; a summary."""
    rows: dict[str, np.ndarray] = {}
    chances: list[tuple[float, bool]] = []
    exchanged = np.zeros(2, int)
    for fold in range(FOLDS):
        inside = [one for one in pictures if one.scene % FOLDS == fold]
        outside = [one for one in pictures if one.scene % FOLDS != fold]
        if not inside or not outside:
            continue
        fitted = fitting(renumbered(outside), config)
        for one, before in with_before(renumbered(inside), fitted):
            answer, kept, logits = answered(one, before, fitted)
            outcome = np.where(kept, one.outcome[answer], 0)
            kind = one.kind if before is None else f"{one.kind}, next"
            rows[kind] = rows.get(kind, np.zeros(6, int)) + counted(outcome, one.present)
            for side in np.flatnonzero(np.isfinite(logits)):
                chances.append((float(1 / (1 + np.exp(-logits[side]))), bool(one.outcome[answer, side] == RIGHTLY)))
            if before is not None:
                exchanged += [1, int(side_changed(before, np.where(kept[:, None], one.boxes_px[answer], np.nan)))]
    print_errors(rows)
    print_reliability(np.array(chances))
    if exchanged[0]:
        print(f"\nside changes from one picture to the next: {exchanged[1]} of {exchanged[0]}")
    totals = sum((row for kind, row in rows.items() if not kind.endswith(", next")), np.zeros(6, int))
    return {"held_out": dict(zip(COLUMNS, totals.tolist(), strict=True))}


def side_changed(before: Before, boxes_px: np.ndarray) -> bool:
    """Whether a hand is where the other one was before, and not the one of its own side."""
    from twohands.geometry.boxes import box_iou

    own = np.nan_to_num(box_iou(boxes_px, before.boxes_px))
    other = np.nan_to_num(box_iou(boxes_px, before.boxes_px[::-1]))
    return bool((other > np.maximum(own, 0.3)).any())


def renumbered(pictures: Sequence[Seen]) -> list[Seen]:
    """Some of the pictures, whole scenes, with `earlier` counted anew."""
    number = {id(one): i for i, one in enumerate(pictures)}
    by_scene = {(one.scene, one.kind): number[id(one)] for one in reversed(pictures)}
    return [one if one.earlier < 0 else one._replace(earlier=by_scene[one.scene, one.kind]) for one in pictures]


COLUMNS: Final = ("pictures", "hands", "same side", "other side", "missed", "invented")


def counted(outcome: np.ndarray, present: np.ndarray) -> np.ndarray:
    """(6,) int by `COLUMNS`, of one picture: outcome (2,) of the reported hands, present (2,) the true ones."""
    rightly = outcome == RIGHTLY
    other = (outcome == WRONG_SIDE)[::-1] & ~rightly  # by true hand
    invented = (outcome == INVENTED).sum() + ((outcome == WRONG_SIDE)[::-1] & rightly).sum()
    missed = present & ~rightly & ~other
    return np.array([1, present.sum(), rightly.sum(), (other & present).sum(), missed.sum(), invented])


def print_errors(rows: dict[str, np.ndarray]) -> None:
    """A table by kind of picture."""
    print("| held out | " + " | ".join(COLUMNS) + " |\n|" + " --- |" * (len(COLUMNS) + 1))
    for kind, row in rows.items():
        print(f"| {kind} | " + " | ".join(map(str, row)) + " |")


def print_reliability(chances: np.ndarray) -> None:
    """How often hands said to be there with a chance were the true hand of their side."""
    print("\n| said | hands | mean said | true |\n| --- | --- | --- | --- |")
    for low, high in itertools.pairwise(BINS):
        inside = chances[(chances[:, 0] >= low) & ((chances[:, 0] < high) | (high == BINS[-1]))]
        if len(inside):
            print(f"| {low:g} to {high:g} | {len(inside)} | {inside[:, 0].mean():.3f} | {inside[:, 1].mean():.3f} |")


def print_weights(config: DecisionConfig) -> None:
    """All of them."""
    for name in ("first", "last"):
        print(f"\n{name}: " + ", ".join(f"{key} {weight:g}" for key, weight in getattr(config, name).items()))


def write_decision(folder: Path, config: DecisionConfig) -> None:
    """Puts weights and the fit's description on the card; what else its "decision" says stays."""
    card = json.loads((folder / "card.json").read_text(encoding="utf-8"))
    fitted = {name: dict(getattr(config, name)) for name in ("first", "last", "fit")}
    card["decision"] = card.get("decision", {}) | fitted
    write_card(folder, card)


ARRAYS: Final[dict[str, Callable[[Seen], object]]] = {
    "kind": lambda one: one.kind,
    "scene": lambda one: one.scene,
    "earlier": lambda one: one.earlier,
    "present": lambda one: one.present,
    "last": lambda one: one.last,
    "distance": lambda one: one.distance,
    "answer_boxes_px": lambda one: one.boxes_px,
    "outcome": lambda one: one.outcome,
    "image_size": lambda one: one.evidence.image_size,
    "boxes_px": lambda one: one.evidence.boxes_px,
    "pose": lambda one: one.evidence.pose,
    "joints": lambda one: one.evidence.joints,
    "merged_pose": lambda one: _or_nan(one.evidence.merged_pose),
    "merged_joints": lambda one: _or_nan(one.evidence.merged_joints),
    "check": lambda one: one.evidence.check,
    "merged_check": lambda one: one.evidence.merged_check,
    "palm": lambda one: one.evidence.palm,
    "palm_distance": lambda one: one.evidence.palm_distance,
    "body": lambda one: _body_row(one.evidence.body),
} | {f.name: lambda one, name=f.name: getattr(one.evidence.maps, name) for f in fields(BoxEvidence)}
"""What the cache holds of every picture."""


def save(path: Path, pictures: Sequence[Seen], identity: str) -> None:
    """Writes the cache, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    arrays: dict[str, Any] = {name: np.array([of(one) for one in pictures]) for name, of in ARRAYS.items()}
    content = io.BytesIO()
    np.savez_compressed(content, identity=np.array(identity), **arrays)
    write_whole(path, content.getvalue())


def load(path: Path, identity: str) -> list[Seen]:
    """Reads the cache.

    Raises:
        InputError: it is of other weights.
    """
    with np.load(path) as file:
        arrays = {name: file[name] for name in (*ARRAYS, "identity")}
    if str(arrays["identity"]) != identity:
        raise InputError(f"{path}: evidence of {arrays['identity']}, not of {identity}; name another file")
    return [_picture({name: arrays[name][i] for name in ARRAYS}) for i in range(len(arrays["kind"]))]


def _picture(row: dict[str, np.ndarray]) -> Seen:
    maps = BoxEvidence(*(row[f.name] for f in fields(BoxEvidence)))
    together = (None, None) if np.isnan(row["merged_pose"]).any() else (row["merged_pose"], row["merged_joints"])
    size = int(row["image_size"][0]), int(row["image_size"][1])
    distance = float(row["palm_distance"])
    checks = row["check"], row["merged_check"], row["palm"]
    said = maps, row["pose"], row["joints"], *together, distance, None, *checks, _body(row["body"])
    evidence = Evidence(size, row["boxes_px"], *said)
    numbers = row["last"], row["distance"], row["answer_boxes_px"], row["outcome"], int(row["earlier"])
    return Seen(str(row["kind"]), int(row["scene"]), row["present"], evidence, *numbers)


def _body_row(body: Body | None) -> np.ndarray:
    """(22,) a body as the cache holds it, without its sizes, which decide nothing; NaN for none."""
    return np.full(22, np.nan) if body is None else np.concatenate([np.ravel(part) for part in body[:5]])


def _body(row: np.ndarray) -> Body | None:
    """The body of a row (22,) of the cache."""
    if np.isnan(row).any():
        return None
    palms_px, boxes_px, visible, around_px, along_px = np.split(row, [4, 12, 14, 18])
    points = around_px.reshape(2, 2), along_px.reshape(2, 2)
    return Body(palms_px.reshape(2, 2), boxes_px.reshape(2, 4), visible, *points, *np.full((2, 3), np.nan))


def _or_nan(values: np.ndarray | None) -> np.ndarray:
    return np.full(2, np.nan) if values is None else values


if __name__ == "__main__":
    sys.exit(main())
