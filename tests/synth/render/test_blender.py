"""Cycles against OpenGL: the same scenes, the same labels. Needs bpy (extra `blender`, Python 3.11)."""

import dataclasses
import importlib.util
import json

import numpy as np
import pytest

from twohands.cli.main import main
from twohands.datasets.ego3dhands import Ego3DHands
from twohands.geometry.camera import project
from twohands.skeleton import LEFT, RIGHT, part_label
from twohands.synth.render.blender import BlenderRenderer, place_camera
from twohands.synth.render.nodes import Value, add_node
from twohands.synth.render.raster import RasterRenderer
from twohands.synth.scene.config import PAPER, WILD
from twohands.synth.scene.sampling import sees_the_person
from twohands.synth.scene.things import NO_LABEL
from twohands.synth.sets.instances import sample_scene
from twohands.types import PinholeCamera

ARMS = dataclasses.replace(WILD, people=0.0)
"""Preset wild without whole people: scenes of two arms."""

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("bpy") is None, reason="bpy is not installed (extra 'blender', Python 3.11)"
)

WIDTH, HEIGHT = 160, 90
DRESSED = dataclasses.replace(ARMS, sleeves=0.7, gloves=0.5)
LADEN = dataclasses.replace(ARMS, sleeves=0.2, gloves=0.0, objects=1.0, watches=1.0, rings=1.0, webcam=0.5)


@pytest.fixture(scope="module")
def cycles():
    return BlenderRenderer(WIDTH, HEIGHT, samples=4)


@pytest.fixture(scope="module")
def raster():
    return RasterRenderer(WIDTH, HEIGHT)


def scenes(count):
    """So many of the paper's, so many of all kinds, whose cameras and clothes vary, and so many with all things."""
    configs = [dataclasses.replace(config, width=WIDTH, height=HEIGHT) for config in (PAPER, DRESSED, LADEN)]
    return [sample_scene(config, 8, index) for config in configs for index in range(count)]


def data_blocks(renderer):
    """How many objects, meshes, materials, lights and images Blender holds."""
    data = renderer._bpy.data
    return [len(blocks) for blocks in (data.objects, data.meshes, data.materials, data.lights, data.images)]


def part_ious(pairs):
    """(14,) intersection over union of every part's mask, over all pairs of label planes together."""
    a, b = (np.stack(planes) for planes in zip(*pairs, strict=True))
    parts = [(a == part, b == part) for part in range(1, 15)]
    return np.array([(x & y).sum() / (x | y).sum() for x, y in parts])


def test_both_renderers_give_the_same_labels(cycles, raster):
    specs = scenes(3)
    kinds = {thing.label for scene in specs for thing in scene.things}
    assert {NO_LABEL, part_label(LEFT, 0), part_label(RIGHT, 0)} < kinds  # objects and bodies, watches; rings
    assert {sees_the_person(scene.view) for scene in specs if scene.things} == {True, False}
    pairs = [(raster.render(scene), cycles.render(scene)) for scene in specs]
    for scene, (a, b) in zip(specs, pairs, strict=True):
        np.testing.assert_array_equal(a.joints_m, b.joints_m)
        np.testing.assert_array_equal(a.present, b.present)
        assert a.camera == b.camera
        both = (a.depth_m > 0) & (b.depth_m > 0)
        difference = np.abs(a.depth_m - b.depth_m)[both]
        assert np.median(difference) < 1e-5
        assert np.quantile(difference, 0.99) < 1e-3
        hands, mask = b.part_labels > 0, b.alpha > 0
        np.testing.assert_array_equal(hands, b.depth_m > 0)
        assert mask[hands].all() and (b.rgb[~mask] == 0).all()
        unlabelled = any(thing.label == NO_LABEL for thing in scene.things)
        assert unlabelled or (mask == hands).all()
        assert ((a.alpha > 0) ^ mask).sum() < 0.01 * mask.sum()
    assert part_ious([(a.part_labels, b.part_labels) for a, b in pairs]).min() > 0.97

    # Half a pixel aside, the masks would not pass.
    moved = [dataclasses.replace(s, camera=dataclasses.replace(s.camera, cx=s.camera.cx + 0.5)) for s in specs]
    aside = [(raster.render(scene).part_labels, b.part_labels) for scene, (_, b) in zip(moved, pairs, strict=True)]
    assert part_ious(aside).min() < 0.97


def test_both_renderers_give_the_same_amodal_masks(cycles, raster):
    config = dataclasses.replace(LADEN, width=WIDTH, height=HEIGHT, together=1.0, drop_rate=0.2)
    hidden = 0
    for index in range(3):
        scene = sample_scene(config, 8, index)
        raster.render(scene)
        frame = cycles.render(scene)
        expected, masks = raster.amodal(scene), cycles.amodal(scene)
        assert masks.shape == expected.shape and masks.dtype == expected.dtype
        np.testing.assert_array_equal(masks.any((1, 2)), scene.present)
        assert (masks ^ expected).sum() < 0.01 * expected.sum()
        for side in (LEFT, RIGHT):
            seen = (frame.part_labels > 7 * side) & (frame.part_labels <= 7 + 7 * side)
            assert (seen & ~masks[side]).sum() <= 3  # on outlines, where rays may just miss
            hidden += int((masks[side] & ~seen).sum())
    assert hidden > 50


def test_both_renderers_light_alike(cycles, raster):
    """Means over each picture's hands and things, of 255, not pixels: lamps, shadows and shine differ in kind."""
    for scene in scenes(2):
        a, b = raster.render(scene), cycles.render(scene)
        inside = (a.alpha == 255) & (b.alpha == 255)
        bright, traced = (frame.rgb[inside].astype(float).mean() for frame in (a, b))
        assert traced == pytest.approx(bright, rel=0.15, abs=12)


def test_a_pixel_shows_what_projects_into_its_middle(cycles):
    """The material that tells labels, here telling positions: with any focal lengths and principal point."""
    scene = scenes(3)[-1]
    centre = PinholeCamera(120.0, 100.0, 67.3, 53.9, WIDTH, HEIGHT)
    for camera in (centre, dataclasses.replace(centre, fx=100.0, fy=120.0, cx=93.2, cy=33.1)):
        cycles.render(dataclasses.replace(scene, camera=camera))
        bpy = cycles._bpy
        material = bpy.data.materials.new("positions")
        material.use_nodes = True
        tree = material.node_tree
        position = Value(tree, add_node(tree, "ShaderNodeNewGeometry", [])["Position"], True)
        glow = add_node(tree, "ShaderNodeEmission", {"Color": position + 2.0, "Strength": 1.0})[0]
        add_node(tree, "ShaderNodeOutputMaterial", {"Surface": glow}, is_active_output=True)
        layer = cycles._labels.view_layers[0]
        kept, layer.material_override = layer.material_override, material
        try:
            picture = cycles._picture(cycles._labels)
        finally:
            layer.material_override = kept
        seen = picture[..., 3] > 0
        assert seen.sum() > 800
        found = project((picture[seen][:, :3] - 2.0) * [1, -1, -1], camera)
        rows, columns = np.nonzero(seen)
        np.testing.assert_allclose(found, np.stack([columns, rows], axis=1) + 0.5, atol=0.02)


def test_the_same_scene_gives_the_same_picture(cycles):
    first, *others = scenes(1)
    assert not first.things and others[-1].things
    frame, kept = cycles.render(first), data_blocks(cycles)
    for other in others:  # leaves nothing behind
        cycles.render(other)
        cycles.amodal(other)
    assert data_blocks(cycles) == kept
    for again in (cycles.render(first), BlenderRenderer(WIDTH, HEIGHT, samples=4).render(first)):
        for name in ("rgb", "alpha", "depth_m", "part_labels"):
            np.testing.assert_array_equal(getattr(frame, name), getattr(again, name))


def test_scale_changes_depth_not_the_picture(cycles):
    scene = scenes(2)[-1]
    scene = dataclasses.replace(scene, scale=1.0)
    double = dataclasses.replace(scene, scale=2.0, joints_m=2 * scene.joints_m)
    small, large = cycles.render(scene), cycles.render(double)
    both = (small.part_labels == large.part_labels) & (small.part_labels > 0)
    assert both.sum() > 0.98 * (small.part_labels > 0).sum()
    np.testing.assert_allclose(large.depth_m[both], 2 * small.depth_m[both], rtol=1e-5)
    assert np.abs(small.rgb[both].astype(int) - large.rgb[both]).mean() < 4


def test_other_size_is_refused(cycles):
    with pytest.raises(ValueError, match="960x540"):
        cycles.render(sample_scene(PAPER, 0, 0))


def test_generate_with_blender(tmp_path, capfd):
    """Any number of workers writes the same bytes, and nothing of what Blender reports is passed on."""
    size = ["--config.width", "96", "--config.height", "54"]
    arguments = ["generate", "static", "--renderer", "blender", "--count", "2", *size]
    for folder, workers in (("set", "1"), ("again", "2")):
        assert main([*arguments, "--out", str(tmp_path / folder), "--workers", workers]) == 0
        said = capfd.readouterr()
        assert "2 instances written" in said.out and not said.err
        assert "Fra:" not in said.out and "Saved" not in said.out
    assert (tmp_path / "set" / "index.jsonl").read_bytes() == (tmp_path / "again" / "index.jsonl").read_bytes()
    manifest = json.loads((tmp_path / "set" / "manifest.json").read_text())
    assert manifest["renderer"] == "blender" and "Cycles" in manifest["made_with"][0]["renderer"]
    assert len(Ego3DHands(tmp_path / "set")) == 2


def test_place_camera_leaves_square_pixels_square(cycles):
    place_camera(cycles._colour, PinholeCamera.ego3dhands(WIDTH, HEIGHT))
    render, lens = cycles._colour.render, cycles._camera.data
    assert (render.pixel_aspect_x, render.pixel_aspect_y, lens.shift_x, lens.shift_y) == (1, 1, 0, 0)
