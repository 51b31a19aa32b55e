"""The work of a run on a Ray cluster: actors with a renderer each, results to the one process that writes them.

Nothing has to be shared between the machines but this package: what an actor needs travels with it, what it makes comes
back through Ray. A folder of backgrounds must be at the same path on all of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import count
from typing import Any

from twohands.errors import InputError, TwoHandsError
from twohands.synth.executors import Opener, Result, ordered


@dataclass(frozen=True)
class RayCluster:
    """A Ray cluster; an `executors.Executor`.

    Attributes:
        address: of a running cluster, "auto" for the one this machine belongs to; None starts one on this machine.
        workers: number of actors, one core each; 0 takes all cores of the cluster.

    Raises:
        InputError: a negative number of workers.
    """

    address: str | None = None
    workers: int = 0

    def __post_init__(self) -> None:
        if self.workers < 0:
            raise InputError(f"workers must be 0 (all cores) or more, got {self.workers}")

    def run(self, opener: Opener[Result], indices: Iterable[int]) -> Iterator[Result]:
        """See `Executor.run`.

        Raises:
            ModuleNotFoundError: Ray is not installed.
            InputError: no cluster at the address.
            TwoHandsError: an actor died, or what the function itself raises.
        """
        import ray  # pyright: ignore[reportMissingImports]

        ours = not ray.is_initialized()
        if ours:
            try:
                ray.init(address=self.address, num_cpus=self._local_cpus(), log_to_driver=False, logging_level="ERROR")
            except (ConnectionError, ValueError) as error:
                raise InputError(f"no Ray cluster at '{self.address}': {error}") from error
        try:
            workers = self.workers or int(ray.cluster_resources().get("CPU", 1))
            actor = ray.remote(num_cpus=1)(_Worker)
            actors: list[Any] = [actor.remote(opener) for _ in range(workers)]
            turn = count()
            yield from ordered(
                lambda index: actors[next(turn) % workers].work.remote(index), _collect, indices, workers
            )
        finally:
            if ours:
                ray.shutdown()

    def _local_cpus(self) -> int | None:
        """Cores of a cluster that is started here; an existing one has those it has."""
        return self.workers or None if self.address is None else None


class _Worker:
    """Becomes an actor; opened by its first job, so that what fails there is raised as a result."""

    def __init__(self, opener: Opener[Any]) -> None:
        self._opener, self._opened = opener, None

    def work(self, index: int) -> Any:
        """The result for one index."""
        if self._opened is None:
            self._opened = self._opener()
        return self._opened(index)


def _collect(ticket: Any) -> Any:
    import ray  # pyright: ignore[reportMissingImports]

    try:
        return ray.get(ticket)
    except ray.exceptions.RayTaskError as error:
        if isinstance(error.cause, TwoHandsError):
            raise error.cause from None
        raise
    except ray.exceptions.RayError as error:
        raise TwoHandsError(
            f"a worker of the Ray cluster died ({type(error).__name__}): run the same command again to go on"
        ) from error
