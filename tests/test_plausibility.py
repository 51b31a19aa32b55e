"""Numbers in the wrong unit are named, and those of real hands and cameras are not."""

import warnings

import pytest

from twohands.errors import PlausibilityWarning
from twohands.plausibility import camera_doubts, hand_length_doubts, range_doubts, warn
from twohands.types import PinholeCamera


@pytest.mark.parametrize(
    ("length_m", "unit"),
    [
        (11, "centimetres; metres are expected"),  # hand_length_m=11
        (110, "millimetres; metres are expected"),
        (4.3, "inches; metres are expected"),
        (0.043, "inches; centimetres are expected"),  # --hand-length 4.3
        (1.1, "millimetres; centimetres are expected"),  # --hand-length 110
        (0.0011, "metres; centimetres are expected"),  # --hand-length 0.11
        (0.185, "0.6 times"),
        (0.5, "are usual"),
        (1e-9, "are usual"),
    ],
)
def test_a_hand_length_in_another_unit_is_named(length_m, unit):
    (doubt,) = hand_length_doubts(length_m)
    assert unit in doubt


@pytest.mark.parametrize("length_m", [0.055, 0.07, 0.095, 0.10, 0.12, 0.15])
def test_hands_from_children_to_giants_are_believed(length_m):
    assert hand_length_doubts(length_m) == []


SIZE = (640, 360)


@pytest.mark.parametrize(
    ("camera", "mistake"),
    [
        (PinholeCamera.from_fov(1.2, *SIZE), "radians? 1.2 radians are 69 degrees"),
        (PinholeCamera.from_fov(179.9, *SIZE), "fisheye"),
        (PinholeCamera(4.25, 4.25, 320, 180, *SIZE), "millimetres"),
        (PinholeCamera(4.25, 4.25, 3.2, 1.8, *SIZE), "look like millimetres"),
        (PinholeCamera(0.39, 0.7, 0.5, 0.5, *SIZE), "fractions"),
        (PinholeCamera(0.004, 0.004, -0.78, -0.22, *SIZE), "inverted camera matrix"),
        (PinholeCamera(250, 250, 180, 320, *SIZE), "cx and cy, or width and height, look exchanged"),
        (PinholeCamera(250, 250, 0, 0, *SIZE), "far from its middle"),
        (PinholeCamera(500, 500, 640, 360, *SIZE), "a picture 2 times as large"),
        (PinholeCamera(125, 125, 161, 91, *SIZE), "a picture 0.5 times as large"),
        (PinholeCamera(250, 500, 320, 180, *SIZE), "fx 250 and fy 500 differ"),
        (PinholeCamera(9000, 9000, 320, 180, *SIZE), "larger picture"),
    ],
)
def test_a_camera_in_another_unit_or_order_is_named(camera, mistake):
    assert any(mistake in doubt for doubt in camera_doubts(camera))


@pytest.mark.parametrize(
    "camera",
    [
        PinholeCamera.ego3dhands(),
        PinholeCamera.from_fov(60, 1280, 720),
        PinholeCamera.from_fov(28, 224, 224),  # FreiHAND
        PinholeCamera.from_fov(120, 1920, 1080),
        PinholeCamera.from_fov(45, 1080, 1920),
        PinholeCamera(1450, 1400, 260, 160, 512, 334),  # InterHand2.6M
    ],
)
def test_cameras_in_use_are_believed(camera):
    assert camera_doubts(camera) == []


@pytest.mark.parametrize(
    ("range_m", "doubted"), [(0.05, True), (0.2, False), (3, False), (22, True), (float("nan"), False)]
)
def test_a_range_that_no_hand_has_is_named(range_m, doubted):
    assert bool(range_doubts(range_m)) == doubted


def test_warnings_are_python_s():
    with pytest.warns(PlausibilityWarning, match="centimetres"):
        warn(hand_length_doubts(11))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn(hand_length_doubts(0.1))
