"""Dynamic sets on disk: readable as any other, resumable, the same bytes with any number of workers."""

import dataclasses
import json
import shutil

import cv2
import numpy as np
import pytest

from twohands.datasets.ego3dhands import Ego3DHands, read_instance
from twohands.datasets.inspection.inspect import inspect_dataset
from twohands.errors import InputError
from twohands.executors.local import LocalProcesses
from twohands.geometry.camera import project
from twohands.synth.production.produce import produce
from twohands.synth.scene.body import load_asset, posed_joints
from twohands.synth.scene.config import WILD, SynthConfig
from twohands.synth.scene.motion import MotionConfig
from twohands.synth.scene.sampling import worn_on_the_head
from twohands.synth.sets.sequences import Sequence, SequenceRenderer, SequenceSet
from twohands.types import PinholeCamera

SET = SequenceSet(SynthConfig(width=160, height=90), seed=6, sequences=2, frames=5)


def contents(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def generate_sequences(sequence_set, out, workers=1, progress=None) -> int:
    return produce(sequence_set, out, LocalProcesses(workers), progress=progress).written


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    out = tmp_path_factory.mktemp("dynamic") / "one"
    assert generate_sequences(SET, out) == 10
    return out


def test_reader_finds_sequences_in_order_of_time(written):
    dataset = Ego3DHands(written)
    assert dataset.sequences == {"00000": (0, 1, 2, 3, 4), "00001": (5, 6, 7, 8, 9)}
    assert [dataset.source(i) for i in (0, 4, 5)] == ["00000/00000", "00000/00004", "00001/00000"]
    assert Ego3DHands(written / "00001").sequences == {".": (0, 1, 2, 3, 4)}
    assert Ego3DHands(written / "00001" / "00002").sequences == {".": (0,)}


def test_every_relation_of_the_layout_holds(written):
    report = inspect_dataset(Ego3DHands(written))
    assert report.problems == () and report.missing_files == {} and report.instances == 10
    assert report.reprojection_px < 1e-6


def test_files_agree_with_the_planned_motion(written):
    sequence = Sequence(SET, 1)
    for k in range(5):
        scene, instance = sequence.scene(k), read_instance(written / "00001" / f"{k:05d}")
        np.testing.assert_array_equal(instance.present, scene.present)
        np.testing.assert_allclose(instance.joints_m, scene.joints_m, atol=1e-12)
        seen = instance.joints_px[instance.present][:, 1:]
        np.testing.assert_allclose(seen, project(scene.joints_m[scene.present][:, 1:], scene.camera), atol=1e-9)


def test_person_and_light_stay_hands_move(written):
    sequence = Sequence(SET, 0)
    first, last = sequence.scene(0), sequence.scene(4)
    assert first.skin is last.skin and first.lighting is last.lighting
    np.testing.assert_array_equal(first.shape, last.shape)
    assert not np.array_equal(first.transforms, last.transforms)
    other = Sequence(SET, 1).scene(0)
    assert not np.array_equal(other.skin.albedo, first.skin.albedo)
    with pytest.raises(IndexError):
        sequence.scene(5)


def test_a_frame_needs_no_other(written):
    """Frame 3 rendered alone, by a fresh renderer, is the one on disk."""
    _, image = SequenceRenderer(SET).frame(1, 3)
    np.testing.assert_array_equal(cv2.imread(str(written / "00001" / "00003" / "color_new.png"))[..., ::-1], image)


def test_a_rerun_writes_only_what_is_missing(written, tmp_path):
    copy = tmp_path / "copy"
    shutil.copytree(written, copy)
    shutil.rmtree(copy / "00000" / "00002")
    shutil.rmtree(copy / "00001" / "00004")
    seen = []
    assert generate_sequences(SET, copy, progress=lambda done, total: seen.append((done, total))) == 2
    assert seen == [(9, 10), (10, 10)]
    assert contents(copy) == contents(written)
    assert generate_sequences(SET, copy) == 0


def test_two_workers_write_the_same_bytes(written, tmp_path):
    generate_sequences(SET, tmp_path / "two", workers=2)
    assert contents(tmp_path / "two") == contents(written)


def test_a_set_may_grow_by_sequences_only(written, tmp_path):
    def changed(**values):
        return SequenceSet(**{**{name: getattr(SET, name) for name in SET.__dataclass_fields__}, **values})

    for values, named in (
        ({"seed": 7}, "seed"),
        ({"frames": 6}, "frames"),
        ({"fps": 25.0}, "fps"),
        ({"motion": MotionConfig(leave_rate=0.5)}, "motion"),
    ):
        with pytest.raises(InputError, match=named):
            generate_sequences(changed(**values), written)
    copy = tmp_path / "copy"
    shutil.copytree(written, copy)
    assert generate_sequences(changed(sequences=1), copy) == 0


def test_manifest(written):
    manifest = json.loads((written / "manifest.json").read_text())
    assert manifest["kind"] == "dynamic" and manifest["frames"] == 5 and manifest["fps"] == 30.0
    assert manifest["motion"]["duration"] == [0.35, 1.4]


def test_splits_share_no_sequence():
    train, test = (Sequence(dataclasses.replace(SET, split=split), 0) for split in ("train", "test"))
    assert not np.array_equal(train.skin.albedo, test.skin.albedo)


@pytest.mark.parametrize("values", [{"sequences": 0}, {"frames": 0}, {"fps": 0.0}, {"fps": float("nan")}])
def test_nonsense_is_refused(values):
    with pytest.raises(InputError, match=next(iter(values))):
        SequenceSet(**values)


def test_hands_leave_the_picture_of_a_camera_on_the_head_alone():
    """Named case: before a webcam, a hand that had left took elbow, upper arm and sleeve with it from one frame to the
    next, up to 4 % of the picture."""
    leaving, still = MotionConfig(leave_rate=0.8, duration=(0.35, 0.4)), {"seed": 3, "sequences": 1, "frames": 40}
    views = {"head": (0.0, 0.0), "webcam": (1.0, 0.0), "free": (0.0, 1.0)}
    gone = {}
    for name, (webcam, free_view) in views.items():
        config = dataclasses.replace(WILD, width=160, height=90, webcam=webcam, free_view=free_view)
        sequence = Sequence(SequenceSet(config, leaving, **still), 0)
        assert worn_on_the_head(sequence.view) == (name == "head")
        gone[name] = any(motion.away.any() for motion in sequence.motion)
    assert gone == {"head": True, "webcam": False, "free": False}


def test_a_wild_sequence_keeps_its_camera_and_clothes():
    wild = dataclasses.replace(WILD, width=160, height=90, sleeves=1.0)
    sequence = Sequence(SequenceSet(wild, MotionConfig(), seed=3, sequences=1, frames=4), 0)
    first, last = sequence.scene(0), sequence.scene(3)
    assert first.camera == last.camera != PinholeCamera.ego3dhands(160, 90)
    assert first.clothes is last.clothes and np.isfinite(first.clothes.sleeve_from)
    np.testing.assert_array_equal(first.view, last.view)
    for scene in (first, last):  # labels go with what is drawn
        posed = posed_joints(load_asset().body(scene.shape), scene.transforms)[scene.present] * scene.scale
        np.testing.assert_allclose(posed, scene.joints_m[scene.present], atol=1e-9)
