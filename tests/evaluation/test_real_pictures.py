"""No regression unseen: the shipped weights on the authors' sample and on ten real pictures beside the checkout.

A picture that is in the balance is marked as such: with the same weights, processors may see it differently.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from benchmarks import real_pictures as pictures
from benchmarks.real_people import KINDS, reaches, read_floors
from benchmarks.real_scores import found_hands, official_figures
from benchmarks.real_systems import OurWeights, run_part

from twohands.datasets.files import read_json
from twohands.inference.estimator import HandEstimator

IN_THE_BALANCE = pytest.mark.xfail(reason="two touching hands; 8 bits are not alike on all processors", strict=False)

PEOPLE = [
    "rock_1bed937b-7ae4-4070-891c-daf69415da41.jpg",
    "call_0413d5c5-f5ba-476f-a921-ea5e967692a9.jpg",
    "four_249c5023-6106-447a-84ac-17eb4713731b.jpg",
    "none_00c84257-800d-4032-9e64-e47eb97005f5.jpg",
]
FRAMES = [
    "asl_milk.mkv/00025",
    pytest.param("asl_book.mkv/00027", marks=IN_THE_BALANCE),
]
LARGEST_ERROR = 0.15
"""Median joint error over the hand's size: half as much again as what counts as good."""


@pytest.fixture(scope="module")
def shared(shared_data):
    """The folder of the shared pictures; a checkout beside which one of them is missing skips."""
    for name in ("data/real_dev", "data/official/ego3dhands", "data/real_train/digits", "tools/score_people.py"):
        if not (shared_data.parent / name).exists():
            pytest.skip(f"no real pictures beside the checkout: {shared_data.parent / name}")
    return shared_data.parent


@pytest.fixture(scope="module")
def fast():
    return OurWeights(HandEstimator.from_preset("fast", threads=1), "fast")


def judged(system, part, name, shared):
    """What `score_people.py` says of one picture of a part, looked at as a photograph."""
    one = replace(part, samples=lambda: (s for s in part.samples() if s.source == name), video=False)
    found = found_hands(run_part(system, one, keep_masks=False))
    return pictures.score_people(shared).score({name: part.reference[name]}, found)


def is_right(score):
    """All reference hands on their own side and near the reference, and no other hand."""
    everything = score["reference"] > 0 and score["same_side"] == score["reference"] and not score["unexplained"]
    return everything and score["error_median_of_size"] <= LARGEST_ERROR


@pytest.mark.parametrize("name", PEOPLE)
def test_a_photograph_of_a_person(fast, shared, name):
    assert is_right(judged(fast, pictures.people(shared), name, shared))


@pytest.mark.parametrize("name", FRAMES)
def test_a_frame_of_a_sign_language_clip(fast, shared, name):
    assert is_right(judged(fast, pictures.some_frames(shared, stride=1), name, shared))


@pytest.mark.parametrize("digit", [1, 3])
def test_a_hand_before_white_paper(fast, shared, digit):
    part = pictures.digits(shared)
    name = next(name for name in part.reference if name.startswith(f"{digit}_"))
    assert is_right(judged(fast, part, name, shared))


@pytest.mark.parametrize("position", [1, 8])
def test_a_labelled_hand(fast, shared, position):
    part = pictures.ge2019(shared)
    sample = list(part.samples())[position]
    known = replace(part, reference={sample.source: pictures.reference_of(sample)}, samples=lambda: [sample])
    assert is_right(judged(fast, known, sample.source, shared))


@cache
def official_worse(shared, preset):
    """Figures of the official sample that are worse than the checked-in floors."""
    part = pictures.official(shared)
    predictions = run_part(OurWeights(HandEstimator.from_preset(preset, threads=1), preset), part, keep_masks=False)
    figures = official_figures(part, predictions, pictures.score_people(shared))
    floors = {key: limit for key, limit in read_floors()[preset].items() if key.startswith("official.")}
    assert floors, "benchmarks/figures.json has no figure of the official sample"
    if figures["official.both"].value > floors["official.both"]:  # errors are of the worse hand, of one before
        floors = {"official.both": floors["official.both"]}
    return {key: figures[key].value for key, limit in floors.items() if not reaches(KINDS[key], figures[key], limit)}


@pytest.mark.parametrize("preset", ["fast", "accurate"])
def test_no_fewer_hands_of_the_official_sample(shared, preset):
    assert "official.both" not in official_worse(shared, preset)


IN_THE_BALANCE_OFFICIAL = "with the same weights, processors see one hand or both, 7 to 32 px off"


@pytest.mark.parametrize(
    "preset",
    ["fast", pytest.param("accurate", marks=pytest.mark.xfail(strict=False, reason=IN_THE_BALANCE_OFFICIAL))],
)
def test_the_official_sample(shared, preset):
    """No worse than the checked-in floors: both hands, their joints and their ranges."""
    assert official_worse(shared, preset) == {}


def test_references_are_hands_of_the_pictures(shared):
    """The counts that the table's lines name, and joints within reach of their picture."""
    people, clips = pictures.people(shared).reference, pictures.clips(shared).reference
    assert sum(hand is not None for picture in people.values() for hand in picture.values()) == 21
    assert sum(hand is not None for picture in clips.values() for hand in picture.values()) == 236
    for sample in pictures.people(shared).samples():
        for joints in filter(None, people[sample.source].values()):
            assert np.shape(joints) == (21, 2)
            assert (np.min(joints, axis=0) < [sample.camera.width, sample.camera.height]).all()
    labels = read_json(shared / "data/real_train/digits/pseudo_labels.json", dict)
    assert 0.15 < len(pictures.digits(shared).reference) / len(labels) < 0.25
