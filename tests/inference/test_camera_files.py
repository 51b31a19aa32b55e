"""Camera files, and cameras at the size of a picture."""

import json

import cv2
import numpy as np
import pytest

from twohands.errors import DataFormatError, InputError, TwoHandsError
from twohands.inference.camera_files import camera_for_image, read_camera
from twohands.types import PinholeCamera

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
        ({"fx": 10**400}, "numbers expected"),
        ({"distortion": [0.1, 0.2]}, "0, 4, 5 or 8"),
        ({"distortion": 3}, "numbers expected"),
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
    with pytest.raises(InputError, match="fx must be positive"):
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


def test_missing_and_binary_files_are_refused(tmp_path):
    with pytest.raises(InputError, match="no such camera file"):
        read_camera(tmp_path / "none.json")
    (tmp_path / "b.json").write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(InputError, match="cannot be read"):
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


@pytest.mark.parametrize("size", [(640, 480), (1080, 1920), (1920, 1200), (1366, 800)])
def test_another_aspect_ratio_is_refused(size):
    with pytest.raises(InputError, match="another aspect ratio"):
        camera_for_image(PinholeCamera(800, 800, 960, 540, 1920, 1080), *size)
