"""`twohands export-motion`: what it writes, what it says, and what it refuses in one line."""

import json

import numpy as np
import pytest
from tests.motion.moving import moving_hands, write_jsonl

from twohands.cli.main import main
from twohands.motion.openxr import NAMES


@pytest.fixture
def clip(tmp_path):
    valid = np.ones((12, 2), bool)
    valid[4:7, 1] = False
    return write_jsonl(moving_hands(12, valid=valid), tmp_path / "hands.jsonl")


def export(clip, to, out, *more) -> int:
    return main(["export-motion", str(clip), "--to", to, "--out", str(out), *more])


def files(folder) -> set[str]:
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize(
    ("to", "out", "made"),
    [
        ("glb", "a.glb", {"a.glb"}),
        ("gltf", "new/a.gltf", {"new/a.gltf"}),
        ("bvh", "a.bvh", {"a_left.bvh", "a_right.bvh"}),
        ("openxr", "a.jsonl", {"a.jsonl"}),
        ("rosbag", "a", {"a/a.mcap", "a/metadata.yaml"}),
    ],
)
def test_each_format_writes_its_files(clip, tmp_path, capsys, to, out, made):
    pytest.importorskip("pygltflib")
    pytest.importorskip("rosbags")
    assert export(clip, to, tmp_path / out) == 0
    assert files(tmp_path) == {"hands.jsonl", *made}
    said = capsys.readouterr().out
    assert "left hand: in 12 of 12 frames; a skeleton of fixed bones lies 0.0 mm from its joints" in said
    assert "right hand: in 9 of 12 frames" in said and "written to " in said
    assert ("12 even frames, in 3 of them it stands still" in said) == (to == "bvh")
    assert export(clip, to, tmp_path / out) == 2  # what is there stays
    assert "exists; choose another --out, or allow it with --overwrite" in capsys.readouterr().err
    assert export(clip, to, tmp_path / out, "--overwrite") == 0
    assert files(tmp_path) == {"hands.jsonl", *made}


def test_one_hand_makes_one_bvh(tmp_path):
    clip = write_jsonl(moving_hands(3, valid=np.array([[False, True]] * 3)), tmp_path / "hands.jsonl")
    assert export(clip, "bvh", tmp_path / "a.bvh") == 0
    assert files(tmp_path) == {"hands.jsonl", "a_right.bvh"}


def test_the_same_clip_makes_the_same_bytes(clip, tmp_path):
    pytest.importorskip("pygltflib")
    for to, ending in (("glb", "glb"), ("gltf", "gltf"), ("openxr", "jsonl")):
        made = [tmp_path / f"{name}.{ending}" for name in "ab"]
        assert [export(clip, to, path) for path in made] == [0, 0]
        assert made[0].read_bytes() == made[1].read_bytes()


def test_openxr_lines(clip, tmp_path):
    assert export(clip, "openxr", tmp_path / "xr.jsonl") == 0
    header, *frames = map(json.loads, (tmp_path / "xr.jsonl").read_text().splitlines())
    assert header["names"] == list(NAMES) and len(frames) == 12
    assert [frame["time_s"] for frame in frames] == [
        json.loads(line)["time_s"] for line in clip.read_text().splitlines()[1:]
    ]


@pytest.mark.parametrize(
    ("to", "out", "said"),
    [
        ("glb", "a.gltf", "the ending .glb expected for --to glb"),
        ("bvh", "a", "the ending .bvh expected for --to bvh"),
        ("openxr", "hands.jsonl", "hands.jsonl is the input; choose another"),
        ("rosbag", "folder", "is a folder, but no bag, and is left as it is"),
        ("rosbag", "hands.jsonl", "is the input"),
        ("rosbag", "file", "cannot be replaced by rosbag"),
        ("glb", "folder.glb", "cannot be replaced by glb"),
    ],
)
def test_what_cannot_be_written(clip, tmp_path, capsys, to, out, said):
    for name in ("folder", "folder.glb"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "mine").write_text("mine")
    (tmp_path / "file").write_text("mine")
    before = files(tmp_path)
    assert export(clip, to, tmp_path / out, "--overwrite") == 2
    error = capsys.readouterr().err
    assert said in error and error.count("\n") == 1
    assert files(tmp_path) == before


def test_no_hands_at_all(tmp_path, capsys):
    clip = write_jsonl(moving_hands(5, valid=np.zeros((5, 2), bool)), tmp_path / "hands.jsonl")
    assert export(clip, "bvh", tmp_path / "a.bvh") == 2
    error = capsys.readouterr().err
    assert (
        "no hand has metres in any of its 5 frames, so there is nothing to export" in error and error.count("\n") == 1
    )
    assert files(tmp_path) == {"hands.jsonl"}


def test_a_folder_that_cannot_be_written(clip, tmp_path, capsys):
    (tmp_path / "file").write_text("")
    for to, out in (("openxr", "file/a.jsonl"), ("rosbag", "file/a")):
        assert export(clip, to, tmp_path / out) == 2
        assert capsys.readouterr().err.count("\n") == 1


def test_without_the_extra_it_is_named(clip, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pygltflib", None)
    assert export(clip, "glb", tmp_path / "a.glb") == 2
    assert "needs the extra 'motion'" in capsys.readouterr().err
