"""Scenes: reproducible, inside the box and the picture, hands apart."""

import dataclasses
import inspect

import numpy as np
import pytest

from twohands.errors import InputError
from twohands.geometry.camera import project
from twohands.skeleton import LEFT, RIGHT, ROOT, WRIST
from twohands.synth.scene.appearance import sample_lighting, sample_skin
from twohands.synth.scene.collision import segment_distance
from twohands.synth.scene.config import WILD, SynthConfig
from twohands.synth.scene.sampling import (
    held_up,
    inside_image,
    looking_from,
    sample_camera,
    sees_the_person,
    worn_on_the_head,
)
from twohands.synth.scene.spec import BARE, moved
from twohands.synth.scene.things import NO_LABEL
from twohands.synth.sets.instances import sample_scene

ARMS = dataclasses.replace(WILD, people=0.0)
"""Preset wild without whole people: scenes of two arms."""

CONFIG = SynthConfig(width=480, height=270)


@pytest.fixture(scope="module")
def scenes():
    return [sample_scene(CONFIG, 7, i) for i in range(60)]


def test_same_seed_and_index_same_scene_whatever_came_before():
    first = sample_scene(CONFIG, 3, 5)
    sample_scene(CONFIG, 3, 6)
    again = sample_scene(CONFIG, 3, 5)
    np.testing.assert_array_equal(first.joints_m, again.joints_m)
    np.testing.assert_array_equal(first.transforms, again.transforms)
    np.testing.assert_array_equal(first.skin.albedo, again.skin.albedo)
    other = sample_scene(CONFIG, 4, 5)
    assert not np.array_equal(first.joints_m, other.joints_m)


def test_hand_length_is_ten_centimetres(scenes):
    for scene in scenes:
        for side in np.flatnonzero(scene.present):
            hand = scene.joints_m[side, 1:]
            assert np.linalg.norm(hand[WRIST] - hand[ROOT]) == pytest.approx(0.10, abs=2e-4)


def test_hands_are_in_their_box_and_in_the_picture(scenes):
    low, high = np.array(CONFIG.box_min), np.array(CONFIG.box_max)
    for scene in scenes:
        for side in np.flatnonzero(scene.present):
            root = scene.joints_m[side, 1 + ROOT] / scene.scale
            if side == RIGHT:
                root = root * [-1, 1, 1]
            assert (root > low - 1e-9).all() and (root < high + 1e-9).all()
            px = project(scene.joints_m[side, 1:], scene.camera)
            assert (px > 0).all() and (px < [480, 270]).all()


def test_absent_hands_are_nan_and_rare():
    present = np.array([sample_scene(CONFIG, 1, i).present for i in range(300)])
    assert present.any(1).all()
    # Each hand is dropped with p = 0.1, both never: 0.1 - 0.01 / 2 of the hands are missing.
    assert 0.06 < 1 - present.mean() < 0.14
    scene = next(s for s in (sample_scene(CONFIG, 1, i) for i in range(300)) if not s.present.all())
    assert np.isnan(scene.joints_m[~scene.present]).all()
    assert np.isfinite(scene.joints_m[scene.present]).all()


def test_poses_vary_and_left_hands_are_mostly_on_the_left(scenes):
    both = [s for s in scenes if s.present.all()]
    roots = np.array([s.joints_m[:, 1 + ROOT] for s in both])
    assert (roots[:, LEFT, 0] < roots[:, RIGHT, 0]).mean() > 0.7
    assert roots.std(0).min() > 0.03


def test_unreachable_box_is_one_clear_error():
    config = SynthConfig(box_min=(-0.2, -0.1, 1.5), box_max=(0.2, 0.1, 1.6))
    with pytest.raises(InputError, match="hand box"):
        sample_scene(config, 0, 0)


@pytest.mark.parametrize(
    "changes",
    [
        {"width": 1},
        {"drop_rate": 1.0},
        {"body_variation": -1.0},
        {"hand_length": 0.0},
        {"box_min": (0.3, 0, 0.2)},
        {"box_min": (-0.3, -0.1, -0.2)},
        {"skin_tones": (0.9, 0.1)},
        {"lights": 0},
        {"image_margin": 0.5},
    ],
)
def test_nonsense_is_refused(changes):
    with pytest.raises(InputError):
        SynthConfig(**changes)


def test_skin_covers_light_and_dark():
    rng = np.random.default_rng(0)
    light = [sample_skin(SynthConfig(skin_tones=(0.0, 0.1)), rng).albedo.mean() for _ in range(30)]
    dark = [sample_skin(SynthConfig(skin_tones=(0.9, 1.0)), rng).albedo.mean() for _ in range(30)]
    assert min(light) > 5 * max(dark)
    for tone in (0.0, 0.5, 1.0):
        skin = sample_skin(SynthConfig(skin_tones=(tone, tone)), rng)
        assert skin.albedo[0] > skin.albedo[2] and np.all(skin.albedo > 0) and np.all(skin.albedo < 1)


def test_lighting_has_the_asked_number_of_lights():
    assert sample_lighting(SynthConfig(lights=3), np.random.default_rng(0)).positions.shape == (3, 3)


def test_segment_distance_by_hand():
    a0, a1 = np.array([[0.0, 0, 0]]), np.array([[1.0, 0, 0]])
    cases = [
        (([0.5, 1, 0], [0.5, 2, 0]), 1.0),  # perpendicular, nearest at an end
        (([0.5, -1, 3], [0.5, 1, 3]), 3.0),  # crossing above
        (([3, 4, 0], [6, 4, 0]), np.hypot(2, 4)),  # collinear direction, end to end
        (([0.2, 0, 0], [0.4, 0, 0]), 0.0),  # overlapping
        (([2, 0, 0], [2, 0, 0]), 1.0),  # a point
    ]
    for (b0, b1), expected in cases:
        assert segment_distance(a0, a1, np.array([b0], float), np.array([b1], float))[0] == pytest.approx(expected)


WILD_CONFIG = dataclasses.replace(ARMS, width=480, height=270, webcam=0.0, free_view=0.0)


@pytest.fixture(scope="module")
def wild_scenes():
    return [sample_scene(WILD_CONFIG, 3, i) for i in range(60)]


def test_wild_cameras_stay_in_their_ranges(wild_scenes):
    fov = np.array([np.degrees(2 * np.arctan(240 / s.camera.fx)) for s in wild_scenes])
    assert fov.min() >= 50 and fov.max() <= 110 and fov.std() > 10
    for scene in wild_scenes:
        assert abs(scene.camera.cx - 240) <= 0.06 * 480 and abs(scene.camera.cy - 135) <= 0.06 * 270
        rotation = scene.view[:, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(rotation) == pytest.approx(1)
        place = -rotation.T @ scene.view[:, 3]
        assert np.abs(place).max() <= 0.06
        down = np.degrees(np.arcsin(rotation[2, 1]))  # how far the optical axis points below the horizon
        assert -15 - 1e-6 <= down <= 40 + 1e-6


def test_cameras_on_the_head_are_near_the_eyes_and_webcams_are_not():
    widest = dataclasses.replace(ARMS, camera_shift=0.15, pitch=(-60.0, 60.0), webcam=0.0, free_view=0.0)
    webcam = dataclasses.replace(ARMS, webcam=1.0, free_view=0.0)
    for seed in range(200):
        assert worn_on_the_head(sample_camera(widest, np.random.default_rng(seed))[1])
        assert not worn_on_the_head(sample_camera(webcam, np.random.default_rng(seed))[1])


def test_looking_from_points_the_axis_at_the_target_with_the_horizon_level():
    rotation = looking_from(np.array([0.2, -0.1, 0.9]), np.array([0.0, 0.1, 0.3]))
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1)
    x, y, z = rotation @ (np.array([0.0, 0.1, 0.3]) - np.array([0.2, -0.1, 0.9]))
    assert (x, y) == (pytest.approx(0), pytest.approx(0)) and z > 0
    assert rotation[0, 1] == pytest.approx(0) and rotation[1, 1] > 0
    np.testing.assert_allclose(looking_from(np.zeros(3), np.array([0.0, 0.0, 1.0])), np.eye(3), atol=1e-12)


def test_a_webcam_sees_the_person_from_in_front_with_the_left_hand_mostly_to_the_right():
    config = dataclasses.replace(ARMS, width=480, height=270, webcam=1.0, free_view=0.0, together=0.0, drop_rate=0.0)
    leftness = []
    for index in range(20):
        scene = sample_scene(config, 4, index)
        place = -scene.view[:, :3].T @ scene.view[:, 3]
        assert 0.5 < place[2] < 1.0 and sees_the_person(scene.view)
        assert sum(thing.label == NO_LABEL for thing in scene.things) >= 4
        assert (scene.joints_m[:, 1:, 2] > 0.02).all()
        leftness.append(scene.joints_m[0, 1 + ROOT, 0] > scene.joints_m[1, 1 + ROOT, 0])
    assert np.mean(leftness) > 0.6


def test_what_is_held_up_by_hand():
    """A flat hand half a metre away, upright, facing the camera; the same turned and pointing elsewhere."""
    hand = np.zeros((21, 3))
    hand[[5, ROOT, 17]] = [[-0.02, -0.09, 0], [0.0, -0.10, 0], [0.05, -0.08, 0]]

    def turned(axis: int, degrees: float) -> bool:
        angle = np.radians(degrees)
        a, b = [i for i in range(3) if i != axis]
        rotation = np.eye(3)
        rotation[[a, b], [a, b]] = np.cos(angle)
        rotation[a, b], rotation[b, a] = -np.sin(angle), np.sin(angle)
        return bool(held_up(hand @ rotation.T + [0, 0, 5.0]))

    assert turned(0, 0) and turned(1, 180)  # palm and back
    assert turned(1, 35) and not turned(1, 55) and not turned(1, 90)  # seen on edge
    assert turned(2, 50) and not turned(2, 70) and not turned(2, 180)  # pointing aside, down
    assert not turned(0, 90)  # pointing at the camera


def test_shown_hands_are_held_up():
    config = dataclasses.replace(ARMS, width=480, height=270, webcam=1.0, free_view=0.0, together=0.0)
    shares = []
    for shown in (0.0, 1.0):
        scenes = [sample_scene(dataclasses.replace(config, shown=shown), 8, i) for i in range(12)]
        hands = np.stack([scene.joints_m[side, 1:] for scene in scenes for side in np.flatnonzero(scene.present)])
        shares.append(held_up(hands).mean())
    assert shares[0] < 0.5 and shares[1] == 1


def test_a_view_that_shows_no_hand_is_drawn_again():
    """Named case: this camera, pitched up, sees nothing of the box, and the whole set stopped there."""
    config = dataclasses.replace(ARMS, width=480, height=270, pitch=(-60.0, 40.0), fov=(50.0, 60.0))
    for index in range(12):
        assert sample_scene(config, 2, index).present.any()


def test_looking_down_moves_the_hands_up():
    straight = dataclasses.replace(CONFIG, min_inside=0)
    down = dataclasses.replace(straight, pitch=(20.0, 20.0))
    for i in range(5):
        a, b = sample_scene(straight, 2, i), sample_scene(down, 2, i)
        side = int(np.flatnonzero(a.present)[0])
        u, v = (project(s.joints_m[side, 1 + ROOT], s.camera) for s in (a, b))
        assert v[1] < u[1]
        distances = [np.linalg.norm(s.joints_m[side, 1 + ROOT]) for s in (a, b)]
        assert distances[0] == pytest.approx(distances[1])


def test_a_positive_roll_turns_the_picture_as_its_help_says():
    """Named case: the help said the other way round. Clockwise, what is to the right goes down."""
    config = dataclasses.replace(CONFIG, roll=(20.0, 20.0))
    _, view = sample_camera(config, np.random.default_rng(0))
    right = moved(view, np.array([0.1, 0.0, 0.4]))
    np.testing.assert_allclose(right[:2], 0.1 * np.array([np.cos(np.radians(20)), np.sin(np.radians(20))]), atol=1e-12)
    assert '"""Range of the camera\'s roll; positive turns the picture clockwise."""' in inspect.getsource(SynthConfig)


def test_wild_hands_are_in_their_box_and_mostly_in_the_picture(wild_scenes):
    low, high = np.array(ARMS.box_min), np.array(ARMS.box_max)
    for scene in wild_scenes:
        assert scene.scale == 1.0
        rotation = scene.view[:, :3]
        for side in np.flatnonzero(scene.present):
            root = rotation.T @ (scene.joints_m[side, 1 + ROOT] - scene.view[:, 3])
            root = root * [-1, 1, 1] if side == RIGHT else root
            assert (root > low - 1e-9).all() and (root < high + 1e-9).all()
            assert inside_image(scene.joints_m[side, 1:], scene.camera, 0.0).sum() >= 14


def test_joints_behind_the_camera_are_outside():
    camera = sample_scene(CONFIG, 0, 0).camera
    inside = inside_image(np.array([[0.0, 0.0, 0.3], [0.0, 0.0, -0.3], [0.5, 0.0, 0.3]]), camera, 0.0)
    assert inside.tolist() == [True, False, False]


def test_hands_that_are_together_are_near_each_other():
    def median_distance(together: float) -> float:
        config = dataclasses.replace(CONFIG, drop_rate=0.0, together=together)
        roots = np.array([sample_scene(config, 9, i).joints_m[:, 1 + ROOT] for i in range(40)])
        return float(np.median(np.linalg.norm(roots[:, 0] - roots[:, 1], axis=1)))

    assert median_distance(1.0) < 0.75 * median_distance(0.0)


def test_clothes_are_as_frequent_as_asked(wild_scenes):
    sleeves = np.mean([np.isfinite(s.clothes.sleeve_from) for s in wild_scenes])
    assert 0.3 < sleeves < 0.7
    assert all(s.clothes is BARE for s in (sample_scene(CONFIG, 7, i) for i in range(5)))
