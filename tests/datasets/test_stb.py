"""STB's reader on a fake of its format. No true STB labels are at hand."""

from pathlib import Path

import numpy as np
import pytest
from tests.datasets.facts import UP, by_name, check_hands, curled_hand, cut_off, write_picture

from twohands.datasets.base import HandDataset
from twohands.datasets.stb import SEQUENCES, STB, left_camera
from twohands.errors import DataFormatError, InputError, MissingExtraError
from twohands.skeleton import LEFT, RIGHT, ROOT, WRIST

scipy_io = pytest.importorskip("scipy.io")

ORDER = by_name(["wrist", *(f"{f}_{i}" for f in ("little", "ring", "middle", "index", "thumb") for i in UP)])


def hand(frame: int) -> np.ndarray:
    return curled_hand(LEFT, (0.01 * frame, 0.02, 0.6))


def write_stb(root: Path, frames: int = 2) -> None:
    (root / "labels").mkdir(parents=True)
    for shift, sequence in enumerate(SEQUENCES["test"]):
        mm = np.stack([1e3 * hand(frame + 10 * shift)[ORDER].T for frame in range(frames)], axis=-1)  # (3, 21, N)
        scipy_io.savemat(root / "labels" / f"{sequence}_BB.mat", {"handPara": mm.astype(np.float32)})
        for frame in range(frames):
            write_picture(root / "images" / sequence / f"BB_left_{frame}.png", 640, 480)


def test_left_hands_in_metres_in_our_order(tmp_path: Path) -> None:
    write_stb(tmp_path)
    dataset = STB(tmp_path)
    assert isinstance(dataset, HandDataset) and (dataset.name, len(dataset)) == ("STB test", 4)
    sample = dataset[3]
    assert sample.source == "B1Random/BB_left_1.png"
    np.testing.assert_array_equal(sample.present, [True, False])
    np.testing.assert_allclose(sample.joints_m[LEFT], hand(11), atol=1e-7)
    assert np.isnan(sample.joints_px[RIGHT]).all()
    np.testing.assert_array_equal(sample.image[0, 0], [200, 100, 50])
    check_hands(sample)


def test_pixels_count_from_the_corner(tmp_path: Path) -> None:
    """On the axis of the published camera, (318.47345, 250.31296) from the first pixel's centre."""
    write_stb(tmp_path, frames=1)
    sample = STB(tmp_path)[0]
    x, y, z = hand(0)[ROOT]
    expected = [822.79041 * x / z + 318.97345, 822.79041 * y / z + 250.81296]
    np.testing.assert_allclose(sample.joints_px[LEFT, ROOT], expected, atol=1e-4)
    assert (left_camera().width, left_camera().height) == (640, 480)


def test_joint_zero_is_the_palm_or_lies_twice_as_far(tmp_path: Path) -> None:
    write_stb(tmp_path, frames=1)
    palm, wrist = STB(tmp_path)[0].joints_m[LEFT], STB(tmp_path, joint_zero="wrist")[0].joints_m[LEFT]
    np.testing.assert_allclose(wrist[WRIST] - palm[ROOT], 2 * (palm[WRIST] - palm[ROOT]), atol=1e-12)
    np.testing.assert_array_equal(wrist[1:], palm[1:])
    assert np.linalg.norm(palm[WRIST] - palm[ROOT]) == pytest.approx(0.09, abs=1e-7)
    check_hands(STB(tmp_path)[0])  # reading with the other joint changed nothing here


def test_split_is_background_1_against_the_others() -> None:
    assert SEQUENCES["test"] == ("B1Counting", "B1Random")
    assert len(SEQUENCES["train"]) == 10 and not set(SEQUENCES["train"]) & set(SEQUENCES["test"])
    assert {name[:2] for name in SEQUENCES["train"]} == {"B2", "B3", "B4", "B5", "B6"}


@pytest.mark.parametrize("keep", [0.0, 0.5, 0.95])
def test_cut_off_files_are_named(tmp_path: Path, keep: float) -> None:
    write_stb(tmp_path)
    cut_off(tmp_path / "images" / "B1Counting" / "BB_left_1.png", keep)
    dataset = STB(tmp_path)
    dataset[0]
    with pytest.raises(DataFormatError, match=r"BB_left_1\.png"):
        dataset[1]
    cut_off(tmp_path / "labels" / "B1Random_BB.mat", keep)
    with pytest.raises(DataFormatError, match=r"B1Random_BB\.mat: [^\n]*$"):
        STB(tmp_path)


def test_other_labels_and_missing_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such folder"):
        STB(tmp_path / "nowhere")
    with pytest.raises(DataFormatError, match=r"B1Counting_BB\.mat: no such file"):
        STB(tmp_path)
    write_stb(tmp_path)
    write_picture(tmp_path / "images" / "B1Counting" / "BB_left_0.png", 320, 240)
    with pytest.raises(DataFormatError, match="expected 640x480"):
        STB(tmp_path)[0]
    path = tmp_path / "labels" / "B1Counting_BB.mat"
    for content in ({"other": np.zeros((3, 21, 2))}, {"handPara": np.zeros((3, 20, 2))}, {"handPara": "text"}):
        scipy_io.savemat(path, content)
        with pytest.raises(DataFormatError, match=r"B1Counting_BB\.mat"):
            STB(tmp_path)
    with pytest.raises(InputError, match="train or test"):
        STB(tmp_path, "evaluation")  # type: ignore[arg-type]


def test_without_scipy_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_stb(tmp_path)
    monkeypatch.setitem(__import__("sys").modules, "scipy.io", None)
    with pytest.raises(MissingExtraError, match="datasets"):
        STB(tmp_path)
