"""Reading ahead changes neither order nor errors, and stops when nobody asks any more."""

import threading

import pytest

from twohands.datasets.read_ahead import AHEAD, read_ahead
from twohands.errors import DataFormatError


class Counting:
    """Samples are their own numbers; the damaged one raises."""

    name = "counting"

    def __init__(self, damaged: int = -1) -> None:
        self.damaged, self.read = damaged, []

    def __len__(self) -> int:
        return 20

    def __getitem__(self, index: int) -> int:
        assert threading.current_thread() is not threading.main_thread()
        self.read.append(index)
        if index == self.damaged:
            raise DataFormatError(f"{index} is damaged")
        return index


def test_order_and_count() -> None:
    assert list(read_ahead(Counting(), 20)) == list(range(20))  # type: ignore[arg-type]
    assert list(read_ahead(Counting(), 2)) == [0, 1]  # type: ignore[arg-type]
    assert list(read_ahead(Counting(), 0)) == []  # type: ignore[arg-type]


def test_an_error_comes_when_its_turn_has_come() -> None:
    samples = read_ahead(Counting(damaged=3), 20)  # type: ignore[arg-type]
    assert [next(samples) for _ in range(3)] == [0, 1, 2]
    with pytest.raises(DataFormatError, match="3 is damaged"):
        next(samples)


def test_no_more_is_read_than_is_asked_for() -> None:
    data = Counting()
    samples = read_ahead(data, 20)  # type: ignore[arg-type]
    next(samples)
    samples.close()
    assert max(data.read) <= AHEAD
