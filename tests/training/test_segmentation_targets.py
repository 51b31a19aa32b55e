"""What HandSegNet is shown and asked for, against values known from the way the pictures were made."""

import dataclasses

import numpy as np
import pytest
from tests.training.drawn import mirrored, sample

from twohands.errors import DataFormatError, InputError
from twohands.geometry.boxes import box_iou
from twohands.geometry.network_input import LETTERBOX_GREY, letterbox
from twohands.geometry.part_labels import hand_classes
from twohands.skeleton import LEFT, RIGHT
from twohands.training.hand_views import hand_box
from twohands.training.segmentation_targets import NARROWEST, ZoomConfig, segmentation_target
from twohands.training.transforms import PhotometricConfig


def test_segmentation_target_scales_labels_and_boxes():
    original = sample()  # 240x135
    found = segmentation_target(original, 270, 480)
    assert np.array_equal(found.classes[::2, ::2], hand_classes(original.labels))
    assert np.allclose(found.boxes_px[LEFT], 2 * hand_box(original, LEFT), atol=1e-4)
    assert found.present.tolist() == [True, True]


def test_segmentation_target_fits_pictures_in_as_inference_does():
    original = sample()  # 240x135
    found = segmentation_target(original, 192, 240)
    canvas, place = letterbox(original.image, (192, 240))
    assert np.array_equal(found.image, canvas)
    assert np.array_equal(place.content(found.classes), hand_classes(original.labels))
    top = place.top * 192
    assert top == 28
    assert np.allclose(found.boxes_px[LEFT], hand_box(original, LEFT) + np.array([0, top, 0, top]), atol=1e-4)


def test_a_hand_of_which_nothing_is_seen_is_not_there():
    """Named case: hands behind the person's own head were once asked for."""
    original = sample()
    labels = np.where(hand_classes(original.labels) == 1 + RIGHT, 0, original.labels)
    found = segmentation_target(dataclasses.replace(original, labels=labels), 270, 480)
    assert found.present.tolist() == [True, False]
    np.testing.assert_array_equal(found.boxes_px[RIGHT], 0)


def test_segmentation_target_needs_labels():
    with pytest.raises(DataFormatError, match="needs part labels"):
        segmentation_target(dataclasses.replace(sample(), labels=None), 64, 96)


def test_flip_equals_the_mirrored_picture():
    original = sample()
    flip = ZoomConfig(flip=1.0)
    a = segmentation_target(original, 135, 240, zoom=flip, rng=np.random.default_rng(0))
    b = segmentation_target(mirrored(original), 135, 240)
    assert np.array_equal(a.classes, b.classes)
    assert np.array_equal(a.image, b.image)
    assert np.allclose(a.boxes_px, b.boxes_px, atol=1e-4)


def test_a_hand_is_there_while_a_joint_of_it_is():
    """Named case: with less than a fifth of its box inside it was absent after a change, though not before one."""
    original, few = sample(), 0
    for seed in range(60):
        shift = ZoomConfig(shift=0.8)
        found = segmentation_target(original, 135, 240, zoom=shift, rng=np.random.default_rng(seed))
        rng = np.random.default_rng(seed)
        rng.uniform()  # the scale
        moved = original.joints_px + rng.uniform(-0.8, 0.8, 2) * [240, 135]
        inside = ((moved > 0) & (moved < [240, 135])).all(axis=-1)
        assert found.present.tolist() == inside.any(axis=1).tolist()
        few += int(((inside.sum(axis=1) > 0) & (inside.sum(axis=1) < 4)).sum())
        boxes = np.concatenate([moved.min(axis=1), moved.max(axis=1)], axis=1).clip(0, [240, 135] * 2)
        np.testing.assert_allclose(found.boxes_px, boxes * found.present[:, None], atol=1e-3)
    assert few > 3


@pytest.mark.parametrize("roll", [0.0, 70.0])
def test_zoomed_boxes_stay_on_the_hands(roll):
    original = sample()
    config = ZoomConfig(zoom=0.4, shift=0.1, flip=0.5, roll=roll)
    changed = 0
    for seed in range(20):
        found = segmentation_target(original, 135, 240, zoom=config, rng=np.random.default_rng(seed))
        for side in (LEFT, RIGHT):
            rows, cols = np.nonzero(found.classes == side + 1)
            if not found.present[side] or not len(rows):
                continue
            drawn = np.array([cols.min(), rows.min(), cols.max() + 1, rows.max() + 1])
            assert np.abs(drawn - found.boxes_px[side]).max() < 8  # bones are drawn with thick lines
            changed += not np.allclose(found.boxes_px[side], hand_box(original, side), atol=1)
    assert changed > 10


def test_half_of_the_pictures_are_turned_and_swap_no_hands():
    original = sample()
    plain = segmentation_target(original, 135, 240)
    seeds = range(40)
    found = [
        segmentation_target(original, 135, 240, zoom=ZoomConfig(roll=40.0), rng=np.random.default_rng(seed))
        for seed in seeds
    ]
    still = [np.array_equal(turned.classes, plain.classes) for turned in found]
    assert 10 < sum(still) < 30
    for turned in found:
        for side in (LEFT, RIGHT):  # the hands are in the middle: turning leaves their areas
            areas = [(target.classes == side + 1).sum() for target in (plain, turned)]
            assert areas[1] == pytest.approx(areas[0], rel=0.25)


def test_a_close_hand_fills_a_good_part_of_the_height_and_is_in_the_picture():
    original = sample(present=(True, False))
    sizes = []
    for seed in range(40):
        config = ZoomConfig(flip=0.5, close=1.0)
        found = segmentation_target(original, 135, 240, zoom=config, rng=np.random.default_rng(seed))
        side = LEFT if found.present[LEFT] else RIGHT
        box = found.boxes_px[side]
        sizes.append((box[2:] - box[:2]).max() / 135)
        rows, cols = np.nonzero(found.classes == side + 1)
        drawn = np.array([cols.min(), rows.min(), cols.max() + 1, rows.max() + 1])
        assert box_iou(drawn, box) > 0.6  # bones are drawn with thick lines
        assert (box[:2] >= -1e-3).all() and (box[2:] <= [240, 135]).all()
    whole = segmentation_target(original, 135, 240).boxes_px[LEFT]
    assert min(sizes) > 0.99 * min(0.25, (whole[2:] - whole[:2]).max() / 135)
    assert max(sizes) > 0.6


def test_a_picture_without_hands_has_none_to_bring_near():
    empty = sample(present=(False, False))
    found = segmentation_target(empty, 135, 240, zoom=ZoomConfig(close=1.0), rng=np.random.default_rng(0))
    assert np.array_equal(found.image, empty.image)


@pytest.mark.parametrize("wrong", [{"roll": 200}, {"close": 1.5}, {"cut": -0.1}])
def test_a_zoom_out_of_range_is_refused(wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        ZoomConfig(**wrong)


def test_a_cut_picture_is_upright_or_square_and_keeps_most_of_a_hand():
    """240x135 in its own size: a narrower part is 135 rows high, in the middle of grey."""
    original = sample()
    widths, kept = [], 0
    for seed in range(40):
        found = segmentation_target(original, 135, 240, zoom=ZoomConfig(cut=1.0), rng=np.random.default_rng(seed))
        filled = np.flatnonzero((found.image != LETTERBOX_GREY).any(axis=(0, 2)))
        left, width = filled[0], filled[-1] + 1 - filled[0]
        if width == 240:
            continue  # so little was cut off that the rest is stretched
        assert abs(left - (240 - width) / 2) <= 1
        assert not (found.classes[:, :left]).any() and not (found.classes[:, left + width :]).any()
        widths.append(width / 135)
        shown = np.flatnonzero((original.image == found.image[:, [left]]).all(axis=(0, 2)))[0] - left
        part = slice(left, left + width)
        assert np.array_equal(found.image[:, part], original.image[:, left + shown : left + shown + width])
        assert np.array_equal(found.classes[:, part], hand_classes(original.labels)[:, part.start + shown :][:, :width])
        for side in np.flatnonzero(found.present):
            whole = hand_box(original, side) - [shown, 0, shown, 0]
            inside = np.clip(whole, [left, 0, left, 0], [left + width, 135, left + width, 135])
            assert np.allclose(found.boxes_px[side], inside, atol=1e-3)
            kept += np.allclose(whole, inside)
    assert len(widths) > 30 and NARROWEST - 0.01 < min(widths) < 0.7 and max(widths) > 1.4
    assert kept > 20


def test_outside_a_picture_is_grey_whatever_its_colours():
    original = sample()
    photometric = PhotometricConfig(brightness=0.2, contrast=0.3, noise=0.05)
    zoom = ZoomConfig(zoom=0.4, roll=45.0, cut=1.0)
    bordered = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        found = segmentation_target(original, 135, 240, photometric=photometric, zoom=zoom, rng=rng)
        border = (found.image == LETTERBOX_GREY).all(axis=2)
        bordered += border.mean() > 0.05
        assert not found.classes[border].any()
    assert bordered > 10


def test_the_sample_is_not_changed():
    original = sample()
    before = [original.image.copy(), original.labels.copy(), original.joints_px.copy()]
    photometric = PhotometricConfig(brightness=0.2, noise=0.05, hue=0.1)
    zoom, rng = ZoomConfig(0.4, 0.1, 1.0, cut=1.0), np.random.default_rng(0)
    segmentation_target(original, 135, 240, photometric=photometric, zoom=zoom, rng=rng)
    after = [original.image, original.labels, original.joints_px]
    assert all(np.array_equal(a, b) for a, b in zip(before, after, strict=True))
