"""The codec: hand-computed digits, exact round trips, and what it must refuse."""

import numpy as np
import pytest

from twohands.errors import DataFormatError
from twohands.formats import ego3dhands as fmt


@pytest.mark.parametrize(
    ("depth_cm", "rgb"),
    [
        (0.0, (0, 0, 0)),
        (28.1082, (82, 10, 28)),  # 28 + 10/100 + 82/10000
        (0.0001, (1, 0, 0)),
        (0.01, (0, 1, 0)),
        (1.0, (0, 0, 1)),
        (2.9999, (99, 99, 2)),
        (2.99996, (0, 0, 3)),  # rounds up through both digits
        (7.00996, (0, 1, 7)),  # carries into G only
        (7.00994, (99, 0, 7)),
        (100.5, (0, 50, 100)),  # B is not limited to two digits
        (255.9999, (99, 99, 255)),
    ],
)
def test_depth_digits(depth_cm: float, rgb: tuple[int, int, int]) -> None:
    encoded = fmt.encode_depth(np.full((1, 1), depth_cm / 100))
    assert encoded.dtype == np.uint8
    assert tuple(encoded[0, 0]) == rgb
    assert fmt.decode_depth(encoded)[0, 0] * 100 == pytest.approx(depth_cm, abs=0.6e-4)


def test_depth_order_is_rgb() -> None:
    """B holds whole centimetres: the last channel, not the first."""
    assert fmt.decode_depth(np.array([[[0, 0, 30]]], np.uint8))[0, 0] == pytest.approx(0.30)
    assert fmt.decode_depth(np.array([[[30, 0, 0]]], np.uint8))[0, 0] == pytest.approx(30e-6)


def test_depth_pixels_survive_decoding_to_float32() -> None:
    rng = np.random.default_rng(0)
    pixels = rng.integers(0, 100, (64, 64, 3)).astype(np.uint8)
    pixels[..., 2] = rng.integers(0, 256, (64, 64))
    depth = fmt.decode_depth(pixels)
    assert depth.dtype == np.float32
    np.testing.assert_array_equal(fmt.encode_depth(depth), pixels)


@pytest.mark.parametrize("bad", [-0.01, np.nan, np.inf, 2.56])
def test_depth_refuses(bad: float) -> None:
    with pytest.raises(DataFormatError):
        fmt.encode_depth(np.array([[0.3, bad]]))


def test_labels_round_trip_and_refusals() -> None:
    labels = np.arange(15, dtype=np.uint8).reshape(3, 5)
    pixels = fmt.encode_labels(labels)
    assert pixels.shape == (3, 5, 3)
    np.testing.assert_array_equal(fmt.decode_labels(pixels), labels)
    np.testing.assert_array_equal(fmt.decode_labels(pixels[..., 1]), labels)
    with pytest.raises(DataFormatError, match="15"):
        fmt.encode_labels(labels + 1)
    pixels[0, 0, 2] = 7
    with pytest.raises(DataFormatError, match="differ"):
        fmt.decode_labels(pixels)


def test_axes_and_units() -> None:
    """x right is the column, y down is the row, a metre is 100 cm."""
    joints_m = np.tile([0.01, 0.02, 0.30], (2, 22, 1))
    np.testing.assert_allclose(fmt.encode_joints_m(joints_m)[0, 5], [2.0, 1.0, 30.0], rtol=1e-15)
    np.testing.assert_array_equal(fmt.encode_canonical(joints_m)[1, 3], [0.02, 0.01, 0.30])
    joints_px = np.tile([120.0, 54.0], (2, 22, 1))
    np.testing.assert_allclose(fmt.encode_joints_px(joints_px, 480, 270)[0, 0], [0.2, 0.25], rtol=1e-15)


def test_joints_round_trip_with_absent_hand() -> None:
    rng = np.random.default_rng(1)
    joints_m = rng.normal(size=(2, 22, 3))
    joints_px = rng.normal(size=(2, 22, 2)) * 300
    for array in (joints_m, joints_px):
        array[0] = np.nan
    before = joints_m.copy(), joints_px.copy()
    for encoded in (
        fmt.encode_joints_m(joints_m),
        fmt.encode_canonical(joints_m),
        fmt.encode_joints_px(joints_px, 960, 540),
    ):
        assert encoded.dtype == np.float64
        assert (encoded[0] == 0).all()
    np.testing.assert_allclose(fmt.decode_joints_m(fmt.encode_joints_m(joints_m)), joints_m, rtol=1e-15)
    np.testing.assert_array_equal(fmt.decode_canonical(fmt.encode_canonical(joints_m)), joints_m)
    round_trip = fmt.decode_joints_px(fmt.encode_joints_px(joints_px, 960, 540), 960, 540)
    np.testing.assert_allclose(round_trip, joints_px, rtol=1e-14)
    np.testing.assert_array_equal(joints_m, before[0])
    np.testing.assert_array_equal(joints_px, before[1])


def test_half_known_hand_is_refused() -> None:
    joints = np.ones((2, 22, 3))
    joints[1, 4] = np.nan
    with pytest.raises(DataFormatError, match="whole hands"):
        fmt.encode_joints_m(joints)
    with pytest.raises(DataFormatError, match="NaN"):
        fmt.decode_joints_m(joints)


@pytest.mark.parametrize("value", [1e308, -1e200, 1.1e9])
def test_numbers_that_no_joint_has_are_refused(value: float) -> None:
    """Their squares overflow: numpy's warnings came out, and lengths were infinite."""
    joints = np.ones((2, 22, 3))
    joints[1, 4, 2] = value
    with pytest.raises(DataFormatError, match="at most 1e\\+09 can be one of a joint"):
        fmt.decode_joints_m(joints)


def test_wrong_shape_is_named() -> None:
    with pytest.raises(DataFormatError, match=r"location_2d.npy.*\(2, 22, 2\).*\(2, 21, 2\)"):
        fmt.decode_joints_px(np.ones((2, 21, 2)), 480, 270)
