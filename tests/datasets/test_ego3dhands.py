"""The reader: what it returns, what it skips, and what it refuses by name."""

import contextlib
from pathlib import Path

import numpy as np
import pytest
from tests.datasets import fakes
from tests.datasets.facts import huge_png

from twohands.datasets.base import HandDataset
from twohands.datasets.ego3dhands import Ego3DHands, read_instance
from twohands.errors import DataFormatError, InputError
from twohands.formats import ego3dhands as fmt
from twohands.geometry.camera import project
from twohands.geometry.canonical import canonical_from_camera
from twohands.geometry.projection import project_global
from twohands.skeleton import LEFT, RIGHT, ROOT, WRIST


def test_reads_what_was_written(tmp_path: Path) -> None:
    joints_m = fakes.write_instance(tmp_path / "data" / "00000", right=False)
    dataset = Ego3DHands(tmp_path / "data")
    assert isinstance(dataset, HandDataset)
    sample = dataset[0]
    assert (dataset.name, len(dataset), sample.source) == ("data", 1, "00000")
    np.testing.assert_array_equal(sample.present, [True, False])
    np.testing.assert_array_equal(sample.valid.all(axis=1), [True, False])
    np.testing.assert_allclose(sample.joints_m, joints_m[:, 1:], rtol=1e-14)
    assert np.isnan(sample.joints_px[RIGHT]).all()
    np.testing.assert_allclose(sample.joints_px[LEFT], project(joints_m[LEFT, 1:], sample.camera), rtol=1e-12)
    row, col = np.floor(sample.joints_px[LEFT, ROOT][::-1]).astype(int)
    assert sample.labels is not None and sample.depth_m is not None
    assert sample.labels[row, col] == 5  # left middle finger
    assert sample.depth_m[row, col] == pytest.approx(0.295, abs=1e-6)
    np.testing.assert_array_equal(sample.image[row, col], fakes.SKIN[LEFT])
    np.testing.assert_array_equal(sample.image[0, 0], [40, 40, 40])


def test_natural_order_at_any_depth(tmp_path: Path) -> None:
    for name in ("seq10/00001", "seq2/00010", "seq2/00009", "seq2/2", "b", ".00003.4711.partial"):
        fakes.write_instance(tmp_path / name)
    dataset = Ego3DHands(tmp_path)
    names = [dataset.source(i) for i in range(len(dataset))]
    assert names == ["b", "seq2/2", "seq2/00009", "seq2/00010", "seq10/00001"]
    assert Ego3DHands(tmp_path / "b").source(0) == "b"


def test_color_on_black_stands_in_for_the_image(tmp_path: Path) -> None:
    fakes.write_instance(tmp_path / "0")
    (tmp_path / "0" / fmt.IMAGE_FILE).unlink()
    instance = read_instance(tmp_path / "0")
    assert instance.missing == (fmt.IMAGE_FILE,)
    np.testing.assert_array_equal(instance.image[0, 0], [0, 0, 0])
    assert (instance.image.max(axis=2) > 0).sum() == (instance.labels > 0).sum()  # type: ignore[operator]
    (tmp_path / "0" / fmt.COLOR_FILE).unlink()
    with pytest.raises(DataFormatError, match=r"color_new.png or color.png, found neither"):
        read_instance(tmp_path / "0")


def test_partial_alpha_darkens_on_black(tmp_path: Path) -> None:
    """Straight alpha: 200 at alpha 51 = 1/5 is 40 on black."""
    fakes.write_instance(tmp_path / "0")
    rgba = np.zeros((fakes.HEIGHT, fakes.WIDTH, 4), np.uint8)
    rgba[3, 4] = (200, 100, 0, 51)
    fakes.write_png(tmp_path / "0" / fmt.COLOR_FILE, rgba)
    (tmp_path / "0" / fmt.IMAGE_FILE).unlink()
    np.testing.assert_array_equal(read_instance(tmp_path / "0").image[3, 4], [40, 20, 0])


def test_missing_optional_files_are_reported_not_fatal(tmp_path: Path) -> None:
    fakes.write_instance(tmp_path / "0")
    gone = (fmt.COLOR_FILE, fmt.LABELS_FILE, fmt.DEPTH_FILE, fmt.JOINTS_3D_FILE, fmt.CANONICAL_FILE)
    for name in gone:
        (tmp_path / "0" / name).unlink()
    instance = read_instance(tmp_path / "0")
    assert instance.missing == gone
    assert instance.labels is None and instance.depth_m is None
    assert np.isnan(instance.joints_m).all() and instance.present.all()


def test_zero_byte_arrays_are_skipped_and_named(tmp_path: Path) -> None:
    for name in ("0", "1", "2"):
        fakes.write_instance(tmp_path / name)
    (tmp_path / "0" / fmt.JOINTS_2D_FILE).write_bytes(b"")
    (tmp_path / "1" / fmt.JOINTS_3D_FILE).write_bytes(b"")
    dataset = Ego3DHands(tmp_path)
    assert [path.name for path in dataset.paths] == ["2"]
    assert dataset.skipped == (
        (tmp_path / "0", f"{fmt.JOINTS_2D_FILE}: zero bytes"),
        (tmp_path / "1", f"{fmt.JOINTS_3D_FILE}: zero bytes"),
    )


def test_no_instance_is_an_input_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such folder"):
        Ego3DHands(tmp_path / "nowhere")
    with pytest.raises(InputError, match="no instance found"):
        Ego3DHands(tmp_path)
    fakes.write_instance(tmp_path / "0")
    (tmp_path / "0" / fmt.JOINTS_2D_FILE).write_bytes(b"")
    with pytest.raises(InputError, match="1 skipped"):
        Ego3DHands(tmp_path)


@pytest.mark.parametrize("name", [fmt.IMAGE_FILE, fmt.LABELS_FILE, fmt.DEPTH_FILE, fmt.JOINTS_2D_FILE])
@pytest.mark.parametrize("keep", [0.0, 0.3, 0.9])
def test_cut_off_file_is_named(tmp_path: Path, name: str, keep: float) -> None:
    fakes.write_instance(tmp_path / "0")
    path = tmp_path / "0" / name
    data = path.read_bytes()
    path.write_bytes(data[: int(keep * len(data))])
    with pytest.raises(DataFormatError, match=name):
        read_instance(tmp_path / "0")


def test_a_damaged_array_is_named_whatever_is_damaged(tmp_path: Path) -> None:
    """Named case: damage within a header came out as an error of Python's tokenizer."""
    fakes.write_instance(tmp_path / "0")
    path = tmp_path / "0" / fmt.JOINTS_2D_FILE
    data = path.read_bytes()
    rng = np.random.default_rng(0)
    for _ in range(300):
        damaged = bytearray(data)
        damaged[int(rng.integers(0, 128))] ^= int(rng.integers(1, 256))
        path.write_bytes(damaged)
        with contextlib.suppress(DataFormatError):
            read_instance(tmp_path / "0")


def test_wrong_sizes_and_values_are_named(tmp_path: Path) -> None:
    fakes.write_instance(tmp_path / "0")
    labels = np.zeros((fakes.HEIGHT, fakes.WIDTH), np.uint8)
    fakes.write_png(tmp_path / "0" / fmt.LABELS_FILE, fmt.encode_labels(labels[:, 1:]))
    with pytest.raises(DataFormatError, match=r"gt_seg.png: expected 96x54"):
        read_instance(tmp_path / "0")
    fakes.write_png(tmp_path / "0" / fmt.LABELS_FILE, np.repeat(labels[..., None] + np.uint8(15), 3, axis=2))
    with pytest.raises(DataFormatError, match=r"labels must be 0..14"):
        read_instance(tmp_path / "0")
    (tmp_path / "0" / fmt.LABELS_FILE).unlink()
    np.save(tmp_path / "0" / fmt.JOINTS_2D_FILE, np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(DataFormatError, match=fmt.JOINTS_2D_FILE):
        read_instance(tmp_path / "0")


def test_a_png_that_says_to_be_huge_is_named(tmp_path: Path) -> None:
    """Named case: 60,000 by 60,000 pixels were OpenCV's own error."""
    fakes.write_instance(tmp_path / "0")
    path = tmp_path / "0" / fmt.IMAGE_FILE
    path.write_bytes(huge_png(path.read_bytes()))
    with pytest.raises(DataFormatError, match=rf"{fmt.IMAGE_FILE}: not a PNG file that can be decoded"):
        read_instance(tmp_path / "0")


def test_a_name_with_a_raised_digit_is_a_name(tmp_path: Path) -> None:
    """Named case: it is a digit, but no number. Digits of other scripts are numbers."""
    for name in ("area_10²", "area_2", "area_१०"):
        fakes.write_instance(tmp_path / name)
    dataset = Ego3DHands(tmp_path)
    assert [dataset.source(i) for i in range(3)] == ["area_2", "area_10²", "area_१०"]


@pytest.mark.parametrize("text", ['{"fx": 1' + "0" * 400 + ', "fy": 1, "cx": 1, "cy": 1}', "[" * 200_000])
def test_a_camera_of_no_numbers_is_named(tmp_path: Path, text: str) -> None:
    fakes.write_instance(tmp_path / "0")
    (tmp_path / "0" / fmt.CAMERA_FILE).write_text(text)
    with pytest.raises(DataFormatError, match=r"camera\.json: fx, fy, cx and cy expected"):
        read_instance(tmp_path / "0")


class TestOfficialSample:
    """The facts of docs/paper-map.md, *Data*, on the authors' own instance."""

    @pytest.fixture
    def instance(self, shared_data: Path):
        return read_instance(shared_data / "official" / "ego3dhands" / "00000")

    def test_complete_and_both_hands(self, instance) -> None:
        assert instance.missing == ()
        assert instance.image.shape == (540, 960, 3)
        assert instance.present.all()

    def test_projection_is_the_papers_camera(self, instance) -> None:
        error = np.abs(project(instance.joints_m, instance.camera) - instance.joints_px)
        assert error[:, 1:].max() < 5e-5  # docs/paper-map.md: 3.5e-5 px
        assert error[:, 0].max() < 2e-4  # the elbow, 700 px below the image

    def test_canonical_is_recomputed_exactly(self, instance) -> None:
        canonical = canonical_from_camera(instance.joints_m[:, 1:])
        assert np.abs(canonical.joints - instance.canonical[:, 1:]).max() < 1e-6

    def test_global_pose_from_labels(self, instance) -> None:
        """2D labels and the canonical pose give the global joints back to 1e-4 cm."""
        pose = project_global(
            instance.canonical[:, 1:], instance.joints_px[:, 1:], instance.camera, 0.10, method="keybone"
        )
        assert pose.valid.all()
        assert np.linalg.norm(pose.joints_m - instance.joints_m[:, 1:], axis=-1).max() < 1e-6  # m

    def test_hand_length_is_ten_centimetres(self, instance) -> None:
        joints = instance.joints_m[:, 1:]
        lengths = np.linalg.norm(joints[:, WRIST] - joints[:, ROOT], axis=-1)
        np.testing.assert_allclose(lengths, Ego3DHands.hand_length_m, atol=1e-6)
