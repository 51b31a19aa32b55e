"""Reader of tar shards as `twohands generate --format webdataset` writes them: the same samples as from folders."""

from __future__ import annotations

import copy
import os
import tarfile
from collections.abc import Mapping, Set
from io import BytesIO
from pathlib import Path

from twohands.datasets.ego3dhands import Ego3DHands, Ego3DHandsInstance, decode_instance
from twohands.datasets.files import existing_folder
from twohands.datasets.manifest import expected_hand_length_m
from twohands.errors import DataFormatError, InputError
from twohands.formats import ego3dhands as fmt
from twohands.formats.instance_index import (
    INDEX_FILE,
    SHARD_PATTERN,
    IndexEntry,
    instance_of_member,
    parse_index,
)
from twohands.types import HandSample


class ShardedEgo3DHands:
    """All instances of a folder of shards, in the order of its index, each read where the index says it lies.

    Instances of shards that are not finished, or not there, are left out and listed in `skipped`.

    Attributes:
        root: the folder.
        entries: the index's lines.
        skipped: (shard, reason).
        hand_length_m: |wrist - root| of every hand, metres.

    Args:
        root: holds `shard-000000.tar` ... and `index.jsonl`.

    Raises:
        InputError: the folder does not exist, or holds no finished shard.
        DataFormatError: the index is missing or damaged.
    """

    _left_out: Set[str] = frozenset()

    def __init__(self, root: str | os.PathLike[str]) -> None:
        self.root = existing_folder(root)
        self.hand_length_m = expected_hand_length_m(self.root) or fmt.HAND_LENGTH_M
        sizes = {path.name: path.stat().st_size for path in self.root.glob(SHARD_PATTERN) if path.is_file()}
        try:
            entries = parse_index((self.root / INDEX_FILE).read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError) as error:
            raise DataFormatError(
                f"{self.root / INDEX_FILE} cannot be read ({error}): run twohands generate again to have it made anew"
            ) from None
        here = [entry for entry in entries if _lies_within(entry, sizes)]
        lost = sorted({str(entry.shard) for entry in entries} - {str(entry.shard) for entry in here})
        self.entries = tuple(here)
        self.skipped = tuple((self.root / shard, "missing, cut off or not finished") for shard in lost)
        if not self.entries:
            raise InputError(f"{self.root}: no finished shard ({SHARD_PATTERN}) that {INDEX_FILE} lists")

    @staticmethod
    def is_sharded(root: Path) -> bool:
        """Whether the folder holds shards."""
        return root.is_dir() and any(root.glob(SHARD_PATTERN))

    @property
    def name(self) -> str:
        """Name of the folder."""
        return self.root.resolve().name

    def __len__(self) -> int:
        return len(self.entries)

    def __getitem__(self, index: int) -> HandSample:
        return self.instance(index).to_sample(self.source(index))

    def instance(self, index: int) -> Ego3DHandsInstance:
        """An instance, elbows and canonical joints included.

        Raises:
            DataFormatError: it is damaged.
        """
        entry = self.entries[index]
        return decode_instance(self.files(index), self.root / str(entry.shard) / entry.instance, self._left_out)

    def leaving_out(self, names: Set[str]) -> ShardedEgo3DHands:
        """The same instances without decoding some of their files (`ego3dhands.decode_instance`)."""
        other = copy.copy(self)
        other._left_out = names
        return other

    def files(self, index: int) -> Mapping[str, bytes]:
        """The files of an instance, by name.

        Raises:
            DataFormatError: the shard cannot be read, or they are not where the index says.
        """
        entry = self.entries[index]
        shard = self.root / str(entry.shard)
        try:
            with shard.open("rb") as file:
                file.seek(entry.offset or 0)
                data = file.read(entry.length or 0)
        except OSError as error:
            raise DataFormatError(f"{shard}: cannot be read ({error.strerror})") from None
        files: dict[str, bytes] = {}
        try:
            with tarfile.open(fileobj=BytesIO(data), mode="r:") as tar:
                for member in tar:
                    name, file_name = instance_of_member(member.name)
                    content = tar.extractfile(member)
                    if name == entry.instance and content is not None:
                        files[file_name] = content.read()
        except tarfile.TarError as error:
            raise DataFormatError(f"{shard}: {entry.instance} is damaged ({error})") from None
        if not files:
            raise DataFormatError(f"{shard}: {entry.instance} is not where {INDEX_FILE} says")
        return files

    def source(self, index: int) -> str:
        """Identifies an instance: its name."""
        return self.entries[index].instance


def open_ego3dhands(root: str | os.PathLike[str]) -> Ego3DHands | ShardedEgo3DHands:
    """The reader that fits a folder: shards, or instances in folders.

    Raises:
        InputError: the folder does not exist or holds no instance.
        DataFormatError: the index of the shards is missing or damaged.
    """
    return ShardedEgo3DHands(root) if ShardedEgo3DHands.is_sharded(Path(root)) else Ego3DHands(root)


def _lies_within(entry: IndexEntry, sizes: Mapping[str, int]) -> bool:
    if entry.shard is None or entry.offset is None or entry.length is None:
        return False
    return entry.offset + entry.length <= sizes.get(entry.shard, -1)
