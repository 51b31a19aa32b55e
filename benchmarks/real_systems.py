"""What runs over the pictures of `benchmarks.real_people`: our weights, and MediaPipe Hands; and HandSegNet alone."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from benchmarks.real_hands import with_anatomical_joints
from benchmarks.real_pictures import Part

from twohands.evaluation.completion import complete_hand, hand_lengths_m
from twohands.evaluation.predictions import Predictions, predict
from twohands.geometry.anatomy import HAND_LENGTH
from twohands.geometry.network_input import letterbox, network_input
from twohands.inference.engine import load_networks
from twohands.inference.estimator import HandEstimator
from twohands.inference.trail import Trail
from twohands.inference.video import VideoEstimator
from twohands.inference.weights import preset_folder, read_card
from twohands.peers.base import by_own_handedness
from twohands.peers.mediapipe_hands import MediaPipeHands
from twohands.types import HandPose, HandSample, TwoHandPose

MEDIAPIPE = "MediaPipe"
"""Its name in tables and file names."""

Segment = Callable[[np.ndarray], np.ndarray]
"""(H, W, 3) uint8 RGB -> (h, w) uint8 masks of the whole picture, 0 background, 1 left, 2 right, of any resolution."""


class System(Protocol):
    """A system under test. It sees pictures, cameras and hand lengths, no other label."""

    @property
    def name(self) -> str:
        """Heading of its column."""
        ...

    def poses(self, part: Part) -> Iterator[tuple[HandSample, TwoHandPose]]:
        """Every picture of a part, and what was found in it, in order."""
        ...


class OurWeights:
    """The pipeline with some weights; a video's frames as `twohands track` sees them (`inference.video`).

    Args:
        estimator: the pipeline.
        name: heading of its column.
    """

    def __init__(self, estimator: HandEstimator, name: str) -> None:
        self.estimator = estimator
        self.name = name

    def poses(self, part: Part) -> Iterator[tuple[HandSample, TwoHandPose]]:
        """See `System`."""
        for _, samples in by_folder(part):
            video = VideoEstimator(decision=self.estimator.card.decision)
            for index, sample in enumerate(samples):
                estimate = self._estimate(part, sample, index)
                pose = video.update(estimate) if part.video else estimate(None)
                if part.real_joints:
                    left, right = map(with_anatomical_joints, pose.hands)
                    pose = replace(pose, left=left, right=right)
                yield sample, pose

    def _estimate(self, part: Part, sample: HandSample, index: int) -> Callable[[Trail | None], TwoHandPose]:
        length_m = hand_lengths_m(sample) if part.length_m is None else part.length_m / HAND_LENGTH
        return lambda trail: self.estimator.estimate(sample.image, sample.camera, length_m, index=index, previous=trail)


class MediaPipe:
    """MediaPipe Hands, its own word on sides, its world joints placed by our solver.

    Args:
        python: interpreter of an environment that holds it.

    Raises:
        InputError: it cannot be run.
    """

    name = MEDIAPIPE

    def __init__(self, python: Path) -> None:
        self._python = python
        self._hands().close()

    def poses(self, part: Part) -> Iterator[tuple[HandSample, TwoHandPose]]:
        """See `System`; a process for every video, which it follows by itself."""
        for _, samples in by_folder(part):
            with closing(self._hands(video=part.video)) as hands:
                for index, sample in enumerate(samples):
                    lengths_m = hand_lengths_m(sample) if part.length_m is None else np.full(2, part.length_m)
                    left, right = (
                        HandPose(present=False)
                        if hand is None
                        else complete_hand(
                            sample.camera,
                            float(lengths_m[side]),
                            joints_px=hand.joints_px,
                            canonical=hand.shape_m,
                            score=hand.score,
                        )
                        for side, hand in enumerate(by_own_handedness(hands.detect(sample.image)))
                    )
                    yield sample, TwoHandPose(left, right, sample.camera, index=index)

    def _hands(self, *, video: bool = False) -> MediaPipeHands:
        return MediaPipeHands(self._python, handedness="own", video=video)


def by_folder(part: Part) -> Iterator[tuple[str, Iterator[HandSample]]]:
    """The videos of a part, each to be read to its end before the next one is asked for; all pictures of one that
    is no video at once."""
    samples = iter(part.samples())
    if not part.video:
        yield "", samples
        return
    waiting = next(samples, None)

    def one(folder: str) -> Iterator[HandSample]:
        nonlocal waiting
        while waiting is not None and waiting.source.rpartition("/")[0] == folder:
            current, waiting = waiting, next(samples, None)
            yield current

    while waiting is not None:
        folder = waiting.source.rpartition("/")[0]
        yield folder, one(folder)


def run_part(system: System, part: Part, *, keep_masks: bool) -> Predictions:
    """What a system says about a part.

    Args:
        system: under test.
        part: the pictures.
        keep_masks: whether masks are to be scored.
    """
    results = system.poses(part)
    current: list[TwoHandPose] = []

    def samples() -> Iterable[HandSample]:
        for sample, pose in results:
            current[:] = [pose if keep_masks else replace(pose, masks=None)]
            yield sample

    settings = {"real_joints": part.real_joints, "video": part.video}
    return predict(samples(), lambda _: current[0], dataset=part.name, weights=system.name, settings=settings)


def segmenter(path: Path) -> Segment:
    """HandSegNet alone, from a checkpoint of training (.safetensors) or a preset's file (.onnx); the extra `train`.

    Raises:
        CheckpointError: not a HandSegNet.
    """
    from twohands.models.checkpoint import load_network

    return network_segmenter(load_network("hand_seg_net", path))


def network_segmenter(network: Any) -> Segment:
    """A HandSegNet in training as a function; it is put into evaluation mode while it looks.

    Args:
        network: `models.hand_seg_net.HandSegNet`, on any device.
    """
    import torch

    size = network.config.height, network.config.width_px
    device = next(network.parameters()).device

    def segment(image: np.ndarray) -> np.ndarray:
        canvas, place = letterbox(image, size)
        training = network.training
        network.eval()
        try:
            with torch.no_grad():
                logits = network(torch.from_numpy(network_input(canvas[None])).to(device))[0][0]
        finally:
            network.train(training)
        return np.argmax(place.content(logits.float().cpu().numpy()), axis=0).astype(np.uint8)

    return segment


def time_ratio(weights: str | Path, today: str | Path, *, threads: int = 0, rounds: int = 30) -> float:
    """Time of HandSegNet, first look at a picture, over that of today's weights, measured in turns.

    Args:
        weights, today: presets or folders.
        threads: CPU threads; 0 takes all cores.
        rounds: so many pictures each; the medians count.
    """
    runs: list[Callable[[], object]] = []
    for preset in (weights, today):
        folder = preset_folder(preset)
        card = read_card(folder)
        network = load_networks(folder, card, threads).hand_seg_net
        noise = np.random.default_rng(0).integers(0, 256, (1, *card.seg_input_size, 3), dtype=np.uint8)
        batch = network_input(noise)
        runs.append(lambda network=network, batch=batch: network(batch))
    seconds = np.zeros((rounds, 2))
    for row in seconds:
        for i, run in enumerate(runs):
            start = time.perf_counter()
            run()
            row[i] = time.perf_counter() - start
    mine, theirs = np.median(seconds, axis=0)
    return float(mine / theirs)
