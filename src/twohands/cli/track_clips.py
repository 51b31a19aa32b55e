"""`twohands track` of many clips: a folder or a pattern of videos, in folders of this machine or in buckets."""

from __future__ import annotations

import glob
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Literal

from twohands.batch.manifest import MANIFEST, Entry
from twohands.batch.run import Existing, environment, track_clips
from twohands.batch.stores import Listing, has_magic, is_remote, join, list_clips, store_of
from twohands.batch.tracker import ClipTracker
from twohands.cli.progress import progress_of
from twohands.cli.track_clip import say
from twohands.errors import InputError
from twohands.executors.base import Executor
from twohands.formats.pictures import IMAGE_SUFFIXES
from twohands.inference.frames import CAMERA_PREFIX, VIDEO_SUFFIXES

EXIT_NOTHING_TRACKED: Final = 1
SHOWN_FAILURES: Final = 20


@dataclass(frozen=True, slots=True)
class Crew:
    """Who is to track the clips, by the options of the command.

    Attributes:
        engine: processes of this machine, or a Ray cluster.
        workers: how many; 0 for all cores.
        ray_address: of a running cluster; None starts one here.
    """

    engine: Literal["local", "ray"]
    workers: int
    ray_address: str | None

    def check(self) -> None:
        """
        Raises:
            InputError: a negative number of workers, an address without Ray, or no cluster there.
            MissingExtraError: Ray is asked for and not installed.
        """
        if self.workers < 0:
            raise InputError(f"--workers must be 0 (all cores) or more, got {self.workers}")
        if self.ray_address is not None and self.engine != "ray":
            raise InputError("--ray-address needs --engine ray")
        if self.engine == "ray":
            from twohands.executors.ray_cluster import RayCluster

            RayCluster(self.ray_address, self.workers).check()

    def executor(self, jobs: int) -> Executor:
        """The crew for a number of jobs; of processes no more than those."""
        if self.engine == "ray":
            from twohands.executors.ray_cluster import RayCluster

            return RayCluster(self.ray_address, self.workers, environment)
        from twohands.executors.local import LocalProcesses

        return LocalProcesses(max(1, min(self.workers or os.cpu_count() or 1, jobs)))


def are_clips(place: str, out: str | None) -> bool:
    """Whether an input of `track` is many clips, or one from or to a bucket: not a picture, not pictures, not a single
    local video with a local output.

    Raises:
        InputError: a pattern matches pictures and videos, or frames of a camera or stream are to go to a bucket.
    """
    if is_remote(place):
        return True
    to_bucket = out is not None and is_remote(out)
    if place.startswith(CAMERA_PREFIX) or "://" in place:
        if to_bucket:
            raise InputError(f"{place}: a camera or stream needs a folder of this machine as --out, got {out}")
        return False
    suffixes = _suffixes(place)
    videos, pictures = suffixes & VIDEO_SUFFIXES, suffixes & set(IMAGE_SUFFIXES) - VIDEO_SUFFIXES
    if os.path.isdir(place):
        return bool(videos) and not pictures
    if has_magic(place) and not os.path.lexists(place):
        if videos and pictures:
            raise InputError(f"{place}: matches videos and pictures; give a pattern for either, such as '*.mp4'")
        return bool(videos or (not suffixes and {Path(place).suffix.lower()} & VIDEO_SUFFIXES))
    return to_bucket and bool(videos)


def track_many(tracker: ClipTracker, place: str, crew: Crew, existing: Existing) -> int:
    """Tracks clips and prints what came of it.

    Args:
        tracker: how; its root is not used.
        place: the clips.
        crew: who does it.
        existing: as `batch.run.track_clips`.

    Returns:
        0, or 1 where no clip could be tracked.
    """
    crew.check()
    listing = _without(list_clips(place), tracker.out)
    if listing.others:
        say(f"{listing.others} files left out, no videos by their endings")
    tracker = replace(tracker, root=listing.root)
    try:
        with progress_of("clips") as progress:
            outcome = track_clips(tracker, listing, crew.executor, existing=existing, progress=progress)
    except KeyboardInterrupt:
        say(f"{tracker.out} is sound as far as it goes: run the same command with --resume to go on")
        raise
    _name_failed([entry for entry in outcome.entries if entry.status == "failed"])
    done = [entry for entry in outcome.entries if entry.status == "done"]
    print(
        f"{len(done)} clips tracked, {sum(entry.frames for entry in done)} frames; {outcome.there} were there already"
    )
    print(f"written to {tracker.out}: {MANIFEST} and a folder for each clip")
    return 0 if done or outcome.there else EXIT_NOTHING_TRACKED


def existing_of(resume: bool, overwrite: bool) -> Existing:
    """What the options say of an output that holds something.

    Raises:
        InputError: both are given.
    """
    if resume and overwrite:
        raise InputError("give --resume or --overwrite, not both")
    return "resume" if resume else "replace" if overwrite else "refuse"


def default_out_of(place: str) -> str:
    """out/track/NAME of a folder, a pattern or a bucket."""
    parts = [part for part in place.replace("://", "/").split("/") if part and part != "."]
    named = [part for part in parts if not has_magic(part)]
    return os.path.join("out", "track", named[-1] if named else Path.cwd().name)


def absolute(place: str) -> str:
    """A place of this machine as seen from any working folder; a bucket's as it is."""
    return place if is_remote(place) else os.path.abspath(place)


def _suffixes(place: str) -> set[str]:
    """Of the files of a local folder or pattern, or of a file."""
    if os.path.isdir(place):
        names = [name for name in os.listdir(place) if not name.startswith(".")]
    else:
        names = [place] if os.path.lexists(place) else glob.glob(place, recursive=True)
    return {Path(name).suffix.lower() for name in names}


def _without(listing: Listing, out: str) -> Listing:
    """A listing without what lies below the output: films that an earlier run has drawn.

    Raises:
        InputError: the output is the folder of the clips, or nothing is left.
    """
    source, place = store_of(listing.root), store_of(out).canonical(out)
    if place == source.canonical(listing.root):
        raise InputError(f"output {out} is the folder of the clips; choose another --out")
    below = join(place, "")
    kept = tuple(
        clip for clip in listing.clips if not source.canonical(join(listing.root, clip.name)).startswith(below)
    )
    if not kept:
        raise InputError(f"{listing.root}: no clips but those below the output {out}")
    return replace(listing, clips=kept)


def _name_failed(failed: Sequence[Entry]) -> None:
    for entry in failed[:SHOWN_FAILURES]:
        say(f"failed: {entry.input}: {entry.error}")
    if len(failed) > SHOWN_FAILURES:
        say(f"... and {len(failed) - SHOWN_FAILURES} more; all are named in {MANIFEST}")
