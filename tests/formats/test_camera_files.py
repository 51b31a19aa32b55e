"""Camera files, and cameras at the size of a picture."""

import gzip
import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from twohands.errors import DataFormatError, InputError, TwoHandsError
from twohands.formats.camera_files import camera_for_image, read_camera
from twohands.types import PinholeCamera

FIELD = Path(__file__).parents[3] / "shared" / "field"

VALUES = {"fx": 500.0, "fy": 510.0, "cx": 322.5, "cy": 241.0, "width": 640, "height": 480}


def write_json(path, **changes):
    path.write_text(json.dumps(VALUES | changes))
    return path


def write_yaml(path, matrix, distortion=None, size=(640, 480)):
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    if size is not None:
        storage.write("image_width", size[0])
        storage.write("image_height", size[1])
    storage.write("camera_matrix", np.array(matrix, float))
    if distortion is not None:
        storage.write("distortion_coefficients", np.array(distortion, float))
    storage.release()
    return path


YAML_NUMBER = "%YAML:1.0\n---\ncamera_matrix: 3\n"
MATRIX = [[500, 0, 322], [0, 510, 240.5], [0, 0, 1]]
"""Of OpenCV, which counts from the centre of the first pixel."""


def test_json(tmp_path):
    assert read_camera(write_json(tmp_path / "c.json")) == PinholeCamera(**VALUES)
    with_lens = read_camera(write_json(tmp_path / "d.json", distortion=[0.1, -0.2, 0, 0.001, 0.05]))
    assert with_lens.distortion == (0.1, -0.2, 0.0, 0.001, 0.05)
    assert read_camera(write_json(tmp_path / "e.json", distortion=[0, 0, 0, 0])).distortion == ()


def test_opencv_yaml(tmp_path):
    assert read_camera(write_yaml(tmp_path / "c.yaml", MATRIX)) == PinholeCamera(**VALUES)
    padded = [[0.1, -0.2, 0, 0.001, 0.05, 0.01, 0.02, 0.03, 0, 0, 0, 0, 0, 0]]  # of CALIB_RATIONAL_MODEL
    assert len(read_camera(write_yaml(tmp_path / "e.yml", MATRIX, padded)).distortion) == 8
    lens = [[0.1], [-0.2], [0.0], [0.001], [0.05]]
    assert read_camera(write_yaml(tmp_path / "d.yml", MATRIX, lens)).distortion == (0.1, -0.2, 0.0, 0.001, 0.05)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"fx": float("nan")}, "fx must be a finite number"),
        ({"fx": 0.0}, "fx must be positive"),
        ({"fy": -3.0}, "fy must be positive"),
        ({"cx": float("inf")}, "cx must be a finite number"),
        ({"width": 0}, "width must be positive"),
        ({"width": 640.5}, "whole number"),
        ({"height": float("nan")}, "whole number"),
        ({"fx": "wide"}, "numbers expected"),
        ({"fx": None}, "numbers expected"),
        ({"fx": 10**400}, "fx must be a finite number"),
        ({"fx": True}, "numbers expected"),
        ({"fx": "500"}, "numbers expected"),
        ({"fx": 1e308}, "fx must be at most"),
        ({"fy": 1e-300}, "fy must be at least"),
        ({"cx": -1e300}, "cx must be at most"),
        ({"width": 99999999999999999999}, "width must be at most"),
        ({"distortion": [1e308, 0, 0, 0]}, "distortion must be at most"),
        ({"distortion": "none"}, "list of numbers expected"),
        ({"distortion": [0.1, 0.2]}, "0, 4, 5 or 8"),
        ({"distortion": 3}, "list of numbers expected"),
        ({"distortion": [float("nan"), 0, 0, 0]}, "finite"),
    ],
)
def test_bad_values_are_named_with_the_file(tmp_path, changes, message):
    with pytest.raises(TwoHandsError, match=rf"bad\.json: .*{message}"):
        read_camera(write_json(tmp_path / "bad.json", **changes))


def test_a_fisheye_lens_is_refused(tmp_path):
    path = write_yaml(tmp_path / "c.yaml", MATRIX, [[0.1], [-0.2], [0.01], [0.001]])
    for value, refused in ((0, False), (1, True)):
        path.write_text(path.read_text().split("fisheye_model")[0] + f"fisheye_model: {value}\n")
        if refused:
            with pytest.raises(DataFormatError, match="fisheye"):
                read_camera(path)
        else:
            assert len(read_camera(path).distortion) == 4


def test_missing_keys_are_named(tmp_path):
    (tmp_path / "c.json").write_text('{"fx": 1, "fy": 1, "width": 4, "height": 4}')
    with pytest.raises(DataFormatError, match="cx, cy missing"):
        read_camera(tmp_path / "c.json")
    with pytest.raises(DataFormatError, match="width, height missing"):
        read_camera(write_yaml(tmp_path / "c.yaml", MATRIX, size=None))
    with pytest.raises(DataFormatError, match="last row"):
        read_camera(write_yaml(tmp_path / "z.yaml", np.zeros((3, 3))))


@pytest.mark.parametrize("name", ["c.json", "c.yaml", "c.txt"])
@pytest.mark.parametrize(
    "text",
    ["", "no camera", "[1, 2]", "%YAML:1.0\n---\nother: 3\n", "%YAML:1.0\n---\ncamera_matrix: 3\n"],
)
def test_other_files_are_refused(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    with pytest.raises(DataFormatError, match=name):
        read_camera(tmp_path / name)


def test_json_of_absurd_depth_is_refused(tmp_path):
    (tmp_path / "c.json").write_text(100_000 * "[")
    with pytest.raises(DataFormatError, match="not JSON"):
        read_camera(tmp_path / "c.json")


def test_lists_in_lists_without_end_are_refused(tmp_path):
    """JSON allows as many levels as Python's stack has; each reader below it needs some, too."""
    for key in ("K", "distortion", "intrinsics", "resolution"):
        (tmp_path / "c.json").write_text(f'{{"{key}": {"[" * 900}1{"]" * 900}}}')
        with pytest.raises(DataFormatError):
            read_camera(tmp_path / "c.json")


def test_missing_and_binary_files_are_refused(tmp_path):
    with pytest.raises(InputError, match="no such camera file"):
        read_camera(tmp_path / "none.json")
    (tmp_path / "b.json").write_bytes(b"{\xff\xfe\x00\x80")
    with pytest.raises(DataFormatError, match="not text in UTF-8"):
        read_camera(tmp_path / "b.json")
    with pytest.raises(InputError, match="cannot be read"):
        read_camera(tmp_path)


def test_a_resized_picture_gets_the_resized_camera():
    camera = PinholeCamera(800, 800, 960, 540, 1920, 1080)
    half = camera_for_image(camera, 960, 540)
    assert (half.fx, half.cx, half.cy, half.width, half.height) == (400, 480, 270, 960, 540)
    assert camera_for_image(camera, 1920, 1080) is camera
    odd = camera_for_image(camera, 1366, 768)  # 768.375 rows, rounded by whoever resized it
    assert (odd.width, odd.height) == (1366, 768)


@pytest.mark.parametrize("size", [(1080, 1920), (540, 960)])
def test_a_camera_of_pictures_held_otherwise_is_refused(size):
    """A telephone's pictures are turned upright as EXIF says; a calibration from its video is of the sensor as it
    lies."""
    with pytest.raises(InputError, match="held upright, or its sides are exchanged"):
        camera_for_image(PinholeCamera(800, 800, 960, 540, 1920, 1080), *size)


@pytest.mark.parametrize("size", [(640, 480), (1920, 1200), (1366, 800)])
def test_another_aspect_ratio_is_refused(size):
    with pytest.raises(InputError, match="another aspect ratio"):
        camera_for_image(PinholeCamera(800, 800, 960, 540, 1920, 1080), *size)


LENS = [0.01, -0.02, 0.0005, -0.0003, 0.0]
PLAIN = {"fx": 250.56, "fy": 250.56, "cx": 320, "cy": 180, "width": 640, "height": 360}
SAME = PinholeCamera(250.56, 250.56, 320.0, 180.0, 640, 360, tuple(LENS))
K = [[250.56, 0.0, 319.5], [0.0, 250.56, 179.5], [0.0, 0.0, 1.0]]
FLAT_K = [number for row in K for number in row]
ROS = f"""# camera of the desk
image_width: 640
image_height: 360
camera_name: desk_cam
camera_matrix:
  rows: 3
  cols: 3
  data: {FLAT_K}
distortion_model: plumb_bob
distortion_coefficients: {{rows: 1, cols: 5, data: {LENS}}}
rectification_matrix:
  rows: 3
  cols: 3
  data: [1., 0., 0., 0., 1., 0., 0., 0., 1.]
projection_matrix:
  rows: 3
  cols: 4
  data: [250., 0., 319., 0., 0., 250., 179., 0., 0., 0., 1., 0.]
"""
ROS_MESSAGE = f"""header:
  seq: 3
  frame_id: "camera"
height: 360
width: 640
distortion_model: "plumb_bob"
D: {LENS}
K: {FLAT_K}
R: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
binning_x: 0
binning_y: 0
roi: {{x_offset: 0, y_offset: 0, height: 0, width: 0, do_rectify: False}}
"""
KALIBR = """cam0:
  T_cam_imu:
  - [0.0, 1.0, 0.0, 0.1]
  camera_model: pinhole
  distortion_coeffs: [0.01, -0.02, 0.0005, -0.0003]
  distortion_model: radtan
  intrinsics: [250.56, 250.56, 319.5, 179.5]
  resolution: [640, 360]
  rostopic: /cam0/image_raw
"""
SLAM = """%YAML:1.0
Camera.type: "PinHole"
Camera.fx: 250.56
Camera.fy: 250.56
Camera.cx: 319.5
Camera.cy: 179.5
Camera.k1: 0.01
Camera.k2: -0.02
Camera.p1: 0.0005
Camera.p2: -0.0003
Camera.width: 640
Camera.height: 360
Camera.fps: 30.0
ORBextractor.nFeatures: 1200
Viewer.PointSize: 2
"""
TUTORIAL = f"""%YAML:1.0
calibration_Time: "Tue Mar  4 10:00:00 2025"
image_Width: 640
image_Height: 360
Camera_Matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: {FLAT_K}
Distortion_Coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: {LENS}
"""
INTERACTIVE = """<?xml version="1.0"?>
<opencv_storage>
<calibrationDate>"Tue Mar  4 10:00:00 2025"</calibrationDate>
<framesCount>30</framesCount>
<cameraResolution>
  640 360</cameraResolution>
<cameraMatrix type_id="opencv-matrix">
  <rows>3</rows><cols>3</cols><dt>d</dt>
  <data>
    250.56 0. 319.5 0. 250.56 179.5 0. 0. 1.</data></cameraMatrix>
<dist_coeffs type_id="opencv-matrix">
  <rows>1</rows><cols>5</cols><dt>d</dt>
  <data>0.01 -0.02 0.0005 -0.0003 0.</data></dist_coeffs>
<avg_reprojection_error>3.1e-01</avg_reprojection_error>
</opencv_storage>
"""
COLMAP = "# Camera list\n# Number of cameras: 1\n1 OPENCV 640 360 250.56 250.56 320 180 0.01 -0.02 0.0005 -0.0003\n"
NERF = {
    "camera_model": "OPENCV", "fl_x": 250.56, "fl_y": 250.56, "cx": 320.0, "cy": 180.0, "w": 640, "h": 360,
    "k1": 0.01, "k2": -0.02, "p1": 0.0005, "p2": -0.0003, "frames": [{"file_path": "a.png"}], "aabb_scale": 16,
}  # fmt: skip
REALSENSE = {
    "width": 640, "height": 360, "fx": 250.56, "fy": 250.56, "ppx": 319.5, "ppy": 179.5, "model": "Brown Conrady",
    "coeffs": LENS,
}  # fmt: skip
ROS2_ECHO = ROS_MESSAGE.lower() + "---\n"
VINS = """%YAML:1.0
---
model_type: PINHOLE
image_width: 640
image_height: 360
distortion_parameters:
   k1: 0.01
   k2: -0.02
   p1: 0.0005
   p2: -0.0003
projection_parameters:
   fx: 250.56
   fy: 250.56
   cx: 319.5
   cy: 179.5
"""
EUROC = """sensor_type: camera
comment: VI-Sensor cam0
T_BS: {cols: 2, rows: 1, data: [1.0, 0.0]}
rate_hz: 20
resolution: [640, 360]
camera_model: pinhole
intrinsics: [250.56, 250.56, 319.5, 179.5]
distortion_model: radial-tangential
distortion_coefficients: [0.01, -0.02, 0.0005, -0.0003]
"""
LENS_BY_NAME = dict(zip(("k1", "k2", "p1", "p2", "k3"), LENS, strict=True))
BASALT = {
    "value0": {
        "intrinsics": [{"camera_type": "pinhole", "intrinsics": {key: PLAIN[key] for key in ("fx", "fy", "cx", "cy")}}],
        "resolution": [[640, 360]],
    }
}
STORAGE = {"type_id": "opencv-matrix", "rows": 3, "cols": 3, "dt": "d", "data": FLAT_K}


@pytest.mark.parametrize(
    "content",
    [
        PLAIN | {"distortion": LENS},
        PLAIN | {"dist_coeffs": LENS},
        PLAIN | {"distortion_coefficients": [LENS]},
        PLAIN | {"distCoeffs": [[value] for value in LENS], "comment": "desk"},
        PLAIN | {"distortion": dict(zip(("k1", "k2", "p1", "p2", "k3"), LENS, strict=True))},
        PLAIN | {"D": LENS_BY_NAME, "fisheye": "no"},
        {"intrinsics": PLAIN, "D": LENS, "rms": 0.3},
        {"camera_matrix": K, "dist_coeff": [LENS], "image_size": [640, 360]},
        {"mtx": K, "dist": LENS, "image_width": 640, "image_height": 360},
        {"K": FLAT_K, "D": LENS, "resolution": {"width": 640, "height": 360}},
        {"cameraMatrix": STORAGE, "distortion": LENS, "w": 640, "h": 360},
        NERF,
        REALSENSE,
        {"model": "OPENCV", "width": 640, "height": 360, "params": [250.56, 250.56, 320, 180, *LENS[:4]]},
        ROS,
        "%YAML:1.0\n---\n" + ROS,
        ROS_MESSAGE,
        ROS2_ECHO,
        VINS,
        EUROC,
        KALIBR,
        KALIBR.replace("cam0", "camera_center"),
        SLAM,
        TUTORIAL,
        INTERACTIVE,
        COLMAP,
    ],
    ids=str,
)
@pytest.mark.parametrize("packed", [False, True])
def test_the_same_camera_in_everybodys_words(tmp_path, content, packed):
    """Names, wrappings and pixel counts of OpenCV, ROS, Kalibr, ORB-SLAM, COLMAP, nerfstudio and RealSense."""
    text = content if isinstance(content, str) else json.dumps(content)
    data = text.encode()
    (tmp_path / "c").write_bytes(gzip.compress(data) if packed else data)
    camera = read_camera(tmp_path / "c")
    assert (*camera.distortion, 0.0)[:5] == SAME.distortion
    for name in PLAIN:
        assert getattr(camera, name) == pytest.approx(getattr(SAME, name), abs=1e-9)


@pytest.mark.parametrize("suffix", [".xml", ".yml", ".json", ".yml.gz"])
@pytest.mark.parametrize("kind", [np.float64, np.float32])
def test_packed_numbers_of_opencv_are_read(tmp_path, suffix, kind):
    """FileStorage's WRITE_BASE64: the matrices' bytes in letters."""
    storage = cv2.FileStorage(str(tmp_path / f"c{suffix}"), cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_BASE64)
    storage.write("image_width", 640)
    storage.write("image_height", 360)
    storage.write("camera_matrix", np.array(K, kind))
    storage.write("distortion_coefficients", np.array([LENS], kind))
    storage.release()
    camera = read_camera(tmp_path / f"c{suffix}")
    assert (camera.fx, camera.cx, *camera.distortion) == pytest.approx((SAME.fx, SAME.cx, *LENS), rel=1e-6)
    text = (tmp_path / "c.json").read_text().replace("MWQg", "MXgg") if suffix == ".json" and kind == np.float64 else ""
    if text:
        (tmp_path / "c.json").write_text(text)
        with pytest.raises(DataFormatError, match="numbers expected"):
            read_camera(tmp_path / "c.json")


def test_basalts_cameras_are_told_by_their_model(tmp_path):
    (tmp_path / "c.json").write_text(json.dumps(BASALT))
    assert read_camera(tmp_path / "c.json") == PinholeCamera(**PLAIN)
    for text, message in (
        (json.dumps(BASALT).replace("pinhole", "kb4"), "lens model 'kb4'"),
        (json.dumps({"value0": {"intrinsics": [{"camera_type": "pinhole"}] * 2}}), "2 cameras in 'intrinsics'"),
    ):
        (tmp_path / "c.json").write_text(text)
        with pytest.raises(DataFormatError, match=message):
            read_camera(tmp_path / "c.json")


FISHEYE_IN_WORDS = {
    "description": "fisheye calibration of the left camera",
    "calibration_method": "cv2.fisheye.calibrate",
    "flags": "CALIB_FISHEYE + CALIB_FIX_SKEW",
    "notes": "Kannala-Brandt, 4 coefficients",
    "camera_name": "FishEye_front",
    "camera": "fisheye_front",
    "camera_id": "equidistant_0",
    "sensor_name": "front fisheye",
    "device": "Omnidirectional 360",
    "comment": ["4 coefficients", "of a fisheye lens"],
}


@pytest.mark.parametrize("key", FISHEYE_IN_WORDS)
def test_a_fisheye_named_in_words_is_not_taken_for_a_pinhole(tmp_path, key):
    """Where nothing else says what the coefficients are; pictures that were undistorted have none."""
    words = {key: FISHEYE_IN_WORDS[key]}
    (tmp_path / "c.json").write_text(json.dumps(PLAIN | words | {"D": LENS[:4]}))
    with pytest.raises(DataFormatError, match=f"'{key}' names a lens that is no pinhole"):
        read_camera(tmp_path / "c.json")
    for right in ({"D": LENS, "distortion_model": "plumb_bob"}, {}):
        (tmp_path / "c.json").write_text(json.dumps(PLAIN | words | right))
        assert read_camera(tmp_path / "c.json").fx == PLAIN["fx"]


@pytest.mark.parametrize("name", ["fisheye_front", "equidistant", "Kannala-Brandt"])
@pytest.mark.parametrize("wrapping", [lambda named: named, lambda named: [named]], ids=["alone", "in a list"])
def test_a_fisheye_named_by_the_key_around_it_is_not_taken_for_a_pinhole(tmp_path, name, wrapping):
    def write(record):
        (tmp_path / "c.json").write_text(json.dumps(wrapping({name: record})))
        return tmp_path / "c.json"

    for record in (PLAIN | {"D": LENS[:4]}, {"cam0": PLAIN | {"D": LENS[:4]}}):
        with pytest.raises(DataFormatError, match=f"'{name}' names a lens that is no pinhole"):
            read_camera(write(record))
    for right in ({"D": LENS, "distortion_model": "plumb_bob"}, {}):
        assert read_camera(write(PLAIN | right)).fx == PLAIN["fx"]


def test_a_part_alone_in_a_file_keeps_its_meaning(tmp_path):
    """VINS counts cx and cy from the first pixel's centre, also where size and lens stand beside them."""
    (tmp_path / "c.json").write_text(json.dumps({"projection_parameters": PLAIN}))
    camera = read_camera(tmp_path / "c.json")
    assert (camera.cx, camera.cy) == (PLAIN["cx"] + 0.5, PLAIN["cy"] + 0.5)


def test_pictures_with_lenses_of_their_own_are_several_cameras(tmp_path):
    """nerfstudio's frames may say each one's camera, which was left out."""
    for lens, message in (
        ({"fl_x": 300}, "fl_x both say what fx is"),
        ({"camera_model": "OPENCV_FISHEYE"}, "OPENCV_FISHEYE"),
        ({"k1": 0.3}, "k1 both say"),
    ):
        (tmp_path / "c.json").write_text(json.dumps(NERF | {"frames": [{"file_path": "a.png", **lens}]}))
        with pytest.raises(DataFormatError, match=message):
            read_camera(tmp_path / "c.json")
    same = {key: NERF[key] for key in ("fl_x", "w", "k1", "camera_model")}
    (tmp_path / "c.json").write_text(json.dumps(NERF | {"frames": [{"file_path": "a.png", **same}] * 3}))
    assert read_camera(tmp_path / "c.json").distortion == tuple(LENS[:4])


def test_utf_16_without_its_mark_is_named(tmp_path):
    (tmp_path / "c.json").write_bytes(json.dumps(PLAIN).encode("utf-16-le"))
    with pytest.raises(DataFormatError, match="UTF-16 and UTF-32 need a byte order mark"):
        read_camera(tmp_path / "c.json")


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-32"])
def test_byte_order_marks_are_read(tmp_path, encoding):
    (tmp_path / "c.json").write_bytes(json.dumps(PLAIN | {"note": "Übung"}).encode(encoding))
    assert read_camera(tmp_path / "c.json") == PinholeCamera(**PLAIN)


FISHEYES = ["fisheye", "equidistant", "KannalaBrandt8", "kannala_brandt", "kb4", "omni", "MEI", "eucm", "ds", "fov"]


@pytest.mark.parametrize("model", [*FISHEYES, "OPENCV_FISHEYE", "THIN_PRISM_FISHEYE", "equirectangular", "ftheta"])
@pytest.mark.parametrize(
    "key", ["distortion_model", "camera_model", "Camera.type", "model", "lens_model", "projection"]
)
def test_another_lens_model_is_refused_by_its_name(tmp_path, key, model):
    """Taken as k1, k2, p1, p2, its coefficients bend rays by 15 degrees without a word."""
    for content in (PLAIN | {"distortion": LENS, key: model}, {key: model, "K": K, "D": LENS[:4], "w": 640, "h": 360}):
        (tmp_path / "c.json").write_text(json.dumps(content))
        with pytest.raises(DataFormatError, match=f"lens model '{model}'"):
            read_camera(tmp_path / "c.json")


@pytest.mark.parametrize("model", ["plumb_bob", "radtan", "rational_polynomial", "pinhole", "OPENCV", "none"])
def test_names_of_opencvs_own_model_are_read(tmp_path, model):
    (tmp_path / "c.json").write_text(json.dumps(PLAIN | {"distortion": LENS, "distortion_model": model}))
    assert read_camera(tmp_path / "c.json") == SAME


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (KALIBR.replace("radtan", "equidistant"), "lens model 'equidistant'"),
        (KALIBR + KALIBR.replace("cam0", "cam1"), "2 cameras"),
        (COLMAP.replace("OPENCV", "OPENCV_FISHEYE"), "OPENCV_FISHEYE"),
        (COLMAP + "2 PINHOLE 640 360 250 250 320 180", "2 cameras"),
        (NERF | {"is_fisheye": True}, "fisheye"),
        (NERF | {"k4": 0.1}, "k4 without k5"),
        ("Camera:\n  setup: monocular\n  model: fisheye\n  fx: 250\n", "lens model 'fisheye'"),
        (PLAIN | {"fisheye": 1.0}, "fisheye lens"),
        (KALIBR.replace("cam0", "camera_center").replace("pinhole", "omni"), "lens model 'omni'"),
        (ROS_MESSAGE + "---\n" + ROS_MESSAGE, "several documents"),
        (REALSENSE | {"model": "Inverse Brown Conrady"}, "Inverse Brown Conrady"),
        (ROS_MESSAGE.replace("binning_x: 0", "binning_x: 2"), "binning"),
        (ROS_MESSAGE.replace("x_offset: 0", "x_offset: 16"), "region of interest"),
        ({"K": np.transpose(K).tolist(), "w": 640, "h": 360}, "transposed"),
        ({"IntrinsicMatrix": np.transpose(K).tolist(), "w": 640, "h": 360}, "transposed"),
        ({"K": [[250, 40, 320], [0, 250, 180], [0, 0, 1]], "w": 640, "h": 360}, "skew of 40"),
        ({"K": [[250, 0, 320], [3, 250, 180], [0, 0, 1]], "w": 640, "h": 360}, "skew of 3"),
        ({"K": [[250, 0, 320], [0, 250, 180], [0, 0, 0]], "w": 640, "h": 360}, "last row"),
        ({"K": [[250, 0, 320], [0, 250, 180]], "w": 640, "h": 360}, "3x3"),
        ({"K": [[-250, 0, 320], [0, 250, 180], [0, 0, 1]], "w": 640, "h": 360}, "fx must be positive"),
        ({"K": K, "w": 640, "h": 360, "fx": 300}, "both say what fx is"),
        (PLAIN | {"lens_distortion_k": LENS}, "unknown key 'lens_distortion_k'"),
        (PLAIN | {"RadialDistortion": [0.1, 0.2]}, "unknown key 'RadialDistortion'"),
        (PLAIN | {"focal_mm": 4.2}, "unknown key 'focal_mm'"),
        (PLAIN | {"distortion": LENS, "D": [0.5, 0, 0, 0]}, "distortion is, differently"),
        (PLAIN | {"distortion": LENS, "k1": 0.5}, "distortion both"),
        (PLAIN | {"distortion": [*LENS, 0, 0, 0, 0.1, 0.2, 0.3, 0.4]}, "0, 4, 5 or 8"),
        ('{"fx": 1, "fx": 2}', "'fx' is there twice"),
        ("fx: 1\nfx: 2\n", "'fx' is there twice"),
        ("a: &a [1]\nb: *a\n", "anchors"),
        ("[" * 1000, "not JSON"),
        ("a:\n" + "".join(" " * i + "- \n" for i in range(1, 50)), "levels deep|not YAML"),
        (INTERACTIVE.replace("<opencv", '<!DOCTYPE a [<!ENTITY b "c">]><opencv', 1), "declarations"),
        (INTERACTIVE.replace("opencv_storage", "calibration"), "not of OpenCV"),
        (INTERACTIVE[:200], "not XML"),
        ("PK\x03\x04 numpy's", "numpy"),
        ("[camera]\nfx = 500\n", "an INI or TOML file"),
        ("[LEFT_CAM_HD]\nfx=500\n", "an INI or TOML file"),
        ("# oST version 5.0 parameters\n\n\n[image]\n\nwidth\n640\n", "an INI or TOML file"),
        ("# made by hand\nD = [0.1, 0.2]\nK = [500.0, 0.0]\n", "an INI or TOML file"),
        (ROS.replace("rows: 3\n  cols: 3\n  data: [250", "rows: 4\n  cols: 3\n  data: [250"), "4x3 numbers announced"),
    ],
    ids=str,
)
def test_what_would_be_lost_or_misread_is_named(tmp_path, content, message):
    (tmp_path / "c.yaml").write_text(content if isinstance(content, str) else json.dumps(content))
    with pytest.raises(TwoHandsError, match=rf"c\.yaml: .*{message}"):
        read_camera(tmp_path / "c.yaml")


def test_many_comments_take_no_time(tmp_path):
    """Each # may begin a comment: a pattern that tries them all takes for ever."""
    text = "#" * 200 + "\n" + "#\n" * 200 + "".join(f"{key}: {value}\n" for key, value in PLAIN.items())
    (tmp_path / "c.yaml").write_text(text)
    assert read_camera(tmp_path / "c.yaml") == PinholeCamera(**PLAIN)


@pytest.mark.parametrize("factor", [2, -1, 1e-6, 1 / 250.56])
def test_a_homogeneous_matrix_is_scaled(tmp_path, factor):
    matrix = factor * np.array(K)
    (tmp_path / "c.json").write_text(json.dumps({"K": matrix.tolist(), "D": LENS, "w": 640, "h": 360}))
    camera = read_camera(tmp_path / "c.json")
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == pytest.approx((SAME.fx, SAME.fy, SAME.cx, SAME.cy))


def test_rounding_of_a_matrix_is_no_skew(tmp_path):
    """A product of matrices in float32 has zeros of this size."""
    rounded = [[250.56, 3e-6, 319.5], [-2e-6, 250.56, 179.5], [1e-10, -3e-9, 1.0]]
    (tmp_path / "c.json").write_text(json.dumps({"K": rounded, "D": LENS, "w": 640, "h": 360}))
    assert read_camera(tmp_path / "c.json") == SAME


@pytest.mark.parametrize(("size", "packed"), [(5 << 20, False), (20 << 20, True)])
def test_large_files_are_refused_unread(tmp_path, size, packed):
    data = b" " * size
    (tmp_path / "c.json").write_bytes(gzip.compress(data, 1) if packed else data)
    with pytest.raises(DataFormatError, match="more than 4 MiB"):
        read_camera(tmp_path / "c.json")


@pytest.mark.skipif(not FIELD.is_dir(), reason="../shared/field is not here")
def test_the_cases_from_the_field():
    """Cases 05, 06, 08 and 09 of its README."""
    lens = {"dist_coeffs": [0.2, -0.02, 0.0005, -0.0003, 0.0]}
    lens["distortion_coefficients"] = lens["dist_coeffs"]
    for path in [path for case in ("08", "09") for path in FIELD.glob(f"{case}-*/*")]:
        expected = PinholeCamera(**PLAIN, distortion=lens.get(path.stem, LENS))
        assert read_camera(path) == expected, path
    assert read_camera(FIELD / "06-camera-matrix" / "scaled.yaml") == PinholeCamera(**PLAIN)
    refused = {"matlab_transposed.yaml": "transposed", "skew.yaml": "skew"}
    refused |= {path.name: "lens model" for path in FIELD.glob("05-*/*")}
    for name, message in refused.items():
        with pytest.raises(DataFormatError, match=message):
            read_camera(next(FIELD.glob(f"0[56]-*/{name}")))
