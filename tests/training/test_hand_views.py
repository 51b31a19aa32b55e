"""Where the hands of a labelled picture are."""

import dataclasses

import numpy as np
import pytest
from tests.training.drawn import sample, with_arm

from twohands.geometry.camera import project
from twohands.geometry.part_labels import hand_classes
from twohands.skeleton import LEFT, RIGHT, part_label
from twohands.training.hand_views import (
    LEAST_ARM,
    MOST_CUT,
    boxes_inside,
    cut_at_border,
    hand_box,
    part_without_hands,
)


def test_hand_box_is_tight_and_clipped_to_the_picture():
    original = sample()
    points = original.joints_px.copy()
    box = hand_box(original, LEFT)
    assert np.allclose(box, [*points[LEFT].min(axis=0), *points[LEFT].max(axis=0)])
    points[LEFT, 0] = [-50, 500]
    box = hand_box(dataclasses.replace(original, joints_px=points), LEFT)
    assert (box[0], box[3]) == (0, original.image.shape[0])


def test_hand_box_of_absent_and_outside_hands():
    assert hand_box(sample(present=(True, False)), RIGHT) is None
    original = sample()
    away = dataclasses.replace(original, joints_px=original.joints_px - [1000, 0])
    assert hand_box(away, LEFT) is None


@pytest.mark.parametrize(("left", "there"), [(20.0, True), (-50.0, True), (-85.0, False), (-200.0, False)])
def test_a_hand_of_which_a_sliver_is_left_is_absent(left, there):
    """100 pixels wide: half of it inside is a hand, 15 % are none."""
    hand = np.array([[left, 10.0], [left + 100, 10.0], [left + 100, 60.0], [np.nan, np.nan]])
    boxes, present = boxes_inside(hand[None], 240, 135)
    assert present.tolist() == [there]
    assert boxes[0].tolist() == ([max(left, 0), 10, left + 100, 60] if there else [0, 0, 0, 0])


def test_a_cut_picture_is_a_part_of_the_picture_with_a_hand_at_its_edge():
    edges = set()
    for seed in range(80):
        original = sample(seed % 4)
        height, width = original.image.shape[:2]
        cut = cut_at_border(original, np.random.default_rng(seed))
        assert (cut.camera.height, cut.camera.width) == cut.image.shape[:2] == cut.labels.shape
        left, top = original.camera.cx - cut.camera.cx, original.camera.cy - cut.camera.cy
        right, bottom = left + cut.camera.width, top + cut.camera.height
        assert min(left, top, width - right, height - bottom) >= 0
        assert min(cut.camera.width / width, cut.camera.height / height) >= 1 - MOST_CUT
        assert cut.camera.width / cut.camera.height == pytest.approx(width / height, abs=0.03)
        window = slice(int(top), int(bottom)), slice(int(left), int(right))
        assert np.array_equal(cut.image, original.image[window])
        assert np.array_equal(cut.labels, original.labels[window])
        assert np.allclose(project(cut.joints_m, cut.camera), cut.joints_px)
        inside = (cut.joints_px >= 0) & (cut.joints_px < [cut.camera.width, cut.camera.height])
        assert cut.present.tolist() == inside.all(axis=-1).any(axis=1).tolist()
        for box in (hand_box(original, side) for side in (LEFT, RIGHT)):
            crossings = {"left": (0, left), "top": (1, top), "right": (0, right), "bottom": (1, bottom)}
            edges |= {name for name, (axis, line) in crossings.items() if box[axis] < line < box[axis + 2]}
    assert edges >= {"left", "right", "bottom"}


def test_a_hand_may_be_gone_from_a_cut_picture():
    original = sample(present=(True, False))
    points = original.joints_px - original.joints_px.mean(axis=1, keepdims=True)
    near_edge = dataclasses.replace(original, joints_px=points * 0.2 + [30, original.camera.height / 2])
    cuts = [cut_at_border(near_edge, np.random.default_rng(seed)) for seed in range(60)]
    gone = [not cut.present[LEFT] for cut in cuts]
    assert 0.05 < np.mean(gone) < 0.4
    assert all(hand_box(cut, LEFT) is None for cut in cuts if not cut.present[LEFT])


def test_a_hand_without_labels_is_not_taken_for_gone_from_a_cut_picture():
    """PoseNet2D's judge would be shown it as no hand."""
    original = sample()
    half_labelled = dataclasses.replace(original, valid=np.stack([original.valid[LEFT], np.zeros(21, bool)]))
    cuts = [cut_at_border(half_labelled, np.random.default_rng(seed)) for seed in range(20)]
    assert all(cut.present[RIGHT] for cut in cuts)
    assert any(cut is not half_labelled for cut in cuts)


def test_nothing_is_cut_where_no_hand_is_or_it_would_cost_too_much():
    rng = np.random.default_rng(0)
    bare = sample(present=(False, False))
    assert cut_at_border(bare, rng) is bare
    original = sample()
    centre = np.array([original.camera.width, original.camera.height]) / 2
    middle = centre + (original.joints_px - original.joints_px.mean(axis=1, keepdims=True)) * 0.05
    far = dataclasses.replace(original, joints_px=middle)
    assert cut_at_border(far, rng) is far


def test_a_part_without_hands_shows_an_arm_and_no_hand():
    original, parts = with_arm(sample(present=(True, False))), []
    for seed in range(60):
        part = part_without_hands(original, np.random.default_rng(seed))
        if part is original:
            continue
        parts.append(part)
        assert (part.camera.height, part.camera.width) == part.image.shape[:2] == part.labels.shape
        assert not part.present.any()
        assert set(np.unique(hand_classes(part.labels))) <= {0, LEFT + 1}
        assert set(np.unique(part.labels)) <= {0, part_label(LEFT, 0)}
        assert (part.labels > 0).mean() >= LEAST_ARM
        inside = (part.joints_px >= 0) & (part.joints_px < [part.camera.width, part.camera.height])
        assert not inside.all(axis=-1).any()
    assert len(parts) > 8
    assert len({part.image.shape for part in parts}) > 5


def test_no_part_without_hands_where_none_can_be_known():
    rng = np.random.default_rng(0)
    original = with_arm(sample(present=(True, False)))
    bare = sample(present=(False, False))
    unlabelled = dataclasses.replace(original, labels=None)
    half = dataclasses.replace(sample(), valid=np.stack([np.ones(21, bool), np.zeros(21, bool)]))
    armless = dataclasses.replace(original, labels=np.where(original.labels == part_label(LEFT, 0), 0, original.labels))
    for one in (bare, unlabelled, half, armless):
        assert part_without_hands(one, rng) is one
