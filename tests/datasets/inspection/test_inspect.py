"""Integrity checks: silent on sound data, and every kind of damage is found and named."""

import re
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from tests.datasets import fakes

from twohands.datasets.ego3dhands import Ego3DHands
from twohands.datasets.inspection.contact_sheet import contact_sheet, draw_joints
from twohands.datasets.inspection.inspect import inspect_dataset
from twohands.formats import ego3dhands as fmt


def test_sound_dataset_has_no_problem(tmp_path: Path) -> None:
    fakes.write_instance(tmp_path / "0")
    fakes.write_instance(tmp_path / "1", left=False)
    fakes.write_instance(tmp_path / "2", left=False, right=False)
    (tmp_path / "2" / fmt.DEPTH_FILE).unlink()
    done: list[int] = []
    report = inspect_dataset(Ego3DHands(tmp_path), done.append)
    assert report.problems == ()
    assert done == [1, 2, 3]
    assert report.presence == {"both": 1, "left only": 0, "right only": 1, "none": 1}
    assert report.image_sizes == {(fakes.WIDTH, fakes.HEIGHT): 3}
    assert report.missing_files == {fmt.DEPTH_FILE: 1}
    assert report.reprojection_px < 1e-9
    assert report.surface_gap_m == pytest.approx(0.005, abs=2e-3)
    # roots at (-0.1, 0.02, 0.30), (0.08, 0, 0.35) twice
    near, far = np.linalg.norm([0.1, 0.02, 0.30]), np.linalg.norm([0.08, 0.0, 0.35])
    np.testing.assert_allclose(report.range_m, (near, far, far), rtol=1e-12)


def _rewrite(name: str, change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Path], None]:
    def damage(folder: Path) -> None:
        if name.endswith(".npy"):
            np.save(folder / name, change(np.load(folder / name)))
        else:
            pixels = change(cv2.imread(str(folder / name), cv2.IMREAD_UNCHANGED))
            cv2.imwrite(str(folder / name), pixels)

    return damage


def _without_left(array: np.ndarray) -> np.ndarray:
    array[0] = 0
    return array


def _one_pixel(pixels: np.ndarray) -> np.ndarray:
    pixels[0, 0] = 3
    return pixels


@pytest.mark.parametrize(
    ("damage", "finding"),
    [
        (_rewrite(fmt.JOINTS_2D_FILE, lambda a: a[..., ::-1]), "px from the projected 3D joints"),
        (_rewrite(fmt.JOINTS_2D_FILE, lambda a: a + 0.5 / fakes.HEIGHT), "px from the projected 3D joints"),
        (_rewrite(fmt.JOINTS_3D_FILE, lambda a: a / 100), r"\|wrist - root\| is 0.1000 cm"),
        (_rewrite(fmt.CANONICAL_FILE, lambda a: a[..., [1, 0, 2]]), "from the canonical pose"),
        (_rewrite(fmt.JOINTS_2D_FILE, _without_left), "left hand is present in location_3d_global.npy but absent"),
        (_rewrite(fmt.JOINTS_2D_FILE, _without_left), r"left hand is absent but gt_seg.png has \d+ of its pixels"),
        (_rewrite(fmt.LABELS_FILE, _one_pixel), "gt_seg.png and depth.png disagree on the foreground in 1 pixels"),
        (_rewrite(fmt.COLOR_FILE, _one_pixel), "depth.png and color.png disagree on the foreground in 1 pixels"),
        (_rewrite(fmt.DEPTH_FILE, lambda a: a * np.uint8([2, 1, 1])), "in front of the surface of depth.png"),
        (_rewrite(fmt.DEPTH_FILE, lambda a: a[:-1]), "depth.png: expected 96x54"),
        (lambda folder: (folder / fmt.IMAGE_FILE).write_bytes(b"\x89PNG"), "color_new.png: not a complete PNG"),
        (lambda folder: (folder / fmt.CANONICAL_FILE).write_bytes(b""), "canonical.npy: zero bytes"),
    ],
)
def test_damage_is_found(tmp_path: Path, damage: Callable[[Path], None], finding: str) -> None:
    fakes.write_instance(tmp_path / "0")
    fakes.write_instance(tmp_path / "1")
    damage(tmp_path / "1")
    report = inspect_dataset(Ego3DHands(tmp_path))
    assert {problem.source for problem in report.problems} == {"1"}
    assert any(re.search(finding, problem.message) for problem in report.problems), report.problems


def test_what_is_seen_of_a_hand_and_not_in_its_amodal_mask_is_found(tmp_path: Path) -> None:
    """Named case: sets once denied watches and sleeves, which they labelled, in their amodal masks."""
    fakes.write_instance(tmp_path / "0")
    labels = cv2.imread(str(tmp_path / "0" / fmt.LABELS_FILE))[..., 0]
    whole = ((labels > 0) & (labels <= 7)) + np.uint8(2) * (labels > 7)
    cv2.imwrite(str(tmp_path / "0" / fmt.AMODAL_FILE), whole)
    assert inspect_dataset(Ego3DHands(tmp_path)).problems == ()
    row, column = np.argwhere(labels > 7)[0]
    whole[row, column] = 1  # the other hand's
    cv2.imwrite(str(tmp_path / "0" / fmt.AMODAL_FILE), whole)
    (problem,) = inspect_dataset(Ego3DHands(tmp_path)).problems
    assert problem.message == "right hand: 1 pixels of gt_seg.png are not in gt_amodal.png"


@pytest.mark.parametrize(
    ("change", "finding"),
    [
        (lambda data: b"", "zero bytes"),
        (lambda data: data[:-1], "not a complete PNG file"),
        (lambda data: data[: len(data) // 2], "not a complete PNG file"),
        (lambda data: b"GIF89a" + data[6:], "not a PNG file that can be decoded"),
        (lambda data: cv2.imencode(".png", np.zeros((3, 4), np.uint8))[1].tobytes(), r"expected the image's size"),
    ],
)
def test_a_damaged_amodal_mask_is_a_problem(tmp_path: Path, change: Callable[[bytes], bytes], finding: str) -> None:
    """Named case: it ended the inspection of the whole set, or was read as if its lost rows were background."""
    mask = np.full((fakes.HEIGHT, fakes.WIDTH), 3, np.uint8)
    data = cv2.imencode(".png", mask)[1].tobytes()
    for name in ("0", "1"):
        fakes.write_instance(tmp_path / name)
        (tmp_path / name / fmt.AMODAL_FILE).write_bytes(data)
    assert inspect_dataset(Ego3DHands(tmp_path)).problems == ()
    (tmp_path / "0" / fmt.AMODAL_FILE).write_bytes(change(data))
    (problem,) = inspect_dataset(Ego3DHands(tmp_path)).problems
    assert problem.source == "0" and re.search(f"{fmt.AMODAL_FILE}: .*({finding})", problem.message)


def test_official_sample_is_sound(shared_data: Path) -> None:
    report = inspect_dataset(Ego3DHands(shared_data / "official" / "ego3dhands"))
    assert report.problems == ()
    assert report.instances == 1
    assert report.reprojection_px < 2e-4
    assert 0 < report.surface_gap_m < 0.025
    np.testing.assert_allclose(report.range_m[::2], (0.2810818, 0.3297801), atol=1e-6)  # docs/paper-map.md, *Exactness*


def test_contact_sheet_shows_every_sample_with_its_joints(tmp_path: Path) -> None:
    for index in range(5):
        fakes.write_instance(tmp_path / str(index), right=False)
    dataset = Ego3DHands(tmp_path)
    sheet = contact_sheet(dataset, 3, columns=2, tile_width=192)
    assert sheet.shape == (2 * 108, 2 * 192, 3) and sheet.dtype == np.uint8
    assert (sheet[108:, 192:] == 0).all()  # three tiles of four
    plain = np.zeros_like(dataset[0].image)
    drawn = draw_joints(plain, dataset[0].joints_px[0], 0)
    assert (plain == 0).all()
    for u, v in dataset[0].joints_px[0]:
        if 1 < u < fakes.WIDTH - 1 and 1 < v < fakes.HEIGHT - 1:
            assert drawn[int(v), int(u)].max() > 100


def test_unknown_joints_are_not_drawn() -> None:
    plain = np.zeros((20, 20, 3), np.uint8)
    assert (draw_joints(plain, np.full((21, 2), np.nan), 1) == 0).all()
