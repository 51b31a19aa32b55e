"""Pictures made of photographed hands."""

import pickle
from pathlib import Path

import numpy as np
import pytest
from tests.datasets.photographed import write_digits
from tests.training.made_frames import write_frames
from tests.training.tiny import tiny_run

from twohands.datasets.digits import Digits
from twohands.errors import InputError
from twohands.geometry.part_labels import hand_classes
from twohands.skeleton import KEY_BONES, PALM, ROOT
from twohands.synth.backgrounds.procedural import ProceduralBackgrounds
from twohands.synth.sets.cache import FrameCache
from twohands.training.batches import Picked, pose_batch, segmentation_batch
from twohands.training.config import DataConfig
from twohands.training.cutouts import CutoutScenes
from twohands.training.sources import open_source


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    root = tmp_path_factory.mktemp("cutouts")
    write_digits(root / "digits", persons=10)
    write_frames(root / "frames", count=20)
    return root


@pytest.fixture(scope="module")
def scenes(folder: Path) -> CutoutScenes:
    digits, frames = Digits(folder / "digits", "training"), FrameCache(folder / "frames")
    return CutoutScenes(digits, ProceduralBackgrounds(), [frames], seed=3, variants=2)


def test_a_picture_depends_on_seed_and_index_alone(scenes: CutoutScenes, folder: Path) -> None:
    again = pickle.loads(pickle.dumps(scenes))
    for index in (40, 3):
        first, second = scenes[index], again[index]
        np.testing.assert_array_equal(first.image, second.image)
        np.testing.assert_array_equal(first.labels, second.labels)
        np.testing.assert_array_equal(first.joints_px, second.joints_px)
    other = CutoutScenes(scenes.hands, scenes.backgrounds, scenes.frames, seed=4, variants=2)
    assert other[3].image.shape != scenes[3].image.shape or (other[3].image != scenes[3].image).any()
    with pytest.raises(IndexError):
        scenes[len(scenes)]


def test_labels_are_whole_and_lie_where_the_hands_are(scenes: CutoutScenes) -> None:
    """Both sides, on rendered arms and on their own; a hand's joints lie on its mask."""
    seen, on_mask = np.zeros(2, int), []
    for index in range(len(scenes)):
        sample = scenes[index]
        height, width = sample.image.shape[:2]
        assert sample.labels is not None and sample.confidence is not None
        assert sample.labels.shape == (height, width) and (sample.camera.width, sample.camera.height) == (width, height)
        assert sample.valid.any() and not (sample.valid & ~np.isfinite(sample.joints_px).all(axis=-1)).any()
        classes = hand_classes(sample.labels)
        for side in np.flatnonzero(sample.present):
            seen[side] += 1
            real = np.isnan(sample.joints_m[side]).all()
            fingers = sample.joints_px[side, [6, 7, 10, 11, 14, 15]]
            inside = ((fingers >= 1) & (fingers < [width - 1, height - 1])).all(axis=1)
            u, v = fingers[inside].astype(int).T
            if real and inside.all() and not sample.present[1 - side]:
                on_mask.append(np.mean(classes[v, u] == side + 1))
    assert seen.min() > 10
    assert np.mean(on_mask) > 0.9


def test_left_hands_are_mirrored(scenes: CutoutScenes) -> None:
    """From wrist over index to little finger a right hand's palm, seen as it was photographed, turns one way."""
    turns: tuple[list[float], list[float]] = ([], [])
    for index in range(0, len(scenes), 2):
        sample = scenes[index]
        for side in np.flatnonzero(sample.present):
            if np.isnan(sample.joints_m[side]).all():
                wrist, first, *_, last = sample.joints_px[side, list(PALM)]
                a, b = first - wrist, last - wrist
                turns[int(side)].append(float(np.sign(a[0] * b[1] - a[1] * b[0])))
    assert len(set(turns[0])) == 1 and set(turns[1]) == {-turns[0][0]}


def test_joints_are_our_skeletons_and_nothing_is_known_in_depth(scenes: CutoutScenes) -> None:
    """The label's palm is shorter than ours by half of what an anatomist's is, 0.249; moved joints count half."""
    sample = next(s for s in map(scenes.__getitem__, range(len(scenes))) if np.isnan(s.joints_m).all())
    side = int(np.flatnonzero(sample.present)[0])
    assert sample.confidence is not None
    assert sample.confidence[side, [0, 5, 9, 13, 17]].tolist() == [0.5] * 5
    assert sample.confidence[side, 8] == 1
    wrist, root = sample.joints_px[side, list(KEY_BONES[0])]
    index_finger = np.linalg.norm(np.diff(sample.joints_px[side, 10:13], axis=0), axis=1).sum()
    labelled = np.linalg.norm(scenes.hands[0].joints_px[1, 0] - scenes.hands[0].joints_px[1, ROOT])
    as_labelled = np.linalg.norm(np.diff(scenes.hands[0].joints_px[1, 10:13], axis=0), axis=1).sum()
    assert np.linalg.norm(wrist - root) / index_finger == pytest.approx(
        labelled / as_labelled / (1 - 0.249 / 2), rel=0.02
    )


def test_both_networks_can_learn_from_them(scenes: CutoutScenes) -> None:
    samples = [scenes[i] for i in range(6)]
    rngs = [np.random.default_rng(i) for i in range(6)]
    masks = segmentation_batch(samples, tiny_run("hand_seg_net"), rngs)
    assert masks["present"].any() and (masks["classes"] > 0).float().mean() > 0.005
    crops = pose_batch(samples, tiny_run("pose_net_2d"), rngs)
    hands = crops["hand"] > 0
    assert hands.any()
    unknown = hands & (crops["canonical_weight"].sum(dim=1) == 0)
    assert unknown.any() and (crops["distance"][unknown] == 0).all()
    assert set(crops["weight"][unknown].flatten().tolist()) <= {0.0, 0.5, 1.0}


def test_a_folder_of_digits_is_a_source(folder: Path) -> None:
    """On the people of the frames beside it; held-out people and frames stay apart."""
    spec = DataConfig(source=f"{folder / 'digits'},{folder / 'frames'}", validation=4, variants=3)
    training, held_out = open_source(spec)
    assert len(training) == 8 * 4 * 3 + 18 * 3 and len(held_out) == 2 + 2
    assert held_out[0].source.startswith("digits held-out cut out") and "frames" in held_out[2].source
    scenes, kept = training.sources[0], held_out.sources[0].source  # type: ignore[attr-defined]
    assert [frames.indices for frames in scenes.frames] == [range(18)]
    assert [frames.indices for frames in kept.frames] == [range(18, 20)]
    assert not set(scenes.hands.persons) & set(kept.hands.persons)


def test_held_out_pictures_are_spread_over_the_people(scenes: CutoutScenes) -> None:
    picked = Picked.evenly(scenes, 4)
    assert (len(picked), picked.indices) == (4, (0, 16, 32, 48))
    np.testing.assert_array_equal(picked[2].image, scenes[32].image)
    assert len(Picked.evenly(scenes, 0)) == 0
    with pytest.raises(IndexError):
        picked[4]


def test_nobody_to_cut_out(tmp_path: Path) -> None:
    write_digits(tmp_path / "digits", persons=1)
    with pytest.raises(InputError, match="no photograph of the part 'held-out'"):
        CutoutScenes(Digits(tmp_path / "digits", "held-out"), ProceduralBackgrounds())
