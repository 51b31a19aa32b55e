"""What is measured: our pipeline, with stages of it replaced by ground truth or over video, or another system."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

import tyro

from twohands.cli.eval.arguments import count_of, this_command
from twohands.cli.eval.console import with_progress
from twohands.datasets.opening import OpenedDataset
from twohands.errors import InputError
from twohands.evaluation.predictions import Predictions, predict
from twohands.inference.estimator import HandEstimator
from twohands.inference.leaving import CARRIED_FRAMES
from twohands.inference.trail import Trail
from twohands.inference.video import VideoEstimator
from twohands.inference.weights import DEFAULT_PRESET, preset_folder, weights_id
from twohands.peers.base import Handedness
from twohands.peers.mediapipe_hands import MediaPipeHands, Placement
from twohands.studies.ground_truth import HeatmapTargets, Stage, TruthfulEstimator
from twohands.types import HandSample, TwoHandPose


@dataclass(frozen=True)
class System:
    """What is measured."""

    weights: str = DEFAULT_PRESET
    """Preset that ships with the package, or a weights folder."""
    truth: tuple[Stage, ...] = ()
    """Stages to replace by ground truth, for isolated results."""
    smooth: bool = False
    """Take the frames of each folder as video: hands that were there a frame before are remembered (not a peer's), and
    ranges are smoothed and leaving hands carried on."""
    rest: bool = False
    """With --smooth: HandSegNet may rest, as in `track`; frames in which it does have no masks."""
    peer: Literal["mediapipe"] | None = None
    """Measure another system instead of ours."""
    peer_python: Path | None = None
    """Interpreter of the environment that holds the peer (docs/evaluation.md)."""
    mediapipe_model: Path | None = None
    """Peer mediapipe: hand_landmarker.task, for its Tasks API; the legacy solution of 0.10.21 if not given."""
    handedness: Handedness = "matched"
    """Peer: which hand is which by its own word, or matched with the labels."""
    placement: Placement = "solver"
    """Peer: placed by our solver with the true hand length, or by PnP at its own size."""


MeasuredSystem: TypeAlias = Annotated[System, tyro.conf.arg(name="")]


def predict_with(dataset: OpenedDataset, system: System, count: int | None) -> Predictions:
    """What a system predicts for the first `count` samples of a dataset, all if None.

    Raises:
        InputError: stages of a peer are to be replaced, the peer cannot be started, or the count is below 1.
        DataFormatError: the peer ends or says what cannot be read.
    """
    samples = with_progress(dataset.samples, count_of(count, dataset.samples), "predicting")
    with contextlib.ExitStack() as stack:
        if system.peer == "mediapipe":
            if system.truth:
                raise InputError("--truth replaces stages of our pipeline; a peer has none of them")
            python, model = system.peer_python, system.mediapipe_model
            peer = stack.enter_context(
                MediaPipeHands(python, handedness=system.handedness, placement=system.placement, model=model)
            )
            name, settings, decision = peer.name, peer.settings, None

            def estimate(sample: HandSample, previous: Trail | None = None, index: int = 0) -> TwoHandPose:
                return replace(peer(sample), index=index)

        else:
            estimator = HandEstimator.from_preset(system.weights)
            folder = preset_folder(system.weights)
            estimate = TruthfulEstimator(estimator, system.truth, HeatmapTargets.from_folder(folder))
            name, decision = weights_id(folder, estimator.card), estimator.card.decision
            settings = _settings(estimator, system)
        if system.smooth:
            settings |= {"smoothed": True, "carried_frames": CARRIED_FRAMES, "rest": system.rest}
        video = VideoEstimator(rests=system.rest, decision=decision)
        tested = _Video(estimate, video) if system.smooth else estimate
        found = predict(samples, tested, dataset=dataset.samples.name, weights=name, settings=settings)
    return replace(found, command=this_command())


def _settings(estimator: HandEstimator, system: System) -> dict[str, Any]:
    return {
        "card": asdict(estimator.card),
        "second": None if estimator.networks.second is None else asdict(estimator.networks.second.card),
        "hand_length_m": "each hand's own, from its labels",
        "camera": "the dataset's",
        "truth": list(system.truth),
    }


class _Video:
    """An estimator over the frames of folders, each a clip of its own (`inference.video`)."""

    def __init__(self, estimate: Callable[[HandSample, Trail | None, int], TwoHandPose], video: VideoEstimator) -> None:
        self._estimate = estimate
        self._video = video
        self._folder: str | None = None
        self._frame = 0

    def __call__(self, sample: HandSample) -> TwoHandPose:
        folder = sample.source.rpartition("/")[0]
        if folder != self._folder:
            self._video.reset()
            self._folder, self._frame = folder, 0
        pose = self._video.update(lambda previous: self._estimate(sample, previous, self._frame))
        self._frame += 1
        return pose
