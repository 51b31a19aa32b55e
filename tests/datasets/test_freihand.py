"""FreiHAND's reader on a fake of its format, and the order of the true 2D sample."""

import json
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
from tests.datasets.facts import check_hands, curled_hand, cut_off, huge_jpeg, write_picture

from twohands.datasets.base import HandDataset
from twohands.datasets.freihand import BACKGROUNDS, FreiHAND
from twohands.errors import DataFormatError, InputError
from twohands.skeleton import RIGHT, ROOT

K = [[480.0, 0.0, 112.0], [0.0, 470.0, 112.0], [0.0, 0.0, 1.0]]


def hand(index: int) -> np.ndarray:
    return curled_hand(RIGHT, (0.01 * index, 0.0, 0.7))


def write_freihand(root: Path, count: int = 2) -> None:
    for split, versions in (("training", 4), ("evaluation", 1)):
        (root / f"{split}_xyz.json").write_text(json.dumps([hand(i).tolist() for i in range(count)]))
        (root / f"{split}_K.json").write_text(json.dumps([K] * count))
        for index in range(versions * count):
            write_picture(root / split / "rgb" / f"{index:08d}.jpg", 224, 224, (20 * index, 0, 0))


def test_right_hands_with_their_own_camera(tmp_path: Path) -> None:
    write_freihand(tmp_path)
    dataset = FreiHAND(tmp_path)
    assert isinstance(dataset, HandDataset) and (dataset.name, len(dataset)) == ("FreiHAND evaluation", 2)
    sample = dataset[1]
    assert sample.source == "evaluation/rgb/00000001.jpg"
    np.testing.assert_array_equal(sample.present, [False, True])
    np.testing.assert_array_equal(sample.joints_m[RIGHT], hand(1))
    # 480 * 0.01 / 0.7 + 112.5 and 470 * 0 + 112.5
    np.testing.assert_allclose(sample.joints_px[RIGHT, ROOT], [480 / 70 + 112.5, 112.5], rtol=1e-12)
    check_hands(sample)
    np.testing.assert_array_equal(dataset[-1].joints_m, sample.joints_m)
    with pytest.raises(IndexError):
        dataset[2]


def test_every_background_belongs_to_the_same_hands(tmp_path: Path) -> None:
    write_freihand(tmp_path)
    for version, background in enumerate(BACKGROUNDS):
        sample = FreiHAND(tmp_path, "training", background=background)[1]  # type: ignore[arg-type]
        assert sample.source == f"training/rgb/{2 * version + 1:08d}.jpg"
        assert abs(int(sample.image[100, 100, 0]) - 20 * (2 * version + 1)) < 5  # JPEG
        np.testing.assert_array_equal(sample.joints_m[RIGHT], hand(1))
    with pytest.raises(InputError, match="no version 'auto'"):
        FreiHAND(tmp_path, "evaluation", background="auto")


@pytest.mark.parametrize("keep", [0.0, 0.5, 0.95])
@pytest.mark.parametrize("name", ["evaluation_xyz.json", "evaluation_K.json", "evaluation/rgb/00000000.jpg"])
def test_cut_off_files_are_named(tmp_path: Path, name: str, keep: float) -> None:
    write_freihand(tmp_path)
    cut_off(tmp_path / name, keep)
    with pytest.raises(DataFormatError, match=rf"{name}: [^\n]*$"):
        FreiHAND(tmp_path)[0]


def test_labels_that_do_not_fit_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such folder"):
        FreiHAND(tmp_path / "nowhere")
    with pytest.raises(DataFormatError, match=r"evaluation_xyz\.json: no such JSON file"):
        FreiHAND(tmp_path)
    write_freihand(tmp_path)
    (tmp_path / "evaluation_K.json").write_text(json.dumps([K] * 3))
    with pytest.raises(DataFormatError, match="got 3 for 2"):
        FreiHAND(tmp_path)
    skewed = [[480.0, 1.0, 112.0], *K[1:]]
    for matrix, message in ((skewed, r"expected K = "), ([1.0], r"shape \(3, 3\)"), (None, "entry 0")):
        (tmp_path / "evaluation_K.json").write_text(json.dumps([matrix, K]))
        with pytest.raises(DataFormatError, match=message):
            FreiHAND(tmp_path)[0]
    (tmp_path / "evaluation_K.json").write_text(json.dumps([[[-480.0, 0, 112.0], *K[1:]], K]))
    with pytest.raises(DataFormatError, match="fx must be positive"):
        FreiHAND(tmp_path)[0]
    (tmp_path / "evaluation_K.json").write_text("{}")
    with pytest.raises(DataFormatError, match="expected a JSON list, got a dict"):
        FreiHAND(tmp_path)


def test_a_jpeg_that_says_to_be_huge_is_named(tmp_path: Path) -> None:
    """Named case: 60,000 by 60,000 pixels were OpenCV's own error."""
    write_freihand(tmp_path)
    path = tmp_path / "evaluation" / "rgb" / "00000000.jpg"
    path.write_bytes(huge_jpeg(path.read_bytes()))
    with pytest.raises(DataFormatError, match=r"00000000\.jpg: not a JPG file that can be decoded"):
        FreiHAND(tmp_path)[0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[" * 200_000, r"evaluation_K\.json: not JSON"),
        (f"[[[1{'0' * 400}, 0, 1], [0, 1, 1], [0, 0, 1]], 0]", "entry 0: expected an array of numbers"),
    ],
)
def test_json_that_python_cannot_hold_is_named(tmp_path: Path, text: str, message: str) -> None:
    """Named case: brackets without end and integers of 400 digits were errors of the interpreter."""
    write_freihand(tmp_path)
    (tmp_path / "evaluation_K.json").write_text(text)
    with pytest.raises(DataFormatError, match=message):
        FreiHAND(tmp_path)[0]


def write_true_sample(source: Path, root: Path) -> None:
    """Pictures (linked) and 2D labels of the true sample in FreiHAND's layout below `root`.

    K and 3D are not in it: every hand is made flat, 0.6 m away, on the rays of its 2D labels.
    """
    labels = json.loads((source / "test_freihand.json").read_text())["annotations"]
    files = sorted(source.glob("*.jpg"))
    by_number = {a["image_id"]: np.reshape(a["keypoints"], (21, 3))[:, :2] for a in labels}
    (root / "evaluation" / "rgb").mkdir(parents=True)
    hands = []
    for index, path in enumerate(files):
        slopes = (by_number[int(path.stem)] - np.array(K)[:2, 2]) / np.diag(K)[:2]
        hands.append((0.6 * np.column_stack([slopes, np.ones(21)])).tolist())
        (root / "evaluation" / "rgb" / f"{index:08d}.jpg").symlink_to(path)
    (root / "evaluation_xyz.json").write_text(json.dumps(hands))
    (root / "evaluation_K.json").write_text(json.dumps([K] * len(files)))


class TestTrueSample:
    """Eight true pictures with 2D labels in the data set's own order (an extract without K and 3D)."""

    @pytest.fixture
    def joints_px(self, shared_data: Path) -> dict[int, np.ndarray]:
        content = json.loads((shared_data / "official" / "freihand" / "test_freihand.json").read_text())
        return {a["image_id"]: np.reshape(a["keypoints"], (21, 3))[:, :2] for a in content["annotations"]}

    def test_pictures_repeat_their_labels_every_32560(self, joints_px: dict[int, np.ndarray]) -> None:
        assert {number % 32560 for number in joints_px} == {17620, 355}
        for number, joints in joints_px.items():
            np.testing.assert_allclose(joints, joints_px[number % 32560], atol=1e-9)

    def test_joint_order_is_ours(self, joints_px: dict[int, np.ndarray]) -> None:
        """Wrist, thumb, ..., little, each base to tip: joining a finger's joints in any other order is a longer way."""

        def shortest(points: np.ndarray) -> tuple[int, ...]:
            """Order of the points on the shortest way from the first."""
            ways = [(0, *rest) for rest in permutations(range(1, len(points)))]
            return min(ways, key=lambda way: np.linalg.norm(np.diff(points[list(way)], axis=0), axis=1).sum())

        for number in (17620, 355):
            joints = joints_px[number]
            for base in (1, 5, 9, 13, 17):
                assert shortest(joints[base : base + 4]) == (0, 1, 2, 3)
            assert shortest(joints[[5, 9, 13, 17]]) == (0, 1, 2, 3)  # knuckles side by side
            assert np.linalg.norm(joints[[1, 5, 9, 13, 17]] - joints[0], axis=1).argmin() == 0  # the thumb's
