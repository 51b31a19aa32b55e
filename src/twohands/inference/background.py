"""Work beside the main thread: reading ahead of it, and writing behind it."""

from __future__ import annotations

import contextlib
import queue
import threading
from collections.abc import Callable, Iterable, Iterator
from typing import Generic, TypeVar

T = TypeVar("T")
_END = object()


def ahead(items: Iterable[T], count: int = 4) -> Iterator[T]:
    """Items in their order, up to `count` of them made in a thread before they are asked for.

    Raises:
        Exception: what making an item raised, in its turn.
    """
    ready: queue.Queue[object] = queue.Queue(count)
    stopped = threading.Event()

    def put(item: object) -> bool:
        while not stopped.is_set():
            with contextlib.suppress(queue.Full):
                ready.put(item, timeout=0.1)
                return True
        return False

    def work() -> None:
        try:
            for item in items:
                if not put(item):
                    return
            put(_END)
        except BaseException as error:  # handed over, whatever it is
            put(_Raised(error))

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    try:
        while (item := ready.get()) is not _END:
            if isinstance(item, _Raised):
                raise item.error
            yield item  # pyright: ignore[reportReturnType]
    finally:
        stopped.set()
        thread.join(timeout=15.0)


class Behind(Generic[T]):
    """Calls a function with items in a thread, in their order; a context manager.

    Leaving waits for all of them. What the function raises comes out at the next `put`, or when leaving.

    Args:
        function: called with each item.
        count: items that wait; `put` waits where there are more.
    """

    def __init__(self, function: Callable[[T], None], count: int = 4) -> None:
        self._function = function
        self._items: queue.Queue[object] = queue.Queue(count)
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._work, daemon=True)

    def __enter__(self) -> Behind[T]:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._items.put(_END)
        self._thread.join()
        if self._error is not None and kind is None:
            raise self._error

    def put(self, item: T) -> None:
        """One more item."""
        if self._error is not None:
            raise self._error
        self._items.put(item)

    def _work(self) -> None:
        while (item := self._items.get()) is not _END:
            if self._error is None:  # after an error items are only taken away, so that `put` does not wait for ever
                try:
                    self._function(item)  # pyright: ignore[reportArgumentType]
                except BaseException as error:
                    self._error = error


class _Raised:
    def __init__(self, error: BaseException) -> None:
        self.error = error
