"""InterHand2.6M's reader on a fake of its format and on four true pictures."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from tests.datasets.facts import DOWN, by_name, check_hands, curled_hand, cut_off, write_picture

from twohands.datasets.base import HandDataset
from twohands.datasets.interhand import InterHand
from twohands.errors import DataFormatError, InputError
from twohands.skeleton import FINGERS, LEFT, RIGHT, ROOT

ORDER = by_name([*(f"{f}_{i}" for f in FINGERS for i in DOWN), "wrist"])
ROTATION = cv2.Rodrigues(np.array([0.3, -0.8, 0.2]))[0]
POSITION_MM = np.array([120.0, -40.0, 300.0])
HANDS_M = np.stack([curled_hand(LEFT, (-0.1, 0.02, 1.0)), curled_hand(RIGHT, (0.1, 0.0, 1.1))])
FOCAL, PRINCIPAL_POINT = (1260.0, 1250.0), (170.0, 250.0)


def content(hand_type: str = "interacting", valid: tuple[int, int] = (1, 1), trusted: int = 1) -> dict[str, Any]:
    """The three files of one picture; valid is (left, right)."""
    cam_mm = 1e3 * np.concatenate([HANDS_M[RIGHT][ORDER], HANDS_M[LEFT][ORDER]])  # right hand first
    world_mm = cam_mm @ ROTATION + POSITION_MM  # rows of R^T X + c
    picture = {
        "id": 7,
        "file_name": "Capture0/seq/cam400012/image42.jpg",
        "width": 334,
        "height": 512,
        "capture": 0,
        "camera": "400012",
        "frame_idx": 42,
    }
    annotation = {
        "id": 70,
        "image_id": 7,
        "joint_valid": [[valid[1]]] * 21 + [[valid[0]]] * 21,
        "hand_type": hand_type,
        "hand_type_valid": trusted,
    }
    camera = {"campos": POSITION_MM.tolist(), "camrot": ROTATION.tolist(), "focal": FOCAL, "princpt": PRINCIPAL_POINT}
    return {
        "data": {"images": [picture], "annotations": [annotation]},
        "camera": {"0": {key: {"400012": value} for key, value in camera.items()}},
        "joint_3d": {"0": {"42": {"world_coord": world_mm.tolist()}}},
    }


def write_interhand(root: Path, files: dict[str, Any], folder: str = "test") -> None:
    annotations = root / "annotations" / folder
    annotations.mkdir(parents=True, exist_ok=True)
    for what, value in files.items():
        (annotations / f"InterHand2.6M_test_{what}.json").write_text(json.dumps(value))
    write_picture(root / "images" / "test" / "Capture0" / "seq" / "cam400012" / "image42.jpg", 334, 512)


def test_world_millimetres_become_camera_metres(tmp_path: Path) -> None:
    write_interhand(tmp_path, content())
    dataset = InterHand(tmp_path)
    assert isinstance(dataset, HandDataset) and (dataset.name, len(dataset)) == ("InterHand2.6M test", 1)
    sample = dataset[0]
    assert sample.source == "Capture0/seq/cam400012/image42.jpg" and sample.present.all()
    np.testing.assert_allclose(sample.joints_m, HANDS_M, atol=1e-12)
    # 1260 * -0.1 / 1 + 170.5, 1250 * 0.02 / 1 + 250.5
    np.testing.assert_allclose(sample.joints_px[LEFT, ROOT], [44.5, 275.5], atol=1e-9)
    check_hands(sample)


@pytest.mark.parametrize(("hand_type", "present"), [("left", [True, False]), ("right", [False, True])])
def test_one_hand(tmp_path: Path, hand_type: str, present: list[bool]) -> None:
    write_interhand(tmp_path, content(hand_type, valid=(int(present[LEFT]), int(present[RIGHT]))))
    sample = InterHand(tmp_path)[0]
    np.testing.assert_array_equal(sample.present, present)
    check_hands(sample)


def test_a_distrusted_hand_type_gives_way_to_the_labels(tmp_path: Path) -> None:
    write_interhand(tmp_path, content(valid=(0, 1), trusted=0))
    np.testing.assert_array_equal(InterHand(tmp_path)[0].present, [False, True])
    write_interhand(tmp_path, content(valid=(0, 1), trusted=1))
    sample = InterHand(tmp_path)[0]  # there, but nothing is known of it
    np.testing.assert_array_equal(sample.present, [True, True])
    assert not sample.valid[LEFT].any() and np.isnan(sample.joints_m[LEFT]).all()


def test_single_joints_may_be_unlabelled(tmp_path: Path) -> None:
    files = content()
    files["data"]["annotations"][0]["joint_valid"][20] = [0]  # the right wrist, 21st of the first hand
    write_interhand(tmp_path, files)
    sample = InterHand(tmp_path)[0]
    assert not sample.valid[RIGHT, 0] and np.isnan(sample.joints_px[RIGHT, 0]).all()
    assert sample.valid.sum() == 41


def test_older_releases_keep_labels_in_subsets(tmp_path: Path) -> None:
    write_interhand(tmp_path, content(), folder="human_annot")
    assert len(InterHand(tmp_path, subset="human_annot")) == 1
    with pytest.raises(DataFormatError, match=r"InterHand2\.6M_test_data\.json: no such JSON file"):
        InterHand(tmp_path)


@pytest.mark.parametrize("keep", [0.0, 0.5, 0.95])
@pytest.mark.parametrize("what", ["data", "camera", "joint_3d", "picture"])
def test_cut_off_files_are_named(tmp_path: Path, what: str, keep: float) -> None:
    write_interhand(tmp_path, content())
    labels = tmp_path / "annotations" / "test" / f"InterHand2.6M_test_{what}.json"
    path = labels if labels.is_file() else tmp_path / "images/test/Capture0/seq/cam400012/image42.jpg"
    cut_off(path, keep)
    with pytest.raises(DataFormatError, match=rf"{path.name}: [^\n]*$"):
        InterHand(tmp_path)[0]


def test_files_that_do_not_fit_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such folder"):
        InterHand(tmp_path / "nowhere")

    def refused(message: str, **changed: Any) -> None:
        write_interhand(tmp_path, {**content(), **changed})
        with pytest.raises(DataFormatError, match=message):
            InterHand(tmp_path)[0]

    refused(r"annotation 70 .*'0'", camera={})
    refused(r"annotation 70 .*'42'", joint_3d={"0": {}})
    refused(
        r"world_coord: expected finite numbers of shape \(42, 3\)", joint_3d={"0": {"42": {"world_coord": [[1.0]]}}}
    )
    ragged = content()["data"]
    ragged["annotations"][0]["joint_valid"] = [[1], [1, 1]]
    refused("annotation 70 ", data=ragged)
    refused("expected the lists images and annotations", data={"images": []})
    refused("holds no annotation", data={"images": [], "annotations": []})
    refused("expected a hand type", data=content(hand_type="foot")["data"])
    data = content()["data"]
    data["images"][0]["width"] = 512
    refused("expected 512x512 pixels", data=data)
    data["images"][0]["file_name"] = "image.bmp"
    refused(r"ends in \.png or \.jpg", data=data)


class TestTrueSample:
    """Four true pictures; the files carry other names, nothing else is changed."""

    @pytest.fixture
    def dataset(self, shared_data: Path, tmp_path: Path) -> InterHand:
        source = shared_data / "official" / "interhand2.6m"
        (tmp_path / "annotations" / "test").mkdir(parents=True)
        for what in ("data", "camera", "joint_3d"):
            target = tmp_path / "annotations" / "test" / f"InterHand2.6M_test_{what}.json"
            target.symlink_to(source / f"test_interhand2.6m_{what}.json")
        (tmp_path / "images").mkdir()
        (tmp_path / "images" / "test").symlink_to(source, target_is_directory=True)
        return InterHand(tmp_path)

    def test_hands_are_where_they_belong(self, dataset: InterHand) -> None:
        present = [sample.present.tolist() for sample in dataset]  # type: ignore[attr-defined]
        assert present == [[True, True], [True, True], [True, False], [False, True]]
        for sample in dataset:  # type: ignore[attr-defined]
            check_hands(sample)

    def test_projections_fill_the_published_box(self, dataset: InterHand, shared_data: Path) -> None:
        """It is that of the joints, widened by a tenth of their extent on every side, half a pixel off our count."""
        path = shared_data / "official" / "interhand2.6m" / "test_interhand2.6m_data.json"
        for sample, annotation in zip(dataset, json.loads(path.read_text())["annotations"], strict=True):  # type: ignore[call-overload]
            x, y, width, height = annotation["bbox"]
            low, high = np.nanmin(sample.joints_px, axis=(0, 1)), np.nanmax(sample.joints_px, axis=(0, 1))
            margin = 0.1 * (high - low)
            np.testing.assert_allclose(low - margin, [x + 0.5, y + 0.5], atol=1e-3)
            np.testing.assert_allclose(high + margin, [x + width + 0.5, y + height + 0.5], atol=1e-3)
