"""Where veins, creases and spots are painted: on the flat chart, then on rendered hands."""

import dataclasses

import numpy as np
import pytest

from twohands.skeleton import part_label
from twohands.synth.render.chart import chart
from twohands.synth.render.markings import HIGH, LOW, TEXEL_M, on_painting, paint_markings
from twohands.synth.render.raster import RasterRenderer
from twohands.synth.render.surface import surface
from twohands.synth.scene.body import load_asset
from twohands.synth.scene.config import PAPER, WILD, SynthConfig
from twohands.synth.scene.spec import BARE, PATTERNS, SkinDetail
from twohands.synth.sets.instances import sample_scene

ARMS = dataclasses.replace(WILD, people=0.0)
"""Preset wild without whole people: scenes of two arms."""

VEINS, CREASES, FRECKLES, MOLES = range(4)
FINGERS = range(1, 5)


def near(painting, place, radius_m):
    """The texels of one sheet within a square about a place on the chart, metres."""
    column, row = ((place - LOW) / TEXEL_M).astype(int)
    reach = round(radius_m / TEXEL_M)
    return painting[row - reach : row + reach + 1, column - reach : column + reach + 1]


def test_the_chart_is_a_flat_hand_with_straight_fingers():
    joints = chart().joints
    np.testing.assert_allclose(joints[1], 0, atol=1e-9)
    assert joints[10, 1] > 0.1 and joints[0, 1] < -0.2  # middle knuckle up, elbow down
    assert joints[6, 0] > joints[18, 0]  # index on the thumb's side
    for finger in FINGERS:
        a, b, c = np.diff(joints[2 + 4 * finger : 6 + 4 * finger], axis=0)
        for first, second in ((a, b), (b, c)):  # in the plane, seen from above; tips sit a little off the bone
            cross = first[0] * second[1] - first[1] * second[0]
            assert abs(cross) < 0.08 * np.linalg.norm(first) * np.linalg.norm(second)


def test_both_arms_have_the_same_chart_nails_on_the_back_pads_on_the_palm_side():
    vertices, attributes = chart().vertices, surface()
    left, right = (np.sort(vertices[load_asset().side == side], axis=0) for side in (0, 1))
    np.testing.assert_allclose(left, right, atol=1e-4)
    nails = (attributes.nail[:, 0] > 0.6) & (attributes.nail[:, 2] > 0.9)
    pads = (attributes.nail[:, 0] > 0.2) & (attributes.nail[:, 2] < -0.9)
    assert nails.sum() > 30 and (vertices[nails, 2] < -0.5).all()
    assert pads.sum() > 30 and (vertices[pads, 2] > 0.5).all()


def test_hands_and_forearms_lie_inside_the_painting():
    below_elbow = surface().along < 0.95
    place = on_painting(chart().vertices[below_elbow, :2])
    assert (place > 0).all() and (place < 1).all()
    np.testing.assert_allclose(on_painting(np.array([LOW, HIGH, (LOW + HIGH) / 2])), [[0, 0], [1, 1], [0.5, 0.5]])


@pytest.mark.parametrize("pattern", [0, 7])
def test_everything_is_where_anatomy_has_it(pattern):
    back, palm = paint_markings(pattern)
    joints = chart().joints
    wrist_row = round(-LOW[1] / TEXEL_M)
    hand = slice(wrist_row + round(0.012 / TEXEL_M), None)
    assert back[hand, :, VEINS].max() > 60 and palm[hand, :, VEINS].max() == 0
    for finger in FINGERS:
        for joint in (3 + 4 * finger, 4 + 4 * finger):  # the two joints of a finger, from both sides
            for sheet in (back, palm):
                assert near(sheet, joints[joint], 0.003)[..., CREASES].max() > 40
            middle_of_bone = (joints[joint] + joints[joint + 1]) / 2
            assert near(palm, middle_of_bone, 0.002)[..., CREASES].max() == 0
    middle_of_palm = near(palm, joints[10] * 0.6, 0.02)
    assert middle_of_palm[..., CREASES].max() > 100
    assert near(back, joints[10] * 0.6, 0.02)[..., CREASES].max() == 0
    assert palm[hand, :, FRECKLES:].max() == 0 and back[hand, :, FRECKLES].max() > 60


def test_a_pattern_is_its_number():
    np.testing.assert_array_equal(paint_markings(3), paint_markings(3))
    assert (paint_markings(3) != paint_markings(4)).mean() > 0.01


def test_paper_has_smooth_skin_and_detail_changes_nothing_else_of_a_scene():
    assert PAPER.skin_detail == 0 and sample_scene(PAPER, 3, 0).skin.detail is None
    for index in range(4):
        detailed = sample_scene(ARMS, 3, index)
        smooth = sample_scene(dataclasses.replace(ARMS, skin_detail=0.0), 3, index)
        assert smooth.skin.detail is None
        np.testing.assert_array_equal(detailed.transforms, smooth.transforms)
        np.testing.assert_array_equal(detailed.skin.seed, smooth.skin.seed)
        assert [len(thing.vertices) for thing in detailed.things] == [len(thing.vertices) for thing in smooth.things]


def test_detail_covers_its_distribution():
    details = [sample_scene(dataclasses.replace(ARMS, skin_detail=0.5), 4, i).skin.detail for i in range(60)]
    creases, freckles, moles = (np.array([getattr(d, n) for d in details]) for n in ("creases", "freckles", "moles"))
    assert creases.min() >= 0.5 * 0.35 and 0.4 < creases.max() <= 0.5
    assert 0.1 < (freckles > 0).mean() < 0.5 and 0.4 < (moles > 0).mean() < 0.8
    assert {d.pattern for d in details} <= set(range(PATTERNS)) and len({d.pattern for d in details}) > 8


@pytest.fixture(scope="module")
def renderer():
    return RasterRenderer(480, 270)


def test_detail_changes_skin_and_leaves_labels_alone(renderer):
    config = SynthConfig(width=480, height=270)
    everything = SkinDetail(1.0, 1.0, 1.0, 1.0, pattern=2)
    changed = []
    for index in range(4):
        scene = sample_scene(config, 11, index)
        detailed = dataclasses.replace(scene, skin=dataclasses.replace(scene.skin, detail=everything))
        smooth, marked = renderer.render(scene), renderer.render(detailed)
        np.testing.assert_array_equal(smooth.part_labels, marked.part_labels)
        np.testing.assert_array_equal(smooth.depth_m, marked.depth_m)
        np.testing.assert_array_equal(smooth.alpha, marked.alpha)
        np.testing.assert_array_equal(renderer.render(scene).rgb, smooth.rgb)  # and back again
        difference = np.abs(smooth.rgb.astype(int) - marked.rgb).max(-1)[smooth.part_labels > 0]
        changed.append((difference > 5).mean())
        assert (difference > 0).any()
    assert 0.01 < np.mean(changed) < 0.4  # lines and spots, not a new colour


def test_sleeves_and_gloves_hide_detail(renderer):
    scene = sample_scene(SynthConfig(width=480, height=270), 11, 0)
    dressed = dataclasses.replace(BARE, sleeve_from=0.3, glove_until=0.3, glove_albedo=np.full(3, 0.3))
    detailed = dataclasses.replace(scene.skin, detail=SkinDetail(1.0, 1.0, 1.0, 1.0, pattern=2))
    pictures = [
        renderer.render(dataclasses.replace(scene, clothes=dressed, skin=skin)) for skin in (scene.skin, detailed)
    ]
    gloved = np.isin(pictures[0].part_labels, [part_label(side, part) for side in (0, 1) for part in range(1, 7)])
    assert gloved.any()
    np.testing.assert_array_equal(pictures[0].rgb[gloved], pictures[1].rgb[gloved])


def test_no_strength_is_smooth_skin(renderer):
    scene = sample_scene(SynthConfig(width=480, height=270), 11, 1)
    none = dataclasses.replace(scene.skin, detail=SkinDetail(0.0, 0.0, 0.0, 0.0, pattern=0))
    smooth, marked = renderer.render(scene), renderer.render(dataclasses.replace(scene, skin=none))
    assert np.abs(smooth.rgb.astype(int) - marked.rgb).max() <= 1
