"""The global projection is exact for exact input, everywhere, for all methods (paper section 4.4)."""

import math

import cv2
import numpy as np
import pytest
from tests.builders import CENTRED_CAMERA, OFF_CENTRE_CAMERA, random_hands, sees_little_longer

from twohands.errors import InputError
from twohands.geometry.camera import project, unproject
from twohands.geometry.canonical import camera_from_canonical, canonical_from_camera
from twohands.geometry.projection import (
    canonical_xy_from_rays,
    consistent_joints_px,
    project_global,
    pull_to_rays,
    range_weights,
)
from twohands.geometry.rotation import centring_angles, rotate, rotation_from_angles
from twohands.skeleton import LITTLE_MCP, ROOT, WRIST
from twohands.types import PinholeCamera

METHODS = ["keybone", "all-joints", "fitted"]
FISHY_CAMERA = PinholeCamera(420.0, 415.0, 300.5, 255.25, 640, 480, (0.05, -0.12, 0.001, -0.002, 0.03))


@pytest.fixture(scope="module", params=["centred", "off-centre"])
def scene(request):
    """5,000 hands over the whole image: camera, joints_m, joints_px, hand_length_m, canonical."""
    camera = {"centred": CENTRED_CAMERA, "off-centre": OFF_CENTRE_CAMERA}[request.param]
    joints_m, joints_px, length = random_hands(5000, camera, np.random.default_rng(11))
    return camera, joints_m, joints_px, length, canonical_from_camera(joints_m).joints


@pytest.fixture(scope="module")
def noisy():
    """2,000 hands with 1 px (of 480x270) and 0.03 canonical units of noise."""
    rng = np.random.default_rng(12)
    joints_m, joints_px, length = random_hands(2000, CENTRED_CAMERA, rng)
    canonical = canonical_from_camera(joints_m).joints
    noise = 0.03 * rng.standard_normal(canonical.shape)
    noise[:, ROOT] = 0
    return joints_m, joints_px + rng.standard_normal(joints_px.shape), length, canonical + noise


def paper_by_hand(canonical, joints_px, camera, length):
    """Paper Eq. 3 to 6 with plain floats, in the paper's axis order (row, column, depth), one hand at a time."""
    q = {
        j: ((joints_px[j][1] - camera.cy) / camera.fy, (joints_px[j][0] - camera.cx) / camera.fx, 1.0)
        for j in (0, 9, 17)
    }
    theta = math.atan2(q[9][0], q[9][2])
    phi = math.atan2(q[9][1], math.sqrt(q[9][0] ** 2 + q[9][2] ** 2))
    to_wrist, to_little = math.dist(joints_px[0], joints_px[9]), math.dist(joints_px[17], joints_px[9])
    s = 0 if to_wrist > to_little else 17
    row, column, depth = q[s]
    row, depth = math.cos(theta) * row - math.sin(theta) * depth, math.sin(theta) * row + math.cos(theta) * depth
    column, depth = math.cos(phi) * column - math.sin(phi) * depth, math.sin(phi) * column + math.cos(phi) * depth
    h_2d, z_2d = math.hypot(row, column), depth
    x_s, y_s, z_s = canonical[s]
    h_3d = length * math.hypot(x_s, y_s)
    z_3d = z_2d * h_3d / h_2d
    return z_3d - length * z_s, s


@pytest.mark.parametrize("method", METHODS)
def test_exact_input_gives_the_exact_pose(to, scene, method):
    camera, joints_m, joints_px, length, canonical = scene
    little = sees_little_longer(joints_px)
    assert 100 < little.sum() < 4900  # both key bones are at work
    pose = project_global(to(canonical), to(joints_px), camera, to(length), method=method)
    assert np.asarray(pose.valid).all()
    assert np.array_equal(np.asarray(pose.key_bone), little.astype(int))
    radius = np.linalg.norm(joints_m[:, ROOT], axis=-1)
    assert (np.abs(np.asarray(pose.radius_m) - radius) / radius).max() < 1e-9
    error = np.linalg.norm(np.asarray(pose.joints_m) - joints_m, axis=-1) / np.linalg.norm(joints_m, axis=-1)
    assert error.max() < 1e-9


@pytest.mark.parametrize("method", METHODS)
def test_exact_through_a_lens(to, method):
    joints_m, _, length = random_hands(300, FISHY_CAMERA, np.random.default_rng(13))
    joints_px = project(joints_m, FISHY_CAMERA, distort=True)
    seen = np.isfinite(unproject(joints_px, FISHY_CAMERA)).all(axis=(1, 2))  # fingers far outside leave the lens model
    assert seen.sum() > 250
    canonical = canonical_from_camera(joints_m).joints
    pose = project_global(to(canonical[seen]), to(joints_px[seen]), FISHY_CAMERA, to(length[seen]), method=method)
    np.testing.assert_allclose(np.asarray(pose.joints_m), joints_m[seen], rtol=0, atol=1e-9)


def test_key_bone_method_is_the_papers_formula(noisy):
    """On noisy input, where no two formulas agree by accident."""
    _, joints_px, length, canonical = noisy
    pose = project_global(canonical, joints_px, CENTRED_CAMERA, length, method="keybone")
    secondaries = set()
    for i in np.flatnonzero(pose.valid)[:300]:
        radius, secondary = paper_by_hand(canonical[i], joints_px[i], CENTRED_CAMERA, length[i])
        assert pose.radius_m[i] == pytest.approx(radius, rel=1e-10)
        assert pose.key_bone[i] == (0 if secondary == WRIST else 1)
        secondaries.add(secondary)
    assert secondaries == {WRIST, LITTLE_MCP}


def test_all_joints_is_least_squares(noisy):
    """Against numpy's solver, weights included: minimise sum w |m (r + L z) - L xy|^2 over r."""
    _, joints_px, length, canonical = noisy
    weights = np.random.default_rng(14).uniform(0, 1, canonical.shape[:-1])
    pose = project_global(canonical, joints_px, CENTRED_CAMERA, length, weights=weights)
    for i in np.flatnonzero(pose.valid)[:100]:
        rays = unproject(joints_px[i], CENTRED_CAMERA)
        rotation = cv2.Rodrigues(np.array([pose.theta[i], 0.0, 0.0]))[0]
        rotation = cv2.Rodrigues(np.array([0.0, -pose.phi[i], 0.0]))[0] @ rotation
        centred = rays @ rotation.T
        m = centred[:, :2] / centred[:, 2:]
        w = np.sqrt(weights[i])[:, None]
        target = length[i] * (canonical[i, :, :2] - m * canonical[i, :, 2:])
        radius = np.linalg.lstsq((w * m).reshape(-1, 1), (w * target).ravel())[0][0]
        assert pose.radius_m[i] == pytest.approx(radius, rel=1e-9)


def test_equal_bones_choose_the_little_finger():
    """Strictly larger: at equal 2D distance the wrist does not win (docs/paper-map.md)."""
    joints_m, joints_px, length = random_hands(1, CENTRED_CAMERA, np.random.default_rng(15))
    joints_px = joints_px[0] * 0
    joints_px[[WRIST, LITTLE_MCP, ROOT]] = [[240, 145], [250, 135], [240, 135]]
    canonical = canonical_from_camera(joints_m[0]).joints
    assert project_global(canonical, joints_px, CENTRED_CAMERA, length[0], method="keybone").key_bone == 1
    joints_px[WRIST, 1] += 1e-9
    assert project_global(canonical, joints_px, CENTRED_CAMERA, length[0], method="keybone").key_bone == 0


def test_hand_length_is_the_wrists_for_either_bone(scene):
    """Scaling the length scales the world, also where the little MCP is the secondary joint."""
    camera, joints_m, joints_px, length, canonical = scene
    little = sees_little_longer(joints_px)
    pose = project_global(canonical[little], joints_px[little], camera, 3 * length[little], method="keybone")
    np.testing.assert_allclose(pose.joints_m, 3 * joints_m[little], rtol=1e-8, atol=1e-9)


def test_all_joints_bears_noise_better(noisy):
    """docs/paper-map.md, *All joints*: the median range error falls by about a third."""
    joints_m, joints_px, length, canonical = noisy
    radius = np.linalg.norm(joints_m[:, ROOT], axis=-1)
    error = {
        method: np.nanmedian(
            np.abs(project_global(canonical, joints_px, CENTRED_CAMERA, length, method=method).radius_m - radius)
        )
        for method in METHODS
    }
    assert error["all-joints"] < 0.8 * error["keybone"]
    assert error["fitted"] < 0.9 * error["all-joints"]


def misfit(root_m, rays, canonical, length):
    """(N,) what the fit minimises: the sum of log(1 + (d / 0.08)^2) over the joints, where d is how far a joint is seen
    from where it should be, in hand lengths at the root's distance."""
    radius = np.linalg.norm(root_m, axis=-1)[:, None]
    rays = rotate(rotation_from_angles(*centring_angles(root_m)), rays)
    joints = canonical * length[:, None, None]
    off = rays[..., :2] / rays[..., 2:] - joints[..., :2] / (radius + joints[..., 2])[..., None]
    return np.log1p((np.linalg.norm(off, axis=-1) * radius / length[:, None] / 0.08) ** 2).sum(axis=-1)


def test_the_fit_is_better_than_where_it_starts_and_than_what_is_near(noisy):
    _, joints_px, length, canonical = noisy
    start, fitted = (
        project_global(canonical, joints_px, CENTRED_CAMERA, length, method=method)
        for method in ("all-joints", "fitted")
    )
    rays = unproject(joints_px, CENTRED_CAMERA)
    valid = start.valid & fitted.valid
    assert valid.mean() > 0.99
    roots = fitted.joints_m[:, ROOT]
    least = misfit(roots, rays, canonical, length)[valid]
    assert (least <= misfit(start.joints_m[:, ROOT], rays, canonical, length)[valid] + 1e-9).mean() > 0.99
    for shift in (*0.005 * np.eye(3), *-0.005 * np.eye(3)):
        assert (misfit(roots + shift, rays, canonical, length)[valid] > least).mean() > 0.95


def test_the_fit_corrects_the_roots_own_pixel(scene):
    """The root's pixel alone is 3 px off: the others put it back."""
    camera, _, joints_px, length, canonical = scene
    joints_px = joints_px[:500].copy()
    joints_px[:, ROOT] += 3.0
    pose = project_global(canonical[:500], joints_px, camera, length[:500], method="fitted")
    off = project(pose.joints_m[:, ROOT], camera) - (joints_px[:, ROOT] - 3.0)
    assert np.median(np.linalg.norm(off, axis=-1)) < 0.5


def test_a_joint_in_the_wrong_place_hardly_moves_the_fit(scene):
    """The index finger's tip is seen 11 degrees off to both sides."""
    camera, joints_m, joints_px, length, canonical = (values[:500] if np.ndim(values) else values for values in scene)
    joints_px = joints_px.copy()
    joints_px[:, 8] += 0.2 * camera.fx
    true = np.linalg.norm(joints_m[:, ROOT], axis=-1)
    straight, fitted = (
        np.abs(project_global(canonical, joints_px, camera, length, method=method).radius_m - true)
        for method in ("all-joints", "fitted")
    )
    assert np.median(fitted) < 0.05 * np.median(straight)


def test_a_fit_that_puts_a_joint_behind_the_camera_is_not_taken():
    """Near hands, wildly noisy: what the straight solution places, the fit places too."""
    rng = np.random.default_rng(23)
    joints_m, joints_px, length = random_hands(2000, CENTRED_CAMERA, rng)
    canonical = (
        canonical_from_camera(joints_m).joints
        + 0.1 * rng.standard_normal(joints_m.shape) * (np.arange(21) != ROOT)[:, None]
    )
    joints_px = joints_px + 30 * rng.standard_normal(joints_px.shape)
    straight, fitted = (
        project_global(canonical, joints_px, CENTRED_CAMERA, length, method=method)
        for method in ("all-joints", "fitted")
    )
    assert straight.valid.sum() > 1000
    assert fitted.valid[straight.valid].all()


@pytest.mark.parametrize(("kind", "tolerance"), [(np.float64, 1e-6), (np.float32, 1e-4)])
def test_a_fit_that_leads_nowhere_stays_where_it_starts(to, kind, tolerance):
    """One joint has a say: of the three coordinates of the root it tells one."""
    joints_m, joints_px, length = random_hands(50, CENTRED_CAMERA, np.random.default_rng(22))
    canonical, weights = canonical_from_camera(joints_m).joints, np.zeros((50, 21))
    weights[:, WRIST] = 1.0
    canonical, joints_px, length, weights = (to(v.astype(kind)) for v in (canonical, joints_px, length, weights))
    pose = project_global(canonical, joints_px, CENTRED_CAMERA, length, method="fitted", weights=weights)
    assert np.asarray(pose.valid).all()
    np.testing.assert_allclose(np.asarray(pose.joints_m), joints_m, atol=tolerance)


@pytest.mark.parametrize("method", METHODS)
def test_mirror(to, scene, method):
    """Flipping the image left to right flips the pose, hand for hand."""
    camera, _, joints_px, length, canonical = scene
    flipped = PinholeCamera(camera.fx, camera.fy, camera.width - camera.cx, camera.cy, camera.width, camera.height)
    pose = project_global(to(canonical), to(joints_px), camera, to(length), method=method)
    mirrored_px = joints_px * [-1, 1] + [camera.width, 0]
    mirrored = project_global(to(canonical * [-1, 1, 1]), to(mirrored_px), flipped, to(length), method=method)
    np.testing.assert_allclose(
        np.asarray(mirrored.joints_m), np.asarray(pose.joints_m) * [-1, 1, 1], rtol=1e-8, atol=1e-10
    )
    np.testing.assert_allclose(np.asarray(mirrored.theta), np.asarray(pose.theta), atol=1e-12)
    np.testing.assert_allclose(np.asarray(mirrored.phi), -np.asarray(pose.phi), atol=1e-12)


@pytest.mark.parametrize("method", METHODS)
def test_resized_image_gives_the_same_pose(scene, method):
    camera, joints_m, joints_px, length, canonical = scene
    larger = camera.resized(2 * camera.width, 2 * camera.height)
    pose = project_global(canonical[:50], 2 * joints_px[:50], larger, length[:50], method=method)
    np.testing.assert_allclose(pose.joints_m, joints_m[:50], atol=1e-9)


@pytest.mark.parametrize("method", METHODS)
def test_batch_is_loop_and_inputs_stay(to, scene, method):
    camera, _, joints_px, length, canonical = scene
    given = [
        to(canonical[:12].reshape(3, 4, 21, 3)),
        to(joints_px[:12].reshape(3, 4, 21, 2)),
        to(length[:12].reshape(3, 4)),
    ]
    batch = project_global(given[0], given[1], camera, given[2], method=method)
    assert np.array_equal(np.asarray(given[0]).reshape(12, 21, 3), canonical[:12])
    assert np.array_equal(np.asarray(given[1]).reshape(12, 21, 2), joints_px[:12])
    assert np.array_equal(np.asarray(given[2]).reshape(12), length[:12])
    for name in ("joints_m", "radius_m", "theta", "phi", "key_bone", "valid"):
        whole = np.asarray(getattr(batch, name))
        assert whole.shape[:2] == (3, 4)
        for i in range(12):
            one = project_global(to(canonical[i]), to(joints_px[i]), camera, float(length[i]), method=method)
            np.testing.assert_allclose(
                np.asarray(getattr(one, name)), whole.reshape(12, *whole.shape[2:])[i], rtol=1e-12, atol=1e-14
            )


def test_one_pose_many_lengths(to, scene):
    """Leading dimensions broadcast: the same hand placed for several assumed lengths."""
    camera, joints_m, joints_px, length, canonical = scene
    factors = np.array([0.5, 1.0, 2.0])
    pose = project_global(to(canonical[20]), to(joints_px[20]), camera, to(factors * length[20]))
    np.testing.assert_allclose(np.asarray(pose.joints_m), factors[:, None, None] * joints_m[20], atol=1e-12)
    assert pose.theta.shape == pose.key_bone.shape == pose.valid.shape == (3,)


@pytest.mark.parametrize("method", METHODS)
def test_single_precision_stays_single(to, scene, method):
    camera, joints_m, joints_px, length, canonical = scene
    single = [to(values[:200].astype(np.float32)) for values in (canonical, joints_px, length)]
    pose = project_global(single[0], single[1], camera, single[2], method=method)
    assert str(pose.joints_m.dtype).endswith("float32") and str(pose.radius_m.dtype).endswith("float32")
    assert np.median(np.abs(np.asarray(pose.joints_m) - joints_m[:200])) < 1e-6


def test_joints_without_weight_are_ignored(to, scene):
    """Hidden joints may be wrong or unknown in 2D."""
    camera, joints_m, joints_px, length, canonical = scene
    weights = np.ones((50, 21))
    weights[:, [3, 8, WRIST]] = 0
    pixels = joints_px[:50].copy()
    pixels[:, 3], pixels[:, 8], pixels[:25, WRIST] = 12345.0, np.nan, np.inf
    pose = project_global(to(canonical[:50]), to(pixels), camera, to(length[:50]), weights=to(weights))
    assert np.asarray(pose.valid).all()
    np.testing.assert_allclose(np.asarray(pose.joints_m), joints_m[:50], atol=1e-9)
    pose = project_global(to(canonical[:50]), to(pixels), camera, to(length[:50]), weights=to(0 * weights))
    assert not np.asarray(pose.valid).any()  # nothing counts
    for nonsense in (-1.0, np.nan):
        weights[:, 5] = nonsense
        pose = project_global(to(canonical[:50]), to(pixels), camera, to(length[:50]), weights=to(weights))
        assert not np.asarray(pose.valid).any() and np.isnan(np.asarray(pose.joints_m)).all()


def test_bad_modes_are_refused(scene):
    camera, _, joints_px, length, canonical = scene
    for wrong in (
        *({"method": "median"}, {"angles": "printed"}, {"method": "keybone", "weights": np.ones(21)}),
        {"method": "fitted", "angles": "paper"},
    ):
        with pytest.raises(InputError):
            project_global(canonical[0], joints_px[0], camera, length[0], **wrong)


# The consistent 2D joints and the target of L_proj ------------------------------------------------------------------


def test_consistent_pixels_of_exact_input_are_the_input(to, scene):
    camera, _, joints_px, length, canonical = scene
    consistent = consistent_joints_px(to(canonical), to(joints_px), camera, to(length))
    np.testing.assert_allclose(np.asarray(consistent), joints_px, atol=1e-6)


@pytest.mark.parametrize("camera", [CENTRED_CAMERA, FISHY_CAMERA], ids=["pinhole", "lens"])
def test_key_bone_on_consistent_pixels_returns_the_same_range(to, camera):
    """So the paper's formula on `consistent` p and our all-joints method are one and the same."""
    rng = np.random.default_rng(19)
    joints_m, _, length = random_hands(400, camera, rng)
    canonical = (
        canonical_from_camera(joints_m).joints
        + 0.03 * rng.standard_normal((400, 21, 3)) * (np.arange(21) != ROOT)[:, None]
    )
    joints_px = project(joints_m, camera, distort=True) + rng.standard_normal((400, 21, 2))
    all_joints = project_global(canonical, joints_px, camera, length)
    consistent = consistent_joints_px(to(canonical), to(joints_px), camera, to(length))
    key_bone = project_global(to(canonical), consistent, camera, to(length), method="keybone")
    both = all_joints.valid & np.asarray(key_bone.valid)
    assert both.sum() > 300
    np.testing.assert_allclose(np.asarray(key_bone.radius_m)[both], all_joints.radius_m[both], rtol=1e-7)
    np.testing.assert_allclose(np.asarray(key_bone.joints_m)[both], all_joints.joints_m[both], atol=1e-7)


def test_true_pixels_imply_the_true_xy(to, scene):
    camera, joints_m, joints_px, length, canonical = scene
    distance = np.linalg.norm(joints_m[:, ROOT], axis=-1) / length
    xy = canonical_xy_from_rays(unproject(to(joints_px), camera), to(distance), to(canonical[..., 2]))
    np.testing.assert_allclose(np.asarray(xy), canonical[..., :2], atol=1e-11)


def test_unknown_pixels_imply_nothing(to, scene):
    camera, joints_m, joints_px, length, canonical = scene
    pixels = joints_px[:2].copy()
    pixels[0, 3], pixels[1, ROOT] = np.nan, np.nan
    distance = np.linalg.norm(joints_m[:2, ROOT], axis=-1) / length[:2]
    xy = np.asarray(canonical_xy_from_rays(unproject(to(pixels), camera), to(distance), to(canonical[:2, :, 2])))
    assert np.isnan(xy[0, 3]).all() and np.isnan(xy[1]).all() and np.isfinite(np.delete(xy[0], 3, axis=0)).all()


# Gradients ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("camera", [OFF_CENTRE_CAMERA, FISHY_CAMERA], ids=["pinhole", "lens"])
@pytest.mark.parametrize("method", METHODS)
def test_gradients(method, camera):
    torch = pytest.importorskip("torch")
    joints_m, _, length = random_hands(2, camera, np.random.default_rng(20))
    joints_px = project(joints_m, camera, distort=True)
    assert np.isfinite(joints_px).all()
    arguments = [
        torch.tensor(values, requires_grad=True)
        for values in (canonical_from_camera(joints_m).joints, joints_px, length)
    ]

    def outputs(canonical, pixels, lengths):
        pose = project_global(canonical, pixels, camera, lengths, method=method)
        assert pose.valid.all()
        return pose.joints_m, pose.radius_m, pose.theta, pose.phi

    assert torch.autograd.gradcheck(outputs, arguments, atol=1e-6, fast_mode=True)


def test_gradients_of_the_loss_target():
    torch = pytest.importorskip("torch")
    joints_m, joints_px, length = random_hands(2, CENTRED_CAMERA, np.random.default_rng(21))
    distance = torch.tensor(np.linalg.norm(joints_m[:, ROOT], axis=-1) / length)
    arguments = [
        torch.tensor(values, requires_grad=True)
        for values in (joints_px, canonical_from_camera(joints_m).joints[..., 2])
    ]
    assert torch.autograd.gradcheck(
        lambda pixels, z: canonical_xy_from_rays(unproject(pixels, CENTRED_CAMERA), distance, z), arguments, atol=1e-6
    )


def test_range_weights_by_hand():
    """Root 4, wrist and other knuckles 1, fingers 1/4, times score^2; nothing said counts as 1, nothing less than
    0.05^2."""
    scores = np.full(21, 0.5)
    scores[[0, 1, 5, 6, 2]] = 1.0, 1.0, 0.0, 0.0, np.nan
    weights = range_weights(scores)
    np.testing.assert_allclose(weights[[0, 1, 5, 6, 2]], [1, 1 / 4, 0.05**2, 0.05**2 / 4, 1 / 4])
    np.testing.assert_allclose(weights[[9, 13, 17]], [1, 1 / 4, 1 / 4])  # 0.5^2
    np.testing.assert_allclose(weights[[3, 10, 20]], 1 / 16)
    assert range_weights(np.zeros((2, 3, 21))).shape == (2, 3, 21)
    assert range_weights(scores.astype(np.float32)).dtype == np.float32


def test_weights_keep_a_doubtful_finger_out_of_the_range():
    """A fingertip 20 px off moves the range; with a score of 0 it hardly does."""
    rng = np.random.default_rng(3)
    joints_m, joints_px, length = random_hands(20, CENTRED_CAMERA, rng)
    canonical = canonical_from_camera(joints_m).joints
    radius = np.linalg.norm(joints_m[:, ROOT], axis=-1)
    joints_px[:, 8] += 20.0
    scores = np.ones((20, 21))
    scores[:, 8] = 0.0
    alike, weighted = (
        np.abs(project_global(canonical, joints_px, CENTRED_CAMERA, length, weights=w).radius_m - radius)
        for w in (None, range_weights(scores))
    )
    assert weighted.max() < 0.02 * alike.max() and (weighted < alike).all()


def test_an_exact_pose_is_not_drawn_anywhere(to, scene):
    camera, _, joints_px, length, canonical = scene
    given = to(canonical), to(joints_px), camera, to(length)
    drawn = pull_to_rays(*given, project_global(*given), 0.7)
    np.testing.assert_allclose(np.asarray(drawn), canonical, atol=1e-9)


@pytest.mark.parametrize("method", ["all-joints", "fitted"])
def test_joints_are_drawn_to_where_they_are_seen_and_keep_their_distance(to, noisy, method):
    """The whole way: seen at the given pixels, the root where it was put. Half of it: half-way between. The wrist keeps
    its bone's length."""
    _, joints_px, length, canonical = noisy
    pose = project_global(canonical, joints_px, CENTRED_CAMERA, length, method=method)
    valid = pose.valid
    given = to(joints_px), CENTRED_CAMERA, to(length)
    given = *given, project_global(to(canonical), *given, method=method)
    drawn, half = (np.asarray(pull_to_rays(to(canonical), *given, share)) for share in (1.0, 0.5))
    there = camera_from_canonical(drawn, length, pose.radius_m, pose.theta, pose.phi)
    others = ~np.isin(np.arange(21), [WRIST, ROOT])
    np.testing.assert_allclose(project(there, CENTRED_CAMERA)[valid][:, others], joints_px[valid][:, others], atol=1e-6)
    before, after = (np.linalg.norm(joints[valid][:, others], axis=-1) for joints in (pose.joints_m, there))
    np.testing.assert_allclose(after, before, rtol=1e-12)
    np.testing.assert_allclose(half[valid][:, others], ((drawn + canonical) / 2)[valid][:, others], atol=1e-12)
    bones = [np.linalg.norm(pose[:, WRIST], axis=-1) for pose in (canonical, half, drawn)]
    np.testing.assert_allclose(bones[1:], [bones[0]] * 2, rtol=1e-12)
    assert np.abs(drawn - canonical)[valid][:, WRIST].max() > 0.01
    np.testing.assert_allclose(drawn[:, ROOT], 0, atol=1e-12)


def test_what_is_not_known_is_not_drawn(to, noisy):
    _, joints_px, length, canonical = (values[:3] for values in noisy)
    joints_px = joints_px.copy()
    place = project_global(to(canonical), to(joints_px), CENTRED_CAMERA, to(length))
    joints_px[2, 5], joints_px[0, ROOT], place.radius_m[1] = np.nan, np.nan, np.nan
    drawn = np.asarray(pull_to_rays(to(canonical), to(joints_px), CENTRED_CAMERA, to(length), place, 1.0))
    same = np.isclose(drawn, canonical, rtol=0, atol=1e-12).all(axis=-1)
    assert same[1].all() and same[2, [5, ROOT]].all() and same[2].sum() == 2
    assert same[0].sum() == 1  # where the root is seen is not asked
