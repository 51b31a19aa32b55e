"""The whole pipeline on one page: segment, find candidates, keypoints, handedness, lift, place.

Source: paper, figure 3 and section 4. Every stage can be replaced by ground truth (`StageTruth`), here and nowhere
else; that is how each stage is studied alone and how the error budget is drawn up.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from twohands.geometry.body import Body
from twohands.geometry.palm import Palm
from twohands.geometry.segmentation import HandBoxes, certain_masks, parted_masks
from twohands.inference.body import BodySight, guessed_masks, no_body
from twohands.inference.detection import Detection, HandFinder
from twohands.inference.engine import Networks, load_networks
from twohands.inference.expected import Expected
from twohands.inference.following import followed_hands, going_on, with_sight
from twohands.inference.keypoints import NO_KEYPOINTS, given_heatmaps
from twohands.inference.palm import no_palms
from twohands.inference.placement import PlacedHands, hand_poses
from twohands.inference.segmenter import HandMaps
from twohands.inference.stages import NO_TRUTH, Stages, StageTruth, check_picture
from twohands.inference.trail import Trail
from twohands.inference.turning import upright_first
from twohands.inference.views import lifted
from twohands.inference.weights import DEFAULT_PRESET, WeightsCard, preset_folder, read_card
from twohands.plausibility import range_doubts, warn
from twohands.types import HandPose, PinholeCamera, TwoHandPose

DEFAULT_HAND_LENGTH_M: Final = 0.10
"""|wrist - middle knuckle| where none is given: the unit to which the paper scales its data (section 3.1)."""


class HandEstimator:
    """Both hands in metres from one picture; never changes once it is made, so threads may share it.

    Args:
        networks: the networks as functions.
        card: what they expect, and every hand-tuned number.
        stages: the stages; those of networks and card if not given.
    """

    def __init__(self, networks: Networks, card: WeightsCard, stages: Stages | None = None) -> None:
        self.networks: Final = networks
        self.card: Final = card
        self.stages: Final = stages or Stages.of(networks, card)

    @classmethod
    def from_preset(cls, preset: str | Path = DEFAULT_PRESET, threads: int = 0) -> HandEstimator:
        """Load shipped weights by name, or a folder with the same layout; on `threads` CPU threads, 0 for all cores.

        Raises:
            CheckpointError: the weights are missing, damaged, or of other networks.
        """
        folder = preset_folder(preset)
        card = read_card(folder)
        return cls(load_networks(folder, card, threads), card)

    def settings(self) -> dict[str, Any]:
        """Every hand-tuned number, as `WeightsCard.settings` gives them; "second" holds those of the second pose
        networks, where there are any."""
        second = self.networks.second
        return self.card.settings() | ({} if second is None else {"second": second.card.settings()})

    def estimate(
        self,
        image: np.ndarray,
        camera: PinholeCamera,
        hand_length_m: float | np.ndarray = DEFAULT_HAND_LENGTH_M,
        truth: StageTruth = NO_TRUTH,
        *,
        index: int = 0,
        time_s: float | None = None,
        previous: TwoHandPose | Trail | None = None,
    ) -> TwoHandPose:
        """Estimate both hands.

        Args:
            image: (H, W, 3) uint8 RGB.
            camera: intrinsics at this image size.
            hand_length_m: |wrist - middle knuckle| of these hands, metres, or (2,) one for each; all lengths scale
                with it.
            truth: ground truth that replaces stages.
            index, time_s: position in the source, handed through.
            previous: of a video, what was found one frame before, or all that the clip has shown: hands seldom come or
                go, or turn into the other one, and the pose networks that saw one see it on. Where HandSegNet may rest
                (`Trail.may_rest`) they are looked for where they should be, first. Pictures alone have more views of a
                hand (`ViewConfig.tta_rolls_deg`).

        Returns:
            Both hands; an absent hand has `present` False. Of hands that were followed there are no masks.

        Warns:
            PlausibilityWarning: camera, hand length or a hand's range are hard to believe (`twohands.plausibility`).

        Raises:
            InputError: image, camera and hand length do not fit together.
        """
        check_picture(image, camera, hand_length_m)
        trail = Trail.of(previous) if isinstance(previous, TwoHandPose) else previous
        see = partial(self._upright, hand_length_m=hand_length_m, truth=truth, index=index, time_s=time_s)
        if not (self.card.says_turn and truth.replaces_nothing):
            pose = see(image, camera, trail=trail)
        else:
            pose = upright_first(see, image, camera, trail, self.card.decision)
        ranges_m = [hand.range_m for hand in pose.hands if hand.range_m is not None]
        warn([doubt for range_m in ranges_m for doubt in range_doubts(range_m)])
        return pose

    def _upright(
        self,
        image: np.ndarray,
        camera: PinholeCamera,
        *,
        hand_length_m: float | np.ndarray,
        truth: StageTruth,
        index: int,
        time_s: float | None,
        trail: Trail | None,
    ) -> TwoHandPose:
        """`estimate` of a picture that is taken for upright."""
        expected = None if trail is None else Expected.of(trail, index if time_s is None else time_s)
        keep_masks = truth.masks is not None
        finder = HandFinder(
            self.stages, self.card, image, camera, expected, keep_masks=keep_masks, lengths_m=hand_length_m
        )
        found, said = None, None
        body, palms = self.body(image, None if trail is None else trail.last[-1].around_px), self.palms(image)
        unaided = self.card.decides and truth.replaces_nothing
        if trail is not None and expected is not None and trail.may_rest and unaided:
            found = followed_hands(finder, trail, expected, palms)
        if found is None:
            maps = None if truth.knows_hands else self.stages.hand_maps(image)
            said = None if maps is None else maps.turn_logits
            finder = replace(finder, body=body, palms=palms) if unaided else finder
            found = self.find_hands(finder, *self.segment(image, truth, maps, finder.body), truth, trail)
        left, right = self.place_hands(finder, found, hand_length_m, truth)
        masks = None if found.followed else certain_masks(found.masks)
        known = found.followed, found.masks, said, body.around_px, image
        return TwoHandPose(left, right, camera, masks, index, time_s, *known)

    def segment(
        self,
        image: np.ndarray,
        truth: StageTruth = NO_TRUTH,
        maps: HandMaps | None = None,
        body: Callable[[], Body | None] = no_body,
    ) -> tuple[np.ndarray, HandBoxes]:
        """Stage 1: masks (H, W), and boxes of the candidates; of HandSegNet's maps where they are known, and of the
        body's hands that it misses."""
        size, masks, boxes = image.shape[:2], truth.masks, truth.hand_boxes()
        if masks is None or boxes is None:
            maps = self.stages.hand_maps(image) if maps is None else maps
            boxes = self.stages.boxes(maps, size, truth.present, body) if boxes is None else boxes
            if masks is None:
                masks = self.stages.masks(maps, size, boxes.present)
                masks = parted_masks(masks, boxes.boxes_px) if boxes.parted else masks
                masks = guessed_masks(masks, boxes)
        return masks, boxes

    def body(self, image: np.ndarray, around_px: np.ndarray | None = None) -> BodySight:
        """What gives the body of the person in a picture, looked for where it was when a clip last asked, (2, 2),
        first; none without networks that know bodies."""
        look = self.stages.body
        return BodySight(None if look is None else partial(look, image), around_px)

    def palms(self, image: np.ndarray) -> Callable[[], Sequence[Palm]]:
        """What gives the palms in a picture, looked for when it is first asked; none without a network that knows
        them."""
        return no_palms if self.stages.palms is None else cache(partial(self.stages.palms, image))

    def find_hands(
        self,
        finder: HandFinder,
        masks: np.ndarray,
        boxes: HandBoxes,
        truth: StageTruth = NO_TRUTH,
        trail: Trail | None = None,
    ) -> Detection:
        """Stages 2 and 3: keypoints of every candidate, whose hands they are, and a second crop where it helps. True
        boxes, maps or joints need one crop; a true `present` needs no decision."""
        sides, known_boxes = np.flatnonzero(boxes.present), truth.boxes_px is not None
        if not len(sides):
            return Detection(masks, boxes, NO_KEYPOINTS)
        crops = finder.crops(masks, boxes.boxes_px, sides, estimated=not known_boxes)
        if truth.heatmaps is None:
            keypoints = finder.looked(masks, boxes.boxes_px, crops)
        else:
            keypoints = self.stages.keypoints(crops, given_heatmaps(self.card, truth.heatmaps, crops))
        found = Detection(masks, boxes, keypoints.corrected(truth.joints_px))
        if truth.heatmaps is not None or truth.joints_px is not None:
            return found
        if known_boxes:
            return finder.seen_better(found, boxes.boxes_px, recrop=False)
        if truth.present is not None or not self.card.decides:
            return finder.seen_better(finder.recropped(found), boxes.boxes_px)
        return finder.decided(found, trail)

    def place_hands(
        self, finder: HandFinder, found: Detection, hand_length_m: float | np.ndarray, truth: StageTruth = NO_TRUTH
    ) -> tuple[HandPose, HandPose]:
        """Stages 4 and 5: lift, place; with nothing known, from all views of the hands, and where they likely are."""
        keypoints, boxes, sides = found.keypoints, found.boxes, found.keypoints.sides
        if not len(sides):
            return HandPose(present=False), HandPose(present=False)
        canonical = truth.canonical
        canonical = lifted(self.stages, keypoints, finder.camera) if canonical is None else canonical[sides]
        lengths_m = np.broadcast_to(hand_length_m, (2,))[sides]
        estimated = truth.heatmaps is None and truth.joints_px is None and truth.canonical is None
        looks_again = any(stages.card.views.looks_again for stages in (self.stages, self.stages.of_pair(1)))
        if estimated and looks_again:
            keypoints, canonical = finder.further_seen(found, canonical)
            if truth.boxes_px is None:
                boxes = finder.joint_boxed(boxes, keypoints)
        placed = self.stages.place(canonical, keypoints.joints_px, keypoints.joint_scores, finder.camera, lengths_m)
        sigmas_m, shares, bodies_m = None, None, finder.bodies_m(found)
        if estimated:
            hands = PlacedHands(canonical, keypoints, placed)
            known = going_on(found, finder.expected)
            ranged = self._ranged(finder, found, hands, lengths_m).scaled(known[:, 0])
            sure = np.where(np.isfinite(known[:, 2]), known[:, 2], ranged.keypoints.joint_scores.mean(axis=-1))
            others = known[:, 1], sure, finder.camera, lengths_m, bodies_m[sides]
            canonical, placed, sigmas_m = self.stages.refine(hands, ranged, *others)
            share = ranged.placed.radius_m / hands.placed.radius_m
            shares = np.column_stack([share, sigmas_m / placed.radius_m, sure])
        poses = hand_poses(finder.in_picture(boxes), keypoints, canonical, placed, found.side_logits, sigmas_m)
        return poses if shares is None else with_sight(poses, found, shares, bodies_m)

    def _ranged(self, finder: HandFinder, found: Detection, hands: PlacedHands, lengths_m: np.ndarray) -> PlacedHands:
        """Hands as the first pose networks see them, `Detection.first`, where the joints are those of the second ones:
        whose joints are nearer in the picture is another question than whose ranges are."""
        first, camera = found.first, finder.camera
        if first is None or not len(rows := np.flatnonzero(hands.keypoints.pairs > first.pairs)):
            return hands
        keypoints = first.rows(rows)
        canonical = lifted(self.stages, keypoints, camera)
        keypoints, canonical = finder.viewer(found.masks).agreed(keypoints, canonical, hands.keypoints.rows(rows))
        placed = self.stages.place(canonical, keypoints.joints_px, keypoints.joint_scores, camera, lengths_m[rows])
        known = np.flatnonzero(placed.valid)
        chosen = PlacedHands(canonical, keypoints, placed).rows(known)
        return hands.replaced(rows[known], chosen)
