import numpy as np
import pytest

from twohands.synth.scene.body import BONE_NAMES, forward_kinematics, load_asset
from twohands.synth.scene.looks import FULL, KINDS, PersonSpec
from twohands.synth.scene.people import (
    BODY_BONES,
    BODY_PARENTS,
    N_BONES,
    after,
    body_bone,
    body_transforms,
    load_people,
    posed,
    shoulder_moves,
)
from twohands.synth.scene.pose import rotation_about
from twohands.synth.scene.wardrobe import LONG_SLEEVES, sample_look, sample_someone


def turned(name: str, axis: list[float], degrees: float) -> np.ndarray:
    turns = np.tile(np.eye(3), (len(BODY_BONES), 1, 1))
    turns[body_bone(name)] = rotation_about(np.array(axis), np.radians(degrees))
    return turns


def test_bones_come_after_their_parents():
    assert BODY_PARENTS[0] == -1
    assert all(0 <= parent < index for index, parent in enumerate(BODY_PARENTS) if index)
    assert N_BONES == len(BODY_BONES) + len(BONE_NAMES) == 76


def test_arms_of_the_average_person_are_those_of_the_arms_asset():
    arms, whole = load_asset().body(), load_people().arms_body(np.zeros(0))
    np.testing.assert_allclose(whole.vertices, arms.vertices, atol=1e-4)
    np.testing.assert_allclose(whole.heads, arms.heads, atol=1e-4)
    np.testing.assert_allclose(whole.joints, arms.joints, atol=1e-4)
    weights = load_people().weights[load_people().arm_rows, len(BODY_BONES) :]
    dense = np.zeros_like(weights)
    np.put_along_axis(dense, load_asset().bone_index, load_asset().bone_weight, axis=1)
    assert np.abs(weights - dense).max() < 0.02


def test_everybody_is_measured_from_between_the_eyes():
    asset = load_people()
    rng = np.random.default_rng(0)
    for _ in range(4):
        shape = sample_someone(rng).shape
        heads = asset.heads(shape)
        np.testing.assert_allclose(heads[[body_bone("eye.L"), body_bone("eye.R")]].mean(0), 0, atol=1e-9)
        ground = asset.points(shape)[: asset.n_points, 1].max()
        assert 1.2 < ground < 2.2  # eyes above the soles
        assert 0.15 < asset.arms_body(shape).hand_length_m * 2 < 0.25


def test_skinning_weights_are_shares():
    weights = load_people().weights
    assert (weights >= 0).all()
    np.testing.assert_allclose(weights.sum(1), 1, atol=1e-5)


def test_what_is_worn_lies_at_weighted_places_of_the_body():
    asset = load_people()
    points = asset.average[: asset.n_points]
    worn = asset.worn["outfit/male_casualsuit03"]
    place = worn.fitted(points)
    for vertex in (0, 100, 1000):
        spans = [abs(points[a, axis] - points[b, axis]) for axis, (a, b) in enumerate(worn.scale)]
        expected = worn.weight[vertex] @ points[worn.bind[vertex]] + worn.offset[vertex] * spans / worn.reference
        np.testing.assert_allclose(place[vertex], expected, atol=1e-12)
    by = np.array([0.1, -0.2, 0.3])
    # Moving the body moves what it wears, and nothing else does.
    np.testing.assert_allclose(worn.fitted(points + by), place + by, atol=1e-12)
    np.testing.assert_allclose(worn.follows(asset.weights).sum(1), 1, atol=1e-5)


def test_all_that_is_worn_lies_about_the_body():
    asset = load_people()
    points = asset.average[: asset.n_points]
    low, high = points.min(0) - 0.15, points.max(0) + 0.15
    for name, worn in asset.worn.items():
        place = worn.fitted(points)
        assert ((place > low) & (place < high)).all(), name
        assert worn.faces.max() < len(place), name
    kinds = ("outfit", "hair", "shoes", "brow", "lash", "hat")
    assert [len(asset.names(kind)) for kind in kinds] == [12, 10, 6, 12, 2, 2]


def test_the_upper_chest_stays_where_it_is():
    asset = load_people()
    heads = asset.heads(np.zeros(0))
    rest = body_transforms(heads, np.tile(np.eye(3), (len(BODY_BONES), 1, 1)))
    np.testing.assert_allclose(rest, np.tile(np.eye(3, 4), (len(BODY_BONES), 1, 1)), atol=1e-12)
    bent = body_transforms(heads, turned("spine03", [1, 0, 0], 30))
    np.testing.assert_allclose(bent[body_bone("head")], np.eye(3, 4), atol=1e-12)
    np.testing.assert_allclose(bent[body_bone("spine01")], np.eye(3, 4), atol=1e-12)
    foot = body_bone("foot.L")
    assert np.linalg.norm(after(bent[foot], np.eye(3, 4))[:, 3]) > 0.1


def test_a_lifted_thigh_goes_forwards_and_carries_the_foot():
    heads = load_people().heads(np.zeros(0))
    moves = body_transforms(heads, turned("upperleg01.R", [1, 0, 0], 90))
    knee, hip = heads[body_bone("lowerleg01.R")], heads[body_bone("upperleg01.R")]
    place = moves[body_bone("lowerleg01.R")] @ np.append(knee, 1)
    assert place[2] > hip[2] + 0.3
    assert abs(place[1] - hip[1]) < 0.12
    np.testing.assert_allclose(moves[body_bone("lowerleg01.L")], np.eye(3, 4), atol=1e-12)


def test_shrugging_carries_the_arm():
    asset = load_people()
    body = asset.arms_body(np.zeros(0))
    moves = body_transforms(asset.heads(np.zeros(0)), turned("clavicle.L", [0, 0, 1], 10))
    left, right = shoulder_moves(moves)
    np.testing.assert_allclose(right, np.eye(3, 4), atol=1e-12)
    arms = forward_kinematics(body, np.tile(np.eye(3), (len(BONE_NAMES), 1, 1)))
    carried = after(left, arms[:24])
    np.testing.assert_allclose(carried, np.broadcast_to(left, carried.shape), atol=1e-12)
    weights, points = asset.weights, asset.average[: asset.n_points]
    whole = posed(points, weights, np.concatenate([moves, carried, arms[24:]]))
    assert np.isfinite(whole).all()


def test_looks_are_a_pure_function_of_the_generator():
    first, second = (sample_look(np.random.default_rng(5), sample_someone(np.random.default_rng(4))) for _ in range(2))
    for name in first.__slots__:
        np.testing.assert_equal(
            getattr(first, name) if name != "clothes" else 0, getattr(second, name) if name != "clothes" else 0
        )
    for a, b in zip(first.clothes, second.clothes, strict=True):
        np.testing.assert_equal([getattr(a, n) for n in a.__slots__], [getattr(b, n) for n in b.__slots__])


def test_wardrobes_are_varied():
    rng = np.random.default_rng(1)
    looks = [sample_look(rng, sample_someone(rng)) for _ in range(400)]
    assert {look.outfit for look in looks} == set(load_people().names("outfit"))
    assert {look.hair for look in looks} >= set(load_people().names("hair")) | {None}
    tones = np.array([look.skin_albedo[1] for look in looks])
    assert (tones < 0.05).mean() > 0.05 and (tones > 0.3).mean() > 0.15
    assert {look.clothes[0].kind for look in looks} == set(range(len(KINDS)))
    long = np.mean([look.outfit in LONG_SLEEVES and look.sleeve_from == FULL for look in looks])
    assert 0.2 < long < 0.7


def test_a_person_scales_with_the_scene():
    rng = np.random.default_rng(2)
    someone = sample_someone(rng)
    look = sample_look(rng, someone)
    turns = np.tile(np.eye(3), (len(BODY_BONES), 1, 1))
    arms = np.tile(np.eye(3, 4), (len(BONE_NAMES), 1, 1))
    one, two = (
        PersonSpec(look, someone.shape, arms, turns, np.eye(3, 4), scale, np.ones(2, bool)).transforms
        for scale in (1.0, 2.0)
    )
    np.testing.assert_allclose(two, 2 * one)
    assert one.shape == (N_BONES, 3, 4)


@pytest.mark.parametrize("name", ["short03", "ponytail01", "long01"])
def test_strands_run_from_root_to_tip(name: str):
    strands = load_people().strands(name)
    assert strands.shape == (len(load_people().worn[f"hair/{name}"].bind), 4)
    assert (strands[:, 1] >= 0).all() and (strands[:, 1] <= 1).all()
    assert set(np.unique(strands[:, 2:])) <= {0.0, 1.0}
