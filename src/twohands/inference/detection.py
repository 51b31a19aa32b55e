"""From HandSegNet's candidates to hands with keypoints: gathers what the decision needs, and carries it out.

Ours; the paper crops once and takes HandSegNet's word for what it found.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from twohands.geometry.body import USUAL_LENGTH_M, Body
from twohands.geometry.boxes import box_in_picture, box_iou
from twohands.geometry.palm import palm_in
from twohands.geometry.segmentation import HandBoxes, as_one_hand, box_around, box_evidence, probability
from twohands.inference.body import SURE
from twohands.inference.expected import FARTHEST, strayed
from twohands.inference.handedness import (
    UNCHECKED,
    Assignment,
    Before,
    Evidence,
    LastLook,
    box_sizes,
    palm_distance,
    rescore,
)
from twohands.inference.keypoints import (
    Keypoints,
    joint_boxes,
    mirror_crop,
)
from twohands.inference.looks import HandLooker
from twohands.inference.placement import body_ranges
from twohands.inference.second_look import knows_better, seen_twice
from twohands.inference.segmenter import corrected_masks
from twohands.inference.side_decision import assign_in_clip, known_assignment
from twohands.inference.side_keeping import NOTHING_KNOWN
from twohands.inference.trail import Trail
from twohands.inference.views import HandViewer
from twohands.skeleton import LEFT, N_JOINTS, RIGHT
from twohands.types import HandCrop

NO_MAPS: Final = np.zeros((2, 1, 1))
"""Energies or leads of which nobody knows anything."""


class Detection(NamedTuple):
    """What is known of the hands in one picture.

    Attributes:
        masks: (H, W) uint8, as `masks_from_logits` gives them.
        boxes: of hands, or of candidates.
        keypoints: of those that are present, in the order LEFT, RIGHT.
        side_logits: (2,) log-odds that a hand is of its side and not of the other; None where nobody has said.
        followed: whether HandSegNet rested; the masks are then those of an earlier frame.
        first: the same hands as the first pose networks see them, where the joints of some are the second ones'; None
            where there are none, or the first ones were not asked.
        bodies_m: (2,) `placement.body_ranges` of the person whose hands these are, NaN where nobody's are; None where
            nobody asked for a body.
        second_px: (2, 21, 2) joints of LEFT and RIGHT as the second ones see them, NaN where they were not asked; None
            where nobody was.
    """

    masks: np.ndarray
    boxes: HandBoxes
    keypoints: Keypoints
    side_logits: np.ndarray | None = None
    followed: bool = False
    first: Keypoints | None = None
    second_px: np.ndarray | None = None
    bodies_m: np.ndarray | None = None


class CandidateViews(NamedTuple):
    """Keypoints of the candidates, one row each, however they were seen.

    Attributes:
        alone: (side, candidate) -> the candidate seen as a hand of that side.
        merged: both candidates in one place seen as one hand, LEFT and RIGHT; None where they are not in one place.
    """

    alone: dict[tuple[int, int], Keypoints]
    merged: Keypoints | None = None

    @classmethod
    def of(cls, seen: Keypoints) -> CandidateViews:
        """Of candidates that were seen once, each as the hand that HandSegNet took it for."""
        return cls({(side, side): seen.rows([i]) for i, side in enumerate(seen.sides)})


@dataclass(frozen=True, slots=True)
class HandFinder(HandLooker):
    """Stages 2 and 3 in one picture.

    Attributes:
        keep_masks: whether masks are known and stay as they are.
        lengths_m: |wrist - root| of the hands, or (2,) one of each.
    """

    keep_masks: bool = False
    lengths_m: float | np.ndarray = USUAL_LENGTH_M

    def seen_better(
        self,
        found: Detection,
        boxes_px: np.ndarray,
        joints_px: np.ndarray | None = None,
        *,
        recrop: bool = True,
        lost: np.ndarray | None = None,
    ) -> Detection:
        """Hands of the first pose networks, seen by the second ones as well: their joints count where they know a hand
        better, and their boxes are those where they were looked for. Which hands are there, and whose, stays what the
        first ones said.

        Args:
            found: hands that are decided.
            boxes_px: (2, 4) of LEFT and RIGHT, where they are looked for.
            joints_px: (2, 21, 2) where their joints are expected; None where nothing is known.
            recrop: whether they are `recropped` then.
            lost: (B,) bool, hands of which the second ones are believed, and no others asked; None where they are asked
                of all but those that the first ones go on to see where they were expected.
        """
        first, config = found.keypoints, self.card.decision
        if self.stages.second is None or not config.second:
            return found
        rows = np.flatnonzero((first.pairs == 0) & (self._unexpected(first) if lost is None else lost))
        if not len(rows):
            return found
        sides = first.sides[rows]
        second = self.second_looked(found.masks, boxes_px, sides, None if joints_px is None else joints_px[sides])
        expected_px = None if self.expected is None else self.expected.seen_px[:, sides]
        better = np.flatnonzero(
            knows_better(first.rows(rows), second, config, expected_px) if lost is None else lost[rows]
        )
        if lost is None:
            better = better[~seen_twice(first, second, rows, better)[better]]
        second_px = np.full((2, N_JOINTS, 2), np.nan)
        second_px[sides] = second.joints_px
        found = found._replace(second_px=second_px)
        if not len(better):
            return found
        boxes = found.boxes.boxes_px.copy()
        boxes[sides[better]] = boxes_px[sides[better]]
        keypoints = first.replaced(rows[better], second.rows(better))
        behind = first if found.first is None else found.first
        seen = found._replace(keypoints=keypoints, boxes=replace(found.boxes, boxes_px=boxes), first=behind)
        return self.recropped(seen) if recrop else seen

    def _unexpected(self, first: Keypoints) -> np.ndarray:
        """(B,) bool, hands that the first pose networks do not go on to see where they were expected."""
        if self.expected is None:
            return np.ones(len(first.sides), bool)
        astray = strayed(self.expected.seen_px[0, first.sides], first.joints_px)
        return (self.expected.pairs[first.sides] > 0) | ~(astray <= FARTHEST[0])

    def both_looked(
        self, masks: np.ndarray, boxes_px: np.ndarray, crops: list[HandCrop]
    ) -> tuple[Keypoints, Keypoints]:
        """Keypoints by the first and by the second pose networks; arguments as of `looked`."""
        first = self.looked(masks, boxes_px, crops)
        return first, self.second_looked(masks, boxes_px, first.sides, None)

    def decided(self, found: Detection, trail: Trail | None) -> Detection:
        """The hands that candidates with keypoints are, and where they help seen again.

        Args:
            found: candidates, each as the hand that HandSegNet took it for.
            trail: of the clip; None of a picture alone.
        """
        again = self._confirmed(found, trail)
        if again is not None:
            return again
        before, known = (None, NOTHING_KNOWN) if trail is None else (Before.of(trail.last[-1]), trail.sides)
        evidence, views = self.evidence(found, before)
        seen_px = self.joint_boxed(found.boxes, found.keypoints).boxes_px
        assignment, side_logits = assign_in_clip(evidence, seen_px, self.card.decision, known)
        checks = evidence.checks(assignment.source)
        decided = self.seen_better(*self._carried_out(found, assignment, views, side_logits, checks))
        return decided._replace(bodies_m=self._body_ranges(decided.boxes, evidence.body))

    def _confirmed(self, found: Detection, trail: Trail | None) -> Detection | None:
        """The hands of the last frame, of whose sides the clip is sure, where the candidates are these: the picture is
        asked nothing of their sides. None where they are not, or one is no hand by the last decision."""
        if trail is None or self.expected is None or trail.sides.misses_one:
            return None
        there = self.expected.present
        sure = trail.sides.sure & found.boxes.present
        if not there.any() or not sure[there].all() or not self._in_place(found.boxes, self.expected.joints_px):
            return None
        assignment, said = known_assignment(trail, there), np.where(there, 0.0, np.nan)
        kept, boxes_px = self._carried_out(found, assignment, CandidateViews.of(found.keypoints), said)
        return self.seen_better(kept, boxes_px) if (kept.boxes.present == there).all() else None

    def _carried_out(
        self,
        found: Detection,
        assignment: Assignment,
        views: CandidateViews,
        side_logits: np.ndarray,
        checks: np.ndarray = UNCHECKED,
    ) -> tuple[Detection, np.ndarray]:
        """The hands of an assignment that are still ones after the last view of them, and the boxes (2, 4) in which
        they were first seen; `checks` as of `last_look`."""
        assigned, changed = self.assigned(found, assignment, views)
        recropped = self.recropped(assigned._replace(side_logits=side_logits), changed)
        return self.rescored(recropped, assignment, checks), assigned.boxes.boxes_px

    def bodies_m(self, found: Detection) -> np.ndarray:
        """(2,) `Detection.bodies_m`, of the last frame where nobody asked for a body in this one; NaN for nobody's."""
        if found.bodies_m is not None:
            return found.bodies_m
        return np.full(2, np.nan) if self.expected is None else self.expected.bodies_m

    def _body_ranges(self, boxes: HandBoxes, body: Body | None) -> np.ndarray:
        """(2,) `body_ranges` of a body one of whose wrists is at one of the hands; NaN without one."""
        hands_px = boxes.boxes_px[boxes.present]
        own = body is not None and any(body.near(box_px).max() > SURE for box_px in hands_px)
        return body_ranges(body if own else None, self.camera.fx, self.lengths_m, self.card.placement)

    def _in_place(self, boxes: HandBoxes, expected_px: np.ndarray) -> bool:
        """Whether candidates are where the hand of their side is expected, joints (2, 21, 2), or, where none is, in the
        place of the other one: a hand may look like both, unless a body has this one there."""
        unseen = np.full((2, 4), np.nan)
        places_px = joint_boxes(expected_px, self.size, unseen, self.card.views.smallest_box_px)
        known = np.asarray(np.isfinite(places_px).all(axis=1))
        places_px = np.where(known[:, None], places_px, places_px[::-1])
        astray = ~(np.asarray(box_iou(boxes.boxes_px, places_px)) >= self.card.decision.same_place_iou)
        if (boxes.present & ~known).any() and (body := self.body()) is not None:
            near = np.array([body.near(box_px)[side] for side, box_px in enumerate(boxes.boxes_px)])
            astray |= ~known & (near > SURE)
        return not astray[boxes.present].any()

    def evidence(self, found: Detection, before: Before | None) -> tuple[Evidence, CandidateViews]:
        """What is known of HandSegNet's candidates; PoseNet2D sees them mirrored, or merged, where that may help, and
        HandCheck sees them then, too.

        Args:
            found: candidates with keypoints, each as the hand that HandSegNet took it for.
            before: the frame before.
        """
        rules, boxes, seen = self.card.decision, found.boxes, found.keypoints
        pose, joints = np.full((2, 2, 2), np.nan)
        alone = CandidateViews.of(seen).alone
        doubtful = bool((seen.hand_logits < rules.mirror_below_logit).any())
        mirrored, merged = self._seen_again(found, doubtful, box_iou(*boxes.boxes_px) >= rules.same_place_iou)
        if mirrored is not None:
            alone |= {(1 - side, side): mirrored.rows([i]) for i, side in enumerate(seen.sides)}
        for where, view in alone.items():
            pose[where], joints[where] = view.hand_logits[0], view.joint_scores.mean()
        distance = palm_distance(seen.joints_px, boxes.boxes_px) if len(seen.sides) == 2 else math.inf
        together = (None, None) if merged is None else (merged.hand_logits, merged.joint_scores.mean(axis=-1))
        doubtful = doubtful or merged is not None
        checks, palms = np.full((3, 2), np.nan), np.full((3, 3), np.nan)
        if doubtful and (check := self.stages.check) is not None:
            checks, palms = self._checked(check, boxes, seen, merged)
        maps = boxes.evidence or box_evidence(NO_MAPS, NO_MAPS, np.full((2, 4), np.nan), (1, 1))
        said = {"check": checks[:2], "merged_check": checks[2], "palm": palms, "body": self.body()}
        known = Evidence(self.size, boxes.boxes_px, maps, pose, joints, *together, distance, before, **said)
        return known, CandidateViews(alone, merged)

    def _checked(
        self, check: Callable[..., np.ndarray], boxes: HandBoxes, seen: Keypoints, merged: Keypoints | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """(3, 2) HandCheck's log-odds, as in `Evidence.check`, of candidates 0 and 1, and of both as the hand for which
        they rather pass; and (3, 3) of the palms in their places, as in `Evidence.palm`. NaN for what there is not."""
        said, of_palms = np.full((3, 2), np.nan), np.full((3, 3), np.nan)
        rows, joints_px, boxes_px = [*seen.sides.tolist()], [*seen.joints_px], [*boxes.boxes_px[seen.sides]]
        if merged is not None:
            rows.append(2)
            joints_px.append(merged.joints_px[np.argmax(merged.hand_logits)])
            boxes_px.append(box_around(boxes.boxes_px))
        palms = self.palms()
        places = {row: palm_in(palms, box_px) for row, box_px in zip(rows, boxes_px, strict=True)}
        known = {row: place for row, place in places.items() if place is not None}
        numbers = sorted({number for number, _ in known.values()})
        checks = check(self.image, np.stack(joints_px), [palms[number] for number in numbers])
        said[rows] = checks[: len(rows)]
        for row, (number, near) in known.items():
            of_palms[row] = near, *checks[len(rows) + numbers.index(number)]
        return said, of_palms

    def assigned(self, found: Detection, assignment: Assignment, views: CandidateViews) -> tuple[Detection, np.ndarray]:
        """The hands that an assignment makes of candidates, with HandSegNet's scores for absent ones; and (B,) bool,
        which of them would be cropped differently now."""
        source = assignment.source
        chosen = dict(views.alone)
        if views.merged is not None and (source >= 0).sum() == 1:
            chosen |= {(side, side): views.merged.rows([side]) for side in (LEFT, RIGHT)}
        remaining = [chosen[int(side), int(source[side])] for side in np.flatnonzero(source >= 0)]
        keypoints = Keypoints.joined(remaining) if remaining else found.keypoints.rows([])
        scores = np.where(source >= 0, probability(np.nan_to_num(assignment.logits)), found.boxes.scores)
        masks, boxes = self._answered(found, source, scores)
        changed = (source[keypoints.sides] != keypoints.sides) | (masks is not found.masks)
        return Detection(masks, boxes, keypoints), changed

    def recropped(self, found: Detection, changed: np.ndarray | bool = False) -> Detection:
        """Boxes of the joints; hands whose box is another one then (`recrop_below_iou`), or that are `changed`, (B,)
        bool, are cropped and seen again."""
        keypoints, sides = found.keypoints, found.keypoints.sides
        boxes = self.joint_boxed(found.boxes, keypoints)
        overlap = box_iou(found.boxes.boxes_px[sides], boxes.boxes_px[sides])
        again = changed | (overlap < self.card.views.recrop_below_iou)
        if again.any():
            one = keypoints.rows(np.flatnonzero(again))
            crops = self.joint_crops(found.masks, boxes.boxes_px, one.joints_px, one.sides, one.pairs)
            keypoints = keypoints.replaced(np.flatnonzero(again), self.stages.keypoints(crops))
            boxes = self.joint_boxed(found.boxes, keypoints)
        return found._replace(boxes=boxes, keypoints=keypoints)

    def last_look(self, found: Detection, assignment: Assignment, checks: np.ndarray = UNCHECKED) -> LastLook:
        """What is known of an assignment's hands after the last view of them; checks (2,) are `Evidence.checks`."""
        last, sides = found.keypoints, found.keypoints.sides
        pose, joints, size = np.full((3, 2), np.nan)
        pose[sides], joints[sides] = last.hand_logits, last.joint_scores.mean(axis=-1)
        size[sides] = box_sizes(found.boxes.boxes_px[sides], self.size)
        distance = palm_distance(last.joints_px, found.boxes.boxes_px[sides]) if len(sides) == 2 else math.inf
        return LastLook(assignment.source, assignment.logits, pose, joints, size, distance, checks)

    def rescored(self, found: Detection, assignment: Assignment, checks: np.ndarray = UNCHECKED) -> Detection:
        """The hands that are still ones after the last view of them; arguments as of `last_look`."""
        kept, logits = rescore(self.last_look(found, assignment, checks), self.card.decision)
        sides = found.keypoints.sides
        scores = found.boxes.scores.copy()
        scores[sides] = probability(logits[sides])
        found = found._replace(boxes=replace(found.boxes, scores=scores))
        if kept[sides].all():
            return found
        source = np.where(kept, [LEFT, RIGHT], -1)
        masks, boxes = self._answered(found, source, scores)
        return Detection(masks, boxes, found.keypoints.rows(np.flatnonzero(kept[sides])), found.side_logits)

    def viewer(self, masks: np.ndarray) -> HandViewer:
        """What shows hands of the picture, with these masks, to the pose networks again."""
        return HandViewer(self.stages, self.card, self.image, masks, self.camera, self.expected is None)

    def further_seen(self, found: Detection, canonical: np.ndarray) -> tuple[Keypoints, np.ndarray]:
        """Keypoints and canonical poses (B, 21, 3) of the hands by the further views of them that the card asks for."""
        viewer = self.viewer(found.masks)
        return viewer.agreed(*viewer.turned(found.keypoints, canonical))

    def joint_boxed(self, boxes: HandBoxes, keypoints: Keypoints) -> HandBoxes:
        """The boxes of the hands' joints, also beyond the picture's edge; as they are where there is nothing to see."""
        boxes_px, smallest_px = boxes.boxes_px.copy(), self.card.views.smallest_box_px
        sides = keypoints.sides
        boxes_px[sides] = joint_boxes(keypoints.placed_px, self.size, boxes_px[sides], smallest_px)
        return replace(boxes, boxes_px=boxes_px)

    def in_picture(self, boxes: HandBoxes) -> HandBoxes:
        """The boxes cut to the picture."""
        height, width = self.size
        return replace(boxes, boxes_px=np.asarray(box_in_picture(boxes.boxes_px.reshape(2, 2, 2), width, height)))

    def _seen_again(
        self, found: Detection, doubtful: bool, together: bool
    ) -> tuple[Keypoints | None, Keypoints | None]:
        """Candidates mirrored, if `doubtful`: of two, both, as they may have been exchanged. And both as one hand, LEFT
        and RIGHT, if they are `together`. In one call, for which the network reads its weights once."""
        mirrored = [mirror_crop(crop) for crop in found.keypoints.crops] if doubtful else []
        merged = self._merged_crops(found) if together else []
        if not mirrored + merged:
            return None, None
        seen, count = self.stages.keypoints(mirrored + merged), len(mirrored)
        of_merged = seen.rows(range(count, count + len(merged))) if together else None
        return seen.rows(range(count)) if doubtful else None, of_merged

    def _merged_crops(self, found: Detection) -> list[HandCrop]:
        """Both candidates as one hand, LEFT and RIGHT."""
        crops = []
        for side in (LEFT, RIGHT):
            masks, box_px = as_one_hand(found.masks, found.boxes.boxes_px, side)
            crops.append(self.stages.crop(self.image, masks, self._to_cut(self.card, box_px), side, self.camera))
        return crops

    def _answered(self, found: Detection, source: np.ndarray, scores: np.ndarray) -> tuple[np.ndarray, HandBoxes]:
        """Masks, known ones as they are, and boxes that agree with an answer, `Assignment.source`."""
        boxes_px = found.boxes.boxes_px
        masks = found.masks if self.keep_masks else corrected_masks(found.masks, source, boxes_px)
        return masks, HandBoxes(np.where((source >= 0)[:, None], boxes_px[source], np.nan), source >= 0, scores)
