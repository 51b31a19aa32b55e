"""What has become of every clip: `manifest.jsonl`, by which a run that was killed goes on.

The first line says what holds for all clips; a run with other settings does not go on with it. Every other line is a
clip, in the order of their names::

    {"version": 1, "twohands": ..., "root": "s3://bucket/day1", "settings": {...}}
    {"input": "clip.mp4", "size": 1234, "etag": "...", "status": "done", "frames": 300, "error": null}

No clock and no worker has left a trace in it: the same clips give the same bytes, whoever has tracked them.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Final, Literal, get_args

from twohands.batch.stores import Clip, Store, by_name
from twohands.errors import InputError
from twohands.version import __version__

MANIFEST: Final = "manifest.jsonl"
VERSION: Final = 1
Status = Literal["done", "failed"]
_SHARE: Final = 0.05
"""Of the time, at most, that goes into writing the manifest while a run goes on."""


@dataclass(frozen=True, slots=True)
class Entry:
    """What has become of a clip.

    Attributes:
        input: its name below the root.
        size, etag: as `stores.Clip`.
        status: "done", with results beside the manifest in a folder of the clip's name, or "failed", without.
        frames: that were tracked.
        error: why it failed, or what of it could not be used; None where all is well.
    """

    input: str
    size: int | None
    etag: str | None
    status: Status
    frames: int
    error: str | None = None


class Manifest:
    """The manifest of a place while clips are tracked.

    Args:
        store: of the place.
        out: the place.
        root: place of the clips.
        settings: JSON values that the results depend on.
        clock: seconds.

    Attributes:
        entries: name of a clip -> what has become of it.
    """

    def __init__(
        self,
        store: Store,
        out: str,
        root: str,
        settings: Mapping[str, Any],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._store, self._out, self._clock = store, out, clock
        self._about = {"version": VERSION, "twohands": __version__, "root": root, "settings": settings}
        self._about = json.loads(json.dumps(self._about))
        self._next = 0.0
        self.entries: dict[str, Entry] = {}

    def load(self) -> None:
        """Takes over what an earlier run has written.

        Raises:
            InputError: there is none, it is damaged, or of other settings.
        """
        content = self._store.read(self._out, MANIFEST)
        if content is None:
            raise InputError(f"{self._out} is not empty and holds no {MANIFEST} to go on with: choose another --out")
        try:
            about, *lines = [json.loads(line) for line in content.decode().splitlines()]
            entries = [_entry(line) for line in lines]
            there = {**about, **about["settings"]}
        except (ValueError, TypeError, KeyError, RecursionError) as error:
            raise InputError(f"{self._out}: {MANIFEST} is damaged: start anew with --overwrite") from error
        here = {**self._about, **self._about["settings"]}
        other = sorted(key for key in {*there, *here} - {"settings"} if there.get(key) != here.get(key))
        if other:
            raise InputError(
                f"{self._out} holds results of another run (it differs in {', '.join(other)}): "
                "choose another --out, or start anew with --overwrite"
            )
        self.entries = {entry.input: entry for entry in entries}

    def holds(self, clip: Clip) -> bool:
        """Whether a clip is done, as it is now."""
        entry = self.entries.get(clip.name)
        return entry is not None and entry.status == "done" and (entry.size, entry.etag) == (clip.size, clip.etag)

    def add(self, entry: Entry) -> None:
        """Takes note of a clip; written at once, unless too much time would go into writing."""
        self.entries[entry.input] = entry
        began = self._clock()
        if began >= self._next:
            self.save()
            ended = self._clock()
            self._next = ended + (ended - began) / _SHARE

    def save(self) -> None:
        """Writes it, whole."""
        entries = sorted(self.entries.values(), key=lambda entry: by_name(entry.input))
        lines = [self._about, *map(asdict, entries)]
        content = "".join(json.dumps(line) + "\n" for line in lines)
        self._store.write(self._out, MANIFEST, content.encode())


def _entry(line: dict[str, Any]) -> Entry:
    """A line of the manifest.

    Raises:
        ValueError, TypeError: it is none.
    """
    entry = Entry(**line)
    told = (entry.size, int), (entry.etag, str), (entry.error, str)
    if (
        not isinstance(entry.input, str)
        or entry.status not in get_args(Status)
        or type(entry.frames) is not int
        or any(value is not None and type(value) is not kind for value, kind in told)
    ):
        raise ValueError(f"no line of a manifest: {line}")
    return entry
