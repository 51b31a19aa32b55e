"""Random changes stay within their limits and do what their names say."""

import dataclasses

import numpy as np
import pytest

from twohands.errors import InputError
from twohands.skeleton import LEFT, RIGHT
from twohands.training.transforms import MaskConfig, PhotometricConfig, in_two_tones, jitter_colours, spoil_masks

IMAGE = np.random.default_rng(0).integers(0, 256, (48, 64, 3), dtype=np.uint8)
GREY = np.full((48, 64, 3), 100, np.uint8)


def hands() -> tuple[np.ndarray, np.ndarray]:
    """Two squares side by side, the lower third of the left one being its arm."""
    classes = np.zeros((128, 128), np.uint8)
    classes[40:100, 20:60] = 1
    classes[40:100, 60:100] = 2
    arm = np.zeros((128, 128), bool)
    arm[80:100, 20:60] = True
    return classes, arm


def test_no_strength_no_change():
    assert np.array_equal(jitter_colours(IMAGE, PhotometricConfig(), np.random.default_rng(0)), IMAGE)
    classes, arm = hands()
    assert np.array_equal(spoil_masks(classes, arm, LEFT, MaskConfig(), np.random.default_rng(0)), classes)


def test_brightness_stays_within_its_limit():
    means = [
        jitter_colours(GREY, PhotometricConfig(brightness=0.1), np.random.default_rng(seed)).mean()
        for seed in range(60)
    ]
    assert min(means) >= (100 - 25.5) * 0.95 - 1 and max(means) <= (100 + 25.5) * 1.05 + 1
    assert max(means) - min(means) > 30


def test_gamma_leaves_black_and_white():
    ends = np.array([[[0] * 3, [255] * 3]], np.uint8)
    for seed in range(10):
        assert np.array_equal(jitter_colours(ends, PhotometricConfig(gamma=1.0), np.random.default_rng(seed)), ends)
    halves = {
        int(jitter_colours(GREY, PhotometricConfig(gamma=1.0), np.random.default_rng(s))[0, 0, 0]) for s in range(20)
    }
    low, high = 255 * (100 / 255) ** 2, 255 * (100 / 255) ** 0.5
    assert len(halves) > 10 and min(halves) >= low - 1 and max(halves) <= high + 1


def test_hue_leaves_grey_and_turns_colour():
    rng = np.random.default_rng(1)
    assert np.array_equal(jitter_colours(GREY, PhotometricConfig(hue=0.3), rng), GREY)
    red = np.zeros((4, 4, 3), np.uint8)
    red[..., 0] = 200
    assert not np.array_equal(jitter_colours(red, PhotometricConfig(hue=0.3), rng), red)


def test_noise_has_the_asked_size():
    deviations = [
        jitter_colours(GREY, PhotometricConfig(noise=0.04), np.random.default_rng(s)).std() for s in range(40)
    ]
    assert max(deviations) < 0.04 * 255 * 1.15 and max(deviations) > 0.03 * 255


def test_blur_lowers_detail():
    outcomes = [jitter_colours(IMAGE, PhotometricConfig(blur=2.0), np.random.default_rng(s)).std() for s in range(10)]
    assert min(outcomes) < 0.6 * IMAGE.std() and max(outcomes) == IMAGE.std()


@pytest.mark.parametrize("seed", range(8))
def test_one_of_two_hands_has_another_colour_and_nothing_else_has(seed):
    picture, (classes, _) = np.full((128, 128, 3), 100, np.uint8), hands()
    changed = (in_two_tones(picture, classes, np.random.default_rng(seed)) != 100).any(axis=-1)
    assert any(np.array_equal(changed, classes == hand) for hand in (1, 2))
    assert (picture == 100).all()


def test_a_hand_alone_keeps_its_colour():
    classes = np.where(hands()[0] == 1, 1, 0).astype(np.uint8)
    picture = np.full((128, 128, 3), 100, np.uint8)
    np.testing.assert_array_equal(in_two_tones(picture, classes, np.random.default_rng(0)), picture)


def test_arm_is_cut_and_nothing_else():
    classes, arm = hands()
    seen = set()
    for seed in range(20):
        out = spoil_masks(classes, arm, LEFT, MaskConfig(no_arm=1.0), np.random.default_rng(seed))
        assert np.array_equal(out[~arm], classes[~arm])
        seen.add(int((out[arm] == 0).sum()) == arm.sum())
    assert seen == {True, False}  # fully and in part


@pytest.mark.parametrize(("name", "before", "after"), [("holes", 1, 0), ("spill", 0, 1)])
def test_holes_take_and_spill_gives(name, before, after):
    classes, arm = hands()
    config = dataclasses.replace(MaskConfig(), **{name: 1.0})
    for seed in range(10):
        out = spoil_masks(classes, arm, LEFT, config, np.random.default_rng(seed))
        changed = out != classes
        assert changed.any() and (classes[changed] == before).all() and (out[changed] == after).all()


def test_confusion_swaps_hands_only():
    classes, arm = hands()
    for side in (LEFT, RIGHT):
        out = spoil_masks(classes, arm, side, MaskConfig(confusion=1.0), np.random.default_rng(3))
        changed = out != classes
        assert changed.any() and set(zip(classes[changed].tolist(), out[changed].tolist(), strict=True)) <= {
            (1, 2),
            (2, 1),
        }


def test_border_moves_within_its_limit():
    classes, arm = hands()
    widths = []
    for seed in range(60):
        out = spoil_masks(classes, arm, LEFT, MaskConfig(border=0.05), np.random.default_rng(seed))
        assert np.array_equal(out == 2, classes == 2)  # the other hand is left alone
        widths.append(int((out[70] == 1).sum()))
    # towards the other hand it cannot grow: 40 + 6 at most; it shrinks by 3 on both sides at most
    assert min(widths) == 40 - 2 * 3 and max(widths) == 40 + 6


def test_coarse_masks_keep_their_place():
    classes, arm = hands()
    out = spoil_masks(classes, arm, LEFT, MaskConfig(coarse=1.0), np.random.default_rng(0))
    assert 0 < (out != classes).mean() < 0.05


def test_coarse_masks_are_not_displaced():
    """Enlarged by the corners of their cells they lay 1.8 of 128 pixels further right and down."""
    v, u = np.mgrid[0:128, 0:128] + 0.5
    disc = ((u - 64) ** 2 + (v - 64) ** 2 < 30**2).astype(np.uint8)
    shifts = []
    for seed in range(200):
        out = spoil_masks(disc, np.zeros_like(disc, bool), LEFT, MaskConfig(coarse=1.0), np.random.default_rng(seed))
        shifts.append([u[out == 1].mean() - 64, v[out == 1].mean() - 64])
    assert np.abs(np.mean(shifts, axis=0)).max() < 0.4


def test_inputs_are_not_changed():
    classes, arm = hands()
    kept = classes.copy()
    spoil_masks(classes, arm, LEFT, MaskConfig(1.0, 0.1, 1.0, 1.0, 1.0, 1.0), np.random.default_rng(0))
    assert np.array_equal(classes, kept)


def test_bad_strengths_are_refused():
    with pytest.raises(InputError, match="noise must not be negative, got -1"):
        PhotometricConfig(noise=-1)
    with pytest.raises(InputError, match=r"holes must lie in 0..1, got 1.5"):
        MaskConfig(holes=1.5)
