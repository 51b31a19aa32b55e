"""What every source of labelled pictures offers."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from twohands.types import HandSample


@runtime_checkable
class HandDataset(Protocol):
    """A finite, indexable collection of labelled pictures; reading an index twice gives equal samples."""

    @property
    def name(self) -> str:
        """Short name for messages and reports."""
        ...

    def __len__(self) -> int: ...

    def __getitem__(self, index: int) -> HandSample: ...
