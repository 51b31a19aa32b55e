"""Where finished instances go: a folder each, or tar shards. What is there is whole, whenever the process was killed.

A sink has one writer, the process that runs the set. It adds a line to `index.jsonl` after each instance; a rerun
believes the index as far as the data are there, and makes the rest again.
"""

from __future__ import annotations

import errno
import os
import shutil
import tarfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from io import BytesIO
from itertools import groupby
from pathlib import Path
from typing import BinaryIO, Protocol

from twohands.errors import DataFormatError, InputError
from twohands.files import write_whole
from twohands.formats.instance_index import (
    INDEX_FILE,
    SHARD_PATTERN,
    IndexEntry,
    entry_of,
    format_entry,
    instance_of_member,
    natural_order,
    parse_index,
    shard_name,
)

STAGING = ".staging"
"""Folder in which an instance is put together before it is renamed to its own."""


class Sink(Protocol):
    """Takes instances, in any order."""

    entries: dict[str, IndexEntry]
    """The instances that are there, by name."""

    def write(self, name: str, files: Mapping[str, bytes]) -> None:
        """Adds one instance.

        Raises:
            InputError: it cannot be written, or the disk is full; nothing half-written is left.
        """
        ...

    def close(self) -> None:
        """Sorts the index and lets go of all files; also after an error."""
        ...


class InstanceIndex:
    """`index.jsonl` while a set is written: lines are appended, and sorted at the end.

    Args:
        folder: of the set.

    Raises:
        InputError: it cannot be read.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / INDEX_FILE
        self.entries: dict[str, IndexEntry] = {}
        self._file: BinaryIO | None = None
        try:
            text = self.path.read_text(encoding="utf-8") if self.path.is_file() else ""
            self.entries = {entry.instance: entry for entry in parse_index(text)}
        except OSError as error:
            raise _write_error(self.path, error) from error
        except (DataFormatError, UnicodeDecodeError):
            pass  # the index can be made again from the data, which is what matters

    def keep(self, entries: Mapping[str, IndexEntry]) -> None:
        """Replaces the index by these entries, sorted; the file stays as it is if it holds just them."""
        self.entries = dict(entries)
        content = "".join(map(format_entry, natural_order(self.entries.values()))).encode()
        with _write_errors(self.path):
            if not self.path.is_file() or self.path.read_bytes() != content:
                write_whole(self.path, content)

    def add(self, entry: IndexEntry) -> None:
        """Appends one line in one write."""
        with _write_errors(self.path):
            self._file = self._file or self.path.open("ab", buffering=0)
            _append(self._file, format_entry(entry).encode())
        self.entries[entry.instance] = entry

    def close(self) -> None:
        """Sorts the file."""
        if self._file is not None:
            self._file.close()
            self._file = None
            self.keep(self.entries)


class FolderSink:
    """One folder per instance: the Ego3DHands layout.

    Args:
        root: the set's folder.
        names: the set's instances; those that are there and not in the index, for their folder was finished and the
            process killed before it could write the line, are taken into it.
    """

    def __init__(self, root: Path, names: Sequence[str]) -> None:
        self.root = root
        shutil.rmtree(root / STAGING, ignore_errors=True)
        self.index = InstanceIndex(root)
        kept = {name: entry for name, entry in self.index.entries.items() if (root / name).is_dir()}
        for name in names:
            if name not in kept and (root / name).is_dir():
                kept[name] = entry_of(name, {path.name: path.read_bytes() for path in (root / name).iterdir()})
        self.index.keep(kept)
        self.entries = self.index.entries

    def write(self, name: str, files: Mapping[str, bytes]) -> None:
        """See `Sink.write`: the folder appears whole or not at all."""
        staging, folder = self.root / STAGING, self.root / name
        with _write_errors(folder):
            try:
                staging.mkdir()
                for file, content in files.items():
                    (staging / file).write_bytes(content)
                folder.parent.mkdir(parents=True, exist_ok=True)
                os.replace(staging, folder)
            except BaseException:
                shutil.rmtree(staging, ignore_errors=True)
                raise
        self.index.add(entry_of(name, files))

    def close(self) -> None:
        """See `Sink.close`."""
        self.index.close()


class ShardSink:
    """Tar files of a fixed number of instances in a row, as the WebDataset tools read them.

    Members are named `<instance>.<file>`, in alphabetical order, without date or owner, so that the same instances give
    the same bytes. A shard is called `.shard-000000.tar.partial` until its last instance is in.

    Args:
        root: the set's folder.
        names: the set's instances, in order.
        shard_size: instances per shard; the last one may hold fewer.

    Raises:
        InputError: fewer than one instance per shard.
    """

    def __init__(self, root: Path, names: Sequence[str], shard_size: int) -> None:
        if shard_size < 1:
            raise InputError(f"shard size must be at least 1, got {shard_size}")
        self.root, self.shard_size = root, shard_size
        self.members = {
            shard_name(i // shard_size): names[i : i + shard_size] for i in range(0, len(names), shard_size)
        }
        self._shard_of = {name: shard for shard, members in self.members.items() for name in members}
        self.index = InstanceIndex(root)
        self._shard: str | None = None
        self._file: BinaryIO | None = None
        listed: dict[str, list[IndexEntry]] = {}
        for entry in self.index.entries.values():
            listed.setdefault(entry.shard or "", []).append(entry)
        shards = {*self.members, *(path.name for path in root.glob(SHARD_PATTERN))}
        kept = [entry for shard in shards for entry in self._there(shard, listed.get(shard, []))]
        self.index.keep({entry.instance: entry for entry in kept})
        self.entries = self.index.entries
        self._end = {shard: 0 for shard in self.members}
        for entry in kept:
            if entry.shard in self._end:
                self._end[entry.shard] += entry.length or 0
        for shard in self.members:
            if self._partial(shard).exists() and self._is_full(shard):  # killed just before it was renamed
                self._open(shard)
                self._finish()

    def write(self, name: str, files: Mapping[str, bytes]) -> None:
        """See `Sink.write`: instances of one shard must come in order."""
        shard = self._shard_of[name]
        if shard != self._shard:
            self._open(shard)
        assert self._file is not None
        content = tar_members(name, files)
        with _write_errors(self._partial(shard)):
            _append(self._file, content)
        start = self._end[shard]
        self.index.add(replace(entry_of(name, files), shard=shard, offset=start, length=len(content)))
        self._end[shard] += len(content)
        if self._is_full(shard):
            self._finish()

    def close(self) -> None:
        """See `Sink.close`."""
        if self._file is not None:
            self._file.close()
            self._file = self._shard = None
        self.index.close()

    def _partial(self, shard: str) -> Path:
        return self.root / f".{shard}.partial"

    def _is_full(self, shard: str) -> bool:
        return all(name in self.entries for name in self.members[shard])

    def _there(self, shard: str, entries: list[IndexEntry]) -> list[IndexEntry]:
        """Those entries of a shard that follow each other from its first byte and end within its file; all of a
        finished shard that the index has lost."""
        whole, partial = self.root / shard, self._partial(shard)
        path = partial if partial.exists() else whole
        if not path.exists():
            return []
        chain, end, size = [], 0, path.stat().st_size
        for entry in sorted(entries, key=lambda entry: entry.offset or 0):
            if entry.offset != end or entry.length is None or end + entry.length > size:
                break
            chain.append(entry)
            end += entry.length
        return chain if chain or path == partial else scan_shard(whole)

    def _open(self, shard: str) -> None:
        """Goes on with a shard after its last listed instance."""
        if self._file is not None:
            self._file.close()
        path, whole, end = self._partial(shard), self.root / shard, self._end[shard]
        with _write_errors(path):
            if end and not path.exists():  # a finished shard of a set that has grown
                copy = path.with_name(f"{path.name}.copy")
                shutil.copyfile(whole, copy)
                os.replace(copy, path)
            self._file = path.open("r+b" if path.exists() else "w+b", buffering=0)
            self._file.truncate(end)
            self._file.seek(end)
        self._shard = shard

    def _finish(self) -> None:
        """Closes the tar and gives it its name."""
        assert self._file is not None and self._shard is not None
        with _write_errors(self._partial(self._shard)):
            end = 2 * tarfile.BLOCKSIZE
            _append(self._file, bytes(end + -(self._file.tell() + end) % tarfile.RECORDSIZE))
            self._file.close()
            os.replace(self._partial(self._shard), self.root / self._shard)
        self._file = self._shard = None


def tar_members(name: str, files: Mapping[str, bytes]) -> bytes:
    """The instance as members of a tar file, headers and padding included, without the tar's end."""
    whole = BytesIO()
    for file in sorted(files):
        header = tarfile.TarInfo(f"{name}.{file}")
        header.size = len(files[file])
        whole.write(header.tobuf(tarfile.USTAR_FORMAT))
        whole.write(files[file])
        whole.write(bytes(-len(files[file]) % tarfile.BLOCKSIZE))
    return whole.getvalue()


def scan_shard(path: Path) -> list[IndexEntry]:
    """The entries of a finished shard, from its content; none if it is damaged."""
    entries: list[IndexEntry] = []
    try:
        with tarfile.open(path, "r:") as tar:
            for name, members in groupby(tar, key=lambda member: instance_of_member(member.name)[0]):
                files, start = {}, None
                for member in members:
                    content = tar.extractfile(member)
                    files[instance_of_member(member.name)[1]] = content.read() if content else b""
                    start = member.offset if start is None else start
                length = len(tar_members(name, files))
                entries.append(replace(entry_of(name, files), shard=path.name, offset=start, length=length))
    except (tarfile.TarError, OSError):
        return []
    return entries


def _append(file: BinaryIO, content: bytes) -> None:
    """Writes all of it or, if the disk is full, nothing."""
    start = file.seek(0, os.SEEK_END)
    try:
        view = memoryview(content)
        while view:
            view = view[file.write(view) :]
    except OSError:
        file.truncate(start)
        raise


@contextmanager
def _write_errors(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise _write_error(path, error) from error


def _write_error(path: Path, error: OSError) -> InputError:
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return InputError(f"{path}: the disk is full: free some space and run the same command again to go on")
    return InputError(f"{path}: cannot be written: {error.strerror}")
