"""Otsu, boxes, absence, masks: hand-made maps with known answers."""

import numpy as np
import pytest
from tests.oracles import drawn_hands, true_boxes

from twohands.geometry.boxes import box_iou
from twohands.geometry.heatmaps import encode_energy
from twohands.geometry.network_input import canvas_size, letterbox, network_input
from twohands.geometry.segmentation import (
    PRESENCE_THRESHOLD,
    boxes_from_energy,
    certain_masks,
    class_leads,
    energy_box,
    hand_scores,
    masks_from_logits,
    mean_of_views,
    otsu_threshold,
    parted_boxes,
    parted_masks,
    unmirrored,
)

BOTH = np.array([True, True])


def otsu_by_definition(levels: np.ndarray) -> int:
    """The level t that maximises the variance between {<= t} and {> t}, written out from Otsu's paper."""
    histogram = np.bincount(levels.ravel(), minlength=256) / levels.size
    best, best_variance = 0, -1.0
    for t in range(255):
        below, above = histogram[: t + 1].sum(), histogram[t + 1 :].sum()
        if below == 0 or above == 0:
            continue
        mean_below = (np.arange(t + 1) * histogram[: t + 1]).sum() / below
        mean_above = (np.arange(t + 1, 256) * histogram[t + 1 :]).sum() / above
        variance = below * above * (mean_below - mean_above) ** 2
        if variance > best_variance + 1e-9:
            best, best_variance = t, variance
    return best


def test_otsu_of_three_levels_computed_by_hand():
    """75 cells of 0.0, 10 of 0.2 (level 51), 15 of 0.8 (level 204).

    Cut below 51: w0 = 3/4, w1 = 1/4, means 0 and (10*51 + 15*204)/25 = 142.8, variance 3/16 * 142.8^2 = 3823.5.
    Cut above 51: w0 = 85/100, w1 = 15/100, means 510/85 = 6 and 204, variance 51/400 * 198^2 = 4998.5: this one.
    """
    energy = np.zeros(100)
    energy[75:85], energy[85:] = 0.2, 0.8
    threshold = otsu_threshold(energy.reshape(10, 10))
    assert threshold == 51 / 255
    assert (energy > threshold).sum() == 15


def test_otsu_is_the_maximum_of_the_variance_between_classes():
    for seed in range(20):
        rng = np.random.default_rng(seed)
        means = np.where(rng.random((30, 40)) < 0.3, 0.7, 0.2)
        energy = np.clip(rng.normal(means, 0.1), 0, 1)
        levels = np.rint(energy * 255).astype(np.uint8)
        assert otsu_threshold(energy) * 255 == pytest.approx(otsu_by_definition(levels))


def test_otsu_of_the_target_blob_gives_the_box_back():
    """The threshold of the Gaussian that fills a box is 0.29, the cut one's box overlaps it by 0.96 or more."""
    size = (288, 512)
    rng = np.random.default_rng(0)
    for _ in range(30):
        centre, sides = rng.uniform([130, 90], [380, 200]), rng.uniform(50, 150, 2)
        box = np.concatenate([centre - sides / 2, centre + sides / 2])
        energy = encode_energy(box, np.array(True), *size)
        assert otsu_threshold(energy) == pytest.approx(0.29, abs=0.02)
        assert box_iou(energy_box(energy), box) > 0.93


def test_a_rectangle_gives_its_own_box():
    """Cells 30..49 by 10..24: the box's corners are cell borders, u from 30 to 50, v from 10 to 25."""
    energy = np.zeros((60, 512))
    energy[10:25, 30:50] = 0.9
    np.testing.assert_array_equal(energy_box(energy), [30, 10, 50, 25])


@pytest.mark.parametrize(
    ("rows", "columns"), [((0, 9), (0, 12)), ((51, 60), (500, 512)), ((30, 31), (7, 8)), ((0, 60), (0, 512))]
)
def test_a_rectangle_at_the_edge_keeps_its_box(rows, columns):
    """The picture's edge opens nothing away; a single cell is a speck."""
    energy = np.zeros((60, 512))
    energy[slice(*rows), slice(*columns)] = 0.9
    energy[0, 300] = 0.9
    found = energy_box(energy)
    if rows[1] - rows[0] == 1:
        assert found is None
    else:
        np.testing.assert_array_equal(found, [columns[0], rows[0], columns[1], rows[1]])


def test_specks_are_opened_away_and_only_the_largest_blob_counts():
    energy = np.zeros((100, 512))
    energy[20:60, 100:150] = 0.9
    energy[10:18, 400:410] = 0.9  # a second, smaller blob, met first
    energy[5:9, 300:304] = 0.9  # 4 x 4: smaller than the 5 x 5 opening
    np.testing.assert_array_equal(energy_box(energy), [100, 20, 150, 60])
    only_speck = np.zeros((100, 512))
    only_speck[5:9, 300:304] = 0.9
    assert energy_box(only_speck) is None


def test_the_opening_shrinks_with_the_map():
    """On a map a quarter as wide the same speck is one cell, and nothing is opened away there."""
    quarter = np.zeros((25, 128))
    quarter[1, 75] = 0.9
    np.testing.assert_array_equal(energy_box(quarter), [75, 1, 76, 2])


def test_presence_is_decided_at_the_threshold():
    energies = np.zeros((2, 100, 512))
    energies[0, 20:60, 100:150] = energies[1, 20:60, 300:350] = 0.9
    scores = np.array([PRESENCE_THRESHOLD, PRESENCE_THRESHOLD - 1e-3])
    found = boxes_from_energy(energies, (100, 512), scores)
    assert found.present.tolist() == [True, False]
    assert np.isnan(found.boxes_px[1]).all()
    np.testing.assert_array_equal(found.scores, scores)
    told = boxes_from_energy(energies, (100, 512), scores, np.array([False, True]))
    assert told.present.tolist() == [False, True]


def test_a_score_joins_the_odds_of_energy_and_mask():
    """Left: energy 0.8 (odds 4), and a lead of log 9 over the next class, here the right hand: sqrt(4 * 9) = 6 to 1.
    Right: energy 0.5 (odds 1), never ahead, log 4 behind at best: sqrt(1 / 4) = 1 to 2."""
    energies, logits = np.zeros((2, 4, 6)), np.zeros((3, 4, 6))
    energies[0, 1, 2], energies[1, 3, 3] = 0.8, 0.5
    logits[2] = -np.log(4)
    logits[:, 2, 5] = -7.0, np.log(9) + 1.0, 1.0
    logits[:, 0, 0] = 0.0, -3.0, -np.log(4)
    logits[2, 2, 5] = 1.0
    np.testing.assert_allclose(hand_scores(energies, class_leads(logits)), [6 / 7, 1 / 3], rtol=1e-6)


def test_boxes_come_in_pixels_of_the_picture():
    """Twice as wide and three times as high as the map."""
    energies = np.zeros((2, 100, 512))
    energies[:, 20:60, 100:150] = 1.0
    found = boxes_from_energy(energies, (300, 1024), np.ones(2))
    np.testing.assert_allclose(found.boxes_px, [[200, 60, 300, 180]] * 2)


def test_true_energies_find_both_hands_of_a_picture():
    for seed in range(10):
        sample = drawn_hands(seed)
        energies = encode_energy(true_boxes(sample), sample.present, 135, 240)
        found = boxes_from_energy(energies, (135, 240), np.ones(2))
        assert found.present.all()
        assert box_iou(found.boxes_px, true_boxes(sample)).min() > 0.85


def test_a_picture_of_the_same_shape_fills_the_input():
    image = np.random.default_rng(0).integers(0, 256, (270, 480, 3), dtype=np.uint8)
    canvas, place = letterbox(image, (270, 480))
    np.testing.assert_array_equal(canvas, image)
    assert (place.top, place.left, place.height, place.width) == (0, 0, 1, 1)


def test_nearly_the_same_shape_is_stretched_to_fill_the_input():
    """480 x 270 into 288 x 160: 0.6 and 0.593, as in training."""
    canvas, place = letterbox(np.full((270, 480, 3), 7, np.uint8), (160, 288))
    assert canvas.shape == (160, 288, 3)
    assert (place.top, place.left, place.height, place.width) == (0, 0, 1, 1)


def test_another_shape_is_centred_in_what_the_network_sees_as_nothing():
    """400 x 400 into 270 x 480: 270 x 270 in the middle, 105 columns on either side."""
    image = np.zeros((400, 400, 3), np.uint8)
    image[:, :200], image[:, 200:] = 30, 220
    canvas, place = letterbox(image, (270, 480))
    assert (canvas[:, 105:240] == 30).all() and (canvas[:, 240:375] == 220).all()
    outside = network_input(np.concatenate([canvas[:, :105], canvas[:, 375:]], axis=1)[None])
    assert not outside.any()
    assert (place.top, place.left * 480, place.height, place.width * 480) == (0, 105, 1, 270)
    assert place.content(canvas.transpose(2, 0, 1)).shape == (3, 270, 270)
    half = np.arange(135 * 240).reshape(1, 135, 240)
    assert place.content(half).shape == (1, 135, 136)  # 52.5 and 187.5 both round to even: 52 to 188


@pytest.mark.parametrize("shape", [(135, 240), (480, 640), (1000, 400), (33, 3000)])
def test_every_shape_of_picture_can_be_put_in_and_taken_out(shape):
    canvas, place = letterbox(np.zeros((*shape, 3), np.uint8), (160, 288))
    assert canvas.shape == (160, 288, 3)
    content = place.content(np.zeros((2, 80, 144)))
    assert min(content.shape[1:]) >= 1
    assert masks_from_logits(np.zeros((3, *content.shape[1:])), shape, BOTH).shape == shape


def test_the_mirror_image_of_a_right_hand_at_its_left_is_a_left_hand_at_the_right():
    logits, energies = np.zeros((3, 1, 2)), np.zeros((2, 1, 2))
    logits[2, 0, 0], energies[1, 0, 0], logits[0, 0, 1] = 2.0, 3.0, 1.0
    masks, energy = unmirrored(logits, energies)
    assert masks[:, 0].tolist() == [[1, 0], [0, 2], [0, 0]] and energy[:, 0].tolist() == [[0, 3], [0, 0]]
    for twice, once in zip(unmirrored(masks, energy), (logits, energies), strict=True):
        np.testing.assert_array_equal(twice, once)


def test_the_mean_of_views_has_the_resolution_of_the_finest():
    """A map that is linear between its cells' centres is the same at any resolution, but for its border."""

    def ramp(rows, columns, scale):
        v, u = np.meshgrid((np.arange(rows) + 0.5) / rows, (np.arange(columns) + 0.5) / columns, indexing="ij")
        return scale * np.stack([u, v, u + v]), scale * np.stack([v, u])

    masks, energies = mean_of_views([ramp(4, 8, 1.0), ramp(16, 32, 2.0), ramp(8, 16, 3.0)])
    assert masks.shape == (3, 16, 32) and energies.shape == (2, 16, 32)
    for found, expected in zip((masks, energies), ramp(16, 32, 2.0), strict=True):
        np.testing.assert_allclose(found[:, 2:-2, 2:-2], expected[:, 2:-2, 2:-2], atol=1e-6)
    alone = ramp(4, 8, 1.0)
    assert all(np.array_equal(a, b) for a, b in zip(mean_of_views([alone]), alone, strict=True))


def test_masks_are_the_largest_logit():
    logits = np.zeros((3, 4, 6), np.float32)
    logits[0] = 2.0
    logits[1, :, :2] = 5.0
    logits[2, :, 4:] = 5.0
    np.testing.assert_array_equal(masks_from_logits(logits, (4, 6), BOTH), [[1, 1, 0, 0, 2, 2]] * 4)
    enlarged = masks_from_logits(logits, (40, 60), BOTH)
    assert (enlarged[:, :15] == 1).all() and (enlarged[:, 45:] == 2).all() and (enlarged[:, 27:33] == 0).all()


def test_pixels_that_the_background_narrowly_wins_are_perhaps_a_hands():
    logits = np.zeros((3, 1, 7))
    logits[1, 0] = [0.1, 0.0, -0.9, -1.0, -0.9, -3.0, -3.0]  # left; the background has 0
    logits[2, 0] = [-3.0, -3.0, -3.0, -3.0, -0.8, -0.5, 2.0]  # right
    masks = masks_from_logits(logits, (1, 7), BOTH)
    np.testing.assert_array_equal(masks, [[1, 3, 3, 0, 4, 4, 2]])
    np.testing.assert_array_equal(certain_masks(masks), [[1, 0, 0, 0, 0, 0, 2]])
    np.testing.assert_array_equal(masks_from_logits(logits, (1, 7), np.array([True, False])), [[1, 3, 3, 0, 3, 0, 0]])


def test_network_input_is_normalised_as_in_training():
    """(x - 128) / 256, channels first: 0 -> -0.5, 128 -> 0, 255 -> 127/256."""
    image = np.zeros((1, 2, 3, 3), np.uint8)
    image[0, 0, 1] = (128, 255, 64)
    batch = network_input(image)
    assert batch.shape == (1, 3, 2, 3) and batch.dtype == np.float32
    np.testing.assert_array_equal(batch[0, :, 0, 1], [0.0, 127 / 256, -0.25])
    assert batch[0, 0, 0, 0] == -0.5


def test_an_absent_hand_gets_no_pixel():
    logits = np.zeros((3, 1, 3))
    logits[1, 0] = [5.0, 1.0, -1.0]  # left
    logits[2, 0] = [1.0, 5.0, -2.0]  # right
    np.testing.assert_array_equal(masks_from_logits(logits, (1, 3), BOTH), [[1, 2, 0]])
    np.testing.assert_array_equal(masks_from_logits(logits, (1, 3), np.array([True, False])), [[1, 1, 0]])
    np.testing.assert_array_equal(masks_from_logits(logits, (1, 3), np.array([False, False])), [[0, 0, 0]])


def test_inputs_take_the_form_of_the_picture():
    own = (224, 384)  # 86,016 cells
    assert canvas_size((540, 960), own) == own
    assert canvas_size((480, 640), own) == (256, 320)  # half size instead of 224 / 480
    assert canvas_size((256, 256), own) == (288, 288)
    assert canvas_size((640, 480), own) == (352, 224)
    assert canvas_size((1280, 720), own) == (384, 224)


@pytest.mark.parametrize("picture", [(480, 640), (1280, 720), (300, 300), (1000, 100), (7, 4000)])
def test_no_input_shows_a_picture_smaller_or_has_more_cells(picture):
    own = (192, 352)
    form = canvas_size(picture, own)
    assert form[0] % 32 == form[1] % 32 == 0 and form[0] * form[1] <= own[0] * own[1]
    assert min(form[0] / picture[0], form[1] / picture[1]) >= min(own[0] / picture[0], own[1] / picture[1])


def two_places(left, right):
    """Energies (2, 6, 16) with two places, each as sure as given as LEFT and as RIGHT."""
    energies = np.full((2, 6, 16), 0.01)
    for place, columns in ((left, slice(1, 5)), (right, slice(10, 14))):
        for side, sure in enumerate(place):
            energies[side, 1:5, columns] = sure
    return energies


def test_hands_seen_but_not_whose_become_candidates_in_two_places():
    """Both sides' energies are highest on the right, which is rather the left hand's place than the other one is."""
    energies = two_places((0.6, 0.5), (0.9, 0.7))
    found = boxes_from_energy(energies, (60, 160), np.array([0.8, 0.7]), threshold=0.03)
    parted = parted_boxes(found, energies, (60, 160), 0.03, 0.4)
    assert parted.parted and parted.present.all()
    np.testing.assert_allclose(parted.boxes_px, [[100, 10, 140, 50], [10, 10, 50, 50]])
    mirrored = energies[::-1, :, ::-1]
    again = boxes_from_energy(mirrored, (60, 160), np.array([0.7, 0.8]), threshold=0.03)
    flipped = parted_boxes(again, mirrored, (60, 160), 0.03, 0.4).boxes_px
    np.testing.assert_allclose(flipped, [[110, 10, 150, 50], [20, 10, 60, 50]])


def test_candidates_in_two_places_or_in_the_only_one_stay():
    apart = two_places((0.9, 0.1), (0.1, 0.9))
    found = boxes_from_energy(apart, (60, 160), np.array([0.8, 0.8]), threshold=0.03)
    assert parted_boxes(found, apart, (60, 160), 0.03, 0.4) is found
    one = two_places((0.9, 0.8), (0.01, 0.01))
    found = boxes_from_energy(one, (60, 160), np.array([0.8, 0.8]), threshold=0.03)
    assert parted_boxes(found, one, (60, 160), 0.03, 0.4) is found


def test_masks_follow_parted_boxes_regions_whole_where_only_one_box_touches_them():
    masks = np.array([[1, 2, 3, 0, 2, 1, 0], [0, 0, 2, 0, 0, 4, 0]], np.uint8)
    boxes_px = np.array([[4.0, 0, 6, 1], [0, 0, 2, 1]])
    parted = parted_masks(masks, boxes_px)
    assert parted.tolist() == [[2, 2, 4, 0, 1, 1, 0], [0, 0, 2, 0, 0, 3, 0]]
    assert masks[0, 0] == 1
