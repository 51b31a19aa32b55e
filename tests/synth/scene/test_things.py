"""What hands hold and wear: closed meshes, in their place, never inside a hand."""

import dataclasses

import numpy as np
import pytest

from twohands.skeleton import N_PART_LABELS, PART_NAMES, part_label
from twohands.synth.scene.body import load_asset, skin
from twohands.synth.scene.collision import capsules, segment_distance
from twohands.synth.scene.config import WILD
from twohands.synth.scene.spec import moved
from twohands.synth.scene.things import NO_LABEL, band, superquadric
from twohands.synth.sets.instances import sample_scene

ARMS = dataclasses.replace(WILD, people=0.0)
"""Preset wild without whole people: scenes of two arms."""

LADEN = {"objects": 1.0, "watches": 1.0, "rings": 1.0, "gloves": 0.0, "sleeves": 0.0}
CONFIG = dataclasses.replace(ARMS, width=480, height=270, webcam=0.0, free_view=0.0, pitch=(0.0, 0.0), **LADEN)


@pytest.fixture(scope="module")
def scenes():
    return [sample_scene(CONFIG, 21, i) for i in range(30)]


def outwardness(vertices, normals, faces):
    """Cosine between the triangles' own normals and those of their corners."""
    corners = vertices[faces]
    own = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(own, axis=1)
    kept = size > 1e-12
    return ((own / np.maximum(size, 1e-12)[:, None]) * normals[faces].mean(1)).sum(1)[kept]


def test_a_superquadric_with_exponents_one_is_an_ellipsoid():
    half = np.array([1.0, 2.0, 3.0])
    vertices, normals, faces, place = superquadric(half, 1.0, 1.0)
    np.testing.assert_allclose(((vertices / half) ** 2).sum(1), 1, atol=1e-12)
    inside = np.abs(vertices[:, 2]) < 2.99  # the poles' many vertices have no single neighbourhood
    gradient = vertices / half**2
    gradient /= np.linalg.norm(gradient, axis=1, keepdims=True)
    np.testing.assert_allclose(normals[inside], gradient[inside], atol=1e-9)
    assert place.min() == 0 and place.max() == 1
    assert outwardness(vertices, normals, faces).min() > 0.9


@pytest.mark.parametrize("exponents", [(0.3, 0.15), (1.0, 0.15), (0.35, 1.0)])
def test_superquadrics_fill_their_box_and_face_outwards(exponents):
    vertices, normals, faces, _ = superquadric(np.array([0.5, 1.0, 2.0]), *exponents)
    np.testing.assert_allclose(np.abs(vertices).max(0), [0.5, 1.0, 2.0], rtol=1e-6)
    assert (outwardness(vertices, normals, faces) > 0).mean() > 0.98


def test_a_band_around_a_cylinder_lies_on_it():
    rng = np.random.default_rng(0)
    angle = rng.uniform(0, 2 * np.pi, 200)
    points = np.stack([0.03 * np.cos(angle), 0.03 * np.sin(angle), rng.uniform(-0.01, 0.01, 200)], 1)
    vertices, normals, faces, _ = band(points, np.zeros(3), np.array([0.0, 0.0, 1.0]), 0.02, 0.002)
    radius = np.hypot(vertices[:, 0], vertices[:, 1])
    assert radius.min() == pytest.approx(0.03, abs=1e-6) and radius.max() == pytest.approx(0.032, abs=1e-6)
    assert np.abs(vertices[:, 2]).max() == pytest.approx(0.01)
    assert outwardness(vertices, normals, faces).min() > 0.2


def test_held_objects_enter_neither_hand(scenes):
    held = 0
    for scene in scenes:
        here = (scene.joints_m[scene.present] / scene.scale - scene.view[:, 3]) @ scene.view[:, :3]
        starts, ends, radii = capsules(scene.body, here)
        for thing in scene.things:
            if thing.label != NO_LABEL:
                continue
            held += 1
            n, m = len(thing.vertices), len(radii)
            point = np.repeat(thing.vertices, m, 0)
            gap = segment_distance(point, point, np.tile(starts, (n, 1)), np.tile(ends, (n, 1))).reshape(n, m)
            assert (gap > radii - 0.004).all()
    assert held > 5


def test_what_is_worn_carries_the_label_of_its_part_and_lies_on_it(scenes):
    worn = [(scene, thing) for scene in scenes for thing in scene.things if thing.label != NO_LABEL]
    assert len(worn) > 30
    for scene, thing in worn:
        assert 1 <= thing.label < N_PART_LABELS
        side, part = divmod(thing.label - 1, 7)
        hand = (scene.joints_m[side] / scene.scale - scene.view[:, 3]) @ scene.view[:, :3]
        near = hand[1] if part == 0 else hand[2 + 4 * (part - 2) : 4 + 4 * (part - 2)].mean(0)
        assert np.linalg.norm(thing.vertices.mean(0) - near) < (0.09 if part == 0 else 0.045)
        np.testing.assert_allclose(np.linalg.norm(thing.normals, axis=1), 1, atol=1e-6)


def test_watch_and_ring_do_not_depend_on_the_other_hand():
    config = dataclasses.replace(CONFIG, objects=0.0, drop_rate=0.0)
    assert [t.label for t in sample_scene(config, 3, 1).things] == [t.label for t in sample_scene(config, 3, 1).things]
    none = dataclasses.replace(CONFIG, objects=0.0, watches=0.0, rings=0.0)
    assert sample_scene(none, 3, 1).things == ()


def winding(points, vertices, faces):
    """(N,) how often a mesh goes around points: 1 inside a closed one, 0 outside (Van Oosterom, Strackee 1983)."""
    a, b, c = (vertices[faces[:, k]] - points[:, None] for k in range(3))
    la, lb, lc = (np.linalg.norm(x, axis=-1) for x in (a, b, c))
    volume = (a * np.cross(b, c)).sum(-1)
    below = la * lb * lc + (a * b).sum(-1) * lc + (b * c).sum(-1) * la + (c * a).sum(-1) * lb
    return np.arctan2(volume, below).sum(1) / (2 * np.pi)


def test_arms_end_inside_the_shirt():
    """From beside and behind, bare arms ended in teeth on the shirt."""
    asset = load_asset()
    edges = np.sort(np.concatenate([asset.faces[:, [i, (i + 1) % 3]] for i in range(3)]), axis=1)
    unique, count = np.unique(edges, axis=0, return_counts=True)
    rim = np.unique(unique[count == 1])
    assert 40 < len(rim) < 80
    config = dataclasses.replace(CONFIG, free_view=1.0, objects=0.0, watches=0.0, rings=0.0, drop_rate=0.3, sleeves=0.3)
    covered, labels = [], set()
    for index in range(20):
        scene = sample_scene(config, 5, index)
        trunk, sleeves = scene.things[0], scene.things[4:]
        assert len(sleeves) == scene.present.sum()
        posed = skin(scene.body, scene.transforms, scene.view)
        for side, sleeve in zip(np.flatnonzero(scene.present), sleeves, strict=True):
            long = bool(scene.clothes.sleeve_albedo.any())
            assert sleeve.label == (part_label(int(side), PART_NAMES.index("arm")) if long else NO_LABEL)
            labels.add(long)
            assert (outwardness(sleeve.vertices, sleeve.normals, sleeve.faces) > 0).mean() > 0.98
            mine = posed[rim[asset.side[rim] == side]]
            around = [winding(mine, moved(scene.view, cloth.vertices), cloth.faces) for cloth in (trunk, sleeve)]
            covered.append(np.max(around, axis=0) > 0.5)
    assert np.concatenate(covered).mean() > 0.99 and labels == {True, False}
