"""Clips and commands for the tests of many clips."""

from __future__ import annotations

from pathlib import Path

from tests.inference.clips import write_clip

RATE = 25.0
SIZE = (64, 48)


def write_clips(folder: Path, count: int, frames: int = 3, size: tuple[int, int] = SIZE) -> Path:
    """A folder of `count` tiny clips, all of other lengths, clip0.mp4 and so on."""
    folder.mkdir(parents=True, exist_ok=True)
    for number in range(count):
        times_s = [index / RATE for index in range(frames + number % 3)]
        write_clip(folder / f"clip{number}.mp4", times_s, size)
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    """Every file below a folder, by its name there."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}
