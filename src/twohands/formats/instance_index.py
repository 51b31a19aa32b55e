"""Line format of `index.jsonl`, which lists the instances of a generated set: one codec for the writer and the readers.

No files are touched here.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Final

from twohands.errors import DataFormatError

INDEX_FILE: Final = "index.jsonl"
"""One JSON object per line and instance, in the order of the instances."""
MANIFEST_FILE: Final = "manifest.json"
"""How the set was made."""
SHARD_PATTERN: Final = "shard-*.tar"


def shard_name(number: int) -> str:
    """File name of a tar shard."""
    return f"shard-{number:06d}.tar"


def instance_of_member(member: str) -> tuple[str, str]:
    """("0003/00012", "color.png") of the tar member "0003/00012.color.png": file names begin after the first dot of the
    last part, as the WebDataset tools split them."""
    folder, slash, base = member.rpartition("/")
    key, _, file = base.partition(".")
    return folder + slash + key, file


@dataclass(frozen=True, slots=True)
class IndexEntry:
    """One instance of a set.

    Attributes:
        instance: its name, and its folder's path below the set where it has one.
        bytes: size of its files together.
        sha256: `digest` of its files.
        shard: file name of the tar that holds it; None where it has a folder.
        offset: byte of the tar where its first member's header begins.
        length: bytes from there to the end of its last member, padding included.
    """

    instance: str
    bytes: int
    sha256: str
    shard: str | None = None
    offset: int | None = None
    length: int | None = None


def digest(files: Mapping[str, bytes]) -> str:
    """SHA-256 of the files' contents one after the other, in alphabetical order of their names.

    In a shell: `cat 00000/* | sha256sum`, with LC_ALL=C.
    """
    whole = hashlib.sha256()
    for name in sorted(files):
        whole.update(files[name])
    return whole.hexdigest()


def entry_of(instance: str, files: Mapping[str, bytes]) -> IndexEntry:
    """The entry of an instance in a folder of its own."""
    return IndexEntry(instance, sum(map(len, files.values())), digest(files))


def format_entry(entry: IndexEntry) -> str:
    """The entry's line, with its line break; fields that are None are left out."""
    return json.dumps({key: value for key, value in asdict(entry).items() if value is not None}) + "\n"


def parse_index(text: str) -> list[IndexEntry]:
    """The entries of an index.

    Args:
        text: the file's content. A last line without line break was cut off by the end of the process that wrote it,
            and is left out.

    Raises:
        DataFormatError: a line is not an entry.
    """
    entries = []
    for number, line in enumerate(text.split("\n")[:-1], 1):
        try:
            entry = IndexEntry(**json.loads(line))
            _check(entry)
        except (ValueError, TypeError, RecursionError):
            raise DataFormatError(f"{INDEX_FILE} line {number}: not an entry: {line[:60]}") from None
        entries.append(entry)
    return entries


def _check(entry: IndexEntry) -> None:
    """Raises TypeError for a field of another type, or ValueError for a number below 0 or a shard in another folder."""
    for value in (entry.instance, entry.sha256, entry.shard or ""):
        if not isinstance(value, str):
            raise TypeError(f"text expected, got {value!r}")
    for value in (entry.bytes, entry.offset or 0, entry.length or 0):
        if not isinstance(value, int):
            raise TypeError(f"an integer expected, got {value!r}")
        if value < 0:
            raise ValueError(f"a number of bytes expected, got {value}")
    if "/" in (entry.shard or ""):
        raise ValueError(f"a file's name expected, got {entry.shard}")


def natural_order(entries: Iterable[IndexEntry]) -> list[IndexEntry]:
    """Sorted by name, "99999" before "100000", "0002/00499" before "0003/00000"."""
    return sorted(entries, key=lambda entry: tuple((len(part), part) for part in entry.instance.split("/")))
