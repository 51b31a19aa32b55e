"""One class for every engine: pickled, called on a place or a row, in any process."""

from __future__ import annotations

import multiprocessing
import os
import pickle

import pytest

pytest.importorskip("av")
from tests.batch.clips import write_clips
from tests.oracles import write_tiny_weights

from twohands.batch import ClipTracker
from twohands.batch.tracker import mediapipe_name
from twohands.errors import InputError
from twohands.inference.clip_files import read_clip
from twohands.lifting import mediapipe_estimator
from twohands.types import PinholeCamera


@pytest.fixture(scope="module")
def weights(tmp_path_factory) -> str:
    return str(write_tiny_weights(tmp_path_factory.mktemp("weights") / "tiny"))


def test_a_row_comes_back_with_what_became_of_its_clip(weights, tmp_path):
    clips = write_clips(tmp_path / "clips", 1)
    camera = PinholeCamera(80, 80, 32, 24, 64, 48)
    tracker = ClipTracker(str(tmp_path / "out"), camera=camera, hand_length_m=0.09, weights=weights, overlay=False)
    tracker = pickle.loads(pickle.dumps(tracker))
    clip = clips / "clip0.mp4"
    row = tracker({"input": str(clip), "subject": 7})
    status = clip.stat()
    etag = f"{status.st_mtime_ns:x}-{status.st_size:x}"
    about = {"size": status.st_size, "etag": etag, "status": "done", "frames": 3, "error": None}
    assert row == {"input": str(clip), "subject": 7, **about}
    header, poses = read_clip(tmp_path / "out" / "clip0.mp4" / "hands.jsonl")
    assert header["camera"]["fx"] == 80 and header["hand_length_m"] == 0.09
    hand = next(poses).left
    assert (hand.scale_source, hand.intrinsics_source) == ("typed", "file")


def test_a_clip_that_cannot_be_read_is_a_status(weights, tmp_path):
    tracker = ClipTracker(str(tmp_path / "out"), weights=weights)
    (tmp_path / "text.mp4").write_text("no video")
    for name, message in (("text.mp4", "not a video"), ("missing.mp4", "no such file")):
        row = tracker(str(tmp_path / name))
        assert row["status"] == "failed" and row["frames"] == 0 and message in row["error"]
    assert not (tmp_path / "out" / "text.mp4").exists()
    with pytest.raises(InputError, match="under 'input' expected"):
        tracker({"path": "a.mp4"})


def test_every_clip_has_a_mediapipe_of_its_own(tmp_path, monkeypatch):
    """It follows hands, so that one clip's must not be looked for in the next; the manifest says which MediaPipe."""
    opened = []

    class StandIn:
        version = "0"

        def __init__(self, python, **options):
            opened.append((python, options["video"]))

        def detect(self, image):
            return []

        def close(self):
            opened.append("closed")

    monkeypatch.setattr(mediapipe_estimator, "MediaPipeHands", StandIn)
    mediapipe_name.cache_clear()
    tracker = ClipTracker(str(tmp_path / "out"), overlay=False, estimator="mediapipe", peer_python="mp/python")
    for clip in sorted(write_clips(tmp_path / "clips", 2).iterdir()):
        assert tracker(str(clip))["status"] == "done"
        header, poses = read_clip(tmp_path / "out" / clip.name / "hands.jsonl")
        assert header["weights"] == "MediaPipe Hands 0" and not next(poses).left.present
    assert opened == [("mp/python", True), "closed"] * 3, "once to ask for its name"
    settings = tracker.settings()
    assert settings["weights"] == "MediaPipe Hands 0" and "peer_python" not in settings and "config" not in settings


def test_results_lie_below_the_output_as_clips_below_the_root(weights, tmp_path):
    clips = write_clips(tmp_path / "clips" / "day1", 1)
    tracker = ClipTracker(str(tmp_path / "out"), str(tmp_path / "clips"), weights=weights, overlay=False)
    assert tracker(str(clips / "clip0.mp4"))["status"] == "done"
    assert (tmp_path / "out" / "day1" / "clip0.mp4" / "hands.jsonl").exists()
    with pytest.raises(InputError, match="does not lie below the root"):
        ClipTracker(str(tmp_path / "out"), str(tmp_path / "other"), weights=weights)(str(clips / "clip0.mp4"))


def test_in_a_pool_of_processes(weights, tmp_path):
    clips = write_clips(tmp_path / "clips", 3)
    tracker = ClipTracker(str(tmp_path / "out"), fov_deg=70, weights=weights, overlay=False)
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        rows = pool.map(tracker, sorted(map(str, clips.iterdir())))
    assert [row["frames"] for row in rows] == [3, 4, 5]
    assert len(list((tmp_path / "out").glob("*/hands.npz"))) == 3


@pytest.mark.slow
def test_in_ray_data(weights, tmp_path):
    ray = pytest.importorskip("ray", reason="ray is not installed (extra 'cluster'; not part of make test)")
    pytest.importorskip("ray.data", reason="ray[data] is not installed", exc_type=ImportError)
    clips = write_clips(tmp_path / "clips", 3)
    options = {"out": str(tmp_path / "out"), "fov_deg": 70, "weights": weights, "overlay": False}
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    ray.init(address="local", num_cpus=2, include_dashboard=False, log_to_driver=False, logging_level="ERROR")
    try:
        rows = ray.data.from_items([{"input": str(path)} for path in sorted(clips.iterdir())])
        found = rows.map(ClipTracker, fn_constructor_kwargs=options, concurrency=1).take_all()
    finally:
        ray.shutdown()
    assert sorted(row["frames"] for row in found) == [3, 4, 5]
    assert len(list((tmp_path / "out").glob("*/hands.npz"))) == 3


@pytest.mark.slow
def test_in_daft(weights, tmp_path):
    daft = pytest.importorskip("daft", reason="daft is not installed")
    clips = write_clips(tmp_path / "clips", 3)
    tracker = ClipTracker(str(tmp_path / "out"), fov_deg=70, weights=weights, overlay=False)
    frame = daft.from_pydict({"input": sorted(map(str, clips.iterdir()))})
    frames = frame["input"].apply(lambda place: tracker(place)["frames"], return_dtype=daft.DataType.int64())
    assert frame.with_column("frames", frames).to_pydict()["frames"] == [3, 4, 5]


@pytest.mark.parametrize(
    "wrong",
    [
        {"camera": PinholeCamera(80, 80, 32, 24, 64, 48), "fov_deg": 70},
        {"fov_deg": 200},
        {"hand_length_m": -1},
        {"start_s": 3, "end_s": 2},
        {"stride": 0},
        {"look_ahead_s": -1},
    ],
)
def test_values_that_cannot_be_are_refused_at_once(wrong):
    with pytest.raises(InputError):
        ClipTracker("out", **wrong)
