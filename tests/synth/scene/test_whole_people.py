"""Scenes of whole people: laws of poses, framing and purity."""

import dataclasses

import numpy as np
import pytest

from twohands.errors import InputError
from twohands.geometry.camera import project
from twohands.synth.scene import gestures, views, whole_people
from twohands.synth.scene.body import bone, posed_joints
from twohands.synth.scene.config import PEOPLE, PEOPLE_VIEWS, WILD, SynthConfig
from twohands.synth.scene.figures import figure, sample_posture
from twohands.synth.scene.posed_arms import pose_arms
from twohands.synth.scene.sampling import inside_image
from twohands.synth.scene.spec import arms_of, moved
from twohands.synth.scene.views import quarter_turns, sample_viewpoint
from twohands.synth.scene.wardrobe import sample_someone
from twohands.synth.sets.instances import sample_scene
from twohands.synth.sets.seeds import stream_seed

CONFIG = dataclasses.replace(WILD, width=480, height=270, people=1.0)


@pytest.fixture(scope="module")
def scenes():
    return [sample_scene(CONFIG, 3, i) for i in range(40)]


def test_same_seed_and_index_give_the_same_people():
    one, other = sample_scene(CONFIG, 3, 7), sample_scene(CONFIG, 3, 7)
    np.testing.assert_array_equal(one.joints_m, other.joints_m)
    assert len(one.people) == len(other.people)
    for a, b in zip(one.people, other.people, strict=True):
        np.testing.assert_array_equal(a.transforms, b.transforms)
    for a, b in zip(one.things, other.things, strict=True):
        np.testing.assert_array_equal(a.vertices, b.vertices)


def test_the_scene_is_about_the_first_person(scenes):
    for scene in scenes:
        first = scene.people[0]
        assert 1 <= len(scene.people) <= 3
        np.testing.assert_array_equal(scene.transforms, first.arms)
        np.testing.assert_array_equal(scene.view, first.view)
        assert first.present.all()


def test_joints_are_those_of_the_posed_arms(scenes):
    """The wrist is where its bone's transform carries the resting wrist."""
    for scene in scenes:
        for side in np.flatnonzero(scene.present):
            wrist = scene.transforms[bone("wrist", int(side))]
            np.testing.assert_allclose(moved(wrist, scene.body.joints[side, 1]), scene.joints_m[side, 1], atol=1e-9)


def test_hands_count_as_present_by_what_is_in_the_picture(scenes):
    for scene in scenes:
        for side in np.flatnonzero(scene.present):
            assert inside_image(scene.joints_m[side, 1:], scene.camera, 0.0).sum() >= whole_people.MIN_INSIDE
    present = np.array([scene.present for scene in scenes])
    assert present.any(1).mean() > 0.7 and (~present.all(1)).mean() > 0.05


def test_other_people_are_smaller_in_the_picture():
    """Shoulders of the others are farther away than those of the first."""
    crowds = [sample_scene(CONFIG, 5, i) for i in range(60)]
    crowds = [scene for scene in crowds if len(scene.people) > 1]
    assert crowds
    for scene in crowds:
        first, *others = (person.view[2, 3] for person in scene.people)
        assert all(depth > first for depth in others)


def test_nobody_shows_hands_that_have_no_labels(monkeypatch):
    """But for pockets: networks learnt from such pictures that hands of people farther off are none."""
    monkeypatch.setattr(whole_people, "OTHERS", (0.0, 0.5, 0.5))
    monkeypatch.setattr(whole_people, "DOING", (0.5, 0.5, 0.0))
    scenes = [sample_scene(dataclasses.replace(CONFIG, people_views=("webcam",)), 8, i) for i in range(20)]
    others = [(scene, person) for scene in scenes for person in scene.people[1:]]
    assert len(others) > 3
    for scene, person in others:
        joints = posed_joints(arms_of(tuple(person.shape.tolist())), person.arms) * person.scale
        assert not inside_image(joints[:, 1:], scene.camera, 0.0).any()


def test_no_hand_is_inside_its_own_body():
    """Within what flesh and cloth yield, for every gesture that is not hidden."""
    rng = np.random.default_rng(1)
    person = figure(sample_someone(rng))
    done = 0
    for _ in range(60):
        viewpoint = sample_viewpoint(CONFIG, rng)
        posture = sample_posture(viewpoint, rng)
        view = viewpoint.view
        arms = pose_arms(
            person, posture, (gestures.talking, gestures.signing), (False, False), view, viewpoint, CONFIG, rng
        )
        if arms is None:
            continue
        done += 1
        depth = person.outline.depth(arms.joints[:, 1:])
        assert depth.max() < 0
        # The hands leave each other alone as well: no two joints of them nearer than a finger's radius.
        gap = np.linalg.norm(arms.joints[0, 1:, None] - arms.joints[1, 1:], axis=-1)
        assert gap.min() > 0.008
    assert done > 20


@pytest.mark.parametrize("seed", range(3))
def test_cameras_are_as_far_and_as_wide_as_said(seed):
    rng = np.random.default_rng(seed)
    seen = set()
    for _ in range(150):
        view = sample_viewpoint(CONFIG, rng)
        seen.add(view.style)
        fov = np.degrees(2 * np.arctan(view.camera.width / 2 / view.camera.fx))
        assert views.FOV[0] - 1e-6 <= fov <= views.FOV[1] + 1e-6
        if view.style == "webcam":
            assert views.WEBCAM_M[0] <= np.linalg.norm(view.place - views.FACE) <= views.WEBCAM_M[1]
        if view.style == "room":
            distance = np.linalg.norm(view.place - views.CHEST)
            assert views.ROOM_M[0] <= distance <= views.ROOM_M[1]
            hand = view.camera.fx * views.HAND_M / distance / view.camera.width
            assert hand >= views.SMALLEST_HAND or distance <= 1.2 * views.ROOM_M[0]
        # What it looks at is in the picture.
        anchor = {"webcam": views.FACE, "selfie": views.FACE, "room": views.CHEST}.get(view.style)
        if anchor is not None:
            u, v = np.asarray(project(moved(view.view, anchor), view.camera)) / [480, 270]
            assert 0 <= u <= 1 and 0 <= v <= 1
    assert seen == set(PEOPLE_VIEWS)


def test_quarter_turns_count_counter_clockwise():
    """A camera turned so that gravity points right in its picture sees the room turned once."""
    upright = np.eye(3, 4)
    right = np.array([[0.0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0]])
    assert [quarter_turns(view) for view in (upright, right)] == [0, 1]
    assert quarter_turns(np.diag([-1.0, -1, 1]) @ np.eye(3, 4)) == 2


def test_people_share_a_set_with_arms():
    """Scenes of arms are those of the set without people, whose cameras are all on the head."""
    some = dataclasses.replace(CONFIG, people=0.5)
    none = dataclasses.replace(CONFIG, people=0.0, webcam=0.0, free_view=0.0)
    kinds = [bool(sample_scene(some, 2, i).people) for i in range(30)]
    assert 5 < sum(kinds) < 25
    arms = kinds.index(False)
    np.testing.assert_array_equal(sample_scene(some, 2, arms).joints_m, sample_scene(none, 2, arms).joints_m)


@pytest.mark.parametrize("index", [18, 103])
def test_bodies_that_cannot_be_posed_give_way_to_others(index):
    """Named case: a cache ended with "no pose of a whole person fits the picture", for somebody whose own fingers
    touch in every pose."""
    config = dataclasses.replace(WILD, width=640, height=360, people=1.0)
    assert sample_scene(config, stream_seed(203, "frames"), index).people


def test_the_views_are_those_asked_for():
    rng = np.random.default_rng(0)
    assert {sample_viewpoint(PEOPLE, rng).style for _ in range(60)} == {"webcam", "room"}
    for wrong in ((), ("moon",)):
        with pytest.raises(InputError, match="people_views must be some of webcam, room, selfie, shoulder, above"):
            SynthConfig(people_views=wrong)
