"""A user's own fabrics on sleeves and gloves."""

import dataclasses
import json

import cv2
import numpy as np
import pytest

from twohands.errors import InputError
from twohands.skeleton import part_label
from twohands.synth.render.raster import RasterRenderer
from twohands.synth.scene.config import WILD, SynthConfig
from twohands.synth.scene.fabrics import MOST_CHANGED, PERIOD_M, Fabric, FabricFolder, Tile, linear
from twohands.synth.scene.spec import BARE
from twohands.synth.sets.instances import sample_scene
from twohands.synth.sets.sequences import Sequence, SequenceSet
from twohands.synth.sets.static import StaticSet, generate_static

ARMS = dataclasses.replace(WILD, people=0.0)
"""Preset wild without whole people: scenes of two arms."""

DRESSED = dataclasses.replace(ARMS, width=240, height=135, sleeves=1.0, gloves=0.5)


@pytest.fixture
def folder(tmp_path):
    """A red and a blue tile, half of each black, and a damaged one."""
    folder = tmp_path / "fabrics"
    folder.mkdir()
    for name, colour in (("red", (0, 0, 255)), ("blue", (255, 0, 0))):
        tile = np.zeros((64, 64, 3), np.uint8)
        tile[:, :32] = colour
        cv2.imwrite(str(folder / f"{name}.png"), tile)
    (folder / "damaged.jpg").write_bytes(b"no picture")
    return folder


def test_fabrics_keep_their_colours_or_take_the_given_ones(folder):
    fabrics, rng = FabricFolder(folder), np.random.default_rng(0)
    sampled = [fabrics.sample(rng, np.array([0.5, 0.25, 0.5])) for _ in range(200)]
    for fabric in sampled:
        assert PERIOD_M[0] <= fabric.period_m <= PERIOD_M[1]
        # Half of a tile is of full colour, so its mean is 1/2 there; other channels are (nearly) black.
        assert fabric.tile.mean.max() == pytest.approx(0.5) and np.sort(fabric.tile.mean)[1] < 0.01
        assert (fabric.albedo <= MOST_CHANGED * fabric.tile.mean + 1e-12).all()
    own = np.mean([np.array_equal(fabric.albedo, fabric.tile.mean) for fabric in sampled])
    assert 0.35 < own < 0.65
    assert len({id(fabric.tile) for fabric in sampled}) == 2  # kept, not read again
    assert fabrics.unreadable == ["fabric damaged.jpg cannot be read"]


def test_bad_folders_are_named(tmp_path):
    with pytest.raises(InputError, match=r"fabric folder .* does not exist"):
        FabricFolder(tmp_path / "nowhere")
    with pytest.raises(InputError, match="no fabric picture"):
        FabricFolder(tmp_path)
    (tmp_path / "a.png").write_bytes(b"no picture")
    with pytest.raises(InputError, match="none of the 1 fabric pictures"):
        FabricFolder(tmp_path)


def test_nothing_but_clothes_depends_on_fabrics(folder):
    fabrics = FabricFolder(folder)
    worn = 0
    for index in range(6):
        config = dataclasses.replace(ARMS, sleeves=0.5)
        plain, woven = (sample_scene(config, 4, index, choice) for choice in (None, fabrics))
        np.testing.assert_array_equal(plain.transforms, woven.transforms)
        assert plain.clothes.sleeve_from == woven.clothes.sleeve_from and plain.skin.detail == woven.skin.detail
        assert plain.clothes.fabric is None and (woven.clothes.fabric is None) == (woven.clothes is BARE)
        worn += woven.clothes.fabric is not None
    assert 0 < worn < 6


@pytest.fixture(scope="module")
def renderer():
    return RasterRenderer(480, 270)


@pytest.mark.parametrize("detailed", [False, True])
def test_sleeves_show_the_tile_and_bare_skin_does_not(renderer, detailed):
    config = SynthConfig(width=480, height=270, skin_detail=float(detailed))
    scene = sample_scene(config, 11, 0)
    halves = np.zeros((64, 64, 3), np.uint8)
    halves[:, :32] = 255
    tile = Tile(halves, linear(halves).mean((0, 1)))
    plain = dataclasses.replace(BARE, sleeve_from=0.1, sleeve_albedo=np.full(3, 0.3), thickness_m=0.002)
    narrow = dataclasses.replace(plain, fabric=Fabric(tile, np.full(3, 0.3), 0.03, 0.4))
    before, after = (renderer.render(dataclasses.replace(scene, clothes=clothes)) for clothes in (plain, narrow))
    np.testing.assert_array_equal(before.part_labels, after.part_labels)
    np.testing.assert_array_equal(before.depth_m, after.depth_m)
    hand = np.isin(before.part_labels, [part_label(side, part) for side in (0, 1) for part in range(1, 7)])
    inner = cv2.erode(hand.astype(np.uint8), np.ones((3, 3))) > 0
    np.testing.assert_array_equal(before.rgb[inner], after.rgb[inner])
    arm = np.isin(before.part_labels, [part_label(side, 0) for side in (0, 1)])
    grey = [frame.rgb[arm].mean(-1) for frame in (before, after)]
    assert 0.3 < (grey[1] < 0.9 * grey[0]).mean() < 0.6  # the black half of the cloth, but for bare wrists
    assert 0.3 < (grey[1] > 1.1 * grey[0]).mean() < 0.6  # and the white one: the mean is the plain sleeve's


def test_a_set_knows_its_fabrics_and_any_number_of_workers_writes_the_same(folder, tmp_path):
    one = StaticSet(DRESSED, seed=3, count=4, fabrics=folder)
    outcome = generate_static(one, tmp_path / "one")
    generate_static(one, tmp_path / "two", workers=2)
    for path in sorted((tmp_path / "one").rglob("*.png")):
        assert path.read_bytes() == (tmp_path / "two" / path.relative_to(tmp_path / "one")).read_bytes()
    manifest = json.loads((tmp_path / "one" / "manifest.json").read_text())
    assert manifest["fabrics"] == FabricFolder(folder).name and "3 pictures" in manifest["fabrics"]
    assert set(outcome.notes) <= {"fabric damaged.jpg cannot be read"}
    with pytest.raises(InputError, match="fabrics"):
        generate_static(StaticSet(DRESSED, seed=3, count=4), tmp_path / "one")


def test_a_sequence_wears_one_fabric(folder):
    dynamic = SequenceSet(DRESSED, seed=1, sequences=2, frames=2, fabrics=folder)
    assert dynamic.identity()["fabrics"] == FabricFolder(folder).name
    assert Sequence(dynamic, 0).clothes.fabric is not None
    plain = Sequence(dataclasses.replace(dynamic, fabrics=None), 0)
    np.testing.assert_array_equal(plain.view, Sequence(dynamic, 0).view)


def test_blender_refuses_fabrics(folder):
    for made in (
        StaticSet(DRESSED, 0, 1, fabrics=folder, renderer="blender"),
        SequenceSet(DRESSED, seed=0, sequences=1, frames=1, fabrics=folder, renderer="blender"),
    ):
        with pytest.raises(InputError, match="Blender draws no fabrics"):
            made.identity()
