"""Folders and buckets: what is listed, how results get there, and what is said of places that are not there."""

from __future__ import annotations

import builtins
import importlib.util
import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("av")
pytest.importorskip("fsspec", reason="fsspec is not installed (extra 'remote')")
from tests.batch.clips import contents, write_clips
from tests.oracles import write_tiny_weights

from twohands.batch import ClipTracker
from twohands.batch.manifest import Entry, Manifest
from twohands.batch.stores import Clip, LocalStore, RemoteStore, is_remote, list_clips, store_of
from twohands.cli.main import main
from twohands.errors import InputError

needs_s3 = pytest.mark.skipif(
    not (importlib.util.find_spec("s3fs") and importlib.util.find_spec("moto")),
    reason="s3fs or moto is not installed; pip install s3fs 'moto[server]'",
)


@pytest.fixture(scope="module")
def weights(tmp_path_factory) -> str:
    return str(write_tiny_weights(tmp_path_factory.mktemp("weights") / "tiny"))


@pytest.fixture
def memory() -> Iterator[object]:
    """A file system in this process's memory."""
    import fsspec

    system = fsspec.filesystem("memory")
    yield system
    system.store.clear()
    system.pseudo_dirs[:] = [""]


def track(*arguments: object) -> int:
    return main(["track", *map(str, arguments), "--fov", "70", "--hand-length", "9"])


def remote_contents(system, folder: str) -> dict[str, bytes]:
    """As `contents`."""
    start = len(system._strip_protocol(folder)) + 1
    return {name[start:]: system.cat_file(name) for name in sorted(system.find(folder))}


@pytest.mark.parametrize(
    ("place", "expected"),
    [
        ("s3://bucket/a.mp4", True),
        ("gs://bucket", True),
        ("memory://x", True),
        ("rtsp://host/stream", False),
        ("https://host/a.mp4", False),
        ("clips/a.mp4", False),
        ("C:\\clips", False),
    ],
)
def test_what_is_a_bucket(place, expected):
    assert is_remote(place) == expected


def test_listings_of_a_folder_a_file_and_patterns(tmp_path, monkeypatch):
    for name in ("b10.mp4", "b2.MP4", "notes.txt", ".hidden.mp4", "deep/c.mkv"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"1234")
    monkeypatch.chdir(tmp_path)

    def names(place: str) -> tuple[str, list[str], int]:
        listing = list_clips(place)
        return os.path.relpath(listing.root), [clip.name for clip in listing.clips], listing.others

    assert names(".") == (".", ["b2.MP4", "b10.mp4"], 1)
    assert names(str(tmp_path)) == (".", ["b2.MP4", "b10.mp4"], 1)
    assert names("b2.MP4") == (".", ["b2.MP4"], 0)
    assert names("*.mp4") == (".", ["b10.mp4"], 0)
    assert names("**/*") == (".", ["b2.MP4", "b10.mp4", "deep/c.mkv"], 1)
    assert names("deep/*") == ("deep", ["c.mkv"], 0)
    (clip,) = list_clips("deep").clips
    assert clip.size == 4 and clip.etag is not None and clip.etag.endswith("-4")


def test_listings_of_a_bucket(memory):
    for name in ("b10.mp4", "b2.MP4", "notes.txt", "deep/c.mkv"):
        memory.pipe_file(f"memory://bucket/{name}", b"1234")

    def names(place: str) -> tuple[str, list[str], int]:
        listing = list_clips(place)
        return listing.root, [clip.name for clip in listing.clips], listing.others

    assert names("memory://bucket") == ("memory://bucket", ["b2.MP4", "b10.mp4"], 1)
    assert names("memory://bucket/") == ("memory://bucket", ["b2.MP4", "b10.mp4"], 1)
    assert names("memory://bucket/b2.MP4") == ("memory://bucket", ["b2.MP4"], 0)
    assert names("memory://bucket/**/*.mkv") == ("memory://bucket", ["deep/c.mkv"], 0)
    assert names("memory://bucket/deep/*") == ("memory://bucket/deep", ["c.mkv"], 0)


def test_a_local_folder_is_delivered_whole_and_replaces_the_old_one(tmp_path):
    store, out = LocalStore(), str(tmp_path / "out")
    for file in ("hands.csv", "hands.npz"):
        with store.staging(out, "day1/a.mp4") as folder:
            (folder / file).write_text("new")
            assert not (tmp_path / "out" / "day1" / "a.mp4" / file).exists()
            store.deliver(folder, out, "day1/a.mp4")
    assert contents(tmp_path / "out") == {"day1/a.mp4/hands.npz": b"new"}
    assert [path.name for path in (tmp_path / "out" / "day1").iterdir()] == ["a.mp4"]


def test_a_remote_folder_replaces_the_old_one(memory, tmp_path):
    store = RemoteStore("memory://out")
    for file in ("hands.csv", "hands.npz"):
        with store.staging("memory://out", "day1/a.mp4") as folder:
            (folder / file).write_text("new")
            store.deliver(folder, "memory://out", "day1/a.mp4")
    assert remote_contents(memory, "memory://out") == {"day1/a.mp4/hands.npz": b"new"}


@pytest.fixture(params=["path", "file", "memory"])
def somewhere(request, memory, tmp_path) -> str:
    """An output, of every kind of store."""
    return {"path": str(tmp_path), "file": tmp_path.as_uri(), "memory": "memory://out"}[request.param]


def deliver(out: str, name: str, file: str = "hands.csv") -> None:
    store = store_of(out)
    with store.staging(out, name) as folder:
        (folder / file).write_text("new")
        store.deliver(folder, out, name)


def put(out: str, name: str, content: bytes = b"old") -> None:
    folder, _, file = f"{out}/{name}".rpartition("/")
    store_of(out).write(folder, file, content)


def test_results_never_replace_what_is_not_ours(somewhere):
    """Named case: a clip in a bucket was deleted to make room for its results; so were folders of strangers."""
    put(somewhere, "film.mp4")
    put(somewhere, "letters.mp4/dear.txt")
    put(somewhere, "letters.mp4/hands.csv")
    for name in ("film.mp4", "letters.mp4"):
        with pytest.raises(InputError, match="holds something else than a clip's results"):
            deliver(somewhere, name)
        store_of(somewhere).discard(somewhere, name)
    for name in ("film.mp4", "letters.mp4/dear.txt", "letters.mp4/hands.csv"):
        assert store_of(somewhere).read(somewhere, name) == b"old", name


@pytest.mark.parametrize("name", ["take[12].mp4", "take?.mp4", "take*.mp4"])
def test_a_name_with_signs_of_a_pattern_is_a_name(name, somewhere):
    """Named case: delivering take[12].mp4 deleted the results of take1.mp4 and take2.mp4."""
    store = store_of(somewhere)
    for neighbour in ("take1.mp4", "take2.mp4"):
        put(somewhere, f"{neighbour}/hands.csv")
    put(somewhere, f"{name}/hands.npz")
    deliver(somewhere, name)
    assert store.read(somewhere, f"{name}/hands.npz") is None
    assert store.read(somewhere, f"{name}/hands.csv") == b"new"
    store.discard(somewhere, name)
    assert store.read(somewhere, f"{name}/hands.csv") is None
    for neighbour in ("take1.mp4", "take2.mp4"):
        assert store.read(somewhere, f"{neighbour}/hands.csv") == b"old"
    put(somewhere, "films/take1.mp4")
    put(somewhere, f"films/{name}")
    assert [clip.name for clip in list_clips(f"{somewhere}/films/{name}").clips] == [name]


def test_a_name_as_long_as_names_can_be(somewhere):
    """Named case: a name of more than 246 bytes ended the run."""
    name = "a" * 251 + ".mp4"
    deliver(somewhere, name)
    assert store_of(somewhere).read(somewhere, f"{name}/hands.csv") == b"new"


def test_a_place_has_one_name(memory, tmp_path):
    """Named case: an output that was the folder of the clips by another name was accepted."""
    (tmp_path / "clips").mkdir()
    (tmp_path / "link").symlink_to("clips")
    names = [str(tmp_path / "clips"), f"{tmp_path}//link/", (tmp_path / "clips").as_uri(), f"local://{tmp_path}/link"]
    assert len({store_of(name).canonical(name) for name in names}) == 1
    names = ["memory://b", "memory:///b", "memory://b/"]
    assert len({store_of(name).canonical(name) for name in names}) == 1
    assert store_of("memory://b").canonical("memory://b") != store_of("memory://c").canonical("memory://c")


def test_a_pattern_in_the_name_of_a_bucket_is_refused(memory):
    """Named case: it was taken for a folder of the file system itself."""
    memory.pipe_file("memory://bucket/a.mp4", b"1234")
    for place in ("memory://buck*/a.mp4", "memory:///buck?t/a.mp4", "memory://*"):
        with pytest.raises(InputError, match="a pattern may stand below a bucket, not in its name"):
            list_clips(place)


def test_the_bucket_of_the_clips_is_no_output_by_any_name(memory, weights, tmp_path, capsys):
    """Named case: memory://b2 and memory:///b2 are one, and the run deleted its clips."""
    for path in write_clips(tmp_path / "clips", 1).iterdir():
        memory.pipe_file(f"memory://b2/{path.name}", path.read_bytes())
    (tmp_path / "link").symlink_to("clips")
    here = contents(tmp_path / "clips")
    for place, out in (
        ("memory://b2", "memory:///b2"),
        (tmp_path / "clips", (tmp_path / "clips").as_uri()),
        (tmp_path / "clips", tmp_path / "link"),
    ):
        assert track(place, "--out", out, "--overwrite", "--weights", weights, "--workers", 1) == 2
        captured = capsys.readouterr()
        assert "is the folder of the clips" in captured.err and captured.err.count("\n") == 1
    assert remote_contents(memory, "memory://b2") == here == contents(tmp_path / "clips")


def test_a_tracker_does_not_replace_its_clip(memory, weights, tmp_path):
    """Named case: ClipTracker("memory://bkt")("memory://bkt/real.mp4") deleted real.mp4."""
    (path,) = write_clips(tmp_path / "clips", 1).iterdir()
    memory.pipe_file("memory://bkt/real.mp4", path.read_bytes())
    with pytest.raises(InputError, match="its results would replace the clip"):
        ClipTracker("memory:///bkt", weights=weights)("memory://bkt/real.mp4")
    assert memory.cat_file("memory://bkt/real.mp4") == path.read_bytes()


def test_a_clip_that_fails_has_no_results(memory, weights, tmp_path):
    """Named case: results of what the clip was before stayed beside its failure."""
    (path,) = write_clips(tmp_path / "clips", 1).iterdir()
    for out in (str(tmp_path / "out"), (tmp_path / "uri").as_uri(), "memory://out"):
        tracker, clip = ClipTracker(out, weights=weights, fov_deg=70, overlay=False), tmp_path / path.name
        clip.write_bytes(path.read_bytes())
        assert tracker(str(clip))["status"] == "done"
        clip.write_bytes(b"no video")
        assert tracker(str(clip))["status"] == "failed"
        assert store_of(out).is_empty(out), out


def test_a_manifest_is_sorted_and_says_nothing_of_the_way_there(tmp_path):
    out = str(tmp_path)
    entries = [Entry(name, 1, "e", "done", 2) for name in ("a10", "a2", "A2")]
    found = []
    for order in (entries, entries[::-1]):
        manifest = Manifest(LocalStore(), out, "clips", {"fov_deg": 70.0})
        for entry in order:
            manifest.add(entry)
        manifest.save()
        found.append((tmp_path / "manifest.jsonl").read_bytes())
    assert found[0] == found[1]
    again = Manifest(LocalStore(), out, "clips", {"fov_deg": 70.0})
    again.load()
    assert list(again.entries) == ["A2", "a2", "a10"]
    assert (
        again.holds(Clip("a2", 1, "e")) and not again.holds(Clip("a2", 1, "f")) and not again.holds(Clip("b", 1, "e"))
    )
    with pytest.raises(InputError, match=r"differs in fov_deg, root\)"):
        Manifest(LocalStore(), out, "films", {"fov_deg": 71.0}).load()


@pytest.mark.parametrize(
    "damage",
    [
        b"",
        b"\xff\xfe",
        b"[]\n",
        b"3\n",
        b"{}\n",
        b'{"version": 1}\n',
        b'{"settings": 3}\n',
        b"[" * 100_000,
        b'{"settings": {}}\n{"input": "a"}\n',
        b'{"settings": {}}\n[1]\n',
        b'{"settings": {}}\n{"input": 1, "size": 1, "etag": "e", "status": "done", "frames": 2, "error": null}\n',
        b'{"settings": {}}\n{"input": "a", "size": 1, "etag": "e", "status": "lost", "frames": 2, "error": null}\n',
        b'{"settings": {}}\n{"input": "a", "size": 1, "etag": "e", "status": "done", "frames": "2", "error": null}\n',
        b'{"settings": {}}\n{"input": [], "size": 1, "etag": "e", "status": "done", "frames": 2, "error": null}\n',
        b'{"settings": {}}\n{"input": "a", "size": "1", "etag": "e", "status": "done", "frames": 2, "error": null}\n',
        b'{"settings": {}}\n{"input": "a", "size": 1, "etag": [], "status": "done", "frames": 2, "error": null}\n',
        b'{"settings": {}}\n{"input": "a", "size": 1, "etag": "e", "status": [], "frames": 2, "error": null}\n',
        b'{"settings": {}}\n{"input": "a", "size": 1, "etag": "e", "status": "failed", "frames": 0, "error": 3}\n',
    ],
)
def test_a_damaged_manifest_is_named(damage, tmp_path):
    (tmp_path / "manifest.jsonl").write_bytes(damage)
    with pytest.raises(InputError, match=r"manifest\.jsonl is damaged: start anew with --overwrite"):
        Manifest(LocalStore(), str(tmp_path), "clips", {}).load()


def test_slow_writing_takes_a_twentieth_of_the_time(tmp_path):
    """A store that takes 1 s to write is written to every 21 s, and at the end."""
    now, written = [0.0], []

    class SlowStore(LocalStore):
        def write(self, out: str, name: str, content: bytes) -> None:
            written.append(now[0])
            now[0] += 1.0

    manifest = Manifest(SlowStore(), "out", "clips", {}, clock=lambda: now[0])
    for number in range(50):
        manifest.add(Entry(f"a{number}", 1, "e", "done", 1))
        now[0] += 1.0
    assert written == [0.0, 21.0, 42.0]


def test_from_bucket_to_bucket(memory, weights, tmp_path, capsys):
    """The bytes of a run from folder to folder."""
    clips = write_clips(tmp_path / "clips", 2)
    for path in clips.iterdir():
        memory.pipe_file(f"memory://bucket/{path.name}", path.read_bytes())
    memory.pipe_file("memory://bucket/broken.mp4", b"no video")
    arguments = ["--weights", weights, "--workers", 1]
    assert track("memory://bucket/*.mp4", "--out", "memory://bucket/hands", *arguments) == 0
    assert "failed: broken.mp4: broken.mp4: not a video that can be read" in capsys.readouterr().err
    assert track(clips, "--out", tmp_path / "out", *arguments) == 0
    there = remote_contents(memory, "memory://bucket/hands")
    here = contents(tmp_path / "out")
    assert {name for name in there if "report" in name} == {"clip0.mp4/report.html", "clip1.mp4/report.html"}
    assert there.pop("manifest.jsonl") != here.pop("manifest.jsonl")  # etags are the store's
    assert there == here
    capsys.readouterr()
    assert track("memory://bucket/*.mp4", "--out", "memory://bucket/hands", "--resume", *arguments) == 0
    assert "0 clips tracked, 0 frames; 2 were there already" in capsys.readouterr().out
    assert track(clips / "clip0.mp4", "--out", "memory://bucket/one", *arguments) == 0
    one = remote_contents(memory, "memory://bucket/one")
    assert one["clip0.mp4/hands.jsonl"] == here["clip0.mp4/hands.jsonl"]


@pytest.mark.parametrize(
    ("place", "message"),
    [
        ("memory://nowhere/*.mp4", "no such bucket, folder or file"),
        ("memory://nowhere", "no such bucket, folder or file"),
        ("nonesuch://bucket/*.mp4", "Protocol not known: nonesuch"),
    ],
)
def test_a_place_that_is_not_there_is_one_line_exit_2(place, message, memory, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert track(place) == 2
    captured = capsys.readouterr()
    assert message in captured.err and captured.err.count("\n") == 1 and captured.out == ""
    assert contents(tmp_path) == {}


def test_without_fsspec_the_extra_is_named(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    usual = builtins.__import__

    def without(name, *rest):
        if name.startswith("fsspec"):
            raise ImportError(name)
        return usual(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    assert track("s3://bucket/*.mp4") == 2
    captured = capsys.readouterr()
    assert "pip install 'twohands[remote]'" in captured.err and captured.err.count("\n") == 1
    assert contents(tmp_path) == {}


def test_without_the_package_of_a_scheme_it_is_named(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "gcsfs", None)
    assert track("gs://bucket/*.mp4") == 2
    captured = capsys.readouterr()
    assert "gcsfs" in captured.err and captured.err.count("\n") == 1


@pytest.fixture(scope="module")
def s3(tmp_path_factory) -> Iterator[object]:
    """A local S3 server and its file system, with the credentials of nobody in this process's environment."""
    import s3fs

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    url = f"http://127.0.0.1:{port}"
    settings = {
        "AWS_ENDPOINT_URL": url,
        "AWS_ACCESS_KEY_ID": "nobody",
        "AWS_SECRET_ACCESS_KEY": "nothing",
        "AWS_DEFAULT_REGION": "us-east-1",
        "AWS_EC2_METADATA_DISABLED": "true",
        "AWS_CONFIG_FILE": os.devnull,
        "AWS_SHARED_CREDENTIALS_FILE": os.devnull,
    }
    with pytest.MonkeyPatch.context() as patch:
        for name, value in settings.items():
            patch.setenv(name, value)
        command = [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)]
        server = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            until = time.monotonic() + 600
            while True:
                try:
                    socket.create_connection(("127.0.0.1", port), timeout=1).close()
                    break
                except OSError:
                    assert server.poll() is None and time.monotonic() < until, "moto's server does not start"
                    time.sleep(0.2)
            system = s3fs.S3FileSystem()
            system.mkdir("clips")
            yield system
        finally:
            server.terminate()
            server.wait()
            s3fs.S3FileSystem.clear_instance_cache()


@needs_s3
@pytest.mark.slow
def test_from_s3_to_s3(s3, weights, tmp_path, capsys):
    """Two workers, each with a connection of its own; the bytes of a run from folder to folder."""
    folder = write_clips(tmp_path / "clips", 5)
    for path in folder.iterdir():
        s3.put_file(str(path), f"clips/{path.name}")
    options = ["--weights", weights, "--no-overlay", "--workers"]
    assert track("s3://clips/*.mp4", "--out", "s3://clips/hands", *options, 2) == 0
    assert track(folder, "--out", tmp_path / "out", *options, 1) == 0
    s3.invalidate_cache()
    there, here = remote_contents(s3, "clips/hands"), contents(tmp_path / "out")
    assert b'"etag": null' not in there["manifest.jsonl"]
    del there["manifest.jsonl"], here["manifest.jsonl"]
    assert there == here
    capsys.readouterr()
    s3.put_file(str(folder / "clip1.mp4"), "clips/clip0.mp4")
    assert track("s3://clips/*.mp4", "--out", "s3://clips/hands", "--resume", *options, 1) == 0
    assert "1 clips tracked, 4 frames; 4 were there already" in capsys.readouterr().out


@needs_s3
@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["s3://nowhere/*.mp4", "--out", "out"], "s3://nowhere/*.mp4: cannot be listed (no such bucket"),
        (["s3://clips/nothing*.mp4", "--out", "out"], "no file there"),
        (["here", "--out", "s3://nowhere/hands"], "s3://nowhere/hands/manifest.jsonl: cannot be written"),
    ],
)
def test_no_such_bucket(arguments, message, s3, weights, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write_clips(Path("here"), 1)
    assert track(*arguments, "--weights", weights, "--workers", 1) == 2
    captured = capsys.readouterr()
    assert message in captured.err and captured.err.count("\n") == 1 and captured.out == ""
    assert not Path("out").exists() and not s3.exists("nowhere")


@needs_s3
@pytest.mark.slow
def test_no_credentials(s3, tmp_path, monkeypatch, capsys):
    import s3fs

    s3fs.S3FileSystem.clear_instance_cache()
    monkeypatch.delenv("AWS_ACCESS_KEY_ID")
    monkeypatch.delenv("AWS_SECRET_ACCESS_KEY")
    assert track("s3://clips/*.mp4", "--out", tmp_path / "out") == 2
    captured = capsys.readouterr()
    assert "redentials" in captured.err and captured.err.count("\n") == 1 and captured.out == ""
    assert not (tmp_path / "out").exists()
