"""Shards give the samples that folders give; what is damaged or not finished is named."""

import io
import json
import shutil
import tarfile
from pathlib import Path

import numpy as np
import pytest
from tests.datasets import fakes

from twohands.datasets.base import HandDataset
from twohands.datasets.ego3dhands import Ego3DHands
from twohands.datasets.inspection.inspect import inspect_dataset
from twohands.datasets.manifest import expected_hand_length_m
from twohands.datasets.shards import ShardedEgo3DHands, open_ego3dhands
from twohands.errors import DataFormatError, InputError
from twohands.formats import ego3dhands as fmt
from twohands.synth.production.manifest import claimed_folder
from twohands.synth.production.sinks import FolderSink, ShardSink
from twohands.training.config import DataConfig
from twohands.training.sources import open_source

NAMES = [f"{i:05d}" for i in range(5)]


@pytest.fixture(scope="module")
def sets(tmp_path_factory) -> tuple[Path, Path]:
    """The same five instances as folders and as shards of two."""
    root = tmp_path_factory.mktemp("sets")
    config = {"config": {"hand_length": 0.1}}
    with claimed_folder(root / "folders", config, {}), claimed_folder(root / "shards", config, {}):
        folders, shards = FolderSink(root / "folders", NAMES), ShardSink(root / "shards", NAMES, 2)
        for i, name in enumerate(NAMES):
            fakes.write_instance(root / "plain" / name, left=i != 1, right=i != 3)
            files = {path.name: path.read_bytes() for path in (root / "plain" / name).iterdir()}
            folders.write(name, files)
            shards.write(name, files)
        folders.close()
        shards.close()
    return root / "folders", root / "shards"


def test_same_samples_from_shards_and_folders(sets):
    folders, shards = open_ego3dhands(sets[0]), open_ego3dhands(sets[1])
    assert isinstance(folders, Ego3DHands) and isinstance(shards, ShardedEgo3DHands)
    assert isinstance(shards, HandDataset) and len(shards) == len(folders) == 5
    for index in (4, 0, 1, 3):
        one, two = folders[index], shards[index]
        assert one.source == two.source == NAMES[index]
        for name in ("image", "present", "joints_px", "joints_m", "valid", "labels", "depth_m"):
            np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
        assert one.camera == two.camera


def test_a_folder_named_twice_is_trained_on_twice_and_held_out_once(tmp_path):
    for i in range(20):
        fakes.write_instance(tmp_path / f"{i:05d}")
    once, twice = (open_source(DataConfig(source=",".join([str(tmp_path)] * times), validation=2)) for times in (1, 2))
    assert [len(source) for source in once] == [18, 2]
    assert [len(source) for source in twice] == [36, 2]
    assert twice[0][18].source == twice[0][0].source == once[0][0].source


def test_training_takes_either(sets):
    pictures = [open_source(DataConfig(source=str(root), validation=0))[0] for root in sets]
    assert [len(source) for source in pictures] == [5, 5]
    for i in range(5):
        from_folder, from_shard = (source[i] for source in pictures)
        assert from_folder.depth_m is None and from_shard.depth_m is None
        np.testing.assert_array_equal(from_folder.image, from_shard.image)
        np.testing.assert_array_equal(from_folder.labels, from_shard.labels)


def test_backgrounds_are_refused_where_all_pictures_have_theirs(sets, tmp_path):
    """Named case: they were not even looked at, and the weights' card named them."""
    (tmp_path / "rooms").mkdir()
    for root in sets:
        with pytest.raises(InputError, match=f"backgrounds '{tmp_path / 'rooms'}' go behind cached frames"):
            open_source(DataConfig(source=str(root), backgrounds=str(tmp_path / "rooms")))


def test_sound_sets_have_no_problem(sets):
    for root in sets:
        report = inspect_dataset(open_ego3dhands(root))
        assert report.problems == () and report.instances == 5


def test_a_changed_file_is_found_by_its_hash(sets, tmp_path):
    shutil.copytree(sets[0], tmp_path / "set")
    image = tmp_path / "set" / "00002" / "color_new.png"
    other = tmp_path / "set" / "00003" / "color_new.png"
    image.write_bytes(other.read_bytes())  # a sound picture of another hand
    shutil.rmtree(tmp_path / "set" / "00004")
    problems = {(p.source, p.message.split(":")[0]) for p in inspect_dataset(Ego3DHands(tmp_path / "set")).problems}
    assert problems == {
        ("00002", "its files are not those that were written"),
        ("00004", "listed in index.jsonl but not there"),
    }


def test_damaged_and_unfinished_shards_are_named(sets, tmp_path):
    shutil.copytree(sets[1], tmp_path / "set")
    shard = tmp_path / "set" / "shard-000001.tar"
    shard.write_bytes(shard.read_bytes()[:3000])
    (tmp_path / "set" / "shard-000002.tar").unlink()
    dataset = ShardedEgo3DHands(tmp_path / "set")
    assert len(dataset) == 2
    assert [path.name for path, _ in dataset.skipped] == ["shard-000001.tar", "shard-000002.tar"]
    first = tmp_path / "set" / "shard-000000.tar"
    first.write_bytes(bytes(len(first.read_bytes())))
    with pytest.raises(DataFormatError, match=r"shard-000000.tar: 00001 is not where"):
        dataset[1]
    assert {p.source for p in inspect_dataset(dataset).problems} >= {"00000", "00001"}


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("offset", -512), ("offset", "0"), ("offset", 0.5), ("length", [1]), ("length", -1), ("bytes", None),
        ("shard", ["shard-000000.tar"]), ("shard", 3), ("shard", "/shard-000000.tar"), ("instance", 1), ("sha256", {}),
    ],
)  # fmt: skip
def test_an_index_of_other_types_is_named(sets, tmp_path, field, value):
    """Named cases: an offset before the shard and one in quotes were errors of the interpreter."""
    shutil.copytree(sets[1], tmp_path / "set")
    index = tmp_path / "set" / "index.jsonl"
    first, second, *rest = index.read_text().splitlines(keepends=True)
    index.write_text(first + json.dumps(json.loads(second) | {field: value}) + "\n" + "".join(rest))
    with pytest.raises(DataFormatError, match=r"index\.jsonl line 2: not an entry"):
        ShardedEgo3DHands(tmp_path / "set")
    index.write_text(first + "[" * 200_000 + "\n")
    with pytest.raises(DataFormatError, match=r"index\.jsonl line 2: not an entry"):
        ShardedEgo3DHands(tmp_path / "set")


def test_a_shard_that_is_gone_is_named(sets, tmp_path):
    """Before the set is opened, as a link to nowhere, and after."""
    shutil.copytree(sets[1], tmp_path / "set")
    dataset = ShardedEgo3DHands(tmp_path / "set")
    shard = tmp_path / "set" / "shard-000000.tar"
    shard.unlink()
    with pytest.raises(DataFormatError, match=r"shard-000000\.tar: cannot be read \(No such file"):
        dataset[0]
    assert {problem.source for problem in inspect_dataset(dataset).problems} == {"00000", "00001"}
    shard.symlink_to("nowhere")
    assert [path.name for path, _ in ShardedEgo3DHands(tmp_path / "set").skipped] == ["shard-000000.tar"]


def test_bad_folders_are_named(sets, tmp_path):
    with pytest.raises(InputError, match="no such folder"):
        open_ego3dhands(tmp_path / "nowhere")
    shutil.copytree(sets[1], tmp_path / "set")
    (tmp_path / "set" / "index.jsonl").unlink()
    with pytest.raises(DataFormatError, match=r"index.jsonl cannot be read"):
        open_ego3dhands(tmp_path / "set")


def test_hand_length_is_that_of_the_manifest(tmp_path):
    """A set of other hands than the official 10 cm is not a set of 10 cm hands with a fault in every picture."""
    fakes.write_instance(tmp_path / "set" / "0")
    for length, problems in (("0.09", 2), ("null", 0), ("0.1", 0)):
        (tmp_path / "set" / "manifest.json").write_text(f'{{"config": {{"hand_length": {length}}}}}')
        assert len(inspect_dataset(Ego3DHands(tmp_path / "set")).problems) == problems


def test_an_instance_of_a_dynamic_set_is_told_its_hand_length(tmp_path, monkeypatch):
    """Named case: the manifest lies two levels above, and the hands were all of a wrong length."""
    fakes.write_instance(tmp_path / "set" / "0003" / "00012")
    (tmp_path / "set" / "manifest.json").write_text('{"config": {"hand_length": 0.09}}')
    assert len(inspect_dataset(Ego3DHands(tmp_path / "set" / "0003" / "00012")).problems) == 2
    (tmp_path / "set" / "manifest.json").write_text('{"config": {"hand_length": null}}')
    monkeypatch.chdir(tmp_path / "set" / "0003")
    for root in (tmp_path / "set" / "0003" / "00012", tmp_path / "set" / "0003", Path("00012"), Path()):
        assert expected_hand_length_m(root) is None
        assert inspect_dataset(Ego3DHands(root)).problems == ()


def test_an_instance_without_joints_is_a_problem_and_no_exception(sets, tmp_path):
    """Named case: in a shard, not in a folder, it was a KeyError."""
    shutil.copytree(sets[1], tmp_path / "set")
    shard = tmp_path / "set" / "shard-000000.tar"
    with tarfile.open(shard) as old:
        members = [(member, old.extractfile(member).read()) for member in old.getmembers()]
    with tarfile.open(shard, "w") as new:
        for member, data in members:
            if member.name == f"00000.{fmt.JOINTS_2D_FILE}":
                member.name = member.name.replace(".npy", ".old")
            new.addfile(member, io.BytesIO(data))
    problems = {
        problem.source: problem.message for problem in inspect_dataset(ShardedEgo3DHands(tmp_path / "set")).problems
    }
    assert f"lacks {fmt.JOINTS_2D_FILE}" in problems["00000"]
