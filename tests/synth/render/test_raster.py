"""Rendered labels against the geometry they come from."""

import dataclasses

import cv2
import numpy as np
import pytest
from tests.synth.render.reference_raster import reference_planes

from twohands import skeleton
from twohands.errors import RendererError
from twohands.geometry.camera import project
from twohands.synth.render.compositing import compose
from twohands.synth.render.raster import RasterRenderer
from twohands.synth.render.surface import posed_vertices, surface
from twohands.synth.scene.body import load_asset, skin
from twohands.synth.scene.config import WILD, SynthConfig
from twohands.synth.scene.spec import BARE
from twohands.synth.scene.things import vertex_normals
from twohands.synth.sets.instances import sample_scene

ARMS = dataclasses.replace(WILD, people=0.0)
"""Preset wild without whole people: scenes of two arms."""

CONFIG = SynthConfig(width=480, height=270)


@pytest.fixture(scope="module")
def renderer():
    return RasterRenderer(480, 270)


@pytest.fixture(scope="module")
def rendered(renderer):
    scenes = [sample_scene(CONFIG, 11, i) for i in range(12)]
    return [(scene, renderer.render(scene)) for scene in scenes]


def test_one_mask_for_colour_labels_and_depth(rendered):
    for _, frame in rendered:
        mask = frame.part_labels > 0
        assert mask.any()
        np.testing.assert_array_equal(mask, frame.depth_m > 0)
        np.testing.assert_array_equal(mask, frame.alpha > 0)
        assert (frame.rgb[~mask] == 0).all()
        assert frame.part_labels.max() <= 14


def test_vertices_project_onto_the_mask_at_their_depth(rendered):
    """The shader skins and projects as the numpy route does: most visible vertices meet their own depth."""
    on_surface = []
    for scene, frame in rendered:
        vertices = skin(scene.body, scene.transforms) * scene.scale
        asset = load_asset()
        vertices = vertices[scene.present[asset.side]]
        inside = vertices[:, 2] > 0.05
        px = project(vertices[inside], scene.camera)
        z = vertices[inside, 2]
        ok = ((px > 0) & (px < [480, 270])).all(1)
        col, row = px[ok].astype(int).T
        seen = frame.depth_m[row, col]
        # No vertex lies in front of the picture's surface, and many lie on it; away from edges, where one pixel
        # holds several depths.
        inner = cv2.erode((frame.depth_m > 0).astype(np.uint8), np.ones((3, 3), np.uint8))
        slope = cv2.dilate(frame.depth_m, np.ones((3, 3))) - cv2.erode(frame.depth_m, np.ones((3, 3)))
        assert (seen > 0).mean() > 0.85  # thin and far hands have many vertices on their rim
        smooth = (inner[row, col] > 0) & (slope[row, col] < 0.006)
        gap = z[ok][smooth] - seen[smooth]
        assert np.percentile(gap, 0.5) > -0.006
        on_surface.append((np.abs(gap) < 0.004).mean())
    assert np.mean(on_surface) > 0.2


def test_the_shader_poses_and_dresses_as_numpy_does(renderer):
    """`posed_vertices`, which the Blender renderer draws, against what the vertex shader wrote."""
    config = dataclasses.replace(ARMS, width=480, height=270, sleeves=1.0, gloves=1.0)
    for i in range(3):
        scene = sample_scene(config, 21, i)
        renderer.render(scene)
        with renderer.ctx:
            posed = np.frombuffer(renderer._posed.read(), np.float32).reshape(-1, 14)[:, :3]
        np.testing.assert_allclose(posed, posed_vertices(scene), atol=2e-6)
        bare = posed_vertices(dataclasses.replace(scene, clothes=BARE))
        assert np.abs(bare - posed).max() > 0.5 * scene.clothes.thickness_m


def test_masks_and_depth_are_exact_at_pixel_centres(rendered):
    """Named case: a shift of half a pixel once passed every other test."""
    scene, frame = rendered[1]
    mask, depth = reference_planes(scene)
    found = frame.part_labels > 0
    assert (mask != found).sum() <= 3
    both = mask & found
    assert both.sum() > 3000
    assert np.percentile(np.abs(depth[both] - frame.depth_m[both]), 99.5) < 1e-5
    shifted = dataclasses.replace(scene.camera, cx=scene.camera.cx + 0.5)
    assert (reference_planes(dataclasses.replace(scene, camera=shifted))[0] != found).sum() > 50


def test_joints_lie_behind_their_own_part(rendered):
    """A visible joint is inside the finger: its depth is behind the surface by at most the hand's thickness."""
    gaps = []
    for scene, frame in rendered:
        for side in np.flatnonzero(scene.present):
            joints = scene.joints_m[side, 1:]
            col, row = project(joints, scene.camera).astype(int).T
            labels = frame.part_labels[row, col]
            for finger in range(5):
                for joint in range(2 + 4 * finger, 5 + 4 * finger):
                    if labels[joint] == skeleton.part_label(side, 2 + finger):
                        gaps.append(joints[joint, 2] - frame.depth_m[row[joint], col[joint]])
    gaps = np.array(gaps)
    assert len(gaps) > 100
    assert np.percentile(gaps, 2) > -0.001 and np.percentile(gaps, 98) < 0.04


def test_absent_hand_leaves_no_label(rendered, renderer):
    scene = next(s for s in (sample_scene(CONFIG, 11, i) for i in range(100)) if not s.present[0])
    frame = renderer.render(scene)
    assert set(np.unique(frame.part_labels)) <= {0, *range(8, 15)}


def test_rendering_twice_gives_the_same_bytes(renderer, rendered):
    scene, frame = rendered[3]
    again = renderer.render(scene)
    for name in ("rgb", "alpha", "depth_m", "part_labels"):
        np.testing.assert_array_equal(getattr(frame, name), getattr(again, name))


def test_the_first_picture_of_a_renderer_shows_the_arms():
    """Named case: vertices were posed before any framebuffer was bound, which OpenGL refuses silently."""
    scene = sample_scene(SynthConfig(width=96, height=54), 3, 0)
    renderer = RasterRenderer(96, 54)
    first, second = renderer.render(scene), renderer.render(scene)
    assert (first.part_labels > 0).any()
    np.testing.assert_array_equal(first.rgb, second.rgb)


def test_two_renderers_of_one_process_do_not_disturb_each_other(renderer, rendered):
    """Named case: the one that was made last took all drawing."""
    scene, before = rendered[0]
    small = sample_scene(SynthConfig(width=96, height=54), 3, 0)
    other = RasterRenderer(96, 54)
    first = other.render(small)
    np.testing.assert_array_equal(renderer.render(scene).rgb, before.rgb)
    np.testing.assert_array_equal(other.render(small).rgb, first.rgb)


def test_the_left_arm_enters_from_the_left(rendered):
    lower_left = sum((frame.part_labels[-40:, :240] == 1).sum() for _, frame in rendered)
    lower_right = sum((frame.part_labels[-40:, 240:] == 1).sum() for _, frame in rendered)
    assert lower_left > 3 * lower_right


def test_other_size_is_refused(renderer):
    with pytest.raises(ValueError, match="960x540"):
        renderer.render(sample_scene(SynthConfig(), 0, 0))


def test_a_size_beyond_the_drivers_is_refused(renderer):
    side = renderer.ctx.info["GL_MAX_RENDERBUFFER_SIZE"] + 1
    with pytest.raises(RendererError, match=f"at most {side - 1} pixels a side here, got {side}x32"):
        RasterRenderer(side, 32)


def test_scale_changes_numbers_not_pictures(renderer):
    small = renderer.render(sample_scene(CONFIG, 2, 0))
    own = renderer.render(sample_scene(SynthConfig(width=480, height=270, hand_length=None), 2, 0))
    assert (small.part_labels != own.part_labels).mean() < 1e-3
    both = (small.depth_m > 0) & (own.depth_m > 0) & (small.part_labels == own.part_labels)
    ratio = own.depth_m[both] / small.depth_m[both]
    assert np.median(ratio) == pytest.approx(load_asset().body().hand_length_m / 0.10, rel=1e-3)


def test_normals_of_a_cube_point_outwards():
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = np.array([t for a, b, c, d in faces for t in ((a, b, c), (a, c, d))])
    normals = vertex_normals(corners, triangles)
    assert ((normals * corners).sum(1) > 0.5).all()
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1)


def test_the_arms_normals_point_outwards():
    body = load_asset().body()
    normals = vertex_normals(body.vertices, body.asset.faces)
    inner = body.vertices - 0.002 * normals

    # Moving inwards shrinks the arm: the enclosed volume (by the divergence theorem) falls.
    def volume(v):
        a, b, c = (v[body.asset.faces[:, k]] for k in range(3))
        return (np.cross(a, b) * c).sum() / 6

    assert 0 < volume(inner) < volume(body.vertices)


def test_nails_are_on_the_back():
    attributes, asset = surface(), load_asset()
    on_nail = (attributes.nail[:, 0] > 0.5) & (attributes.nail[:, 2] > 0.6) & (np.abs(attributes.nail[:, 1]) < 0.5)
    assert on_nail.sum() >= 20
    assert attributes.palmar[on_nail].max() < 0.5
    assert set(asset.side[on_nail]) == {0, 1}


def test_compose_by_hand():
    rgb = np.full((1, 3, 3), 200, np.uint8)
    background = np.full((1, 3, 3), 100, np.uint8)
    out = compose(rgb, np.array([[0, 255, 51]], np.uint8), background)
    # 51 / 255 = 1/5: 200 / 5 + 100 * 4 / 5 = 120.
    assert out[0, :, 0].tolist() == [100, 200, 120]


def test_edges_are_smooth(rendered):
    _, frame = rendered[0]
    edge = cv2.morphologyEx((frame.part_labels > 0).astype(np.uint8), cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8))
    partial = (frame.alpha > 0) & (frame.alpha < 255)
    assert partial.sum() > 50
    assert (edge[partial] > 0).mean() > 0.95


def test_wild_hands_are_where_their_labels_say(renderer):
    """A turned and shifted camera, another focal length: visible hand vertices still meet their own depth."""
    bare = {"sleeves": 0.0, "gloves": 0.0, "objects": 0.0, "webcam": 0.0, "free_view": 0.0}
    config = dataclasses.replace(ARMS, width=480, height=270, **bare)
    asset = load_asset()
    follows_bones = asset.bone_weight.sum(1) > 0.999  # the torso's share follows the view instead
    seen_share = []
    for i in range(6):
        scene = sample_scene(config, 21, i)
        frame = renderer.render(scene)
        vertices = skin(scene.body, scene.transforms)[follows_bones & scene.present[asset.side]] * scene.scale
        px = project(np.where(vertices[:, 2:] > 0.05, vertices, [0, 0, 1]), scene.camera)
        ok = (vertices[:, 2] > 0.05) & ((px > 1) & (px < [479, 269])).all(1)
        col, row = px[ok].astype(int).T
        seen, z = frame.depth_m[row, col], vertices[ok, 2]
        hit = seen > 0
        assert hit.mean() > 0.9
        assert np.quantile(z[hit] - seen[hit], 0.05) > -0.002  # hardly any vertex in front of what is seen
        seen_share.append((np.abs(z[hit] - seen[hit]) < 0.002).mean())
    assert np.mean(seen_share) > 0.2  # half of them are on the far side, many behind other fingers


def test_the_other_hand_only_takes_light_away(renderer):
    """Shadows and occlusion: with the other hand away, no pixel of this hand gets darker."""
    config = dataclasses.replace(CONFIG, drop_rate=0.0, together=1.0)
    darker = 0
    for i in range(6):
        scene = sample_scene(config, 5, i)
        alone = dataclasses.replace(
            scene, present=np.array([True, False]), joints_m=np.where([[[True]], [[False]]], scene.joints_m, np.nan)
        )
        both, one = renderer.render(scene), renderer.render(alone)
        same = (both.part_labels == one.part_labels) & (one.part_labels > 0)
        same &= (both.alpha == 255) & (one.alpha == 255)
        change = both.rgb[same].astype(int) - one.rgb[same].astype(int)
        assert (change > 3).any(-1).mean() < 0.01  # a few on outlines, where pixels mix both hands
        darker += (change < -4).any(-1).sum()
    assert darker > 500


def test_things_cover_hands_but_have_no_label(renderer):
    config = dataclasses.replace(ARMS, width=480, height=270, objects=1.0)
    covered = 0
    for index in range(25):
        scene = sample_scene(config, 6, index)
        frame = renderer.render(scene)
        bare = renderer.render(dataclasses.replace(scene, things=()))
        taken = (bare.part_labels > 0) & (frame.part_labels == 0)
        covered += int(taken.sum())
        assert (frame.alpha[taken] == 255).mean() > 0.7 if taken.sum() > 50 else True
        assert (frame.depth_m[frame.part_labels == 0] == 0).all()
        assert (frame.alpha[frame.part_labels > 0] > 0).all()
    assert covered > 100


def test_a_held_object_only_takes_light_from_hands(renderer):
    """The same object with and without its shadow: no pixel gets brighter, the object itself stays, and hands that hold
    something are darker somewhere."""
    config = dataclasses.replace(ARMS, width=480, height=270, objects=1.0, sleeves=0.0, gloves=0.0, webcam=0.0)
    holding, darker = 0, 0
    for index in range(30):
        scene = sample_scene(config, 6, index)
        if all(thing.core is None for thing in scene.things):
            continue
        holding += 1
        floating = tuple(dataclasses.replace(thing, core=None) for thing in scene.things)
        lit, shaded = renderer.render(dataclasses.replace(scene, things=floating)), renderer.render(scene)
        np.testing.assert_array_equal(lit.part_labels, shaded.part_labels)
        np.testing.assert_array_equal(lit.alpha, shaded.alpha)
        change = shaded.rgb.astype(int) - lit.rgb
        assert change.max() <= 2  # rounding, and edges where pixels mix
        solid = (lit.part_labels == 0) & (lit.alpha == 255)
        inner = cv2.erode(solid.astype(np.uint8), np.ones((3, 3))) > 0
        assert not change[inner].any()
        darker += (change.min(-1) < -4).any()
    assert holding >= 5 and darker > 0.6 * holding


def test_the_core_of_a_held_object_is_about_the_object():
    config = dataclasses.replace(ARMS, objects=1.0)
    held = [thing for i in range(20) for thing in sample_scene(config, 6, i).things if thing.core is not None]
    assert len(held) >= 5
    for thing in held:
        (start, end), radius = thing.core
        np.testing.assert_allclose((start + end) / 2, thing.vertices.mean(0), atol=1e-3)
        axis = (end - start) / np.linalg.norm(end - start)
        along = (thing.vertices - (start + end) / 2) @ axis
        beside = np.linalg.norm(thing.vertices - (start + end) / 2 - along[:, None] * axis, axis=1)
        assert radius <= beside.max() * 1.01 and radius > 0.5 * beside.max()


def test_amodal_masks_show_what_is_hidden(renderer):
    config = dataclasses.replace(ARMS, width=480, height=270, together=1.0, drop_rate=0.0)
    hidden = 0
    for index in range(8):
        scene = sample_scene(config, 8, index)
        frame, masks = renderer.render(scene), renderer.amodal(scene)
        for side in (0, 1):
            worn = tuple(thing for thing in scene.things if 1 + 7 * side <= thing.label <= 7 + 7 * side)
            alone = renderer.render(dataclasses.replace(scene, present=np.arange(2) == side, things=worn))
            np.testing.assert_array_equal(masks[side], alone.part_labels > 0)
            seen = (frame.part_labels > 7 * side) & (frame.part_labels <= 7 + 7 * side)
            hidden += int((masks[side] & ~seen).sum())
    assert hidden > 100


@pytest.mark.parametrize(
    "worn", [{"watches": 1.0, "rings": 1.0, "sleeves": 0.0, "gloves": 0.0}, {"sleeves": 1.0, "webcam": 1.0}]
)
def test_what_is_seen_of_an_arm_is_in_its_amodal_mask(renderer, worn):
    """Named case: watches, rings and short sleeves had the label of the arm that wears them, and no place in its
    mask. To the pixel, whatever the picture's anti-aliasing: labels and masks are drawn alike."""
    config = dataclasses.replace(ARMS, width=480, height=270, free_view=0.0, **worn)
    outside_the_skin = 0
    for index in range(8):
        scene = sample_scene(config, 6, index)
        frame, masks = renderer.render(scene), renderer.amodal(scene)
        bare = renderer.render(dataclasses.replace(scene, things=()))
        for side in (0, 1):
            seen = (frame.part_labels > 7 * side) & (frame.part_labels <= 7 + 7 * side)
            assert not (seen & ~masks[side]).any()
            outside_the_skin += int((seen & (bare.part_labels == 0)).sum())
    assert outside_the_skin > 20


def test_sleeves_cover_the_arm_and_nothing_else(renderer):
    scene = sample_scene(CONFIG, 11, 0)
    thick = dataclasses.replace(BARE, sleeve_from=0.05, sleeve_albedo=np.array([0.0, 0.0, 0.8]), thickness_m=0.004)
    bare, dressed = renderer.render(scene), renderer.render(dataclasses.replace(scene, clothes=thick))
    hand = (bare.part_labels > 0) & ~np.isin(bare.part_labels, [1, 8])
    kept = hand & (dressed.part_labels == bare.part_labels)
    assert kept.sum() > 0.98 * hand.sum()
    interior = cv2.erode(kept.astype(np.uint8), np.ones((3, 3))) > 0
    np.testing.assert_array_equal(dressed.rgb[interior], bare.rgb[interior])
    arm = np.isin(dressed.part_labels, [1, 8])
    blue = dressed.rgb[..., 2].astype(int) > dressed.rgb[..., 0].astype(int) + 40
    assert (blue & arm).sum() > 0.4 * arm.sum()
    assert not (blue & ~arm).any()
    assert arm.sum() > np.isin(bare.part_labels, [1, 8]).sum()  # fabric has a thickness
