"""RHD's reader on a fake of its format, on three true hands, and against pickles that want more than numbers."""

import json
import os
import pickle
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from tests.datasets.facts import DOWN, by_name, check_hands, curled_hand, cut_off, write_picture

from twohands.datasets.base import HandDataset
from twohands.datasets.rhd import RHD, evaluated_hand, hand_pixels, part_labels, read_number_pickle
from twohands.errors import DataFormatError, InputError
from twohands.skeleton import FINGERS, LEFT, RIGHT, ROOT, part_label

ORDER = by_name(["wrist", *(f"{f}_{i}" for f in FINGERS for i in DOWN)])
K = np.array([[300.0, 0.0, 160.0], [0.0, 300.0, 160.0], [0.0, 0.0, 1.0]])
HANDS_M = np.stack([curled_hand(LEFT, (-0.1, 0.0, 0.6)), curled_hand(RIGHT, (0.1, 0.03, 0.7))])


def annotation(hands_m: np.ndarray = HANDS_M) -> dict[str, np.ndarray]:
    xyz = np.concatenate(hands_m[:, ORDER])  # (42, 3), left hand first
    uv = (xyz @ K.T)[:, :2] / xyz[:, 2:]
    visible = np.arange(42) % 2
    return {"xyz": xyz.astype(np.float32), "uv_vis": np.column_stack([uv, visible]), "K": K.astype(np.float32)}


def write_rhd(root: Path, annotations: Any, masks: dict[int, np.ndarray], protocol: int = 2) -> Path:
    """masks: (H, W) classes by number; the picture has the mask's size."""
    folder = root / "evaluation"
    for number, mask in masks.items():
        write_picture(folder / "color" / f"{number:05d}.png", mask.shape[1], mask.shape[0])
        (folder / "mask").mkdir(exist_ok=True)
        assert cv2.imwrite(str(folder / "mask" / f"{number:05d}.png"), mask)
    path = folder / "anno_evaluation.pickle"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(pickle.dumps(annotations, protocol))
    return path


def mask_of(left: int, right: int) -> np.ndarray:
    """(320, 320) with so many pixels of the left palm and the right thumb's tip, on a person."""
    mask = np.full((320, 320), 1, np.uint8)
    mask[:10] = 0
    mask[20].ravel()[:left] = 17
    mask[30].ravel()[:right] = 18
    return mask


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_both_hands_in_our_order(tmp_path: Path, protocol: int) -> None:
    write_rhd(tmp_path, {12: annotation(), 3: annotation()}, {12: mask_of(5, 4), 3: mask_of(0, 9)}, protocol)
    dataset = RHD(tmp_path, hands="both")
    assert isinstance(dataset, HandDataset) and (dataset.name, len(dataset)) == ("RHD evaluation", 2)
    assert [dataset[i].source for i in range(2)] == ["evaluation/00003", "evaluation/00012"]
    sample = dataset[1]
    np.testing.assert_allclose(sample.joints_m, HANDS_M, atol=1e-7)
    # 300 * -0.1 / 0.6 + 160, 160: the middle of 320 pixels counts from the corner already
    np.testing.assert_allclose(sample.joints_px[LEFT, ROOT], [110.0, 160.0], atol=1e-9)
    assert (sample.camera.cx, sample.camera.cy) == (160.0, 160.0)
    check_hands(sample, 1e-3)


def test_visibility_follows_the_joints(tmp_path: Path) -> None:
    """Theirs: odd of 42. The left hand's visible ones are 1, 3, ..., the right hand's (21 + i) 0, 2, ..."""
    write_rhd(tmp_path, {0: annotation()}, {0: mask_of(5, 4)})
    visible = RHD(tmp_path, hands="both")[0].visible
    assert visible is not None
    assert visible[LEFT, [0, 4, 3, 9]].tolist() == [False, True, False, False]  # theirs 0, 1, 2, 12
    assert visible[RIGHT, [0, 4, 3, 9]].tolist() == [True, False, True, True]  # theirs 21, 22, 23, 33
    assert visible.sum() == 21


@pytest.mark.parametrize(
    ("left", "right", "present", "both"),
    [
        (5, 4, [True, False], [True, True]),
        (4, 5, [False, True], [True, True]),
        (4, 4, [False, True], [True, True]),  # left only if it has strictly more
        (3, 0, [True, False], [True, False]),
        (0, 0, [False, False], [False, False]),
    ],
)
def test_evaluated_hand(tmp_path: Path, left: int, right: int, present: list[bool], both: list[bool]) -> None:
    write_rhd(tmp_path, {0: annotation()}, {0: mask_of(left, right)})
    np.testing.assert_array_equal(hand_pixels(mask_of(left, right)), [left, right])
    assert evaluated_hand(mask_of(left, right)) == (LEFT if left > right else RIGHT)
    sample = RHD(tmp_path)[0]
    np.testing.assert_array_equal(sample.present, present)
    np.testing.assert_array_equal(sample.valid.all(axis=1), present)
    assert sample.visible is not None and not sample.visible[~sample.present].any()
    check_hands(sample, 1e-3)
    np.testing.assert_array_equal(RHD(tmp_path, hands="both")[0].present, both)


def test_part_labels() -> None:
    classes = np.array([[0, 1, 2, 4, 5, 14, 16, 17, 18, 20, 32, 33]], np.uint8)
    expected = [0, 0]
    for side, parts in ((LEFT, ("thumb", "thumb", "index", "little", "little", "palm")), (RIGHT, ())):
        expected += [part_label(side, ("arm", "palm", *FINGERS).index(part)) for part in parts]
    expected += [part_label(RIGHT, part) for part in (2, 2, 6, 1)]  # thumb, thumb, little, palm
    np.testing.assert_array_equal(part_labels(classes)[0], expected)


@pytest.mark.parametrize("keep", [0.0, 0.5, 0.95])
@pytest.mark.parametrize("name", ["anno_evaluation.pickle", "color/00000.png", "mask/00000.png"])
def test_cut_off_files_are_named(tmp_path: Path, name: str, keep: float) -> None:
    write_rhd(tmp_path, {0: annotation()}, {0: mask_of(5, 4)})
    cut_off(tmp_path / "evaluation" / name, keep)
    with pytest.raises(DataFormatError, match=rf"{name}: [^\n]*$"):
        RHD(tmp_path)[0]


def test_files_that_do_not_fit_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such folder"):
        RHD(tmp_path / "nowhere")
    with pytest.raises(DataFormatError, match=r"anno_evaluation\.pickle: no such file"):
        RHD(tmp_path)

    def refused(message: str, annotations: Any, mask: np.ndarray | None = None) -> None:
        write_rhd(tmp_path, annotations, {0: mask_of(5, 4) if mask is None else mask})
        with pytest.raises(DataFormatError, match=message):
            RHD(tmp_path)[0]

    refused("pictures' numbers", [annotation()])
    refused("pictures' numbers", {"0": annotation()})
    refused("pictures' numbers", {})
    refused("entry 0: expected xyz, uv_vis and K", {0: {"xyz": np.zeros((42, 3))}})
    refused(r"xyz: expected finite numbers of shape \(42, 3\)", {0: {**annotation(), "xyz": np.zeros((21, 3))}})
    refused("uv_vis", {0: {**annotation(), "uv_vis": np.full((42, 3), np.nan)}})
    refused("got 34", {0: annotation()}, np.full((320, 320), 34, np.uint8))
    write_rhd(tmp_path, {0: annotation()}, {0: mask_of(5, 4)})
    write_picture(tmp_path / "evaluation" / "color" / "00000.png", 300, 320)
    with pytest.raises(DataFormatError, match="expected the picture's size"):
        RHD(tmp_path)[0]


class _Call:
    """Pickles as the call of any function, and what it returns given a state."""

    def __init__(self, function: Any, *arguments: Any, state: Any = None) -> None:
        self._call = (function, arguments) if state is None else (function, arguments, state)

    def __reduce__(self) -> tuple[Any, ...]:
        return self._call


class TestPickle:
    @pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
    def test_numbers_come_back(self, tmp_path: Path, protocol: int) -> None:
        path = tmp_path / "a.pickle"
        path.write_bytes(pickle.dumps({1: [np.arange(3.0), np.float32(2.5)], "é": (None, True, 7)}, protocol))
        content = read_number_pickle(path)
        np.testing.assert_array_equal(content[1][0], [0.0, 1.0, 2.0])
        assert content[1][1] == 2.5 and content["é"] == (None, True, 7)

    def test_arrays_of_python_2(self, tmp_path: Path) -> None:
        """Protocol 2 as Python 2 wrote it: names of old numpy, bytes as plain strings."""
        data = np.array([1.5, -2.0]).tobytes()
        program = (
            b"\x80\x02cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85U\x01b\x87R"
            b"(K\x01K\x02\x85cnumpy\ndtype\nU\x02f8K\x00K\x01\x87R(K\x03U\x01<NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb"
            b"\x89U" + bytes([len(data)]) + data + b"tb."
        )
        (tmp_path / "a.pickle").write_bytes(program)
        np.testing.assert_array_equal(read_number_pickle(tmp_path / "a.pickle"), [1.5, -2.0])

    @pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
    @pytest.mark.parametrize("function", [os.mkdir, Path.mkdir, eval, getattr, np.load, np.save, exec])
    def test_nothing_else_is_called(self, tmp_path: Path, protocol: int, function: Any) -> None:
        trap = tmp_path / "trap"
        arguments = (str(trap),) if function is os.mkdir else (f"__import__('os').mkdir({str(trap)!r})",)
        (tmp_path / "a.pickle").write_bytes(pickle.dumps({0: _Call(function, *arguments)}, protocol))
        with pytest.raises(DataFormatError, match=r"a\.pickle: [^\n]*it names "):
            read_number_pickle(tmp_path / "a.pickle")
        assert not trap.exists()

    def test_the_trap_works(self, tmp_path: Path) -> None:
        """What the test above relies on: plain `pickle` would have made the folder."""
        pickle.loads(pickle.dumps({0: _Call(os.mkdir, str(tmp_path / "trap"))}))
        assert (tmp_path / "trap").exists()

    @pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
    @pytest.mark.parametrize("kind", ["<f4", ">f8", "|u1", "<i2", "|b1"])
    def test_arrays_of_every_kind_and_order(self, tmp_path: Path, protocol: int, kind: str) -> None:
        values = np.arange(6).reshape(2, 3).astype(kind)
        path = tmp_path / "a.pickle"
        path.write_bytes(pickle.dumps([values, np.asfortranarray(values), values[0, 1], values[:, ::2]], protocol))
        rows, columns, number, some = (np.asarray(part) for part in read_number_pickle(path))
        for read in (rows, columns):
            np.testing.assert_array_equal(read, values)
            assert read.dtype == values.dtype
        np.testing.assert_array_equal(some, values[:, ::2])
        assert number == values[0, 1] and number.dtype == values.dtype.newbyteorder("=")

    @pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
    @pytest.mark.parametrize(
        "forged",
        [
            _Call(np.dtype, "O"),
            _Call(np.dtype, "V8"),
            _Call(np.dtype, "i1,f8"),
            _Call(np.dtype, "f8", state=(3, "|", None, ("a",), {"a": (np.dtype("f8"), 0)}, 8, 1, 0)),
            _Call(np.dtype, "V8", state=(3, "|", None, ("a",), {"a": (_Call(np.dtype, "O"), 0)}, 8, 1, 63)),
            _Call(np.dtype, "f8", state=(3, "|", (np.dtype("f8"), (2,)), None, None, 16, 1, 0)),
            np.zeros(2, [("a", "f8")]),
            np.array(["text"]),
            np.array([object()]),
            np.zeros(2, "M8[s]"),
            np.complex128(1),
        ],
    )
    def test_no_type_but_numbers(self, tmp_path: Path, protocol: int, forged: Any) -> None:
        """Named case: the state of a dtype turned raw bytes into pointers to objects."""
        (tmp_path / "a.pickle").write_bytes(pickle.dumps({0: forged}, protocol))
        with pytest.raises(DataFormatError, match=r"a\.pickle: [^\n]*(not numbers|no array of numbers)"):
            read_number_pickle(tmp_path / "a.pickle")

    @pytest.mark.parametrize("data", [b"1234567", bytes(24), None, 8])
    def test_bytes_that_do_not_fill_the_array(self, tmp_path: Path, data: Any) -> None:
        new = np.zeros(2).__reduce__()
        forged = _Call(new[0], *new[1], state=(1, (2,), np.dtype("f8"), False, data))
        (tmp_path / "a.pickle").write_bytes(pickle.dumps(forged, 2))
        with pytest.raises(DataFormatError, match="not a complete pickle of numbers"):
            read_number_pickle(tmp_path / "a.pickle")

    def test_what_is_no_annotation_is_named(self, tmp_path: Path) -> None:
        """An array without numbers, a type, an array and a number in the place of an annotation or of its part."""
        new = np.zeros(2).__reduce__()
        empty = _Call(new[0], *new[1])
        for wrong in (empty, np.dtype("f8"), np.zeros(3), np.float64(2)):
            for entry in (wrong, annotation() | {"xyz": wrong}):
                write_rhd(tmp_path, {0: entry}, {0: mask_of(5, 4)}, pickle.HIGHEST_PROTOCOL)
                with pytest.raises(DataFormatError, match="entry 0"):
                    RHD(tmp_path)[0]

    def test_no_other_codec(self, tmp_path: Path) -> None:
        import _codecs

        (tmp_path / "a.pickle").write_bytes(pickle.dumps(_Call(_codecs.encode, "abc", "zlib")))
        with pytest.raises(DataFormatError, match="expected bytes written as latin1"):
            read_number_pickle(tmp_path / "a.pickle")


def write_true_sample(source: Path, root: Path) -> None:
    """The true sample in RHD's own layout below `root`; its pictures are linked."""
    content = json.loads((source / "test_rhd.json").read_text())
    annotations, masks = {}, {}
    for picture, hand in zip(content["images"], content["annotations"], strict=True):
        first = 0 if hand["hand_type"] == "left" else 21
        xyz, uv_vis, mask = np.ones((42, 3)), np.zeros((42, 3)), np.zeros((320, 320), np.uint8)
        xyz[first : first + 21] = np.array(hand["joint_cam"]) / 1e3
        uv_vis[first : first + 21] = hand["keypoints"]
        for u, v, _ in hand["keypoints"]:
            mask[int(v), int(u)] = 17 if first == 0 else 33
        k = np.diag([*picture["cam_param"]["focal"], 1.0])
        k[:2, 2] = picture["cam_param"]["princpt"]
        annotations[picture["id"]], masks[picture["id"]] = {"xyz": xyz, "uv_vis": uv_vis, "K": k}, mask
    write_rhd(root, annotations, masks)
    for number in masks:
        path = root / "evaluation" / "color" / f"{number:05d}.png"
        path.unlink()
        path.symlink_to(source / path.name)


class TestTrueSample:
    """Three true hands, published as JSON with one hand each; brought into RHD's own layout, numbers unchanged.

    The sample holds no masks, so the labelled hand's mask is its joints.
    """

    @pytest.fixture
    def dataset(self, shared_data: Path, tmp_path: Path) -> RHD:
        write_true_sample(shared_data / "official" / "rhd", tmp_path)
        return RHD(tmp_path)

    def test_hands_are_where_they_belong(self, dataset: RHD) -> None:
        assert [dataset[i].present.tolist() for i in range(3)] == [[True, False], [True, False], [False, True]]
        for index in range(3):
            check_hands(dataset[index], reprojection_px=0.08)  # the labels are rounded to four digits

    def test_the_middle_of_the_picture_is_the_principal_point_of_the_2d_labels(self, dataset: RHD) -> None:
        """f, cx, cy fitted to 3D and 2D labels: 160, so K and 2D labels count from the same point."""
        for index in range(3):
            sample = dataset[index]
            joints_m, joints_px = sample.joints_m[sample.present][0], sample.joints_px[sample.present][0]
            slopes = joints_m[:, :2] / joints_m[:, 2:]
            rows = [np.column_stack([slopes[:, i], np.full(21, 1 - i), np.full(21, i)]) for i in (0, 1)]
            fit = np.linalg.lstsq(np.concatenate(rows), joints_px.T.ravel(), rcond=None)[0]
            np.testing.assert_allclose(fit, [sample.camera.fx, 160.0, 160.0], atol=0.25)
            np.testing.assert_allclose(fit[1:], [160.0, 160.0], atol=0.05)
