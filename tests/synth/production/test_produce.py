"""Runs that are killed, go on, grow, or find no room: what is there is whole, and ends as if nothing had happened."""

import errno
import hashlib
import json
import pickle
import subprocess
import tarfile
from pathlib import Path

import pytest
from tests.synth.production.fake_production import FakeSet

from twohands import files
from twohands.errors import InputError, MissingExtraError
from twohands.executors.local import LocalProcesses
from twohands.formats.instance_index import digest, parse_index
from twohands.synth.production import produce as production_module
from twohands.synth.production import sinks
from twohands.synth.production.produce import Outcome, Plan, produce

HERE = LocalProcesses(1)
LAYOUTS = ["ego3dhands", "webdataset"]


def make(folder: Path, count: int = 11, layout="ego3dhands", **options) -> Outcome:
    return produce(FakeSet(count), folder, options.pop("executor", HERE), layout=layout, shard_size=5, **options)


def contents(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


class Killed(BaseException):
    """Stands for the end of the process: nothing may catch it to tidy up."""


@pytest.mark.parametrize("layout", LAYOUTS)
def test_two_workers_write_the_same_bytes(tmp_path, layout):
    make(tmp_path / "one", layout=layout)
    make(tmp_path / "two", layout=layout, executor=LocalProcesses(2))
    assert contents(tmp_path / "one") == contents(tmp_path / "two")


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("moment", range(0, 60, 3))
def test_a_run_killed_at_any_write_goes_on_to_the_same_bytes(tmp_path, monkeypatch, layout, moment):
    """Every way to change the disk is counted; at number `moment` the process ends, with no chance to clean up."""
    make(tmp_path / "whole", layout=layout)
    steps = iter(range(10_000))

    def deadly(function):
        def call(*args, **kwargs):
            if next(steps) == moment:
                raise Killed
            return function(*args, **kwargs)

        return call

    with monkeypatch.context() as patch:
        patch.setattr(sinks.os, "replace", deadly(sinks.os.replace))
        patch.setattr(sinks, "_append", deadly(sinks._append))
        patch.setattr(sinks.shutil, "rmtree", lambda *a, **k: None)
        patch.setattr(sinks.FolderSink, "close", lambda self: None)
        patch.setattr(sinks.ShardSink, "close", lambda self: None)
        patch.setattr(Path, "write_bytes", deadly(Path.write_bytes))
        try:
            make(tmp_path / "cut", layout=layout)
        except Killed:
            pass
        else:
            assert moment > 25  # the run has fewer steps than that
    make(tmp_path / "cut", layout=layout)
    assert contents(tmp_path / "cut") == contents(tmp_path / "whole")


@pytest.mark.parametrize("layout", LAYOUTS)
def test_torn_writes_are_mended(tmp_path, layout):
    """The system may have written only a part: half an index line, half an instance, half a copy."""
    make(tmp_path / "whole", layout=layout)
    make(tmp_path / "torn", count=8, layout=layout)
    torn = tmp_path / "torn"
    index = (torn / "index.jsonl").read_bytes()
    (torn / "index.jsonl").write_bytes(index[:-20])
    if layout == "ego3dhands":
        (torn / ".staging").mkdir()
        (torn / ".staging" / "b.bin").write_bytes(b"half")
    else:
        (torn / ".shard-000001.tar.partial.copy").write_bytes(b"half")
        (torn / ".shard-000002.tar.partial").write_bytes(b"half an instance")
    make(torn, layout=layout)
    (torn / ".shard-000001.tar.partial.copy").unlink(missing_ok=True)
    assert contents(torn) == contents(tmp_path / "whole")


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_set_may_grow(tmp_path, layout):
    make(tmp_path / "whole", layout=layout)
    assert make(tmp_path / "grown", count=3, layout=layout).written == 3
    assert make(tmp_path / "grown", count=7, layout=layout).written == 4
    assert make(tmp_path / "grown", layout=layout).written == 4
    assert make(tmp_path / "grown", layout=layout).written == 0
    assert contents(tmp_path / "grown") == contents(tmp_path / "whole")


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_lost_index_is_made_again_from_the_data(tmp_path, layout):
    make(tmp_path / "set", layout=layout)
    before = contents(tmp_path / "set")
    (tmp_path / "set" / "index.jsonl").write_text("nonsense\n")
    assert make(tmp_path / "set", layout=layout).written == 0
    assert contents(tmp_path / "set") == before


def test_index_names_every_instance_with_its_hash(tmp_path):
    make(tmp_path / "set")
    entries = parse_index((tmp_path / "set" / "index.jsonl").read_text())
    assert [entry.instance for entry in entries] == [f"{i // 4:04d}/{i % 4:05d}" for i in range(11)]
    folder = tmp_path / "set" / "0000" / "00002"
    joined = (folder / "a.txt").read_bytes() + (folder / "b.bin").read_bytes()
    assert entries[2].sha256 == hashlib.sha256(joined).hexdigest() and entries[2].bytes == len(joined) == 2 + 702
    assert digest({"b": b"2", "a": b"1"}) == hashlib.sha256(b"12").hexdigest()


def test_shards_are_plain_tar_files(tmp_path):
    make(tmp_path / "set", layout="webdataset")
    shards = sorted(path.name for path in (tmp_path / "set").glob("shard-*.tar"))
    assert shards == ["shard-000000.tar", "shard-000001.tar", "shard-000002.tar"]
    names = []
    for shard in shards:
        with tarfile.open(tmp_path / "set" / shard) as tar:
            names += tar.getnames()
            assert {member.mtime for member in tar} == {0}
    assert names[:3] == ["0000/00000.a.txt", "0000/00000.b.bin", "0000/00001.a.txt"] and len(names) == 22
    entry = parse_index((tmp_path / "set" / "index.jsonl").read_text())[6]
    with (tmp_path / "set" / str(entry.shard)).open("rb") as file:
        file.seek(entry.offset or 0)
        assert file.read(20).startswith(b"0001/00002.a.txt\0")


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_full_disk_stops_with_one_line_and_goes_on_later(tmp_path, monkeypatch, layout):
    make(tmp_path / "whole", layout=layout)
    left = 4000

    def limited(function, size):
        def call(target, content):
            nonlocal left
            left -= size(content)
            if left < 0:
                raise OSError(errno.ENOSPC, "No space left on device")
            return function(target, content)

        return call

    with monkeypatch.context() as patch:
        if layout == "ego3dhands":
            patch.setattr(Path, "write_bytes", limited(Path.write_bytes, len))
        else:
            patch.setattr(sinks, "_append", limited(sinks._append, len))
        with pytest.raises(InputError, match=r"disk is full.*same command again"):
            make(tmp_path / "full", layout=layout)
    assert not (tmp_path / "full" / ".staging").exists()
    assert make(tmp_path / "full", layout=layout).written > 0
    assert contents(tmp_path / "full") == contents(tmp_path / "whole")


def test_room_is_asked_for_before_anything_is_made(tmp_path):
    with pytest.raises(InputError, match=r"GB are needed .* are free"):
        produce(FakeSet(10, size=10**15), tmp_path / "set", HERE)
    assert sorted(contents(tmp_path / "set")) == ["index.jsonl", "manifest.json"]
    plans: list[Plan] = []
    make(tmp_path / "small", announce=plans.append)
    assert plans[0].missing == 11 and plans[0].bytes_needed == 11 * (1000 + production_module.FOLDER_OVERHEAD)


def test_room_is_estimated_from_what_is_there(tmp_path):
    plans: list[Plan] = []
    produce(FakeSet(20), tmp_path / "set", HERE)
    produce(FakeSet(30, size=10**15), tmp_path / "set", HERE, announce=plans.append)
    mean = sum(700 + i + len(f"{i}\n") for i in range(20)) // 20
    assert plans[0].bytes_needed == 10 * (mean + production_module.FOLDER_OVERHEAD)


def test_notes_come_once(tmp_path):
    assert make(tmp_path / "set").notes == ("odd",)


def test_progress_counts_what_was_there(tmp_path):
    calls: list[tuple[int, int]] = []
    make(tmp_path / "set", count=9)
    make(tmp_path / "set", progress=lambda done, total: calls.append((done, total)))
    assert calls == [(10, 11), (11, 11)]


def test_a_folder_has_one_writer(tmp_path):
    def second(plan: Plan) -> None:
        with pytest.raises(InputError, match="another process is writing"):
            make(tmp_path / "set")

    assert make(tmp_path / "set", announce=second).written == 11


def test_a_folder_has_one_writer_from_whatever_environment(tmp_path, monkeypatch):
    """Named case: a second run with other library versions replaced the manifest, and with it the file that the first
    one had locked; both then wrote."""

    def second(plan: Plan) -> None:
        before = contents(tmp_path / "set")
        with monkeypatch.context() as patch:
            patch.setattr(FakeSet, "made_with", lambda self: {"fake": "2"})
            with pytest.raises(InputError, match="another process is writing"):
                make(tmp_path / "set")
        assert contents(tmp_path / "set") == before

    assert make(tmp_path / "set", announce=second).written == 11


def test_a_folder_that_cannot_be_locked_can_be_written(tmp_path, monkeypatch):
    """Some network file systems know no locks."""

    def refuse(*_):
        raise OSError(errno.EBADF, "Bad file descriptor")

    fcntl = pytest.importorskip("fcntl")
    monkeypatch.setattr(fcntl, "flock", refuse)
    assert make(tmp_path / "set").written == 11


@pytest.mark.parametrize("step", ["write_bytes", "replace"])
def test_a_run_killed_at_its_first_manifest_goes_on(tmp_path, monkeypatch, step):
    """Named case: a manifest that was put together and never renamed made the folder count as somebody else's."""

    def deadly(path: Path, *_):
        (tmp_path / "set" / ".manifest.json.partial").write_text("half")
        raise Killed

    with monkeypatch.context() as patch:
        if step == "replace":
            patch.setattr(files.os, "replace", deadly)
        else:
            patch.setattr(Path, "write_bytes", deadly)
        with pytest.raises(Killed):
            make(tmp_path / "set")
    assert make(tmp_path / "set").written == 11
    make(tmp_path / "whole")
    assert contents(tmp_path / "set") == contents(tmp_path / "whole")


@pytest.mark.parametrize("there", ["a.txt", ".hidden", ".staging"])
def test_a_folder_of_something_else_is_refused(tmp_path, there):
    (tmp_path / there).write_text("mine")
    with pytest.raises(InputError, match="not empty and holds no set of ours"):
        make(tmp_path)
    assert contents(tmp_path) == {there: b"mine"}


@pytest.mark.parametrize("text", ["[]", "null", "7", "{", '{"made_with": 3}', "\xff"])
def test_a_damaged_manifest_is_named(tmp_path, text):
    (tmp_path / "manifest.json").write_text(text, encoding="latin-1")
    with pytest.raises(InputError, match=r"manifest.json is damaged: choose another folder"):
        make(tmp_path)
    assert (tmp_path / "manifest.json").read_text(encoding="latin-1") == text


def test_another_set_is_refused_by_name(tmp_path):
    make(tmp_path / "set")
    with pytest.raises(InputError, match="seed is 0 there, 1 here"):
        produce(FakeSet(11, seed=1), tmp_path / "set", HERE)
    with pytest.raises(InputError, match='format is "ego3dhands" there'):
        make(tmp_path / "set", layout="webdataset")


def test_manifest_lists_every_environment_that_wrote(tmp_path, monkeypatch):
    make(tmp_path / "set", count=2)
    monkeypatch.setattr(FakeSet, "made_with", lambda self: {"fake": "2"})
    make(tmp_path / "set", count=3)
    make(tmp_path / "set", count=4)
    assert json.loads((tmp_path / "set" / "manifest.json").read_text())["made_with"] == [{"fake": "1"}, {"fake": "2"}]


def test_errors_of_workers_arrive_whole():
    """Named case: this error could not be unpickled, which broke the pool of processes."""
    error = pickle.loads(pickle.dumps(MissingExtraError("rendering", "synth")))
    assert isinstance(error, MissingExtraError) and error.extra == "synth" and "pip install" in str(error)


def test_shell_recipe_of_the_hash(tmp_path):
    make(tmp_path / "set")
    entry = parse_index((tmp_path / "set" / "index.jsonl").read_text())[0]
    command = f"cat {tmp_path}/set/{entry.instance}/* | sha256sum"
    assert subprocess.run(command, shell=True, capture_output=True, text=True).stdout.split()[0] == entry.sha256
