"""Rooms behind people."""

import numpy as np
import pytest

from twohands.synth.backgrounds import behind
from twohands.synth.backgrounds.base import Background
from twohands.synth.backgrounds.interiors import interior
from twohands.types import PinholeCamera

CAMERA = PinholeCamera(100, 110, 30, 22, 64, 48)


class Sky:
    """Blue above, green below."""

    name, unreadable = "sky", ()

    def sample(self, rng, camera):
        picture = np.zeros((camera.height, camera.width, 3), np.uint8)
        picture[: camera.height // 2, :, 2] = 200
        picture[camera.height // 2 :, :, 1] = 200
        return Background(picture)


@pytest.mark.parametrize(
    ("turns", "blue"),
    [(0, np.s_[:20, :]), (1, np.s_[:, :25]), (2, np.s_[30:, :]), (3, np.s_[:, 40:])],
)
def test_the_room_turns_with_the_camera(monkeypatch, turns, blue):
    """One quarter turn counter-clockwise brings the top to the left."""
    monkeypatch.setattr(behind, "DRAWN", 0.0)
    monkeypatch.setattr(behind, "BLURRED", 0.0)
    picture = behind.room_behind(Sky(), np.random.default_rng(0), CAMERA, turns).picture
    assert picture.shape == (48, 64, 3)
    assert (picture[blue][..., 2] == 200).all()


def test_a_room_is_a_pure_function_of_its_randomness():
    one, other = (behind.room_behind(Sky(), np.random.default_rng(4), CAMERA, 1).picture for _ in range(2))
    np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("size", [(64, 36), (480, 270), (37, 64)])
def test_every_room_can_be_drawn(size):
    """Whatever stands in it, of any size and shape; most are neither black nor blown out."""
    width, height = size
    photograph = np.random.default_rng(0).integers(0, 255, (40, 60, 3), dtype=np.uint8)
    rooms = [interior(np.random.default_rng(seed), width, height, photograph) for seed in range(60)]
    assert all(room.shape == (height, width, 3) and room.dtype == np.uint8 for room in rooms)
    levels = np.array([room.mean() for room in rooms])
    assert ((levels > 25) & (levels < 240)).mean() > 0.8
    assert len({room.tobytes() for room in rooms}) == 60
