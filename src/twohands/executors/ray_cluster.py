"""The work of a run on a Ray cluster: actors that are opened once each, results to the process that runs it.

Nothing has to be shared between the machines but this package at one version: what an actor needs travels to it, what
it makes comes back through Ray. Folders that the work reads must be at the same path on all of them.
"""

from __future__ import annotations

import os
import platform
import socket
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from twohands.errors import InputError, MissingExtraError, TwoHandsError
from twohands.executors.base import AHEAD, Opener, Result, in_flight
from twohands.version import __version__

REACH_SECONDS = 5.0
"""How long the head of a cluster may take to answer."""

MadeWith = Callable[[], dict[str, str]]


@dataclass(frozen=True)
class RayCluster:
    """A Ray cluster; a `base.Executor`.

    Attributes:
        address: HOST:PORT of a running cluster's head, "auto" for the cluster that this machine belongs to; None starts
            one on this machine, which ends with the run.
        workers: number of actors, one core each, at most as many as the cluster has cores; 0 takes all of them.
        made_with: versions that the results depend on; must come out the same on all machines as here, or their bytes
            would differ. None compares nothing but the package's version. Picklable.
        restarts: how often each actor is started again after it died, along with the jobs it held.

    Raises:
        InputError: a negative number of workers, or no such address.
    """

    address: str | None = None
    workers: int = 0
    made_with: MadeWith | None = None
    restarts: int = 3

    def __post_init__(self) -> None:
        if self.workers < 0:
            raise InputError(f"workers must be 0 (all cores) or more, got {self.workers}")
        if self.address not in (None, "auto"):
            _host_and_port(self.address)

    def check(self) -> None:
        """Whether Ray is installed and something answers at the address, before anything is written.

        Raises:
            MissingExtraError: Ray is not installed.
            InputError: nothing answers.
        """
        import_ray()
        if self.address not in (None, "auto"):
            _reach(self.address)

    def run(self, opener: Opener[Result], indices: Iterable[int], *, in_order: bool = True) -> Iterator[Result]:
        """See `Executor.run`.

        Raises:
            MissingExtraError: Ray is not installed.
            InputError: no cluster at the address, or a machine of it would make other bytes than this one.
            TwoHandsError: an actor died too often, or what the function itself raises.
        """
        self.check()
        ray = import_ray()
        with self._connected(ray):
            cores = int(ray.cluster_resources().get("CPU", 0))
            if cores < 1:
                raise InputError("the Ray cluster has no core to work on")
            workers = min(self.workers or cores, cores)  # an actor without a core would wait for ever
            actor = ray.remote(num_cpus=1, max_restarts=self.restarts, max_task_retries=self.restarts)(_Worker)
            expected = fingerprint(self.made_with)
            actors: list[Any] = [actor.remote(opener, self.made_with, expected) for _ in range(workers)]
            free = deque(actors * (AHEAD if in_order else 1))
            busy: dict[Any, Any] = {}

            def submit(index: int) -> Any:
                actor = free.popleft()
                ticket = actor.work.remote(index)
                busy[ticket] = actor
                return ticket

            def collect(ticket: Any) -> Any:
                result = _collect(ticket)
                free.append(busy.pop(ticket))
                return result

            first_done = None if in_order else lambda tickets: ray.wait(list(tickets))[0][0]
            try:
                yield from in_flight(submit, collect, indices, len(free), first_done)
            finally:  # or they would keep their cores as long as an error's traceback keeps their handles
                for each in actors:
                    ray.kill(each)

    @contextmanager
    def _connected(self, ray: Any) -> Iterator[None]:
        """A connection for the time of a run; one that the caller has opened is used and left open."""
        if ray.is_initialized():
            yield
            return
        try:
            ray.init(log_to_driver=False, logging_level="ERROR", **self._options())
        except Exception as error:  # Ray says some of it as a plain Exception
            raise InputError(f"no Ray cluster {self._complaint(error)}") from error
        try:
            yield
        finally:
            ray.shutdown()

    def _complaint(self, error: Exception) -> str:
        if self.address == "auto":
            return "runs on this machine: start or join one with `ray start`, or leave --ray-address out"
        if self.address is None:
            return f"could be started: {_first_line(error)}"
        hint = "where it asks for a token, set RAY_AUTH_MODE and RAY_AUTH_TOKEN_PATH as there"
        return f"lets us in at '{self.address}': {_first_line(error)} ({hint})"

    def _options(self) -> dict[str, Any]:
        """Arguments of ray.init. A cluster of our own reports nothing to anyone; an existing one keeps its settings."""
        if self.address is not None:
            return {"address": self.address}
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        return {"address": "local", "num_cpus": self.workers or None, "include_dashboard": False}


def import_ray() -> Any:
    """The package.

    Raises:
        MissingExtraError: it is not installed.
    """
    try:
        import ray  # pyright: ignore[reportMissingImports]
    except ModuleNotFoundError as error:
        raise MissingExtraError("a Ray cluster", "cluster") from error
    return ray


def fingerprint(made_with: MadeWith | None) -> dict[str, str]:
    """What the bytes that this machine makes depend on."""
    return {"twohands": __version__, **(made_with() if made_with is not None else {})}


class _Worker:
    """Becomes an actor; opened by its first job, so that what fails there is raised as a result."""

    def __init__(self, opener: Opener[Any], made_with: MadeWith | None, expected: dict[str, str]) -> None:
        self._opener, self._made_with, self._expected = opener, made_with, expected
        self._opened: Callable[[int], Any] | None = None

    def work(self, index: int) -> Any:
        """The result for one index."""
        if self._opened is None:
            _check_fingerprint(fingerprint(self._made_with), self._expected)
            self._opened = self._opener()
        return self._opened(index)


def _check_fingerprint(found: dict[str, str], expected: dict[str, str]) -> None:
    differences = [
        f"{key} is {found.get(key, 'missing')} there, {expected.get(key, 'missing')} here"
        for key in sorted({*found, *expected})
        if found.get(key) != expected.get(key)
    ]
    if differences:
        raise InputError(
            f"machine {platform.node()} of the Ray cluster would make other bytes than this one "
            f"({'; '.join(differences)}): give all machines the same versions, or leave it out"
        )


def _collect(ticket: Any) -> Any:
    """Waits for a result.

    Raises:
        TwoHandsError: the function's own, or an actor died.
    """
    ray = import_ray()
    try:
        return ray.get(ticket)
    except ray.exceptions.RayTaskError as error:
        if isinstance(error.cause, TwoHandsError):
            raise error.cause from None
        raise
    except ray.exceptions.RayError as error:
        raise TwoHandsError(
            f"a worker of the Ray cluster died ({type(error).__name__}: killed, out of memory, or its machine gone): "
            "run the same command again to go on"
        ) from error


def _host_and_port(address: str | None) -> tuple[str, int]:
    """
    Raises:
        InputError: it is not HOST:PORT.
    """
    host, _, port = (address or "").rpartition(":")
    if not host or "/" in host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise InputError(f"Ray address must be 'auto' or HOST:PORT of the cluster's head, got '{address}'")
    return host.strip("[]"), int(port)


def _reach(address: str | None) -> None:
    """Ray itself would try for long, and complain in many lines.

    Raises:
        InputError: nothing answers.
    """
    try:
        socket.create_connection(_host_and_port(address), timeout=REACH_SECONDS).close()
    except OSError as error:
        raise InputError(
            f"no Ray cluster answers at '{address}' ({error.strerror or error}): "
            "give the address that `ray start --head` printed, on a machine that has joined that cluster"
        ) from error


def _first_line(error: BaseException) -> str:
    return next(iter(str(error).splitlines()), type(error).__name__)
