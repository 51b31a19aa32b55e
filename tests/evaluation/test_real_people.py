"""The referee on made-up pictures: what is read, how it is counted, what is written and refused."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from benchmarks import real_people, real_pictures, real_scores, real_sheets, real_systems
from benchmarks.real_people import KINDS, ROWS
from benchmarks.real_pictures import Part, unlabelled
from benchmarks.real_scores import Measured
from tests.oracles import write_tiny_weights

from twohands.errors import InputError
from twohands.inference.decision import DecisionConfig
from twohands.inference.estimator import HandEstimator
from twohands.skeleton import LEFT, RIGHT
from twohands.types import HandPose, TwoHandPose

TOOL = '''
def score(reference, found):
    """Hands at one place are the same; everything else as in the original."""
    hands = [(n, s) for n, r in reference.items() for s in ("left", "right") if r[s] is not None]
    same = [h for h in hands if found[h[0]][h[1]] is not None]
    all_found = sum(found[n][s] is not None for n in reference for s in ("left", "right"))
    total = max(1, len(hands))
    return dict(reference=len(hands), same_side=len(same), other_side=0, none=len(hands) - len(same), found=all_found,
        unexplained=all_found - len(same), pictures=len(reference), missing=0, same_side_share=len(same) / total,
        other_side_share=0.0, error_median_of_size=0.05 if same else float("nan"),
        **{"good_share_below_0.1": 1.0 if same else 0.0})
'''


def hand_at(u, v, size=20.0):
    """(21, 2) joints of a square hand whose palm's centre is (u, v)."""
    corners = np.array([[-0.5, -0.5], [0.5, 0.5], [-0.5, 0.5], [0.5, -0.5]])
    joints = np.tile([[0.0, 0.0]], (21, 1))
    joints[[4, 8, 12, 16]] = corners
    return joints * size + [u, v]


def video(*frames):
    """joints (T, 2, 21, 2) and present (T, 2) of frames given as (left, right), each a place or None."""
    joints = np.full((len(frames), 2, 21, 2), np.nan)
    for t, frame in enumerate(frames):
        for side, place in enumerate(frame):
            if place is not None:
                joints[t, side] = hand_at(*place)
    return joints, np.isfinite(joints).all(axis=(2, 3))


class TestSideChanges:
    A, B = (50, 50), (150, 50)

    def test_hands_that_move_keep_their_sides(self):
        assert real_scores.side_changes(*video((self.A, self.B), ((55, 50), (145, 50)), ((60, 50), None))) == 0

    def test_a_hand_that_takes_the_other_side_and_comes_back_changes_twice(self):
        assert real_scores.side_changes(*video((self.A, None), (None, self.A), (self.A, None))) == 2

    def test_two_hands_that_swap_are_two_changes(self):
        assert real_scores.side_changes(*video((self.A, self.B), (self.B, self.A))) == 2

    def test_a_gap_of_five_frames_is_remembered_no_longer_one(self):
        empty = (None, None)
        assert real_scores.side_changes(*video((self.A, None), *[empty] * 4, (None, self.A))) == 1
        assert real_scores.side_changes(*video((self.A, None), *[empty] * 5, (None, self.A))) == 0

    def test_hands_that_touch_are_no_change(self):
        near = (54, 50)  # a fifth of a hand's size away
        assert real_scores.side_changes(*video((self.A, near), (near, self.A))) == 0

    def test_a_new_hand_elsewhere_is_no_change(self):
        assert real_scores.side_changes(*video((self.A, None), (None, self.B))) == 0


def write_video(path, count, size=(64, 48)):
    """Grey frames that get brighter."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 30, size)
    for i in range(count):
        writer.write(np.full((size[1], size[0], 3), 20 * i, np.uint8))
    writer.release()


@pytest.fixture
def shared(tmp_path):
    """Two photographs of people, two clips, one of them without reference."""
    folder = tmp_path / "shared"
    (folder / "tools").mkdir(parents=True)
    (folder / "tools/score_people.py").write_text(TOOL)
    people, clips = folder / "data/real_dev/people", folder / "data/real_dev/clips"
    people.mkdir(parents=True)
    clips.mkdir()
    hand = hand_at(30, 20).tolist()
    for name in ("a.jpg", "b.jpg"):
        cv2.imwrite(str(people / name), np.full((48, 64, 3), 90, np.uint8))
    references = {"a.jpg": {"left": hand, "right": None}, "b.jpg": {"left": None, "right": None}}
    (people / "reference.json").write_text(json.dumps(references))
    for name, count in (("asl_book.mkv", 6), ("z_palm.mp4", 3)):
        write_video(clips / f"{name}.avi", count)
        (clips / f"{name}.avi").rename(clips / name)
    rows = [{"frame": t, "left": hand, "right": hand if t == 5 else None} for t in (1, 3, 5)]
    (clips / "reference.json").write_text(json.dumps({"asl_book.mkv": rows}))
    return folder


def test_clips_are_read_frame_by_frame_and_their_references_by_number(shared):
    part = real_pictures.clips(shared)
    samples = list(part.samples())
    assert [s.source for s in samples][:2] == ["asl_book.mkv/00000", "asl_book.mkv/00001"]
    assert len(samples) == 9 and samples[-1].source == "z_palm.mp4/00002"
    assert list(part.reference) == [f"asl_book.mkv/{t:05d}" for t in (1, 3, 5)]
    assert abs(int(samples[3].image.mean()) - 60) <= 2
    frames = real_pictures.some_frames(shared, stride=2)
    assert (
        [s.source for s in frames.samples()] == list(frames.reference) == ["asl_book.mkv/00001", "asl_book.mkv/00005"]
    )


def test_videos_come_one_by_one_and_whole(shared):
    part = real_pictures.clips(shared)
    found = {folder: len(list(samples)) for folder, samples in real_systems.by_folder(part)}
    assert found == {"asl_book.mkv": 6, "z_palm.mp4": 3}
    assert [len(list(s)) for _, s in real_systems.by_folder(real_pictures.people(shared))] == [2]


class Recorder:
    """Finds a left hand in every picture, and notes what it is told of the frame before."""

    card = SimpleNamespace(decision=DecisionConfig())

    def __init__(self):
        self.told = []

    def estimate(self, image, camera, hand_length_m, *, index, previous):
        self.told.append((index, previous is not None))
        joints = hand_at(30, 20)
        left = HandPose(True, 0.9, joints_px=joints, canonical=np.zeros((21, 3)), valid=False)
        return TwoHandPose(left, HandPose(False), camera, index=index)


def test_only_frames_of_a_video_know_of_the_frame_before(shared):
    system = real_systems.OurWeights(Recorder(), "r")
    predictions = real_systems.run_part(system, real_pictures.clips(shared), keep_masks=False)
    assert system.estimator.told == [(t, t > 0) for t in range(6)] + [(t, t > 0) for t in range(3)]
    assert predictions.present[:, LEFT].all() and not predictions.present[:, RIGHT].any()
    figures = real_scores.clip_figures(real_pictures.clips(shared), predictions, real_pictures.score_people(shared))
    assert figures["clips.same_side"] == Measured(0.75, 4)
    assert figures["clips.book_both"] == Measured(0.0, 3)
    assert figures["clips.side_changes"] == Measured(0.0, 9)
    photographs = real_systems.OurWeights(Recorder(), "r")
    real_systems.run_part(photographs, real_pictures.people(shared), keep_masks=False)
    assert photographs.estimator.told == [(0, False), (1, False)]


def test_the_segmentation_check_looks_at_palms(shared):
    """Hands: one in people, and in the one frame of every four of the clip (the first); palms lie at (30, 20)."""

    def left_everywhere_in_a_corner(image):
        masks = np.zeros((24, 32), np.uint8)  # half the resolution of the pictures
        masks[10, 15] = 1
        return masks

    found = real_people.segmentation_check(left_everywhere_in_a_corner, shared)
    assert found == {"hands": 2, "any_side": 1.0, "right_side": 1.0, "area": pytest.approx(1 / (24 * 32))}
    wrong = real_people.segmentation_check(lambda image: np.full(image.shape[:2], 2, np.uint8), shared)
    assert wrong == {"hands": 2, "any_side": 1.0, "right_side": 0.0, "area": 1.0}


def test_a_network_in_training_goes_on_training():
    from torch import nn

    from twohands.models.hand_seg_net import HandSegNet, HandSegNetConfig

    network = HandSegNet(HandSegNetConfig("encoder-decoder", height=32, width_px=64, width=0.125)).train()
    before = {key: value.clone() for key, value in network.state_dict().items()}
    masks = real_systems.network_segmenter(network)(np.zeros((40, 40, 3), np.uint8))
    assert masks.ndim == 2 and masks.shape[0] == masks.shape[1] and masks.max() <= 2
    assert network.training and all(m.training for m in network.modules() if isinstance(m, nn.BatchNorm2d))
    assert all((value == before[key]).all() for key, value in network.state_dict().items())


class TestTable:
    def test_every_line_has_known_figures_and_an_aim_beyond_its_must(self):
        for row in ROWS:
            for key, must, aim in row.bars:
                assert aim >= must if KINDS[key].more else aim <= must

    def test_a_line_is_bold_where_every_figure_reaches_what_it_must(self):
        row = next(row for row in ROWS if row.name.startswith("digits"))
        good = {"digits.right": Measured(0.98, 100), "digits.ghost": Measured(0.01, 100)}
        assert row.cell(good) == "**98.0 % / 1.0 %**"
        assert row.cell(good | {"digits.ghost": Measured(0.02, 100)}) == "98.0 % / 2.0 %"
        assert row.cell({"digits.right": Measured(0.99, 100)}) == "99.0 % / -"
        assert row.cell({}) == "-"

    def test_nothing_to_measure_reaches_nothing(self):
        row = next(row for row in ROWS if row.name.startswith("good"))
        assert row.cell({"people.good": Measured(math.nan, 0)}) == "n/a"

    def test_the_short_table_leaves_out_bars_and_what_nobody_measured(self):
        lines = real_people.short_table({"fast": {"research.any": Measured(0.002, 810)}, "x": {}}).splitlines()
        assert lines[0] == "| figure | fast | x |" and lines[2:] == [
            "| research photographs: any hand found | 0.20 % | - |"
        ]

    def test_the_table_has_a_column_for_each_system(self):
        lines = real_people.table({"fast": {"research.any": Measured(0.002, 810)}, "MediaPipe": {}}).splitlines()
        assert len(lines) == 2 + len(ROWS) and lines[0].endswith("| aim | fast | MediaPipe |")
        assert next(line for line in lines if line.startswith("| research")).endswith("| **0.20 %** | - |")


class TestFloors:
    def test_a_share_may_fall_by_one_picture_an_error_rise_by_three_percent(self):
        assert real_people.floor(KINDS["people.same_side"], Measured(0.5, 20)) == pytest.approx(0.45)
        assert real_people.floor(KINDS["ge2019.ghosts"], Measured(0.0, 100)) == pytest.approx(0.01)
        assert real_people.floor(KINDS["clips.side_changes"], Measured(1.0, 100)) == pytest.approx(2.0)
        assert real_people.floor(KINDS["ge2019.error_px"], Measured(10.0, 96)) == pytest.approx(10.3)

    def test_what_was_accepted_has_not_fallen_and_what_is_worse_has(self):
        accepted = {"people.same_side": Measured(0.5, 20), "official.error_px": Measured(5.0, 2)}
        limits = real_people.floors(accepted)
        assert real_people.fallen(accepted, limits) == []
        assert real_people.fallen(accepted | {"people.same_side": Measured(0.4, 20)}, limits) == [
            "people: same hand, same side: 40 %, but 45 % is the floor"
        ]
        assert len(real_people.fallen({"official.error_px": Measured(math.nan, 0)}, limits)) == 1
        assert real_people.fallen({}, limits) == []

    def test_a_time_and_nothing_measured_have_no_floor(self):
        assert (
            real_people.floors({real_people.TIME: Measured(0.5, 1), "people.good_of_all": Measured(math.nan, 0)}) == {}
        )

    def test_what_is_said_of_found_hands_alone_has_no_floor(self):
        assert real_people.floors({"people.good": Measured(1.0, 2), "people.error": Measured(0.1, 2)}) == {}

    def test_the_checked_in_floors_are_of_known_figures(self):
        assert {"fast"} <= real_people.read_floors().keys()


def test_a_verdict_names_what_is_wrong(shared):
    tool = real_pictures.score_people(shared)
    hand, nothing = hand_at(3, 3).tolist(), {"left": None, "right": None}
    assert real_sheets.verdict(None, nothing, tool) == ""
    assert real_sheets.verdict({"left": hand, "right": None}, nothing, tool) == "1 not found"
    assert real_sheets.verdict(nothing, {"left": hand, "right": hand}, tool) == "2 unexplained"
    assert real_sheets.verdict({"left": hand, "right": None}, {"left": hand, "right": None}, tool) == ""


def run(tmp_path, shared, *options):
    weights = write_tiny_weights(tmp_path / "tiny", energy_bias=4.0)
    common = ["--systems", str(weights), "--shared", str(shared), "--out", str(tmp_path / "out"), "--threads", "1"]
    return real_people.main([*common, "--only", "people,clips", *options])


def test_the_command_predicts_once_and_scores_again_without_networks(tmp_path, shared, capsys, monkeypatch):
    assert run(tmp_path, shared) == 0
    text = capsys.readouterr().out
    assert text == (tmp_path / "out/real_people.md").read_text() and "| tiny |" in text
    content = json.loads((tmp_path / "out/real_people.json").read_text())
    assert content["tiny"]["clips.book_both"]["count"] == 3
    assert sorted(p.name for p in (tmp_path / "out/sheets/tiny").iterdir()) == ["clips_01.png", "people_01.png"]

    def no_network(*_):
        raise AssertionError("re-scoring ran a network")

    monkeypatch.setattr(HandEstimator, "from_preset", no_network)
    document = tmp_path / "results.md"
    document.write_text("# Results\n")
    assert run(tmp_path, shared, "--score-only", "--sheets", "none", "--insert", str(document)) == 0
    assert capsys.readouterr().out == text and text.strip() in document.read_text()


def test_the_command_says_what_has_fallen(tmp_path, shared, capsys, monkeypatch):
    monkeypatch.setattr(real_people, "FLOORS", tmp_path / "figures.json")
    monkeypatch.setattr(real_people.read_floors, "__defaults__", (tmp_path / "figures.json",))
    assert run(tmp_path, shared, "--accept") == 0
    assert run(tmp_path, shared, "--score-only", "--check") == 0
    assert "nothing has fallen" in capsys.readouterr().err
    limits = json.loads((tmp_path / "figures.json").read_text())
    limits["tiny"]["clips.side_changes"] = -1.0
    (tmp_path / "figures.json").write_text(json.dumps(limits))
    assert run(tmp_path, shared, "--score-only", "--check") == 1
    assert "side changes" in capsys.readouterr().err


def test_quick_gives_plain_numbers(tmp_path, shared, monkeypatch):
    monkeypatch.setattr(real_people, "QUICK_PARTS", ("people", "frames"))
    estimator = HandEstimator.from_preset(write_tiny_weights(tmp_path / "tiny", energy_bias=-6.0), threads=1)
    found = real_people.quick(estimator, shared)
    assert found["people.same_side"] == found["frames.same_side"] == 0.0 and math.isnan(found["people.good"])
    assert all(key in KINDS for key in found)


def test_a_part_without_labels_has_a_camera_and_nothing_else():
    sample = unlabelled(np.zeros((48, 64, 3), np.uint8), "x")
    assert (sample.camera.width, sample.camera.height) == (64, 48) and not sample.present.any()
    assert real_pictures.reference_of(sample) == {"left": None, "right": None}
    part = Part("people", lambda: [sample], {"x": {"left": None, "right": None}})
    assert replace(part, video=True).name == "people"


def test_unknown_parts_and_missing_pictures_are_refused(tmp_path, shared):
    with pytest.raises(SystemExit):
        real_people.main(["--only", "peple"])
    with pytest.raises(InputError, match="no such folder"):
        real_people.parts_of(["stills"], tmp_path)
    with pytest.raises(InputError, match="two of one name"):
        real_people.main(["--systems", "a/x", "b/x", "--shared", str(shared)])
