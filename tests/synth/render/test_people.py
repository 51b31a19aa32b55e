import dataclasses

import numpy as np
import pytest

from twohands.synth.render.people_maps import strand_map, wrinkle_map
from twohands.synth.render.person_mesh import PARTS, person_mesh
from twohands.synth.scene.appearance import sample_lighting, sample_skin
from twohands.synth.scene.body import BONE_NAMES, forward_kinematics, posed_joints
from twohands.synth.scene.config import SynthConfig
from twohands.synth.scene.looks import PersonLook, PersonSpec
from twohands.synth.scene.people import BODY_BONES, load_people
from twohands.synth.scene.spec import SceneSpec, arms_of, moved, viewed
from twohands.synth.scene.wardrobe import sample_look, sample_someone
from twohands.types import PinholeCamera

CAMERA = PinholeCamera.from_fov(70, 160, 120)
VIEW = np.array([[-1.0, 0, 0, 0], [0, 1, 0, -0.3], [0, 0, -1, 1.3]])
"""A camera 1.3 m before the person, at the height of the chest."""


def someone_dressed(seed: int, **changes: object) -> tuple[np.ndarray, PersonLook]:
    rng = np.random.default_rng(seed)
    someone = sample_someone(rng)
    return someone.shape, dataclasses.replace(sample_look(rng, someone), **changes)


def person(shape: np.ndarray, look: PersonLook, view: np.ndarray = VIEW) -> PersonSpec:
    arms = forward_kinematics(arms_of(tuple(shape.tolist())), np.tile(np.eye(3), (len(BONE_NAMES), 1, 1)))
    turns = np.tile(np.eye(3), (len(BODY_BONES), 1, 1))
    return PersonSpec(look, shape, viewed(view, arms), turns, view, 1.0, np.ones(2, bool))


def scene_of(*people: PersonSpec) -> SceneSpec:
    rng, first = np.random.default_rng(0), people[0]
    lighting = sample_lighting(SynthConfig(), rng)
    lighting = dataclasses.replace(lighting, positions=moved(first.view, lighting.positions))
    joints = posed_joints(arms_of(tuple(first.shape.tolist())), first.arms)
    skin = sample_skin(SynthConfig(), rng)
    return SceneSpec(
        CAMERA, first.shape, first.arms, 1.0, joints, first.present, skin, lighting, 0, first.view, people=people
    )


@pytest.fixture(scope="module")
def renderer():
    pytest.importorskip("moderngl")
    from twohands.errors import RendererError
    from twohands.synth.render.raster import RasterRenderer

    try:
        return RasterRenderer(CAMERA.width, CAMERA.height)
    except RendererError as error:
        pytest.skip(str(error))


def test_a_mesh_has_all_parts_once():
    shape, look = someone_dressed(0, outfit="male_casualsuit02", hair="short01", hat=None)
    mesh = person_mesh(look, shape)
    assert (np.diff(mesh.first) > 0).all() and len(mesh.first) == len(PARTS) + 1
    assert mesh.first[-1] == len(mesh.faces) and mesh.faces.max() < len(mesh.position)
    np.testing.assert_allclose(np.linalg.norm(mesh.normal, axis=1), 1, atol=1e-3)
    np.testing.assert_allclose(mesh.weight.sum(1), 1, atol=1e-4)


def test_cloth_from_the_shoulder_on_counts_as_that_arm():
    shape, look = someone_dressed(0, outfit="male_casualsuit02", sleeve_from=0.0)
    mesh = person_mesh(look, shape)
    first, last = mesh.first[PARTS.index("cloth")], mesh.first[PARTS.index("cloth") + 1]
    cloth = np.unique(mesh.faces[first:last])
    label, x = mesh.still[cloth, -1], mesh.position[cloth, 0]
    assert set(np.unique(label)) == {1.0, 8.0, 255.0}
    assert (x[label == 1] < -0.1).all() and (x[label == 8] > 0.1).all()  # the left side is at negative x
    arms = mesh.weight[cloth, len(BODY_BONES) :].reshape(len(cloth), 2, -1).sum(2)
    assert ((arms.max(1) > 0.5) == (label < 255)).all()


def test_a_long_sleeve_hides_the_arm_and_a_cut_one_does_not():
    shape, look = someone_dressed(0, outfit="male_casualsuit02", sleeve_from=0.0)
    cut = dataclasses.replace(look, sleeve_from=0.9)
    bare, dressed = ((person_mesh(each, shape).still[:, -1] == 8).sum() for each in (cut, look))
    assert bare > dressed + 100


def test_maps_continue_themselves():
    for picture in (wrinkle_map().astype(float), strand_map().astype(float)):
        for axis in (0, 1):
            step = np.abs(np.diff(picture, axis=axis)).mean()
            seam = np.abs(np.take(picture, 0, axis) - np.take(picture, -1, axis)).mean()
            assert seam < 3 * step


def test_only_the_first_persons_arms_have_labels(renderer):
    shape, look = someone_dressed(1, outfit="male_casualsuit04")
    aside = VIEW + np.array([[0, 0, 0, 0.55], [0, 0, 0, 0], [0, 0, 0, 0.4]])
    one = renderer.render(scene_of(person(shape, look)))
    two = renderer.render(scene_of(person(shape, look), person(*someone_dressed(2), aside)))
    assert set(np.unique(one.part_labels)) >= {0, 1, 2, 8, 9}
    # The person faces the camera: the right hand is on the left of the picture.
    left, right = (np.flatnonzero(((one.part_labels >= a) & (one.part_labels < a + 7)).any(0)).mean() for a in (1, 8))
    assert right < 80 < left
    assert (two.alpha > 0).sum() > (one.alpha > 0).sum() + 200
    assert ((two.part_labels > 0) <= (one.part_labels > 0)).all()
    for frame in (one, two):
        assert ((frame.part_labels > 0) == (frame.depth_m > 0)).all()
        assert (frame.alpha[frame.part_labels > 0] > 0).all()
        assert 0.5 < np.median(frame.depth_m[frame.depth_m > 0]) < 1.6


def test_pictures_are_a_function_of_the_scene(renderer):
    first, other = (scene_of(person(*someone_dressed(seed))) for seed in (3, 4))
    before = renderer.render(first)
    renderer.render(other)
    after = renderer.render(first)
    np.testing.assert_array_equal(before.rgb, after.rgb)
    np.testing.assert_array_equal(before.part_labels, after.part_labels)


def test_arms_alone_cover_no_less_than_what_is_seen_of_them(renderer):
    scene = scene_of(person(*someone_dressed(5)))
    frame, amodal = renderer.render(scene), renderer.amodal(scene)
    for side in (0, 1):
        seen = (frame.part_labels >= 1 + 7 * side) & (frame.part_labels < 8 + 7 * side)
        assert (amodal[side] >= seen).all() and amodal[side].any()


def test_hands_lie_where_their_joints_are(renderer):
    scene = scene_of(person(*someone_dressed(6)))
    frame = renderer.render(scene)
    middle = scene.joints_m[:, 10]  # root of the middle finger
    for side in (0, 1):
        u, v = (middle[side, :2] / middle[side, 2] * [CAMERA.fx, CAMERA.fy] + [CAMERA.cx, CAMERA.cy]).astype(int)
        if 2 <= u < CAMERA.width - 2 and 2 <= v < CAMERA.height - 2:
            near = frame.part_labels[v - 2 : v + 3, u - 2 : u + 3]
            assert ((near >= 1 + 7 * side) & (near < 8 + 7 * side)).any()


def test_all_people_can_be_drawn(renderer):
    for outfit in load_people().names("outfit"):
        frame = renderer.render(scene_of(person(*someone_dressed(7, outfit=outfit))))
        inside = frame.alpha == 255
        assert inside.mean() > 0.05
        assert frame.rgb[inside].std() > 8
