"""Order is kept, errors come out in their turn, and nothing waits for ever."""

import threading
import time

import pytest

from twohands.inference.background import Behind, ahead


def test_items_come_in_order_and_are_made_ahead():
    made = []

    def items():
        for i in range(20):
            made.append(i)
            yield i

    found = ahead(items(), 3)
    assert next(found) == 0
    deadline = time.monotonic() + 60
    while len(made) < 4 and time.monotonic() < deadline:
        time.sleep(0.01)
    time.sleep(0.05)
    assert 4 <= len(made) <= 6, "three wait, one is offered"
    assert [*found] == list(range(1, 20))


def test_an_error_comes_in_its_turn():
    def items():
        yield 1
        raise ValueError("broken")

    found = ahead(items())
    assert next(found) == 1
    with pytest.raises(ValueError, match="broken"):
        next(found)


def test_who_stops_early_ends_the_thread():
    before = threading.active_count()
    found = ahead(iter(range(10**9)), 2)
    next(found)
    found.close()
    assert threading.active_count() == before


def test_behind_calls_in_order_and_leaving_waits():
    done = []
    with Behind(lambda item: (time.sleep(0.005), done.append(item)), 2) as behind:
        for i in range(10):
            behind.put(i)
    assert done == list(range(10))


def test_an_error_behind_comes_out_and_nothing_hangs():
    def fail(item):
        raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"), Behind(fail, 1) as behind:
        for i in range(100):
            behind.put(i)
    with pytest.raises(OSError, match="disk full"), Behind(fail, 1) as behind:
        behind.put(0)
