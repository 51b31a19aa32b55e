"""Where clips come from and results go: folders of this machine, and buckets that fsspec reaches (extra `remote`).

A place is a path, or the address of a bucket or a folder in it: "s3://bucket/day1". What lies below is named with
slashes: "camera2/clip.mp4".
"""

from __future__ import annotations

import contextlib
import glob
import hashlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, Final, Protocol

from twohands.batch.clip import RESULTS
from twohands.errors import InputError, MissingExtraError
from twohands.files import write_whole
from twohands.formats.pictures import natural_key
from twohands.inference.frames import VIDEO_SUFFIXES

_STREAMS: Final = frozenset(
    ("hls", "http", "https", "mms", "mmsh", "rtmp", "rtmps", "rtp", "rtsp", "rtsps", "sap", "srt", "tcp", "tls", "udp")
)
"""Schemes of addresses that are streams to PyAV."""
_MAGIC: Final = "*?["
_ETAGS: Final = ("ETag", "etag", "md5Hash", "md5", "content_hash", "hash")
"""Names under which file systems keep what tells a file's content, without its bytes."""


@dataclass(frozen=True, slots=True)
class Clip:
    """A clip of a listing.

    Attributes:
        name: below the listing's root.
        size: bytes; None where the store does not say.
        etag: changes when the content does; of a local file made of its size and time; None where there is none.
    """

    name: str
    size: int | None = None
    etag: str | None = None


@dataclass(frozen=True, slots=True)
class Listing:
    """What a file, a folder or a pattern names.

    Attributes:
        root: place that everything lies below.
        clips: videos, by their endings, in the order of their names.
        others: number of files that are none.
    """

    root: str
    clips: tuple[Clip, ...]
    others: int


class Store(Protocol):
    """A kind of places. Every method raises InputError where a place cannot be read or written, and says why."""

    def files(self, place: str) -> tuple[str, list[Clip]]:
        """Root and files of a file, a folder (its own files alone) or a pattern with * ? [ or **."""
        ...

    def fetched(self, root: str, name: str) -> contextlib.AbstractContextManager[Path]:
        """A file as one of this machine, for as long as the block runs."""
        ...

    def staging(self, out: str, name: str) -> contextlib.AbstractContextManager[Path]:
        """An empty folder in which a clip's results are put together, for as long as the block runs."""
        ...

    def deliver(self, folder: Path, out: str, name: str) -> None:
        """Gives a staged folder its place; an old one of a clip's results is replaced, anything else is refused."""
        ...

    def discard(self, out: str, name: str) -> None:
        """Removes a clip's results; anything else that is in their place stays."""
        ...

    def canonical(self, place: str) -> str:
        """The one name of a place that has several; places of different stores compare as well."""
        ...

    def read(self, out: str, name: str) -> bytes | None:
        """A small file of a place; None where there is none."""
        ...

    def write(self, out: str, name: str, content: bytes) -> None:
        """A small file, which appears whole or not at all."""
        ...

    def is_empty(self, out: str) -> bool:
        """Whether nothing is there, hidden files apart."""
        ...


def is_remote(place: str) -> bool:
    """Whether a place is reached by fsspec: it has a scheme, and not one of a stream."""
    scheme, sign, _ = place.partition("://")
    return bool(sign) and scheme.lower() not in _STREAMS


def store_of(place: str) -> Store:
    """What reads and writes a place.

    Raises:
        MissingExtraError: fsspec is not installed.
        InputError: fsspec does not know its scheme, or lacks the package for it.
    """
    return RemoteStore(place) if is_remote(place) else LocalStore()


def list_clips(place: str) -> Listing:
    """The clips that a file, a folder or a pattern names.

    Raises:
        InputError: there is no such thing, or no video in it.
        MissingExtraError: fsspec is not installed.
    """
    root, files = store_of(place).files(place)
    clips = [clip for clip in files if PurePosixPath(clip.name).suffix.lower() in VIDEO_SUFFIXES]
    if not clips:
        found = f"none of its {len(files)} files is a video by its ending" if files else "no file there"
        raise InputError(f"{place}: {found}; a video, a folder of videos or a pattern such as '*.mp4' expected")
    clips.sort(key=lambda clip: by_name(clip.name))
    return Listing(root, tuple(clips), len(files) - len(clips))


def by_name(name: str) -> tuple[list[tuple[int, int | str]], str]:
    """Sort key of names: numbers count as numbers, and no two names are alike."""
    return natural_key(name), name


def has_magic(place: str) -> bool:
    """Whether a place is a pattern."""
    return any(sign in place for sign in _MAGIC)


def join(place: str, name: str) -> str:
    """The place of something below a place."""
    return f"{place.rstrip('/')}/{name}"


class LocalStore:
    """Folders of this machine."""

    def files(self, place: str) -> tuple[str, list[Clip]]:
        """See `Store.files`; the root is absolute."""
        path = os.path.abspath(place)
        if has_magic(place) and not os.path.lexists(path):
            root, pattern = _split(place)
            root = os.path.abspath(root)
            found = [os.path.join(root, each) for each in glob.glob(pattern, root_dir=root, recursive=True)]
        elif os.path.isdir(path):
            root = path
            with _local_errors(place, "read"):
                found = [os.path.join(root, each) for each in os.listdir(root) if not each.startswith(".")]
        elif os.path.lexists(path):
            root, found = os.path.dirname(path), [path]
        else:
            raise InputError(f"{place}: no such file or folder")
        return root, [_local_clip(root, each) for each in found if os.path.isfile(each)]

    @contextlib.contextmanager
    def fetched(self, root: str, name: str) -> Iterator[Path]:
        """See `Store.fetched`: the file itself."""
        yield Path(root, name)

    @contextlib.contextmanager
    def staging(self, out: str, name: str) -> Iterator[Path]:
        """See `Store.staging`: beside its place."""
        place = Path(out, name)  # whose name may be as long as names can be
        folder = place.with_name(f".{hashlib.sha256(os.fsencode(place.name)).hexdigest()[:16]}.partial")
        shutil.rmtree(folder, ignore_errors=True)
        with _local_errors(str(folder), "written"):
            folder.mkdir(parents=True)
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def deliver(self, folder: Path, out: str, name: str) -> None:
        """See `Store.deliver`: the folder appears whole or not at all."""
        place = Path(out, name)
        with _local_errors(str(place), "written"):
            place.parent.mkdir(parents=True, exist_ok=True)
            if os.path.lexists(place):
                if not _holds_results(place):
                    raise _foreign(str(place))
                shutil.rmtree(place)
            os.replace(folder, place)

    def discard(self, out: str, name: str) -> None:
        """See `Store.discard`."""
        place = Path(out, name)
        with _local_errors(str(place), "removed"):
            if _holds_results(place):
                shutil.rmtree(place)

    def canonical(self, place: str) -> str:
        """See `Store.canonical`."""
        return os.path.realpath(place)

    def read(self, out: str, name: str) -> bytes | None:
        """See `Store.read`."""
        path = Path(out, name)
        with _local_errors(str(path), "read"):
            return path.read_bytes() if path.is_file() else None

    def write(self, out: str, name: str, content: bytes) -> None:
        """See `Store.write`."""
        with _local_errors(str(Path(out, name)), "written"):
            os.makedirs(out, exist_ok=True)
            write_whole(Path(out, name), content)

    def is_empty(self, out: str) -> bool:
        """See `Store.is_empty`."""
        with _local_errors(out, "read"):
            return not (os.path.lexists(out) and any(not name.startswith(".") for name in os.listdir(out)))


class RemoteStore:
    """Buckets and other places that fsspec reaches.

    Args:
        place: any of them.

    Raises:
        MissingExtraError: fsspec is not installed.
        InputError: fsspec does not know its scheme, or lacks the package for it.
    """

    def __init__(self, place: str) -> None:
        try:
            from fsspec.core import url_to_fs
        except ImportError:
            raise MissingExtraError(f"{place}: a bucket", "remote") from None
        with _remote_errors(place, "opened"):
            self._fs: Any = url_to_fs(place)[0]

    def files(self, place: str) -> tuple[str, list[Clip]]:
        """See `Store.files`."""
        place = place.rstrip("/")
        with _remote_errors(place, "listed"):
            self._fs.invalidate_cache()  # of what was there before
            path = self._path(place)
            if self._fs.isfile(path):
                root, found = place.rpartition("/")[0], [self._fs.info(path)]
            elif has_magic(place) and not self._fs.isdir(path):
                root = _split_address(place)
                found = list(self._fs.glob(path, detail=True).values())
                if not found:
                    self._fs.ls(self._path(root), detail=False)  # says if there is no such bucket
            else:
                root, found = place, self._fs.ls(path, detail=True)
            start = len(self._path(root).rstrip("/")) + 1
            return root, [_remote_clip(info, start) for info in found if info.get("type") == "file"]

    @contextlib.contextmanager
    def fetched(self, root: str, name: str) -> Iterator[Path]:
        """See `Store.fetched`: downloaded."""
        with tempfile.TemporaryDirectory(prefix="twohands-") as folder:
            path = Path(folder, f"clip{PurePosixPath(name).suffix}")
            with _remote_errors(join(root, name), "read"):
                self._fs.get_file(self._path(join(root, name)), str(path))
            yield path

    @contextlib.contextmanager
    def staging(self, out: str, name: str) -> Iterator[Path]:
        """See `Store.staging`: among the temporary files of this machine."""
        with tempfile.TemporaryDirectory(prefix="twohands-") as folder:
            yield Path(folder)

    def deliver(self, folder: Path, out: str, name: str) -> None:
        """See `Store.deliver`: file by file; the manifest tells which clips are whole."""
        place = self._path(join(out, name))
        with _remote_errors(join(out, name), "written"):
            old = self._results(place)
            if old is None:
                raise _foreign(join(out, name))
            self._remove(old)
            self._make_folder(place)
            for path in sorted(folder.iterdir()):
                self._fs.put_file(str(path), join(place, path.name))

    def discard(self, out: str, name: str) -> None:
        """See `Store.discard`."""
        place = self._path(join(out, name))
        with _remote_errors(join(out, name), "removed"):
            old = self._results(place)
            if old:
                self._remove(old)
                if place.startswith("/") and self._fs.isdir(place):  # see `_make_folder`
                    self._fs.rmdir(place)

    def canonical(self, place: str) -> str:
        """See `Store.canonical`."""
        path, names = self._path(place), self._fs.protocol
        scheme = names if isinstance(names, str) else names[0]
        if scheme == "file":
            return os.path.realpath(path)
        return f"{scheme}://{getattr(self._fs, 'host', '')}/{path.lstrip('/')}"

    def read(self, out: str, name: str) -> bytes | None:
        """See `Store.read`."""
        with _remote_errors(join(out, name), "read"):
            self._fs.invalidate_cache()
            path = self._path(join(out, name))
            return self._fs.cat_file(path) if self._fs.isfile(path) else None

    def write(self, out: str, name: str, content: bytes) -> None:
        """See `Store.write`: buckets put an object whole or not at all."""
        with _remote_errors(join(out, name), "written"):
            self._make_folder(self._path(out))
            self._fs.pipe_file(self._path(join(out, name)), content)

    def is_empty(self, out: str) -> bool:
        """See `Store.is_empty`."""
        with _remote_errors(out, "listed"):
            self._fs.invalidate_cache()
            return not (self._fs.exists(self._path(out)) and self._fs.ls(self._path(out), detail=False))

    def _path(self, place: str) -> str:
        return str(self._fs._strip_protocol(place))

    def _results(self, path: str) -> list[str] | None:
        """Files of a clip's results; none where nothing is, None where it is something else."""
        self._fs.invalidate_cache()
        if self._fs.isfile(path):
            return None
        found = [str(each) for each in self._fs.find(path)]
        return found if all(each.removeprefix(f"{path}/") in RESULTS for each in found) else None

    def _remove(self, paths: list[str]) -> None:
        """One by one: `rm` takes * ? [ in a name for a pattern."""
        for path in paths:
            self._fs.rm_file(path)

    def _make_folder(self, path: str) -> None:
        """Where a file system has folders. Buckets have none: a bucket would be made, which is not ours to do."""
        if path.startswith("/"):
            self._fs.makedirs(path, exist_ok=True)


def _split(place: str) -> tuple[str, str]:
    """The folders of a pattern before the first sign of one, and the rest."""
    parts = place.split("/")
    first = next(i for i, part in enumerate(parts) if has_magic(part))
    root = "/".join(parts[:first])
    return root or ("/" if first else ""), "/".join(parts[first:])


def _split_address(place: str) -> str:
    """The folders of a remote pattern before the first sign of one.

    Raises:
        InputError: the bucket is a pattern.
    """
    scheme, _, path = place.partition("://")
    if has_magic(path.lstrip("/").partition("/")[0]):
        raise InputError(f"{place}: a pattern may stand below a bucket, not in its name")
    return f"{scheme}://{_split(path)[0]}"


def _holds_results(place: Path) -> bool:
    """Whether it is a folder of this machine with a clip's results and nothing else."""
    return place.is_dir() and not place.is_symlink() and set(os.listdir(place)) <= RESULTS


def _foreign(place: str) -> InputError:
    return InputError(f"{place}: holds something else than a clip's results: move it away, or choose another output")


def _local_clip(root: str, path: str) -> Clip:
    status = os.stat(path)
    name = PurePosixPath(Path(path).relative_to(root)).as_posix()
    return Clip(name, status.st_size, f"{status.st_mtime_ns:x}-{status.st_size:x}")


def _remote_clip(info: dict[str, Any], start: int) -> Clip:
    etag = next((str(info[key]).strip('"') for key in _ETAGS if info.get(key)), None)
    size = info.get("size")
    return Clip(str(info["name"])[start:], None if size is None else int(size), etag)


@contextlib.contextmanager
def _local_errors(place: str, what: str) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise InputError(f"{place}: cannot be {what}: {error.strerror or error}") from error


@contextlib.contextmanager
def _remote_errors(place: str, what: str) -> Iterator[None]:
    """Every file system has errors of its own, those of its network included: the first line of any is what is said."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        lines = str(error).strip().splitlines()
        reason = lines[0] if lines else type(error).__name__
        if isinstance(error, FileNotFoundError):
            reason = f"no such bucket, folder or file: {reason}"
        raise InputError(f"{place}: cannot be {what} ({reason})") from error
