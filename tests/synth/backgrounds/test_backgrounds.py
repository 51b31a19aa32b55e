"""Backgrounds: right size, varied, reproducible, and clear errors for bad folders."""

import cv2
import numpy as np
import pytest

from twohands.errors import InputError
from twohands.synth.backgrounds.base import MixedBackgrounds
from twohands.synth.backgrounds.photographs import BackgroundFolder, augment
from twohands.synth.backgrounds.pictures import read_picture
from twohands.synth.backgrounds.procedural import ProceduralBackgrounds
from twohands.types import PinholeCamera


def write(path, colour, size=(60, 80)):
    cv2.imwrite(str(path), np.full((*size, 3), colour, np.uint8))


def camera_of(width, height):
    return PinholeCamera.from_fov(80, width, height)


@pytest.mark.parametrize("size", [(480, 270), (64, 64), (33, 100)])
def test_procedural_has_the_asked_size_and_varies(size):
    width, height = size
    source = ProceduralBackgrounds()
    camera = camera_of(width, height)
    pictures = [source.sample(np.random.default_rng(i), camera).picture for i in range(6)]
    for picture in pictures:
        assert picture.shape == (height, width, 3) and picture.dtype == np.uint8
        assert picture.std() > 3
    assert len({picture.tobytes() for picture in pictures}) == 6
    again = source.sample(np.random.default_rng(0), camera).picture
    np.testing.assert_array_equal(again, pictures[0])


def test_folder_is_searched_deeply_and_skips_what_is_no_picture(tmp_path):
    (tmp_path / "a" / "b").mkdir(parents=True)
    write(tmp_path / "a" / "b" / "one.png", (0, 0, 200))
    (tmp_path / "broken.jpg").write_bytes(b"no picture")
    (tmp_path / "empty.png").write_bytes(b"")
    (tmp_path / "notes.txt").write_text("hello")
    folder = BackgroundFolder(tmp_path)
    assert [path.name for path in folder.files] == ["one.png", "broken.jpg", "empty.png"]
    rng = np.random.default_rng(0)
    for _ in range(10):
        picture = folder.sample(rng, camera_of(40, 30)).picture
        assert picture.shape == (30, 40, 3)
        assert picture[..., 0].mean() > picture[..., 2].mean() + 50  # red in RGB order
    assert sorted(folder.unreadable) == ["background broken.jpg cannot be read", "background empty.png cannot be read"]
    with_more = BackgroundFolder(tmp_path / "a")
    assert with_more.unreadable == [] and with_more.name != folder.name


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_a_picture_that_was_cut_off_is_skipped(tmp_path, suffix):
    """The decoder fills what is missing with grey and says nothing."""
    noise = np.random.default_rng(0).integers(0, 255, (64, 64, 3), dtype=np.uint8)
    cv2.imwrite(str(tmp_path / f"whole{suffix}"), noise)
    data = (tmp_path / f"whole{suffix}").read_bytes()
    (tmp_path / f"cut{suffix}").write_bytes(data[: len(data) // 2])
    (tmp_path / f"more{suffix}").write_bytes(data + b"appended by a camera")
    assert read_picture(tmp_path / f"cut{suffix}") is None
    for name in ("whole", "more"):
        picture = read_picture(tmp_path / f"{name}{suffix}")
        assert picture is not None and picture.shape == (64, 64, 3)
    assert read_picture(tmp_path / "nowhere.png") is None


def test_bad_folders_are_named(tmp_path):
    with pytest.raises(InputError, match="does not exist"):
        BackgroundFolder(tmp_path / "nowhere")
    with pytest.raises(InputError, match="no background picture"):
        BackgroundFolder(tmp_path)
    (tmp_path / "broken.jpg").write_bytes(b"no picture")
    with pytest.raises(InputError, match="none of the 1 background pictures"):
        BackgroundFolder(tmp_path)


def test_mixture_keeps_its_weights(tmp_path):
    (tmp_path / "red").mkdir()
    (tmp_path / "blue").mkdir()
    write(tmp_path / "red" / "r.png", (0, 0, 255))
    write(tmp_path / "blue" / "b.png", (255, 0, 0))
    mixed = MixedBackgrounds((BackgroundFolder(tmp_path / "red"), BackgroundFolder(tmp_path / "blue")), (3.0, 1.0))
    rng = np.random.default_rng(0)
    red = [mixed.sample(rng, camera_of(32, 32)).picture[..., 0].mean() > 60 for _ in range(400)]
    assert 0.68 < np.mean(red) < 0.82


def test_augment_crops_flips_and_leaves_its_input_alone():
    ramp = np.repeat(np.arange(200, dtype=np.uint8)[None, :, None], 100, axis=0).repeat(3, axis=2)
    before = ramp.copy()
    slopes = [
        np.sign(np.diff(augment(ramp, np.random.default_rng(i), 64, 36)[..., 1].mean(0)).sum()) for i in range(60)
    ]
    np.testing.assert_array_equal(ramp, before)
    assert 0.3 < np.mean(np.array(slopes) > 0) < 0.7


def halves(left, right):
    """A panorama (512, 1024, 3) whose left and right half have one RGB colour each: behind the middle column, and
    before it, they meet."""
    picture = np.empty((512, 1024, 3), np.uint8)
    picture[:, :512], picture[:, 512:] = left, right
    return picture


def test_a_panorama_is_seen_through_the_camera_and_brings_its_light(tmp_path):
    cv2.imwrite(str(tmp_path / "round.png"), halves((200, 0, 0), (0, 0, 200))[..., ::-1])
    folder, camera = BackgroundFolder(tmp_path), camera_of(96, 54)
    shares = []
    for seed in range(40):
        sampled = folder.sample(np.random.default_rng(seed), camera)
        assert sampled.picture.shape == (54, 96, 3) and sampled.surroundings is not None
        around = sampled.surroundings
        np.testing.assert_allclose(around.world_from_camera @ around.world_from_camera.T, np.eye(3), atol=1e-12)
        # Red lies to the left of the world, blue to its right: so says the picture's middle, mirrored or not.
        ahead = around.world_from_camera @ [0.0, 0.0, 1.0]
        red, _, blue = sampled.picture[27, 48].astype(int)
        if abs(ahead[0]) > 0.1:
            assert (red > blue) == (ahead[0] < 0)
        # And so says the light, cell by cell, of what is to the picture's right.
        right = around.world_from_camera @ [0.6, 0.0, 0.8]
        red, _, blue = sampled.picture[27, int(48 + 0.75 * camera.fx)].astype(int)
        if abs(right[0]) > 0.1:
            assert (red > blue) == (right[0] < 0)
        shares.append(ahead[2] > 0)
    assert 0.2 < np.mean(shares) < 0.8  # to all sides


def test_other_pictures_bring_no_light(tmp_path):
    cv2.imwrite(str(tmp_path / "wide.png"), np.zeros((400, 1024, 3), np.uint8))
    assert BackgroundFolder(tmp_path).sample(np.random.default_rng(0), camera_of(40, 30)).surroundings is None


def test_light_beside_a_panorama_is_used_named_in_the_set_and_reported_if_damaged(tmp_path):
    (tmp_path / "ldr").mkdir()
    (tmp_path / "light").mkdir()
    cv2.imwrite(str(tmp_path / "ldr" / "room.png"), halves((100, 100, 100), (100, 100, 100)))
    plain, camera = BackgroundFolder(tmp_path / "ldr"), camera_of(40, 30)
    own = plain.sample(np.random.default_rng(0), camera).surroundings.radiance
    np.testing.assert_allclose(own, np.broadcast_to(own[0, 0], own.shape))
    light = np.full((64, 128, 3), 0.5, np.float16)
    light[20, 100] = 700.0
    np.save(tmp_path / "light" / "room.npy", light)
    measured = BackgroundFolder(tmp_path / "ldr")
    assert measured.name != plain.name
    better = measured.sample(np.random.default_rng(0), camera).surroundings.radiance
    assert better[20, 100].max() > 1000 * np.median(better)
    np.testing.assert_allclose(np.median(better.mean(-1)), np.median(own.mean(-1)), rtol=0.05)
    assert measured.unreadable == []
    (tmp_path / "light" / "room.npy").write_bytes(b"no array")
    damaged = BackgroundFolder(tmp_path / "ldr")
    np.testing.assert_allclose(damaged.sample(np.random.default_rng(0), camera).surroundings.radiance, own)
    assert damaged.unreadable == ["light of background room.png cannot be read"]
