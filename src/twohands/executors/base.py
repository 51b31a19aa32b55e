"""What all executors have in common: they call a function on numbers and hand back the results, in the order of the
numbers where that is wanted, so that what is written does not depend on who made it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import islice
from typing import Any, Protocol, TypeVar

Result = TypeVar("Result")
Opener = Callable[[], Callable[[int], Result]]
"""Called once in every worker; what it returns is called on numbers. It must be picklable, the returned function need
not be."""

AHEAD = 4
"""Jobs handed out per worker before the oldest must be done, where results come in order: enough to hide one slow job,
few enough for the memory. Otherwise a worker has one at a time, so that none waits behind a slow one."""


class Executor(Protocol):
    """Runs a function on numbers."""

    def run(self, opener: Opener[Result], indices: Iterable[int], *, in_order: bool = True) -> Iterator[Result]:
        """The function's results.

        Args:
            opener: makes the function, in every worker.
            indices: what to call it on; taken as needed, never listed whole.
            in_order: results come in the order of the indices; otherwise as soon as they are there.

        Raises:
            TwoHandsError: a worker died, or what the function itself raises.
        """
        ...


def in_flight(
    submit: Callable[[int], Any],
    collect: Callable[[Any], Result],
    indices: Iterable[int],
    most: int,
    first_done: Callable[[Sequence[Any]], Any] | None = None,
) -> Iterator[Result]:
    """Results, a number of jobs in flight.

    Args:
        submit: hands one job out, returns its ticket.
        collect: waits for a ticket's result.
        indices: the jobs.
        most: jobs in flight.
        first_done: waits for one of the tickets and returns it; None for the results in the order of the indices.
    """
    remaining = iter(indices)
    tickets = deque(submit(index) for index in islice(remaining, most))
    while tickets:
        ticket = tickets[0] if first_done is None else first_done(tickets)
        tickets.remove(ticket)
        result = collect(ticket)
        tickets.extend(submit(index) for index in islice(remaining, 1))
        yield result
