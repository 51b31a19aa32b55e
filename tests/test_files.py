"""Files appear whole or not at all, and are read up to a limit."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from twohands.errors import InputError
from twohands.files import appearing, partial_path, read_file, write_whole


def test_an_old_file_stays_until_the_new_one_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    write_whole(path, b"old")
    with appearing(path) as partial:
        partial.write_bytes(b"new")
        assert path.read_bytes() == b"old"
    assert path.read_bytes() == b"new"
    assert list(tmp_path.iterdir()) == [path]


def test_after_an_error_the_old_file_is_there_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    write_whole(path, b"old")
    with pytest.raises(KeyboardInterrupt), appearing(path) as partial:
        partial.write_bytes(b"half of the n")
        raise KeyboardInterrupt
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_what_a_killed_process_left_is_written_over(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    partial_path(path).write_bytes(b"left over, and longer")
    write_whole(path, b"new")
    assert path.read_bytes() == b"new"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(("limit", "read"), [(2, b"012"), (10, b"0123456789"), (99, b"0123456789")])
def test_a_file_is_read_to_its_limit_and_one_byte_further(tmp_path: Path, limit: int, read: bytes) -> None:
    path = tmp_path / "a.txt"
    path.write_bytes(b"0123456789")
    assert read_file(path, limit) == read


def test_a_pipe_is_read_to_its_end() -> None:
    source, sink = os.pipe()
    os.write(sink, b"0123456789")
    os.close(sink)
    try:
        assert read_file(Path(f"/dev/fd/{source}"), 99) == b"0123456789"
    finally:
        os.close(source)


def test_what_cannot_be_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"b\.txt: no such camera file$"):
        read_file(tmp_path / "b.txt", 99, "camera file")
    with pytest.raises(InputError, match="cannot be read: Is a directory"):
        read_file(tmp_path, 99)
    with pytest.raises(InputError, match=r"cannot be read: .*null"):
        read_file(tmp_path / "\0", 99)
