"""Sets on disk: the official layout, any number of workers, resumable, never overwriting."""

import dataclasses
import json
import os
import shutil
import signal

import cv2
import numpy as np
import pytest

from twohands.datasets.ego3dhands import Ego3DHands, read_instance
from twohands.datasets.inspection.inspect import inspect_dataset
from twohands.errors import DataFormatError, InputError, TwoHandsError
from twohands.executors.local import LocalProcesses
from twohands.geometry.canonical import canonical_from_camera
from twohands.skeleton import ROOT
from twohands.synth.backgrounds.base import Background
from twohands.synth.scene.config import WILD, SynthConfig
from twohands.synth.sets.cache import FrameCache, build_cache
from twohands.synth.sets.instances import sample_scene
from twohands.synth.sets.seeds import stream_seed
from twohands.synth.sets.static import StaticSet, generate_static
from twohands.synth.sets.stream import SyntheticStream
from twohands.synth.sets.writer import joints_px_with_elbow

CONFIG = SynthConfig(width=240, height=135)
SET = StaticSet(CONFIG, seed=9, count=6)


def contents(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    out = tmp_path_factory.mktemp("sets") / "one"
    assert generate_static(SET, out).written == 6
    return out


def test_two_workers_write_the_same_bytes(written, tmp_path):
    generate_static(SET, tmp_path / "two", workers=2)
    assert contents(tmp_path / "two") == contents(written)


def test_a_rerun_writes_only_what_is_missing(written, tmp_path):
    copy = tmp_path / "copy"
    shutil.copytree(written, copy)
    shutil.rmtree(copy / "00003")
    (copy / ".staging").mkdir()
    assert generate_static(SET, copy).written == 1
    assert contents(copy) == contents(written)


def test_another_set_is_never_overwritten(written, tmp_path):
    with pytest.raises(InputError, match="seed"):
        generate_static(StaticSet(CONFIG, seed=10, count=6), written)
    with pytest.raises(InputError, match="config"):
        generate_static(StaticSet(SynthConfig(), seed=9, count=6), written)
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    (foreign / "thesis.txt").write_text("mine")
    with pytest.raises(InputError, match="not empty"):
        generate_static(SET, foreign)
    (tmp_path / "file").write_text("mine")
    with pytest.raises(InputError, match="cannot be written"):
        generate_static(SET, tmp_path / "file" / "out")


def test_count_must_be_positive(tmp_path):
    with pytest.raises(InputError, match="count"):
        generate_static(StaticSet(CONFIG, 0, 0), tmp_path / "x")


def test_files_follow_the_official_layout(written):
    """Read with plain cv2 and numpy, from the description of the format alone (docs/dataset-format.md)."""
    for folder in sorted(p for p in written.iterdir() if p.is_dir()):
        color = cv2.imread(str(folder / "color.png"), cv2.IMREAD_UNCHANGED)
        image = cv2.imread(str(folder / "color_new.png"), cv2.IMREAD_UNCHANGED)
        labels = cv2.imread(str(folder / "gt_seg.png"), cv2.IMREAD_UNCHANGED)
        depth = cv2.imread(str(folder / "depth.png"), cv2.IMREAD_UNCHANGED).astype(float)
        p2, p3, can = (np.load(folder / f"location_{n}.npy") for n in ("2d", "3d_global", "3d_canonical"))
        assert color.shape == (135, 240, 4) and image.shape == labels.shape == (135, 240, 3)
        assert p2.shape == (2, 22, 2) and p3.shape == can.shape == (2, 22, 3) and p2.dtype == np.float64
        assert (labels[..., 0] == labels[..., 2]).all() and labels.max() <= 14
        depth_cm = depth[..., 0] + 0.01 * depth[..., 1] + 0.0001 * depth[..., 2]  # B, G, R
        np.testing.assert_array_equal(labels[..., 0] > 0, depth_cm > 0)
        np.testing.assert_array_equal(labels[..., 0] > 0, color[..., 3] > 0)
        opaque = color[..., 3] == 255
        np.testing.assert_array_equal(image[opaque], color[opaque][:, :3])
        for side in (0, 1):
            if (p3[side] == 0).all():
                assert (p2[side] == 0).all() and (can[side] == 0).all()
                continue
            row, col, z = p3[side].T
            f = 187.932202 * 135 / 270
            np.testing.assert_allclose(p2[side, :, 0], (f * row / z + 67.5) / 135, atol=1e-9)
            np.testing.assert_allclose(p2[side, :, 1], (f * col / z + 120) / 240, atol=1e-9)
            assert np.linalg.norm(p3[side, 1] - p3[side, 10]) == pytest.approx(10.0, abs=0.02)
            np.testing.assert_allclose(can[side, 10], 0, atol=1e-12)
            assert np.linalg.norm(can[side, 1]) == pytest.approx(1)
            joints = p3[side, 1:][:, [1, 0, 2]]
            np.testing.assert_allclose(canonical_from_camera(joints).joints, can[side, 1:][:, [1, 0, 2]], atol=1e-9)
            # The elbow is carried along rigidly.
            length = np.linalg.norm(p3[side, 0] - p3[side, 10])
            assert np.linalg.norm(can[side, 0]) * 10.0 == pytest.approx(length, rel=2e-3)
            assert np.linalg.norm(joints[ROOT]) > 10


def test_an_elbow_behind_the_camera_still_gets_a_number():
    frame = SyntheticStream(CONFIG, 9, 6).frame(0)
    joints = frame.joints_m.copy()
    side = int(np.flatnonzero(frame.present)[0])
    joints[side, 0] = [-0.2, 0.3, -0.1]
    pixels = joints_px_with_elbow(dataclasses.replace(frame, joints_m=joints))
    # x / z = 2, y / z = -3, times the focal length, from the centre.
    np.testing.assert_allclose(pixels[side, 0], [2 * frame.camera.fx + 120, -3 * frame.camera.fy + 67.5])
    assert np.isfinite(pixels[frame.present]).all()


def test_manifest_says_how_it_was_made(written):
    manifest = json.loads((written / "manifest.json").read_text())
    assert manifest["seed"] == 9 and manifest["config"]["width"] == 240 and manifest["backgrounds"] == "procedural"


def test_stream_items_are_a_pure_function_of_the_index():
    import pickle

    stream = SyntheticStream(CONFIG, 9, 6)
    later = stream[4].image
    copy = pickle.loads(pickle.dumps(stream))
    np.testing.assert_array_equal(copy[4].image, later)
    np.testing.assert_array_equal(stream[4].image, later)
    sample = stream[0]
    assert sample.joints_px.shape == (2, 21, 2) and sample.joints_m.shape == (2, 21, 3)
    np.testing.assert_array_equal(sample.valid.all(1), sample.present)
    with pytest.raises(IndexError):
        stream[6]


def test_stream_and_set_agree(written):
    sample = SET.stream()[2]
    image = cv2.imread(str(written / "00002" / "color_new.png"))[..., ::-1]
    np.testing.assert_array_equal(image, sample.image)


def test_cache_resumes_and_varies_backgrounds(tmp_path):
    build_cache(tmp_path / "c", CONFIG, 9, 4)
    before = contents(tmp_path / "c")
    build_cache(tmp_path / "c", CONFIG, 9, 4)
    assert contents(tmp_path / "c") == before
    with pytest.raises(InputError, match="another set"):
        build_cache(tmp_path / "c", CONFIG, 10, 4)
    cache = FrameCache(tmp_path / "c", variants=3)
    assert len(cache) == 12
    first, second, same = cache[1], cache[5], cache[1]
    np.testing.assert_array_equal(first.labels, second.labels)
    np.testing.assert_array_equal(first.image, same.image)
    assert not np.array_equal(first.image, second.image)
    np.testing.assert_allclose(
        first.joints_m, SyntheticStream(CONFIG, stream_seed(9, "frames"), 4)[1].joints_m, atol=1e-6
    )
    empty = FrameCache(tmp_path / "c", empty_rate=1.0)[0]
    assert not empty.present.any() and not empty.labels.any() and empty.image.std() > 0
    full, no_arm = cache[0], cache[0].labels == 0
    np.testing.assert_array_equal(FrameCache(tmp_path / "c", empty_rate=1.0)[0].image[no_arm], full.image[no_arm])


def test_cached_frames_are_taken_by_the_camera_of_their_preset(tmp_path):
    """Named case: frames of the preset wild once had neither blur nor noise. Without a sensor, pictures of flat walls
    are as flat as the walls; and a person whose arms are taken out stays in the picture."""

    class Wall:
        name, unreadable = "wall", ()

        def sample(self, rng, camera):
            return Background(np.full((camera.height, camera.width, 3), 90, np.uint8))

    wild = dataclasses.replace(WILD, width=160, height=90, people=0.0, webcam=1.0, free_view=0.0)
    for sensor in (0.0, 1.0):
        build_cache(tmp_path / str(sensor), dataclasses.replace(wild, sensor=sensor), 5, 6)
    clean, taken = (FrameCache(tmp_path / sensor, Wall(), empty_rate=1.0) for sensor in ("0.0", "1.0"))
    walls = [(clean[i].image == 90).all(-1) for i in range(6)]
    assert all(wall.any() for wall in walls) and not all(wall.all() for wall in walls)
    assert np.mean([taken[i].image[walls[i]].std() for i in range(6)]) > 0.5


@pytest.mark.parametrize("text", ["[]", "{", '{"seed": 9, "config": []}', '{"seed": null, "config": {}}'])
def test_frames_with_a_damaged_manifest_are_refused(tmp_path, text):
    (tmp_path / "manifest.json").write_text(text)
    with pytest.raises(DataFormatError, match="holds no frame cache"):
        FrameCache(tmp_path)


def test_frames_never_land_in_a_foreign_folder(tmp_path):
    """Named case: a user's own labels.npy was once overwritten."""
    np.save(tmp_path / "labels.npy", np.full(3, 99))
    with pytest.raises(InputError, match="not empty"):
        build_cache(tmp_path, CONFIG, 9, 2)
    assert np.load(tmp_path / "labels.npy").tolist() == [99, 99, 99]


def test_held_out_frames_share_no_background_with_training(tmp_path):
    """Named case: item k of the held-out part once had the background of item k of the training part."""
    build_cache(tmp_path / "c", CONFIG, 9, 4)
    train, held_out = (FrameCache(tmp_path / "c", frames=f) for f in ((0, 2), (2, 4)))
    same = (train[0].image == held_out[0].image).all(-1)
    free = (train[0].labels == 0) & (held_out[0].labels == 0)
    assert same[free].mean() < 0.2


def _die(_: int) -> int:
    os.kill(os.getpid(), signal.SIGKILL)
    return 0


def _open_death():
    return _die


def test_a_dead_worker_is_an_error_not_a_hang():
    """Named case: a killed worker once left the run waiting for ever."""
    with pytest.raises(TwoHandsError, match="worker process died"):
        list(LocalProcesses(2).run(_open_death, [1, 2, 3]))


def test_wild_pictures_carry_their_camera_and_reprojection_holds(tmp_path):
    wild = dataclasses.replace(WILD, width=160, height=90)
    generate_static(StaticSet(wild, 4, 6), tmp_path / "wild")
    dataset = Ego3DHands(tmp_path / "wild")
    assert inspect_dataset(dataset).problems == ()
    cameras = [read_instance(tmp_path / "wild" / f"{i:05d}").camera for i in range(6)]
    assert len({camera.fx for camera in cameras}) == 6
    scene = sample_scene(wild, stream_seed(4, "static"), 2)
    assert cameras[2] == scene.camera
    (tmp_path / "wild" / "00002" / "camera.json").write_text('{"fx": 0}')
    with pytest.raises(DataFormatError, match=r"00002.*camera\.json"):
        read_instance(tmp_path / "wild" / "00002")
