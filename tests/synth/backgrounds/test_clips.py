"""Clips: what a folder holds is recognised, every frame can be had alone, and views move smoothly."""

import shutil
from itertools import pairwise

import cv2
import numpy as np
import pytest

from twohands.errors import InputError
from twohands.synth.backgrounds.clip_sources import ClipSource, assign_clips, find_clips, numbered, unusable
from twohands.synth.backgrounds.clips import _Film, open_clip
from twohands.synth.backgrounds.panoramas import is_panorama
from twohands.synth.backgrounds.photographs import Look
from twohands.synth.backgrounds.rooms import RoomBackgrounds
from twohands.types import PinholeCamera

CAMERA = PinholeCamera.ego3dhands(160, 90)


def write_video(path, frames=40, fps=20.0, size=(96, 54)):
    """Grey rises by 5 a frame from 20, then falls as it rose."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), fps, size)
    for k in range(frames):
        writer.write(np.full((size[1], size[0], 3), 20 + 5 * k, np.uint8))
    writer.release()


def textured(height, width, seed=0):
    """Smooth random picture."""
    grid = np.random.default_rng(seed).uniform(0, 255, (12, 24, 3)).astype(np.float32)
    return np.clip(cv2.resize(grid, (width, height), interpolation=cv2.INTER_CUBIC), 0, 255).astype(np.uint8)


def clip_of(source, seed=0, frames=100, fps=20.0):
    return open_clip(source, np.random.default_rng(seed), frames, fps, CAMERA)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    root = tmp_path_factory.mktemp("backgrounds")
    (root / "film").mkdir()
    (root / "holiday").mkdir()
    write_video(root / "ride.avi")
    write_video(root / "short.avi", frames=10)
    (root / "broken.mp4").write_bytes(b"no video")
    base = textured(60, 400)
    for k in range(32):
        cv2.imwrite(str(root / "film" / f"frame{k + 7}.png"), base[:, 2 * k : 2 * k + 100])
        cv2.imwrite(str(root / "holiday" / f"IMG_{k:03d}.png"), np.full((60, 100, 3), (k * 97) % 256, np.uint8))
    cv2.imwrite(str(root / "sphere.jpg"), textured(512, 1024))
    cv2.imwrite(str(root / "wide.jpg"), textured(100, 200))
    return root


SOURCES = [("ride.avi", "video"), ("film", "frames"), ("sphere.jpg", "panorama"), ("wide.jpg", "still"), (None, "room")]


def source_of(folder, name, kind):
    return ClipSource(kind, folder / name if name else None)


def test_kinds_are_recognised(folder):
    """Numbered holiday pictures differ too much from each other to be a film."""
    kinds = {}
    for source in find_clips(folder):
        kinds.setdefault(source.kind, []).append(source.path.relative_to(folder).as_posix())
    assert sorted(kinds["video"]) == ["broken.mp4", "ride.avi", "short.avi"]
    assert kinds["frames"] == ["film"] and kinds["panorama"] == ["sphere.jpg"]
    assert len(kinds["still"]) == 33 and "wide.jpg" in kinds["still"]


@pytest.mark.parametrize(
    ("name", "width", "height", "kind"),
    [
        ("narrow.jpg", 1023, 512, "still"),
        ("least.jpg", 1024, 512, "panorama"),
        ("odd.png", 1030, 511, "panorama"),
        ("high.png", 1079, 533, "still"),
        ("wide.jpg", 1041, 515, "still"),
    ],
)
def test_a_panorama_is_judged_by_its_own_size(tmp_path, name, width, height, kind):
    """Named case: an eighth of it was judged, which is 128 wide for 1023, and 128x63 for 1030x511."""
    cv2.imwrite(str(tmp_path / name), textured(height, width))
    assert [source.kind for source in find_clips(tmp_path)] == [kind]
    assert is_panorama(width, height) == (kind == "panorama")


def test_frames_of_a_folder_are_in_the_order_of_their_numbers(folder):
    assert [path.name for path in numbered(folder / "film")[:4]] == [f"frame{k}.png" for k in (7, 8, 9, 10)]


def test_every_sequence_has_its_own_clip_and_stills_come_last(folder):
    assignment = assign_clips(folder, np.random.default_rng(3), 10)
    assert len(set(assignment.sources)) == 10
    assert {source.kind for source in assignment.sources[:3]} == {"video", "frames", "panorama"}
    assert {source.kind for source in assignment.sources[3:]} == {"still"}
    assert sorted((path.name, reason.split(",")[0]) for path, reason in assignment.skipped) == [
        ("broken.mp4", "not a video that can be decoded"),
        ("short.avi", "0.5 s long"),
    ]
    assert assign_clips(folder, np.random.default_rng(3), 4).sources == assignment.sources[:4]
    assert assign_clips(folder, np.random.default_rng(4), 10).sources != assignment.sources
    assert len(assign_clips(folder, np.random.default_rng(3), 60).sources) == 60  # 36 usable ones, then again


def test_no_folder_means_procedural_rooms():
    assignment = assign_clips(None, np.random.default_rng(0), 2)
    assert assignment.sources == (ClipSource("room"),) * 2 and not assignment.skipped


def test_bad_folders_are_named(tmp_path):
    with pytest.raises(InputError, match="does not exist"):
        assign_clips(tmp_path / "nowhere", np.random.default_rng(0), 1)
    with pytest.raises(InputError, match="no video or picture"):
        assign_clips(tmp_path, np.random.default_rng(0), 1)
    (tmp_path / "broken.mp4").write_bytes(b"no video")
    with pytest.raises(InputError, match=r"can be read: broken\.mp4: not a video"):
        assign_clips(tmp_path, np.random.default_rng(0), 1)
    assert unusable(ClipSource("still", tmp_path / "gone.png")) == "not a picture that can be read"


@pytest.mark.parametrize(("name", "kind"), SOURCES)
def test_a_frame_is_the_same_alone_and_in_order(folder, name, kind):
    source = source_of(folder, name, kind)
    clip = clip_of(source)
    played = [clip.frame(k) for k in range(0, 100, 9)]
    assert all(frame.shape == (90, 160, 3) and frame.dtype == np.uint8 for frame in played)
    np.testing.assert_array_equal(clip_of(source).frame(90), played[10])
    np.testing.assert_array_equal(clip.frame(18), played[2])  # backwards
    assert not np.array_equal(clip_of(source, seed=1).frame(0), played[0])


class EndingEarly:
    """A film of 73 frames whose header says 120, as readers of videos find out when they get there."""

    fps = 30.0
    count = 120

    def read(self, index):
        if index >= 73:
            self.count = 73
        return np.full((54, 96, 3), min(index, 72), np.uint8)


@pytest.mark.parametrize("frames", [100, 300])
def test_a_video_shorter_than_its_header_says_has_the_same_frames_in_any_order(frames):
    """Named case: once the end was found, the frames before it turned back earlier; sets differed by their workers."""
    camera = PinholeCamera.from_fov(90.0, 96, 54)

    def film() -> _Film:
        rng = np.random.default_rng(3)
        return _Film(EndingEarly(), rng, frames, 30.0, (camera.width, camera.height), Look(rng))

    played = film()
    for index, frame in enumerate([played.frame(k) for k in range(frames)]):
        np.testing.assert_array_equal(film().frame(index), frame)


def test_a_folder_of_frames_with_a_damaged_one_is_skipped_and_the_frame_named(folder, tmp_path):
    """Named case: a set could not be made, for frame 20 of a background was empty."""
    films = [source for source in find_clips(folder) if source.kind == "frames"]
    shutil.copytree(films[0].path, tmp_path / "walk")
    assert unusable(ClipSource("frames", tmp_path / "walk")) is None
    files = numbered(tmp_path / "walk")
    files[-2].write_bytes(b"")
    assert unusable(ClipSource("frames", tmp_path / "walk")) == f"{files[-2].name} is not a picture that can be read"


def test_a_cut_off_still_is_skipped(tmp_path):
    data = cv2.imencode(".jpg", textured(200, 300))[1].tobytes()
    (tmp_path / "still.jpg").write_bytes(data[: len(data) // 3])
    assert unusable(ClipSource("still", tmp_path / "still.jpg")) == "not a picture that can be read"


@pytest.mark.parametrize(("name", "kind"), SOURCES[2:])
def test_views_move_and_never_jump(folder, name, kind):
    clip = clip_of(source_of(folder, name, kind), fps=30.0)
    frames = [clip.frame(k).astype(float) for k in range(30)]
    steps = np.array([np.abs(a - b).mean() for a, b in pairwise(frames)])
    assert steps.mean() > 0.05
    assert steps.max() < 4 * steps.mean() + 1
    assert np.abs(frames[0] - frames[-1]).mean() > 2 * steps.mean()


def test_a_short_video_plays_to_and_fro_at_its_own_speed(folder):
    """40 frames of 20 a second, shown at 40 a second: each twice, the last one at frame 78, then backwards."""
    clip = clip_of(ClipSource("video", folder / "ride.avi"), frames=200, fps=40.0)
    grey = np.array([clip.frame(k).mean() for k in range(0, 160, 2)])
    assert (np.diff(grey[:40]) > 0).all() and (np.diff(grey[39:79]) < 0).all()
    np.testing.assert_allclose(grey[39:79], grey[:40][::-1], atol=1e-9)
    assert clip.frame(0).mean() == clip.frame(1).mean()


def test_a_long_video_starts_where_the_whole_sequence_fits(folder):
    """30 of 40 frames: the last one is still on the way up."""
    for seed in range(5):
        clip = clip_of(ClipSource("video", folder / "ride.avi"), seed=seed, frames=30)
        grey = np.array([clip.frame(k).mean() for k in range(30)])
        assert (np.diff(grey) > 0).all()


def test_panorama_ahead_is_its_middle(folder, monkeypatch):
    """A head that looks straight ahead sees the middle of the panorama in the middle of the picture, and what lies
    atan(x / f) to the right of it x pixels to the right."""
    columns = np.tile((np.arange(1024) / 4).astype(np.uint8)[None, :, None], (512, 1, 3))
    cv2.imwrite(str(folder.parent / "columns.png"), columns)
    monkeypatch.setattr("twohands.synth.backgrounds.wandering.Head.rotation", lambda self, index: np.eye(3))
    monkeypatch.setattr("twohands.synth.backgrounds.clips.Look.apply", lambda self, picture: picture)
    view = clip_of(ClipSource("panorama", folder.parent / "columns.png")).frame(0)
    assert int(view[45, 80, 0]) == pytest.approx(128, abs=1.5)
    right = np.arctan((140.5 - 80) / CAMERA.fx) / (2 * np.pi) * 256 + 128
    assert int(view[45, 140, 0]) == pytest.approx(right, abs=1.5)


def test_only_panoramas_know_the_light_from_all_directions(folder):
    for name, kind in SOURCES:
        around = clip_of(source_of(folder, name, kind)).surroundings(3)
        assert (around is not None) == (kind == "panorama")


def test_the_light_of_a_panorama_turns_with_the_head(folder):
    clip = clip_of(source_of(folder, *next(s for s in SOURCES if s[1] == "panorama")))
    first, later = clip.surroundings(0), clip.surroundings(60)
    np.testing.assert_array_equal(first.radiance, later.radiance)
    turned = first.world_from_camera.T @ later.world_from_camera
    assert np.degrees(np.arccos((np.trace(turned) - 1) / 2)) > 1


def test_a_panorama_with_damaged_light_is_skipped_with_a_reason(tmp_path):
    (tmp_path / "light").mkdir()
    (tmp_path / "ldr").mkdir()
    cv2.imwrite(str(tmp_path / "ldr" / "a.png"), np.full((512, 1024, 3), 90, np.uint8))
    source = ClipSource("panorama", tmp_path / "ldr" / "a.png")
    assert unusable(source) is None
    (tmp_path / "light" / "a.npy").write_bytes(b"no array")
    assert unusable(source) == "its light (light/a.npy) cannot be read"


def test_a_room_behind_a_single_picture_is_the_first_frame_of_such_a_sequence():
    picture = RoomBackgrounds().sample(np.random.default_rng(4), CAMERA).picture
    np.testing.assert_array_equal(picture, clip_of(ClipSource("room"), seed=4).frame(0))
    other = RoomBackgrounds().sample(np.random.default_rng(5), CAMERA).picture
    assert picture.shape == (90, 160, 3) and np.abs(picture.astype(int) - other).mean() > 10
