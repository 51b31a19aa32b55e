"""Encoding and decoding of heatmaps and energies (docs/paper-map.md, *PoseNet2D and heatmaps*)."""

import math

import numpy as np
import pytest

from twohands.geometry.boxes import box_from_points, box_iou
from twohands.geometry.heatmaps import (
    decode_argmax,
    decode_softargmax,
    decode_subpixel,
    encode_energy,
    encode_heatmaps,
)

CROP, MAP = 256, 32
PX_PER_CELL = CROP / MAP


@pytest.fixture(scope="module")
def joints():
    """(100, 21, 2) anywhere in the crop, its borders included."""
    joints = np.random.default_rng(0).uniform(0, CROP, (100, 21, 2))
    joints[0, :4] = [[0, 0], [CROP, 0], [0, CROP], [CROP, CROP]]
    return joints


def test_encoding_by_hand(to):
    """A joint at crop (100, 60) lies at cell coordinates (12.5, 7.5): the centre of row 7, column 12."""
    maps = np.asarray(encode_heatmaps(to(np.array([[100.0, 60.0]])), crop_size=CROP))
    assert maps.shape == (1, 32, 32)
    assert maps[0, 7, 12] == 1.0
    assert maps[0, 7, 14] == pytest.approx(math.exp(-(2**2) / (2 * 2**2)))
    assert maps[0, 10, 13] == pytest.approx(math.exp(-(3**2 + 1**2) / (2 * 2**2)))
    assert maps[0, 7, 18] == pytest.approx(math.exp(-(6**2) / 8)) and maps[0, 7, 18] > 0.0099
    assert maps[0, 7, 19] == 0.0  # exp(-49/8) = 0.0022 is cut off
    assert (maps >= 0).all() and not ((maps > 0) & (maps < 0.0099)).any()


def test_spread_widens_closer_joints(to):
    """z = -2, 0, 2: width 2 sigma, sigma, sigma / 2; beyond +-2 nothing changes; unknown depth counts as 0."""
    z = np.array([-2.0, 0.0, 2.0, -5.0, np.nan])
    maps = np.asarray(encode_heatmaps(to(np.full((5, 2), 132.0)), crop_size=CROP, z=to(z)))
    assert (maps[:, 16, 16] == 1).all()
    for i, sigma in enumerate((4.0, 2.0, 1.0, 4.0, 2.0)):
        assert maps[i, 16, 18] == pytest.approx(math.exp(-(2**2) / (2 * sigma**2)))
    energy = maps.sum(axis=(1, 2))
    assert energy[0] > energy[1] > energy[2]  # "stronger heatmap energy for closer joints"
    plain = np.asarray(encode_heatmaps(to(np.full((1, 2), 132.0)), crop_size=CROP))
    np.testing.assert_array_equal(maps[1], plain[0])


def test_amplitude_raises_closer_joints(to):
    z = np.array([-2.0, 0.0, 2.0, 9.0])
    maps = np.asarray(
        encode_heatmaps(to(np.full((4, 2), 132.0)), crop_size=CROP, z=to(z), mode="amplitude", cutoff=0.0)
    )
    np.testing.assert_allclose(maps[:, 16, 16], [1.0, 0.75, 0.5, 0.5])
    np.testing.assert_allclose(maps[0] / 2, maps[2])


def test_unknown_joints_have_empty_maps(to):
    points = np.array([[np.nan, np.nan], [10.0, np.inf], [128.0, 128.0], [9000.0, 9000.0]])
    maps = np.asarray(encode_heatmaps(to(points), crop_size=CROP, z=to(np.zeros(4))))
    assert (maps.sum(axis=(1, 2)) > 0).tolist() == [False, False, True, False]
    np.testing.assert_array_equal(np.asarray(decode_subpixel(to(maps))[1]), [0, 0, maps[2].max(), 0])


@pytest.mark.parametrize("mode", ["plain", "spread", "amplitude"])
def test_subpixel_is_exact_without_noise(to, joints, mode):
    """Far below the demanded 0.5 px, over the whole crop, borders and every width included."""
    options = {} if mode == "plain" else {"z": to(np.random.default_rng(1).uniform(-2, 2, (100, 21))), "mode": mode}
    points, peaks = decode_subpixel(encode_heatmaps(to(joints), crop_size=CROP, **options))
    np.testing.assert_allclose(np.asarray(points) * PX_PER_CELL, joints, atol=1e-6)
    assert points.shape == (100, 21, 2) and peaks.shape == (100, 21)


def test_subpixel_with_noise(to, joints):
    """docs/paper-map.md: 0.4 px at noise 0.01."""
    noise = 0.01 * np.random.default_rng(2).standard_normal((100, 21, MAP, MAP))
    maps = np.asarray(encode_heatmaps(to(joints), crop_size=CROP)) + noise
    points = np.asarray(decode_subpixel(to(maps))[0]) * PX_PER_CELL
    inside = ((joints > 8) & (joints < CROP - 8)).all(axis=-1)
    error = np.linalg.norm(points - joints, axis=-1)
    assert error[inside].mean() < 0.5
    assert error.max() < 2 * PX_PER_CELL  # never leaves the highest cell


def test_argmax_error_is_that_of_the_cell(to, joints):
    """Mean distance from the centre of a square of side a is a (sqrt 2 + asinh 1) / 6: 3.06 px for 8 px cells."""
    points, peaks = decode_argmax(encode_heatmaps(to(joints), crop_size=CROP))
    error = np.linalg.norm(np.asarray(points) * PX_PER_CELL - joints, axis=-1)
    assert error.mean() == pytest.approx(PX_PER_CELL * (math.sqrt(2) + math.asinh(1)) / 6, rel=0.02)
    assert error.max() <= PX_PER_CELL / math.sqrt(2) + 1e-9
    assert (np.asarray(peaks) > math.exp(-0.5 / 8)).all()  # at most half a cell off along either axis


def test_softargmax_is_exact_away_from_the_border(to):
    joints = np.random.default_rng(3).uniform(100, 156, (50, 21, 2))
    maps = encode_heatmaps(to(joints), crop_size=CROP, cutoff=0.0)
    for factor in (1.0, 0.04):  # a common factor does not matter
        points, peaks = decode_softargmax(maps * factor)
        np.testing.assert_allclose(np.asarray(points) * PX_PER_CELL, joints, atol=1e-3)
        np.testing.assert_allclose(np.asarray(peaks), factor * np.asarray(maps).max(axis=(-2, -1)))


def test_decoding_by_hand(to):
    line = np.zeros((1, 4, 6))
    line[0, 2, 1:4] = [math.exp(-2.0), 1.0, math.exp(-1.0)]
    points, peaks = decode_subpixel(to(line))
    # along u: 0.5 (l - r) / (l - 2 c + r) of the logarithms -2, 0, -1 is 1/6, so 2.5 + 1/6; along v: alone, no slope
    np.testing.assert_allclose(np.asarray(points), [[2.5 + 1 / 6, 2.5]])
    np.testing.assert_allclose(np.asarray(peaks), [1.0])
    line[0, 2, 1] = -0.1  # no logarithm: a quarter cell towards the larger neighbour
    np.testing.assert_allclose(np.asarray(decode_subpixel(to(line))[0]), [[2.75, 2.5]])
    np.testing.assert_allclose(np.asarray(decode_argmax(to(line))[0]), [[2.5, 2.5]])
    np.testing.assert_allclose(np.asarray(decode_softargmax(to(np.ones((1, 4, 6))))[0]), [[3.0, 2.0]])


@pytest.mark.parametrize("decode", [decode_argmax, decode_subpixel, decode_softargmax])
def test_an_empty_map_says_so(to, decode):
    points, peaks = decode(to(np.zeros((2, 8, 8))))
    assert np.isfinite(np.asarray(points)).all() and (np.asarray(peaks) == 0).all()


def test_batch_is_loop_and_inputs_stay(to, joints):
    z = np.random.default_rng(4).uniform(-2, 2, (2, 3, 21))
    given = to(joints[:6].reshape(2, 3, 21, 2))
    maps = encode_heatmaps(given, crop_size=CROP, z=to(z))
    assert tuple(maps.shape) == (2, 3, 21, 32, 32)
    assert np.array_equal(np.asarray(given), joints[:6].reshape(2, 3, 21, 2))
    before = np.array(np.asarray(maps))
    for decode in (decode_argmax, decode_subpixel, decode_softargmax):
        points = np.asarray(decode(maps)[0])
        for i in range(6):
            one = encode_heatmaps(to(joints[i]), crop_size=CROP, z=to(z[i // 3, i % 3]))
            np.testing.assert_allclose(points[i // 3, i % 3], np.asarray(decode(one)[0]), atol=1e-12)
    assert np.array_equal(np.asarray(maps), before)


def test_single_precision_stays_single(to, joints):
    maps = encode_heatmaps(to(joints.astype(np.float32)), crop_size=CROP)
    assert str(maps.dtype).endswith("float32")
    points, _ = decode_subpixel(maps)
    assert str(points.dtype).endswith("float32")
    np.testing.assert_allclose(np.asarray(points) * PX_PER_CELL, joints, atol=0.01)


def test_mirror(to, joints):
    """Flipping the crop flips the maps: no half-cell is lost anywhere."""
    maps = np.asarray(encode_heatmaps(to(joints), crop_size=CROP))
    mirrored = np.asarray(encode_heatmaps(to(joints * [-1, 1] + [CROP, 0]), crop_size=CROP))
    np.testing.assert_allclose(mirrored, maps[..., ::-1], atol=1e-12)


def test_gradients():
    torch = pytest.importorskip("torch")
    points = torch.tensor([[100.0, 60.0], [30.0, 222.0]], dtype=torch.float64, requires_grad=True)
    maps = encode_heatmaps(points, crop_size=CROP, cutoff=0.0).detach().requires_grad_()
    assert torch.autograd.gradcheck(lambda p: encode_heatmaps(p, crop_size=CROP, map_size=8, cutoff=0.0), points)
    assert torch.autograd.gradcheck(lambda m: decode_softargmax(m)[0], maps, fast_mode=True)


# Energies -----------------------------------------------------------------------------------------------------------


def test_energy_by_hand(to):
    """Box from (100, 40) to (200, 90): deviations 32 and 16, centre (150, 65)."""
    energy = np.asarray(encode_energy(to(np.array([100.0, 40.0, 200.0, 90.0])), to(np.array(True)), 135, 240))
    assert energy.shape == (135, 240)
    expected = math.exp(-((180.5 - 150) ** 2) / (2 * 32.0**2) - ((50.5 - 65) ** 2) / (2 * 16.0**2))
    assert energy[50, 180] == pytest.approx(expected)
    assert energy.max() == pytest.approx(1.0, abs=1e-3)


def test_threshold_gives_the_box_back(to):
    """Cut at 0.29, where Otsu's threshold lies for this shape, and measure the box of what is left."""
    rng = np.random.default_rng(5)
    low = rng.uniform(5, 150, (60, 2))
    boxes = np.concatenate([low, low + rng.uniform(40, 110, (60, 2))], axis=-1)
    energies = np.asarray(encode_energy(to(boxes), to(np.ones(60, bool)), 288, 512))
    found = []
    for energy in energies:
        v, u = np.nonzero(energy > 0.29)
        found.append([u.min(), v.min(), u.max() + 1, v.max() + 1])
    iou = box_iou(np.array(found, dtype=float), boxes)
    assert iou.min() > 0.9 and iou.mean() > 0.95


def test_absent_hands_have_no_energy(to):
    boxes = np.array([[10.0, 10, 60, 60], [10, 10, 60, 60], [np.nan] * 4])
    energies = np.asarray(encode_energy(to(boxes), to(np.array([True, False, True])), 90, 160))
    assert energies.shape == (3, 90, 160)
    assert (energies.max(axis=(1, 2)) > 0.9).tolist() == [True, False, False]
    assert (energies[1:] == 0).all()


def test_energy_of_both_hands_from_joints(to):
    """The way training calls it: boxes of (..., 2, 21, 2) joints, NaN for the absent hand."""
    joints = np.random.default_rng(6).uniform(20, 100, (4, 2, 21, 2))
    joints[1, 0] = np.nan
    boxes = box_from_points(to(joints))
    energies = np.asarray(encode_energy(boxes, to(np.ones((4, 2), bool)), 120, 120))
    assert energies.shape == (4, 2, 120, 120) and (energies[1, 0] == 0).all() and energies[1, 1].max() > 0.9
