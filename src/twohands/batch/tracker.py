"""Tracks a clip from anywhere to anywhere, in whatever process it finds itself."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np

from twohands.batch.clip import ClipJob, sourced, write_clip
from twohands.batch.estimators import EstimatorKind, OpenEstimator
from twohands.batch.manifest import Entry
from twohands.batch.stores import Clip, is_remote, join, list_clips, store_of
from twohands.errors import InputError, TwoHandsError
from twohands.formats.profiles import IntrinsicsSource, ScaleSource
from twohands.inference.estimator import DEFAULT_HAND_LENGTH_M, HandEstimator
from twohands.inference.frames import VideoFrames, load_av
from twohands.inference.known import Known
from twohands.inference.look_ahead import LookAhead
from twohands.inference.weights import DEFAULT_PRESET
from twohands.types import PinholeCamera

THREADS: Final = 1
"""Of the networks, whoever runs them: with another number sums come in another order, and bytes differ."""


@dataclass(frozen=True)
class ClipTracker:
    """Tracks clips; picklable, and called in as many processes as one likes. A process loads the networks once.

    Results of a clip are those of `twohands track`, in a folder with the clip's whole name: out/clip.mp4/hands.jsonl.
    They appear when the clip is done.

    Attributes:
        out: folder or bucket ("s3://bucket/hands").
        root: folder or bucket that clips lie below; results lie below `out` as they do there. None takes a clip's last
            name alone.
        camera: of all clips, at any size of the same aspect; None where `fov_deg` says it, or 60 degrees are assumed.
        fov_deg: horizontal field of view, degrees.
        hand_length_m: |wrist - middle knuckle|, metres; None assumes `DEFAULT_HAND_LENGTH_M`.
        scale_source, camera_source: how they are known, written into the results; None: as they are given here.
        weights: preset, or a weights folder.
        start_s, end_s, stride: the part of every clip that is wanted, as `frames.VideoFrames`.
        mirrored, smooth, look_ahead_s, overlay: as `clip.ClipJob`.
        estimator: our networks, or MediaPipe, of which every clip gets a process of its own.
        peer_python: interpreter of the environment that holds mediapipe; None for this one.
        mediapipe_model: file of its Tasks API; None for the models of 0.10.21.

    Raises:
        InputError: camera and field of view are both given, or a value cannot be.
    """

    out: str
    root: str | None = None
    camera: PinholeCamera | None = None
    fov_deg: float | None = None
    hand_length_m: float | None = None
    scale_source: ScaleSource | None = None
    camera_source: IntrinsicsSource | None = None
    weights: str = DEFAULT_PRESET
    start_s: float = 0.0
    end_s: float = math.inf
    stride: int = 1
    mirrored: bool = False
    smooth: bool = True
    look_ahead_s: float = 0.0
    overlay: bool = True
    estimator: EstimatorKind = "ours"
    peer_python: str | None = None
    mediapipe_model: str | None = None

    def __post_init__(self) -> None:
        if self.camera is not None and self.fov_deg is not None:
            raise InputError("camera or fov_deg expected, not both")
        if self.fov_deg is not None:
            PinholeCamera.from_fov(self.fov_deg, 1000, 1000)  # refuses what is no field of view
        if self.hand_length_m is not None and not (math.isfinite(self.hand_length_m) and self.hand_length_m > 0):
            raise InputError(f"hand_length_m must be a positive number of metres, got {self.hand_length_m}")
        if not (self.start_s >= 0 and self.end_s > self.start_s):
            raise InputError(f"0 <= start_s < end_s expected, got {self.start_s:g} and {self.end_s:g}")
        if self.stride < 1:
            raise InputError(f"stride must be at least 1, got {self.stride}")
        if self.look_ahead_s:
            LookAhead(self.look_ahead_s)

    def __call__(self, clip: str | Mapping[str, Any]) -> dict[str, Any]:
        """Tracks one clip.

        Args:
            clip: a video file or its address, or a row that has it under "input".

        Returns:
            The row, with "input", "size", "etag", "status", "frames" and "error" (`manifest.Entry`).

        Raises:
            TwoHandsError: the networks cannot be loaded, or the results cannot be written. That a clip cannot be read
                is no error, but its status.
        """
        row = {"input": clip} if isinstance(clip, str) else dict(clip)
        place = row.get("input")
        if not isinstance(place, str):
            raise InputError(f"a row with the clip's place under 'input' expected, got keys {sorted(row)}")
        try:
            listing = list_clips(place)
            if len(listing.clips) != 1:
                raise InputError(f"{place}: one clip expected, got {len(listing.clips)}")
        except InputError as error:
            entry = Entry(place, None, None, "failed", 0, str(error))
        else:
            (found,) = listing.clips
            entry = self.track(listing.root, found, self._name_of(join(listing.root, found.name)))
        return {**row, **asdict(entry), "input": place}

    def track(self, root: str, clip: Clip, name: str | None = None) -> Entry:
        """Tracks a clip of a listing.

        Args:
            root: place that it lies below.
            clip: of the listing.
            name: of the results' folder below `out`; the clip's if not given.

        Raises:
            TwoHandsError: as `__call__`.
        """
        name = clip.name if name is None else name
        self.check()
        store, source = store_of(self.out), store_of(root)
        place = store.canonical(join(self.out, name))
        if f"{source.canonical(join(root, clip.name))}/".startswith(f"{place}/"):
            raise InputError(f"{join(self.out, name)}: its results would replace the clip: choose another output")
        with store.staging(self.out, name) as folder:
            try:
                with source.fetched(root, clip.name) as path:
                    said, frames = self._write(path, name, folder)
            except TwoHandsError as error:
                said, frames = str(error), 0
            except OSError as error:
                raise InputError(f"{self.out}: cannot be written: {error.strerror or error}") from error
            if frames:
                store.deliver(folder, self.out, name)
                return Entry(name, clip.size, clip.etag, "done", frames, said)
        store.discard(self.out, name)
        return Entry(name, clip.size, clip.etag, "failed", 0, said or "not one frame in it")

    def check(self) -> None:
        """Loads what is needed.

        Raises:
            MissingExtraError: PyAV is not installed.
            CheckpointError, InputError: there are no such weights, they are damaged, or MediaPipe cannot be run.
        """
        load_av()
        if self.estimator == "mediapipe":
            mediapipe_name(self.peer_python, self.mediapipe_model)
        else:
            load_estimator(self.weights)

    @property
    def known(self) -> Known:
        """What is known of camera and hand."""
        source = self.camera_source or ("file" if self.camera else "fov" if self.fov_deg is not None else None)
        if self.hand_length_m is None:
            return Known(DEFAULT_HAND_LENGTH_M, "assumed", self.camera, self.fov_deg, source)
        return Known(self.hand_length_m, self.scale_source or "typed", self.camera, self.fov_deg, source)

    def settings(self) -> dict[str, Any]:
        """All that the results depend on beside the clips, as JSON values."""
        apart = ("out", "root", "estimator", "peer_python", "mediapipe_model")
        found = {name: value for name, value in asdict(self).items() if name not in apart}
        found["end_s"] = self.end_s if math.isfinite(self.end_s) else None
        if self.camera is not None:
            found["camera"] = {key: np.asarray(value).tolist() for key, value in found["camera"].items()}
        if self.estimator == "mediapipe":
            name = mediapipe_name(self.peer_python, self.mediapipe_model)
            return found | {"weights": name, "mediapipe_model": self.mediapipe_model}
        estimator = load_estimator(self.weights)
        return found | {"weights": estimator.card.name, "config": estimator.settings()}

    def _write(self, path: Path, name: str, folder: Path) -> tuple[str | None, int]:
        """Tracks a file; what is to be said of it, and how many frames of it were used.

        Raises:
            TwoHandsError: it cannot be read; names it as the results do, for it may lie in a place that only we know.
            OSError: the results cannot be written.
        """
        known = self.known
        try:
            with ExitStack() as stack:
                frames = stack.enter_context(
                    VideoFrames(path, start_s=self.start_s, end_s=self.end_s, stride=self.stride)
                )
                found = self._opened(stack)
                job = ClipJob(
                    name,
                    folder,
                    lambda width, height: known.camera_of(width, height)[0],
                    known.hand_length_m,
                    self.mirrored,
                    self.smooth,
                    self.look_ahead_s,
                    self.overlay,
                    found.weights,
                    found.more,
                    found.decision,
                )
                estimate = sourced(found.estimate, known.scale_source, known.camera_source or "assumed")
                tally = write_clip(job, frames, estimate)
        except TwoHandsError as error:
            raise InputError(str(error).replace(str(path), name)) from error
        remarks = []
        if frames.unreadable:
            remarks.append(f"{frames.unreadable} of {frames.decoded + frames.unreadable} frames unreadable")
        if tally.skipped:
            remarks.append(f"{tally.skipped} frames skipped, the first: {tally.reason}")
        return "; ".join(remarks) or None, tally.frames

    def _opened(self, stack: ExitStack) -> OpenEstimator:
        """The estimator of one clip, which `stack` closes."""
        if self.estimator == "mediapipe":
            return OpenEstimator.mediapipe(stack, self.peer_python, self.mediapipe_model)
        return OpenEstimator.ours(load_estimator(self.weights))

    def _name_of(self, place: str) -> str:
        """The name of the results' folder of a clip."""
        if self.root is None:
            return place.rpartition("/")[2]
        root = (self.root if is_remote(self.root) else os.path.abspath(self.root)).rstrip("/") + "/"
        if not place.startswith(root):
            raise InputError(f"{place} does not lie below the root {self.root}")
        return place.removeprefix(root)


@lru_cache(maxsize=1)
def load_estimator(weights: str) -> HandEstimator:
    """The networks, once for each process.

    Raises:
        CheckpointError, InputError: there are none of this name, or they are damaged.
    """
    return HandEstimator.from_preset(weights, THREADS)


@lru_cache(maxsize=1)
def mediapipe_name(python: str | None, model: str | None) -> str:
    """MediaPipe's name and version, asked once for each process.

    Raises:
        InputError: as `MediaPipeEstimator`.
    """
    with ExitStack() as stack:
        return OpenEstimator.mediapipe(stack, python, model).weights
