"""Sequences of whole people: the camera and the room stand still, labels go with what is drawn."""

import dataclasses

import numpy as np
import pytest

from twohands.datasets.ego3dhands import Ego3DHands
from twohands.datasets.inspection.inspect import inspect_dataset
from twohands.errors import InputError
from twohands.executors.local import LocalProcesses
from twohands.synth.production.produce import produce
from twohands.synth.scene.body import posed_joints
from twohands.synth.scene.config import PEOPLE
from twohands.synth.sets.people_sequences import PeopleSequence
from twohands.synth.sets.sequences import Sequence, SequenceRenderer, SequenceSet, open_sequence

CONFIG = dataclasses.replace(PEOPLE, width=160, height=96)
SET = SequenceSet(CONFIG, seed=5, sequences=2, frames=6, fps=5.0)


@pytest.fixture(scope="module")
def sequence():
    return open_sequence(SET, 0)


def test_camera_person_and_light_stay_arms_move(sequence):
    first, last = sequence.scene(0), sequence.scene(5)
    assert isinstance(sequence, PeopleSequence) and first.camera == last.camera and first.lighting is last.lighting
    np.testing.assert_array_equal(first.view, last.view)
    assert first.people[0].look is last.people[0].look and len(first.people) == len(last.people)
    assert np.abs(first.transforms - last.transforms).max() > 0.01
    assert len(first.things) == len(last.things)
    with pytest.raises(IndexError):
        sequence.scene(6)


def test_joints_are_those_of_the_drawn_arms(sequence):
    for frame in range(6):
        scene = sequence.scene(frame)
        posed = posed_joints(scene.body, scene.transforms)[scene.present] * scene.scale
        np.testing.assert_allclose(posed, scene.joints_m[scene.present], atol=1e-9)


def test_arms_turn_during_the_exposure_as_they_move(sequence):
    """The elbow's way while the shutter is open, by the turn about the shoulder, is its true one."""
    exposed = dataclasses.replace(SET, frames=60, fps=30.0)
    sequence = open_sequence(exposed, 0)
    half, ways = sequence.exposure_s / 2, []
    for frame in range(0, 60, 3):
        scene = sequence.scene(frame)
        before, after = (sequence.setting.scene(sequence.motion.at(frame / 30 + step), 0) for step in (-half, half))
        for side in range(2):
            elbows = [posed_joints(one.body, one.transforms)[side, 0] * one.scale for one in (before, scene, after)]
            motion = scene.motion[side]
            assert motion is not None
            way = np.cross(motion.swing, elbows[1] - motion.shoulder)
            np.testing.assert_allclose(way, elbows[2] - elbows[0], atol=2e-3)
            ways.append(np.linalg.norm(way))
    assert max(ways) > 2e-3


def test_the_room_stands_still_and_a_frame_needs_no_other():
    one, other = SequenceRenderer(SET), SequenceRenderer(SET)
    pictures = [one.frame(0, k)[1] for k in range(4)]
    np.testing.assert_array_equal(other.frame(0, 3)[1], pictures[3])
    clip = open_sequence(SET, 0).clip(SET.clips.sources[0])
    np.testing.assert_array_equal(clip.frame(0), clip.frame(5))
    assert clip.frame(0).shape == (96, 160, 3)


def test_every_relation_of_the_layout_holds(tmp_path):
    assert produce(SET, tmp_path / "people", LocalProcesses(1)).written == 12
    report = inspect_dataset(Ego3DHands(tmp_path / "people"))
    assert report.problems == () and report.instances == 12 and report.reprojection_px < 1e-6


def test_the_others_show_arms_as_in_single_pictures():
    """Named case: dynamic sets of preset people showed arms before solids, and nobody said so."""
    some = dataclasses.replace(SET, config=dataclasses.replace(CONFIG, people=0.5, webcam=0.9), sequences=8)
    kinds = [open_sequence(some, index) for index in range(8)]
    arms = [one for one in kinds if isinstance(one, Sequence)]
    assert 0 < len(arms) < 8 and all(one.set.config.webcam == 0 for one in arms)
    assert all(isinstance(open_sequence(SET, index), PeopleSequence) for index in range(2))


def test_blender_draws_no_people():
    with pytest.raises(InputError, match="Blender draws no whole people"):
        SequenceSet(CONFIG, renderer="blender")
