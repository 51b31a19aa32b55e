"""Jobs in flight: few at a time, in order or as they are done."""

from twohands.executors.base import in_flight


def test_results_come_in_order_with_few_in_flight():
    started: list[int] = []
    results = []
    for result in in_flight(lambda i: started.append(i) or i, lambda ticket: ticket, range(30), most=8):
        results.append(result)
        assert len(started) <= len(results) + 8
    assert results == list(range(30))


def test_whichever_is_done_first_comes_first():
    """Here always the last one that was handed out."""
    results = list(in_flight(lambda i: i, lambda ticket: ticket, range(6), 3, lambda tickets: tickets[-1]))
    assert results == [2, 3, 4, 5, 1, 0]
