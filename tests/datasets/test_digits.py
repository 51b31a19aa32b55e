"""The reader of the photographed digits."""

import json
from pathlib import Path

import numpy as np
import pytest
from tests.datasets.photographed import write_digits

from twohands.datasets.base import HandDataset
from twohands.datasets.cutting import cut_out
from twohands.datasets.digits import Digits, persons_of
from twohands.errors import DataFormatError, InputError
from twohands.skeleton import LEFT, RIGHT


def test_right_hands_without_depth(tmp_path: Path) -> None:
    write_digits(tmp_path / "digits")
    digits = Digits(tmp_path / "digits", "all")
    assert isinstance(digits, HandDataset) and (digits.name, len(digits)) == ("digits all", 20)
    sample = digits[1]
    assert sample.source == "images/1_IMG_1119.jpg" and sample.image.shape == (100, 100, 3)
    np.testing.assert_array_equal(sample.present, [False, True])
    assert sample.valid[RIGHT].all() and not sample.valid[LEFT].any()
    assert np.isfinite(sample.joints_px[RIGHT]).all() and np.isnan(sample.joints_m).all()
    assert sample.confidence is not None and (sample.confidence[RIGHT] == 1).all()


def test_a_person_is_in_one_part_only(tmp_path: Path) -> None:
    write_digits(tmp_path / "digits", persons=10)
    training, held_out = Digits(tmp_path / "digits", "training"), Digits(tmp_path / "digits", "held-out")
    assert set(held_out.persons) == {4, 9} and set(training.persons) == set(range(10)) - {4, 9}
    assert sorted(training.names + held_out.names) == sorted(Digits(tmp_path / "digits", "all").names)


@pytest.mark.parametrize(
    ("digits", "persons"),
    [
        ([0, 1, 2, 9, 0, 1, 9], [0, 0, 0, 0, 1, 1, 1]),
        ([7, 9, 8, 0, 2, 1, 3], [0, 0, 0, 1, 1, 1, 1]),  # two swapped pictures begin no person
        ([8, 9, 3, 8], [0, 0, 1, 1]),  # missing pictures
        ([5, 0, 1, 2], [0, 0, 0, 0]),  # a picture by itself belongs to the next person
        ([], []),
    ],
)
def test_a_person_begins_where_the_digit_falls(digits: list[int], persons: list[int]) -> None:
    assert persons_of(digits).tolist() == persons


def test_an_unsure_label_counts_less(tmp_path: Path) -> None:
    write_digits(tmp_path / "digits", persons=1)
    path = tmp_path / "digits" / "pseudo_labels.json"
    labels = json.loads(path.read_text())
    for entry, score in zip(labels.values(), (0.6, 0.85, 0.91, 0.97), strict=True):
        entry["score"] = score
    path.write_text(json.dumps(labels))
    digits = Digits(tmp_path / "digits", "all")
    weights = [sample.confidence[RIGHT, 0] for sample in digits if sample.confidence is not None]
    np.testing.assert_allclose(weights, [0.25, 0.25, 0.625, 1.0])


def test_damage_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such folder"):
        Digits(tmp_path / "none")
    write_digits(tmp_path / "digits", persons=1)
    with pytest.raises(InputError, match="held-out"):
        Digits(tmp_path / "digits", "test")  # type: ignore[arg-type]
    path = tmp_path / "digits" / "pseudo_labels.json"
    path.write_text('{"0_IMG_1118.jpg": {"score": 1}}')
    with pytest.raises(DataFormatError, match=r"0_IMG_1118.jpg: expected joints_px"):
        Digits(tmp_path / "digits", "all")[0]
    path.write_text('{"first.jpg": {}}')
    with pytest.raises(DataFormatError, match=r"expected names like 0_IMG_1118.jpg"):
        Digits(tmp_path / "digits", "all")


def test_the_true_photographs(shared_data: Path) -> None:
    """150 people, a fifth of them held out; nearly all of their hands can be cut out."""
    root = shared_data / "real_train" / "digits"
    if not root.is_dir():
        pytest.skip(f"no photographs of digits beside the checkout: expected the folder {root}")
    everyone, held_out = Digits(root, "all"), Digits(root, "held-out")
    assert (len(everyone), everyone.persons.max() + 1) == (1456, 150)
    assert (len(held_out), len(set(held_out.persons))) == (289, 30)
    cuts = [cut_out(sample.image, sample.joints_px[RIGHT]) for sample in (everyone[i] for i in range(0, 1456, 29))]
    assert np.mean([cut.flaw != "" for cut in cuts]) < 0.05
