"""Folders of pictures that a user gives, of which some may be damaged."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Generic, TypeVar

import cv2
import numpy as np

from twohands.errors import InputError
from twohands.formats.pictures import IMAGE_SUFFIXES, read_pixels
from twohands.synth.backgrounds.panoramas import is_panorama

Content = TypeVar("Content")


class PictureFolder(Generic[Content]):
    """The pictures of a folder and its subfolders.

    A picture that cannot be read is skipped: the next one is taken in its place, and it is named in `unreadable`.

    Attributes:
        folder: of the user.
        files: all pictures, sorted.
        name: the folder's name, their number, and a checksum of their names and sizes.
        unreadable: a line for every picture that was skipped so far.

    Args:
        folder: holds pictures (docs/inputs.md).
        what: they show, for messages: "background".
        read: reads a picture; None if it cannot be read. Picklable.
        keep: how many pictures to keep in memory.
        describe: what belongs to the checksum beside a picture's name and size.

    Raises:
        InputError: the folder does not exist, cannot be read, or holds no readable picture.
    """

    def __init__(
        self,
        folder: Path,
        what: str,
        read: Callable[[Path], Content | None],
        keep: int,
        describe: Callable[[Path], str] = lambda path: "",
    ) -> None:
        if not folder.is_dir():
            raise InputError(f"{what} folder {folder} does not exist")
        if not os.access(folder, os.R_OK | os.X_OK):
            raise InputError(f"{what} folder {folder} cannot be read: no permission")
        found = (path for path in folder.rglob("*") if path.suffix.lower() in IMAGE_SUFFIXES and path.is_file())
        self.files = tuple(sorted(found))
        if not self.files:
            raise InputError(f"no {what} picture ({', '.join(IMAGE_SUFFIXES)}) in {folder}")
        self.folder, self.what, self.keep = folder, what, keep
        self._read_file = read
        self.unreadable: list[str] = []
        if all(read_picture(path) is None for path in self.files):
            raise InputError(f"none of the {len(self.files)} {what} pictures in {folder} can be read")
        listing = "\n".join(
            f"{path.relative_to(folder).as_posix()} {path.stat().st_size}{describe(path)}" for path in self.files
        )
        digest = hashlib.sha256(listing.encode()).hexdigest()[:12]
        self.name = f"{folder.name} ({len(self.files)} pictures, {digest})"

    @cached_property
    def _read(self) -> Callable[[Path], Content | None]:
        return lru_cache(maxsize=self.keep)(self._read_file)

    def __getstate__(self) -> dict[str, object]:
        return {key: value for key, value in self.__dict__.items() if key != "_read"}

    def pick(self, rng: np.random.Generator) -> tuple[Path, Content]:
        """A random picture: its file, and what `read` made of it.

        Raises:
            InputError: no picture can be read any more.
        """
        first = int(rng.integers(len(self.files)))
        for path in (*self.files[first:], *self.files[:first]):
            content = self._read(path)
            if content is not None:
                return path, content
            self.note(path)
        raise InputError(f"{self.what} pictures of {self.name} cannot be read")

    def note(self, path: Path, part: str = "") -> None:
        """Adds to `unreadable`, once, that a picture, or `part` of it ("light of "), cannot be read."""
        line = f"{part}{self.what} {path.relative_to(self.folder).as_posix()} cannot be read"
        if line not in self.unreadable:
            self.unreadable.append(line)


def read_picture(path: Path) -> np.ndarray | None:
    """A background at most 960 pixels wide or high, a panorama at most 2048.

    Returns:
        (H, W, 3) uint8 RGB; None if the file is missing, cut off, or no picture.
    """
    picture = read_pixels(path, cv2.IMREAD_COLOR)
    if picture is None:
        return None
    scale = (2048 if is_panorama(*picture.shape[1::-1]) else 960) / max(picture.shape[:2])
    if scale < 1:
        picture = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB))
