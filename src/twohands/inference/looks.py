"""How hands in one picture are cut out and shown to the pose networks: by boxes, by joints, with the fingers up.

Ours; the paper crops once.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from twohands.geometry.body import Body
from twohands.geometry.boxes import continued_box, ellipse_in, roll_up_deg, upright_roll_deg
from twohands.geometry.palm import SURE_LOGIT, Palm, palm_in
from twohands.inference.body import SURE, no_body
from twohands.inference.expected import Expected
from twohands.inference.keypoints import Keypoints, cuttable, in_sight, off_upright_deg, rolled_hand_box
from twohands.inference.palm import no_palms
from twohands.inference.stages import Stages
from twohands.inference.weights import WeightsCard
from twohands.types import HandCrop, PinholeCamera

QUARTERS_DEG: Final = (90.0, 180.0, -90.0)
"""By which further turns a hand is looked for."""


@dataclass(frozen=True, slots=True)
class HandLooker:
    """Looks at hands in one picture.

    Attributes:
        stages, card: of the estimator.
        image: (H, W, 3).
        camera: of the image.
        expected: of the frame of a clip; None of a picture alone, and of the first frame.
        body, palms: give the person's, and those in the picture; the networks are asked where somebody wants to know.
    """

    stages: Stages
    card: WeightsCard
    image: np.ndarray
    camera: PinholeCamera
    expected: Expected | None = None
    body: Callable[[], Body | None] = no_body
    palms: Callable[[], Sequence[Palm]] = no_palms

    @property
    def size(self) -> tuple[int, int]:
        """(H, W) of the picture."""
        return self.image.shape[0], self.image.shape[1]

    def crops(
        self, masks: np.ndarray, boxes_px: np.ndarray, sides: np.ndarray, *, estimated: bool = True, pair: int = 0
    ) -> list[HandCrop]:
        """Crops of the given sides' boxes, boxes_px (2, 4), for a pair of pose networks; only estimated boxes may be
        continued beyond the picture's edge (`continued_box`) or made smaller (`cuttable`)."""
        stages = self.stages.of_pair(pair)
        chosen = [self._to_cut(stages.card, box) if estimated else box for box in boxes_px[sides]]
        hands = zip(chosen, sides, strict=True)
        return [stages.crop(self.image, masks, box, int(side), self.camera) for box, side in hands]

    def looked(self, masks: np.ndarray, boxes_px: np.ndarray, crops: list[HandCrop]) -> Keypoints:
        """Keypoints of crops by the first pose networks.

        Args:
            masks: of the picture.
            boxes_px: (2, 4) of LEFT and RIGHT, of which the crops were cut.
            crops: B of them.
        """
        return self._uprighted(masks, boxes_px, self.stages.keypoints(crops))

    def _to_cut(self, card: WeightsCard, box_px: np.ndarray) -> np.ndarray:
        """What is cut out of the picture for an estimated box (4,)."""
        return cuttable(card, self._continued(box_px), self.camera)

    def _continued(self, box_px: np.ndarray) -> np.ndarray:
        return continued_box(box_px, self.size[1], self.size[0])

    def second_looked(
        self, masks: np.ndarray, boxes_px: np.ndarray, sides: np.ndarray, joints_px: np.ndarray | None
    ) -> Keypoints:
        """Keypoints of the hands of B sides by the second pose networks; (B, 21, 2) joints, otherwise as
        `seen_better`."""
        if joints_px is not None:
            crops = self.joint_crops(masks, boxes_px, joints_px, sides, np.ones(len(sides), int))
            return self._uprighted(masks, boxes_px, self.stages.keypoints(crops))
        crops: list[HandCrop] = []
        for side, shown in zip(sides.tolist(), self._shown(boxes_px, sides).tolist(), strict=True):
            view = self._known_view(boxes_px[side], side) if shown else None
            if view is None:
                crops += self.crops(masks, boxes_px, np.array([side]), pair=1)
            else:
                crops.append(self._rolled_crop(masks, view[0], side, 1, view[1]))
        return self._searched(masks, boxes_px, self._uprighted(masks, boxes_px, self.stages.keypoints(crops)))

    def _known_view(self, box_px: np.ndarray, side: int) -> tuple[np.ndarray, float] | None:
        """Points (N, 2) around a side's hand in a box (4,), and the roll of a camera that would see it with the fingers
        up: as the second pose networks saw it in the last frame, else by a sure palm there, else by the body that has a
        hand there; None where none of them says."""
        if not self.stages.of_pair(1).card.views.upright:
            return None
        if self.expected is not None and np.isfinite(self.expected.seen_px[1, side]).all():
            return self._around(box_px), float(upright_roll_deg(self.expected.seen_px[1, side]))
        palms = self.palms()
        place = palm_in(palms, box_px)
        if place is not None and place[1] > SURE and palms[place[0]].logit > SURE_LOGIT:
            palm = palms[place[0]]
            return palm.around_px(), float(roll_up_deg(palm.along_px))
        if (body := self.body()) is not None:
            near = body.near(box_px)
            if near.max() > SURE:
                return self._around(box_px), float(roll_up_deg(body.along_px[near.argmax()]))
        return None

    def joint_crops(
        self, masks: np.ndarray, boxes_px: np.ndarray, joints_px: np.ndarray, sides: np.ndarray, pairs: np.ndarray
    ) -> list[HandCrop]:
        """Crops of B hands of which joints are known.

        Args:
            masks: of the picture.
            boxes_px: (2, 4) of LEFT and RIGHT, to which the hands are cut.
            joints_px: (B, 21, 2), to which they are cut where the card of their pose networks says so: as cameras see
                them that are rolled so that the fingers point up.
            sides, pairs: (B,) LEFT or RIGHT, and for which pose networks.
        """
        crops, rolls_deg = [], upright_roll_deg(joints_px)
        seen = in_sight(joints_px, self.size, self.card.views.smallest_box_px)
        for row, (side, pair) in enumerate(zip(sides.tolist(), pairs.tolist(), strict=True)):
            if seen[row] and self.stages.of_pair(pair).card.views.upright:
                crops.append(self._rolled_crop(masks, joints_px[row], side, pair, float(rolls_deg[row])))
            else:
                crops += self.crops(masks, boxes_px, np.array([side]), pair=pair)
        return crops

    def _uprighted(self, masks: np.ndarray, boxes_px: np.ndarray, keypoints: Keypoints) -> Keypoints:
        """Hands whose fingers point farther from up than `ViewConfig.upright_within_deg`, seen again in the same boxes:
        where the fingers point is known sooner than where they end."""
        views = [self.stages.of_pair(crop.pair).card.views for crop in keypoints.crops]
        if not any(each.upright for each in views):
            return keypoints
        within_deg = np.array([each.upright_within_deg for each in views])
        seen = in_sight(keypoints.joints_px, self.size, self.card.views.smallest_box_px)
        again = np.flatnonzero(seen & (np.abs(off_upright_deg(keypoints)) > within_deg))
        if not len(again):
            return keypoints
        rolls_deg = upright_roll_deg(keypoints.joints_px[again])
        crops = [
            self._rolled_crop(masks, self._around(boxes_px[crop.side]), crop.side, crop.pair, roll_deg)
            for crop, roll_deg in zip((keypoints.crops[row] for row in again), rolls_deg.tolist(), strict=True)
        ]
        return keypoints.replaced(again, self.stages.keypoints(crops))

    def _searched(self, masks: np.ndarray, boxes_px: np.ndarray, keypoints: Keypoints) -> Keypoints:
        """Hands of whose joints the second pose networks are not sure (`ViewConfig.search_below_score`), seen in the
        same boxes by cameras rolled by further quarters of a turn. The view with the surest joints counts, seen once
        more with the fingers up where they are not. Who does not know the hand does not know where its fingers point
        either."""
        unsure = keypoints.joint_scores.mean(axis=-1) < self.stages.of_pair(1).card.views.search_below_score
        rows = np.flatnonzero(unsure & self._shown(boxes_px, keypoints.sides))
        if not len(rows):
            return keypoints
        crops = [
            self._rolled_crop(masks, self._around(boxes_px[crop.side]), crop.side, 1, crop.roll_deg + quarter_deg)
            for quarter_deg in QUARTERS_DEG
            for crop in (keypoints.crops[row] for row in rows)
        ]
        views = Keypoints.joined([keypoints.rows(rows), self.stages.keypoints(crops)])
        sureness = views.joint_scores.mean(axis=-1).reshape(-1, len(rows))
        best = views.rows(sureness.argmax(axis=0) * len(rows) + np.arange(len(rows)))
        return keypoints.replaced(rows, self._uprighted(masks, boxes_px, best))

    def _shown(self, boxes_px: np.ndarray, sides: np.ndarray) -> np.ndarray:
        """(B,) bool, whether there is something to see of the boxes of B sides: a known one may lie elsewhere."""
        return in_sight(boxes_px[sides].reshape(-1, 2, 2), self.size, self.card.views.smallest_box_px)

    def _around(self, box_px: np.ndarray) -> np.ndarray:
        """Points around a hand's box (4,), which may go on beyond the picture's edge."""
        return ellipse_in(self._continued(box_px))

    def _rolled_crop(self, masks: np.ndarray, points_px: np.ndarray, side: int, pair: int, roll_deg: float) -> HandCrop:
        """A side's hand, whose points are (N, 2), for a pair of pose networks, as a camera sees it that is rolled so
        far."""
        stages = self.stages.of_pair(pair)
        box_px = rolled_hand_box(stages.card, points_px, self.size, self.camera, roll_deg)
        return stages.crop(self.image, masks, box_px, side, self.camera, roll_deg)
