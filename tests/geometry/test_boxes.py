"""Boxes, crops and warping (docs/paper-map.md, *Perspective crop*)."""

import cv2
import numpy as np
import pytest
from tests.builders import CENTRED_CAMERA, OFF_CENTRE_CAMERA, open_hand

from twohands.errors import InputError
from twohands.geometry.boxes import (
    apply_homography,
    box_before_camera,
    box_from_points,
    box_in_picture,
    box_iou,
    continued_box,
    image_from_rolled,
    perspective_crop,
    points_from_crops,
    rolled_box,
    square_crop,
    upright_crop,
    upright_roll_deg,
    warp_image,
)
from twohands.geometry.camera import project, unproject
from twohands.geometry.canonical import camera_from_canonical
from twohands.geometry.rotation import rotation_about_z
from twohands.skeleton import LEFT, RIGHT, ROOT, WRIST
from twohands.types import PinholeCamera

WIDE_CAMERA = PinholeCamera.from_fov(150, 960, 540)
BOX = np.array([330.0, 40.0, 450.0, 110.0])
CROP_CORNERS = np.array([[0.0, 0.0], [256.0, 0.0], [0.0, 256.0], [256.0, 256.0], [128.0, 128.0], [10.0, 200.0]])


def crops(side):
    return {
        "square": square_crop(BOX, size=256, side=side),
        "perspective": perspective_crop(BOX, CENTRED_CAMERA, size=256, side=side),
    }


# Boxes --------------------------------------------------------------------------------------------------------------


def test_box_from_points(to):
    points = np.array([[[1.0, 5.0], [3.0, 2.0], [np.nan, 9.0], [9.0, 9.0]], np.full((4, 2), np.nan)])
    np.testing.assert_array_equal(np.asarray(box_from_points(to(points))), [[1, 2, 9, 9], [np.nan] * 4])
    valid = np.array([[True, True, True, False], [True] * 4])
    np.testing.assert_array_equal(np.asarray(box_from_points(to(points), to(valid))), [[1, 2, 3, 5], [np.nan] * 4])


def test_a_box_ends_at_the_pictures_edge(to):
    points = np.array([[[-5.0, 2.0], [30.0, 50.0]], [[3.0, 4.0], [5.0, 6.0]], np.full((2, 2), np.nan)])
    found = np.asarray(box_in_picture(to(points), 20, 10))
    np.testing.assert_array_equal(found, [[0, 2, 20, 10], [3, 4, 5, 6], [np.nan] * 4])


def test_box_iou(to):
    a = np.array([[0.0, 0.0, 4.0, 2.0], [0.0, 0.0, 4.0, 2.0], [0.0, 0.0, 1.0, 1.0], [1.0, 1.0, 1.0, 1.0]])
    b = np.array([[2.0, 1.0, 6.0, 3.0], [0.0, 0.0, 4.0, 2.0], [2.0, 2.0, 3.0, 3.0], [1.0, 1.0, 1.0, 1.0]])
    expected = [2 / 14, 1.0, 0.0, 0.0]  # 2x1 common of 8 + 8 - 2; the same; apart, though both differences are negative
    np.testing.assert_allclose(np.asarray(box_iou(to(a), to(b))), expected)
    np.testing.assert_allclose(np.asarray(box_iou(to(b), to(a))), expected)
    assert np.isnan(np.asarray(box_iou(to(a[:1] * np.nan), to(b[:1])))).all()


# Crop matrices ------------------------------------------------------------------------------------------------------


def test_square_crop_by_hand():
    """Box 120x70 at (390, 75): the square's side is 180, from (300, -15) to (480, 165)."""
    corners = apply_homography(square_crop(BOX, size=256, side=LEFT), CROP_CORNERS[:4])
    np.testing.assert_allclose(corners, [[300, -15], [480, -15], [300, 165], [480, 165]])
    corners = apply_homography(square_crop(BOX, size=256, side=RIGHT), CROP_CORNERS[:4])
    np.testing.assert_allclose(corners, [[480, -15], [300, -15], [480, 165], [300, 165]])


@pytest.mark.parametrize("turned_deg", [0, 30, 90, 180, -100])
def test_an_upright_crop_shows_the_hand_in_its_middle_with_the_fingers_up(turned_deg):
    """Of a hand twice as long as wide, 100 pixels: with a margin of 1.5 it takes two thirds of the crop, and half of
    that across. The picture is not mirrored."""
    turn = np.radians(turned_deg)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    upright = np.zeros((21, 2))
    upright[ROOT], upright[1], upright[2] = [0, -60], [-20, -100], [30, -50]
    found = upright_crop(upright @ rotation.T + [300, 200], size=96, margin=1.5)
    shown = apply_homography(np.linalg.inv(found), upright @ rotation.T + [300, 200])
    np.testing.assert_allclose(box_from_points(shown), [32, 16, 64, 80], atol=1e-9)
    np.testing.assert_allclose(shown[ROOT] - shown[WRIST], [0, -38.4], atol=1e-9)
    assert np.linalg.det(found) > 0


def test_an_upright_crop_of_a_point_is_still_one():
    found = upright_crop(np.full((21, 2), 7.0), size=10, margin=2.0)
    np.testing.assert_allclose(apply_homography(found, np.array([[5.0, 5.0]])), [[7, 7]])
    assert np.linalg.det(found) == pytest.approx(0.2**2)


@pytest.mark.parametrize("side", [LEFT, RIGHT])
@pytest.mark.parametrize("kind", ["square", "perspective"])
def test_round_trip(to, kind, side):
    image_from_crop = crops(side)[kind]
    assert image_from_crop.dtype == np.float64
    image = apply_homography(to(image_from_crop), to(CROP_CORNERS))
    back = apply_homography(to(np.linalg.inv(image_from_crop)), image)
    np.testing.assert_allclose(np.asarray(back), CROP_CORNERS, atol=1e-9)


@pytest.mark.parametrize("kind", ["square", "perspective"])
def test_right_crop_is_the_mirrored_left_crop(kind):
    mirrored = CROP_CORNERS * [-1, 1] + [256, 0]
    right, left = crops(RIGHT)[kind], crops(LEFT)[kind]
    np.testing.assert_allclose(apply_homography(right, mirrored), apply_homography(left, CROP_CORNERS), atol=1e-9)
    assert np.linalg.det(right) < 0 < np.linalg.det(left)


@pytest.mark.parametrize("kind", ["square", "perspective"])
def test_crop_is_centred_on_the_box(kind):
    centre = apply_homography(crops(LEFT)[kind], np.array([[128.0, 128.0]]))
    np.testing.assert_allclose(centre, [[390.0, 75.0]], atol=1e-9)


def test_perspective_crop_is_square_crop_near_the_axis():
    """For a small box around the principal point a turned camera and a cut-out are the same."""
    u, v = OFF_CENTRE_CAMERA.cx, OFF_CENTRE_CAMERA.cy
    camera = PinholeCamera(600.0, 600.0, u, v, 640, 480)
    box = [u - 0.5, v - 0.3, u + 0.5, v + 0.3]
    for side in (LEFT, RIGHT):
        square = apply_homography(square_crop(box, size=256, side=side), CROP_CORNERS)
        turned = apply_homography(perspective_crop(box, camera, size=256, side=side), CROP_CORNERS)
        np.testing.assert_allclose(turned, square, atol=1e-6)


@pytest.mark.parametrize("camera", [CENTRED_CAMERA, OFF_CENTRE_CAMERA], ids=["centred", "off-centre"])
def test_perspective_crop_is_a_turned_camera(camera):
    """K^-1 H^-1 splits into intrinsics and a rotation; a ray turned and projected there lands on the crop's pixel."""
    intrinsics = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    crop_from_image = np.linalg.inv(perspective_crop(BOX, camera, size=256, side=LEFT))
    _, crop_intrinsics, rotation, *_ = cv2.RQDecomp3x3(crop_from_image @ intrinsics)
    crop_intrinsics = crop_intrinsics / crop_intrinsics[2, 2]
    focal = crop_intrinsics[0, 0]
    np.testing.assert_allclose(crop_intrinsics, [[focal, 0, 128], [0, focal, 128], [0, 0, 1]], atol=1e-9)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert focal > 0 and np.linalg.det(rotation) > 0
    ray = unproject(np.array([390.0, 75.0]), camera)
    np.testing.assert_allclose(rotation @ ray / np.linalg.norm(ray), [0, 0, 1], atol=1e-12)

    virtual = PinholeCamera(focal, focal, 128, 128, 256, 256)
    points = np.random.default_rng(0).uniform([0.3, -0.3, 0.4], [0.5, 0.2, 0.8], (50, 3))
    seen = project(points @ rotation.T, virtual)
    np.testing.assert_allclose(apply_homography(crop_from_image, project(points, camera)), seen, atol=1e-8)


@pytest.mark.parametrize("margin", [1.0, 1.5])
def test_perspective_crop_holds_the_box_and_no_more(margin):
    u0, v0, u1, v1 = BOX
    crop_from_image = np.linalg.inv(perspective_crop(BOX, CENTRED_CAMERA, size=256, side=LEFT, margin=margin))
    corners = apply_homography(crop_from_image, np.array([[u0, v0], [u1, v0], [u0, v1], [u1, v1]]))
    np.testing.assert_allclose(np.abs(corners - 128).max(), 128 / margin)


def test_perspective_crop_shows_the_same_hand_alike_everywhere():
    """One canonical hand in the middle and in a corner of the image: turned crops agree, upright squares do not."""
    canonical = open_hand() - open_hand()[9]

    def shape_in_crop(theta, phi, perspective):
        joints_m = camera_from_canonical(canonical, 0.1, 0.4, np.asarray(theta), np.asarray(phi))
        joints_px = project(joints_m, CENTRED_CAMERA)
        root_px = joints_px[9]
        box = np.concatenate([root_px - 20, root_px + 20])
        if perspective:
            image_from_crop = perspective_crop(box, CENTRED_CAMERA, size=256, side=LEFT)
        else:
            image_from_crop = square_crop(box, size=256, side=LEFT)
        offsets = apply_homography(np.linalg.inv(image_from_crop), joints_px) - 128
        return offsets / np.abs(offsets).max()

    for perspective, agree in ((True, True), (False, False)):
        middle, corner = (shape_in_crop(*angles, perspective) for angles in ((0.0, 0.0), (0.4, 0.7)))
        assert (np.abs(middle - corner).max() < 1e-9) == agree
        assert agree or np.abs(middle - corner).max() > 0.1


@pytest.mark.parametrize("box", [[0, 0, 0, 0], [5, 5, 5, 5], [0, 0, np.nan, 4], [4, 0, 0, 4], [0, 0, np.inf, 4]])
def test_a_box_without_extent_is_refused(box):
    with pytest.raises(InputError, match="finite box"):
        square_crop(box, size=256, side=LEFT)
    with pytest.raises(InputError, match="finite box"):
        perspective_crop(box, CENTRED_CAMERA, size=256, side=LEFT)


def test_other_bad_requests_are_refused():
    with pytest.raises(InputError, match="side"):
        square_crop(BOX, size=256, side=2)
    with pytest.raises(InputError, match="half space"):
        perspective_crop([0, 0, 1e9, 10], CENTRED_CAMERA, size=256, side=LEFT)


@pytest.mark.parametrize("box", [[600, 100, 960, 500], [0, 0, 959, 540], [-900, 200, 950, 300]])
def test_an_estimated_box_is_shrunk_about_its_centre_where_there_is_no_crop_of_it(box):
    """A growing box is as it is, up to a size at which it stays; of every one there is a crop."""
    box = np.array(box, float)
    middle, half = (box[:2] + box[2:]) / 2, (box[2:] - box[:2]) / 2
    grown = [np.concatenate([middle - k * half, middle + k * half]) for k in (1e-3, 0.3, 0.5, 1, 2, 4, 1e6)]
    found = [box_before_camera(each, WIDE_CAMERA) for each in grown]
    same = [np.array_equal(*pair) for pair in zip(grown, found, strict=True)]
    assert same == sorted(same, reverse=True) and same[0] and not same[-1]
    for each, is_same in zip(found, same, strict=True):
        assert np.isfinite(perspective_crop(each, WIDE_CAMERA, size=256, side=LEFT)).all()
        np.testing.assert_allclose((each[:2] + each[2:]) / 2, middle, atol=1e-9)
        if not is_same:
            np.testing.assert_allclose(each, found[-1], atol=1e-9)


def test_a_point_found_behind_the_camera_is_moved_towards_the_crops_centre():
    crop = np.stack([perspective_crop([560.0, 150, 960, 420], WIDE_CAMERA, size=256, side=side) for side in (0, 1)])
    points = np.random.default_rng(3).uniform(0, 256, (2, 200, 2))
    plain = np.asarray(apply_homography(crop, points))
    moved, found = points_from_crops(crop, points, 256)
    assert 0.05 < found.mean() < 0.99 and not found[np.isnan(plain).any(axis=-1)].any()
    np.testing.assert_array_equal(moved[found], plain[found])
    assert np.isfinite(moved).all() and (moved[~found, 0] > 960).all()  # that is where the crop leaves the picture
    for i in range(2):
        back = np.asarray(apply_homography(np.linalg.inv(crop[i]), moved[i])) - 128
        way = points[i] - 128
        np.testing.assert_allclose(back[:, 0] * way[:, 1], back[:, 1] * way[:, 0], atol=1e-6)
        shares = np.linalg.norm(back, axis=-1) / np.linalg.norm(way, axis=-1)
        assert ((shares[~found[i]] > 0) & (shares[~found[i]] < 1)).all()
    square = np.stack([square_crop(BOX, size=256, side=side) for side in (0, 1)])
    moved, found = points_from_crops(square, points, 256)
    assert found.all()
    np.testing.assert_array_equal(moved, apply_homography(square, points))


def test_points_behind_the_camera_have_no_place(to):
    behind = np.array([[1.0, 0, 0], [0, 1, 0], [-0.01, 0, 1]])
    mapped = np.asarray(apply_homography(to(behind), to(np.array([[50.0, 1.0], [150.0, 1.0], [100.0, 1.0]]))))
    np.testing.assert_allclose(mapped[0], [100.0, 2.0])
    assert np.isnan(mapped[1:]).all()


def test_homography_batches(to):
    points = np.random.default_rng(1).uniform(0, 256, (2, 21, 2))
    both = np.stack([crops(LEFT)["perspective"], crops(RIGHT)["perspective"]])
    batch = np.asarray(apply_homography(to(both), to(points)))
    for i in range(2):
        np.testing.assert_allclose(batch[i], np.asarray(apply_homography(to(both[i]), to(points[i]))))


# Warping ------------------------------------------------------------------------------------------------------------


def pattern(height=12, width=16, channels=3):
    """Multiples of 16, so that quarters are whole numbers."""
    return (16 * np.random.default_rng(2).integers(0, 16, (height, width, channels))).astype(np.uint8)


@pytest.mark.parametrize("interpolation", ["linear", "nearest"])
@pytest.mark.parametrize("shift", [(0, 0), (3, 2), (-2, 5)])
def test_integer_shift_is_exact(shift, interpolation):
    image, (du, dv), size = pattern(), shift, 9
    before = image.copy()
    crop = warp_image(image, np.array([[1.0, 0, du], [0, 1, dv], [0, 0, 1]]), size, interpolation=interpolation)
    expected = np.zeros((size, size, 3), np.uint8)
    for row in range(size):
        for column in range(size):
            if 0 <= row + dv < 12 and 0 <= column + du < 16:
                expected[row, column] = image[row + dv, column + du]
    np.testing.assert_array_equal(crop, expected)
    np.testing.assert_array_equal(image, before)


def test_upscaling_by_two_keeps_the_half_pixel_law():
    """Crop pixel i's centre is i + 0.5, that is (i + 0.5) / 2 in the image: a quarter pixel beside an image centre."""
    image = pattern(8, 8)
    crop = warp_image(image, np.diag([0.5, 0.5, 1.0]), 16)
    line = np.zeros((16, 8))
    for i in range(1, 15):
        near, far = i // 2, i // 2 + (1 if i % 2 else -1)
        line[i, near], line[i, far] = 0.75, 0.25
    expected = np.einsum("ir,jc,rck->ijk", line, line, image.astype(float))
    np.testing.assert_allclose(crop[1:15, 1:15], expected[1:15, 1:15], atol=0.5)
    nearest = warp_image(image, np.diag([0.5, 0.5, 1.0]), 16, interpolation="nearest")
    np.testing.assert_array_equal(nearest, image.repeat(2, axis=0).repeat(2, axis=1))


@pytest.mark.parametrize("times", [2, 3, 5])
def test_a_shrunk_crop_is_the_mean_of_what_its_pixels_cover(times):
    image = np.random.default_rng(times).integers(0, 256, (times * 8, times * 8, 3), np.uint8)
    crop = warp_image(image, np.diag([times, times, 1.0]), 8)
    means = image.reshape(8, times, 8, times, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(crop, means, atol=0.5 + 1e-6)


def test_a_hand_in_a_photograph_of_many_pixels_is_shown_without_its_noise():
    """A grey hand under a sensor's noise, once as a webcam and once as a telephone takes it."""
    noise = np.random.default_rng(0).normal(128, 40, (2160, 3840)).clip(0, 255).astype(np.uint8)
    camera = PinholeCamera.from_fov(70, 3840, 2160)
    crop = warp_image(noise, perspective_crop([1500, 600, 2400, 1500], camera, size=128, side=LEFT), 128)
    assert crop.std() < 40 / 7  # every pixel covers nine by nine or more; one sample of them would have 40 / 1.5


@pytest.mark.parametrize("box", [[-300.0, 900, 500, 1600], [1500.0, 600, 2600, 1083]], ids=["left edge", "lower edge"])
def test_a_shrunk_crop_is_black_outside_the_picture_alone(box):
    white = np.full((1083, 1927, 3), 255, np.uint8)  # no multiple of any block
    camera = PinholeCamera.from_fov(70, 1927, 1083)
    image_from_crop = perspective_crop(box, camera, size=128, side=LEFT)
    crop = warp_image(white, image_from_crop, 128)
    v, u = np.mgrid[0:128, 0:128] + 0.5
    seen = apply_homography(image_from_crop, np.stack([u, v], axis=-1).reshape(-1, 2)).reshape(128, 128, 2)
    to_edge = np.minimum(seen, np.array([1927, 1083]) - seen).min(axis=-1)  # negative outside
    assert (crop[to_edge > 20] == 255).all()
    assert (crop[to_edge < -20] == 0).all()
    assert (to_edge > 20).any() and (to_edge < -20).any()


def test_upscaling_floats_is_not_rounded():
    ramp = np.arange(8, dtype=np.float32)[None, :].repeat(8, axis=0)
    crop = warp_image(ramp, np.diag([0.5, 0.5, 1.0]), 16)
    np.testing.assert_allclose(crop[8, 1:15], (np.arange(1, 15) + 0.5) / 2 - 0.5, atol=1e-6)


def test_mirrored_picture_is_the_flipped_picture():
    image = pattern()
    box = [4.0, 2.0, 12.0, 10.0]
    left = warp_image(image, square_crop(box, size=12, side=LEFT), 12)
    right = warp_image(image, square_crop(box, size=12, side=RIGHT), 12)
    np.testing.assert_array_equal(right, left[:, ::-1])
    np.testing.assert_array_equal(left, image[:, 2:14])  # side 12 about (8, 6)


@pytest.mark.parametrize("side", [LEFT, RIGHT])
@pytest.mark.parametrize("kind", ["square", "perspective"])
def test_picture_and_points_agree(kind, side):
    """A blob drawn at a joint is found at the joint's crop position: matrices and warping share one pixel law."""
    joint = np.array([402.3, 81.6])
    v, u = np.mgrid[0:270, 0:480] + 0.5
    image = np.exp(-((u - joint[0]) ** 2 + (v - joint[1]) ** 2) / (2 * 4.0**2)).astype(np.float32)
    image_from_crop = crops(side)[kind]
    crop = warp_image(image, image_from_crop, 256).astype(np.float64)
    v, u = np.mgrid[0:256, 0:256] + 0.5
    found = np.array([(crop * u).sum(), (crop * v).sum()]) / crop.sum()
    expected = apply_homography(np.linalg.inv(image_from_crop), joint[None])[0]
    np.testing.assert_allclose(found, expected, atol=0.15)


def test_pixels_of_a_rolled_camera_lead_to_those_of_the_upright_one():
    roll = rotation_about_z(0.4)
    assert np.allclose(roll @ [1, 0, 0], [np.cos(0.4), np.sin(0.4), 0])
    points = np.random.default_rng(0).uniform([-0.2, -0.2, 0.3], [0.2, 0.2, 0.6], (50, 3))
    found = apply_homography(image_from_rolled(OFF_CENTRE_CAMERA, roll), project(points @ roll.T, OFF_CENTRE_CAMERA))
    np.testing.assert_allclose(found, project(points, OFF_CENTRE_CAMERA), atol=1e-9)


@pytest.mark.parametrize(("along", "degrees"), [((0, -40), 0), ((40, 0), -90), ((-40, 0), 90), ((30, -30), -45)])
def test_a_camera_rolled_upright_sees_the_knuckle_above_the_wrist(along, degrees):
    joints_px = np.full((2, 21, 2), 240.0)
    joints_px[:, ROOT] += along
    rolls_deg = upright_roll_deg(joints_px)
    np.testing.assert_allclose(rolls_deg, degrees, atol=1e-9)
    from_rolled = image_from_rolled(OFF_CENTRE_CAMERA, rotation_about_z(np.radians(rolls_deg[0])))
    seen = apply_homography(np.linalg.inv(from_rolled), joints_px[0])
    assert seen[ROOT, 0] == pytest.approx(seen[WRIST, 0], abs=0.2) and seen[ROOT, 1] < seen[WRIST, 1]


def test_a_hand_upside_down_is_rolled_by_half_a_turn():
    joints_px = np.full((21, 2), 100.0)
    joints_px[ROOT, 1] += 50
    assert abs(upright_roll_deg(joints_px)) == pytest.approx(180)


def test_box_before_a_rolled_camera_is_that_of_what_the_upright_picture_shows():
    """A quarter turn about the middle (300, 200) of a picture: 40 pixels right of it become 40 below, and what lies
    beyond the edge counts as on it."""
    camera = PinholeCamera(500, 500, 300, 200, width=600, height=400)
    from_rolled = image_from_rolled(camera, rotation_about_z(np.pi / 2))
    points = np.array([[340.0, 200.0], [300.0, 170.0], [300.0, 900.0], [5.0, 5.0]])
    valid = np.array([True, True, True, False])
    np.testing.assert_allclose(rolled_box(points, (400, 600), from_rolled, valid), [100, 200, 330, 240])
    upright = image_from_rolled(camera, np.eye(3))
    np.testing.assert_allclose(rolled_box(points, (400, 600), upright), box_in_picture(points, 600, 400))


@pytest.mark.parametrize(
    ("box", "continued"),
    [
        ([100, 100, 140, 180], [100, 100, 140, 180]),  # inside
        ([100, 320, 140, 400], [100, 320, 140, 416]),  # a fifth of the 80 pixels, below
        ([3, 320, 83, 397], [-13, 320, 83, 413]),  # two edges; within six pixels, a hundredth of 600, touches
        ([7, 100, 87, 140], [7, 100, 87, 140]),
        ([0, 100, 600, 200], [-120, 100, 720, 200]),
    ],
)
def test_a_box_is_continued_beyond_the_edges_that_it_touches(box, continued):
    np.testing.assert_array_equal(continued_box(np.array(box, float), 600, 400), continued)
