"""`twohands train --your-camera`: render for a camera, train on, export; one folder, resumable at any moment."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from pathlib import Path

from twohands.cli.progress import progress_of
from twohands.errors import InputError
from twohands.formats.camera_files import read_camera
from twohands.inference.weights import DEFAULT_PRESET, NETWORK_NAMES, preset_folder, preset_names, read_card
from twohands.training.config import TrainConfig

DEFAULT_MINUTES = 30.0
CALIBRATION_PICTURES = 64
"""On which activations are measured for 8-bit arithmetic."""
WORK_FOLDER = "work"
"""Inside the output folder: frames and runs; only needed to resume."""


def fine_tune(
    camera_file: Path, out: Path, *, minutes: float, resume: bool, change: Callable[[TrainConfig], TrainConfig]
) -> None:
    """Fine-tune the shipped weights for one camera, and export them.

    Args:
        camera_file: as for `twohands track --camera`.
        out: becomes the weights folder; `work` inside it holds frames and runs.
        minutes: of training; rendering and export come on top.
        resume: go on with what is in `out`.
        change: applies the user's settings to the run of a stage.

    Raises:
        InputError: a camera, folder or budget that cannot be used, or the frames there are of another camera or budget.
    """
    from twohands.export.calibration import add_int8
    from twohands.export.onnx import export_preset
    from twohands.synth.sets.cache import build_cache
    from twohands.training.fine_tune import SHARES, fine_tuning_run, frame_count, scenes_for, shapes_of
    from twohands.training.sources import backgrounds_of, open_source
    from twohands.training.trainer import train

    if not 0 < minutes < math.inf:
        raise InputError(f"--minutes must be a positive number, got {minutes:g}")
    camera = read_camera(camera_file)
    work = out / WORK_FOLDER
    if resume and not work.is_dir():
        raise InputError(f"{out} holds no fine-tuning to resume")
    if not resume and out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"{out} is not an empty folder: choose another --out, or go on with --resume")
    given = {name: preset_folder(DEFAULT_PRESET) / f"{name}.onnx" for name in NETWORK_NAMES}
    networks = shapes_of(given)
    checkpoints: dict[str, Path] = {}
    runs = {
        stage: change(
            fine_tuning_run(stage, networks, minutes, work / "frames", work / "hand_seg_net/hand_seg_net.safetensors")
        )
        for stage in SHARES
    }
    backgrounds_of(next(iter(runs.values())).data)  # refuses what is none before anything is rendered
    if camera.distortion:
        print("lens distortion is not rendered: the networks learn an ideal lens of this focal length")
    print(f"fine-tuning of {DEFAULT_PRESET} for a field of view of {camera.hfov_deg:.0f} degrees, {minutes:g} min")
    with progress_of("frames") as progress:
        build_cache(
            work / "frames",
            scenes_for(camera),
            next(iter(runs.values())).seed,
            frame_count(minutes),
            workers=os.cpu_count() or 1,
            progress=progress,
        )
    for stage, config in runs.items():
        source, held_out = open_source(config.data)
        print(f"{stage}: {len(source)} pictures, {len(held_out)} held out")
        result = train(
            config,
            source,
            held_out,
            work / stage,
            weights=[given[name] for name in _networks_of(stage)],
            resume=(work / stage / "config.json").is_file(),
            report=lambda line: print(line, flush=True),
        )
        checkpoints |= result.checkpoints
    shipped = read_card(preset_folder(DEFAULT_PRESET))
    settings = shipped.settings()
    further = {"fine_tuned_from": DEFAULT_PRESET} | {
        name: settings[name] for name in ("views", "placement", "decision")
    }
    if shipped.second:
        further["second"] = shipped.second
    export_preset(checkpoints, out, name=out.resolve().name, further=further)
    add_int8(out, (source[i] for i in range(min(CALIBRATION_PICTURES, len(source)))))
    folder = f"./{out}" if str(out) in preset_names() else out  # the name alone is that of shipped weights
    print(f"weights written to {out}; use them with twohands track --weights {folder} --camera {camera_file}")


def _networks_of(stage: str) -> tuple[str, ...]:
    return ("hand_seg_net",) if stage == "hand_seg_net" else ("pose_net_2d", "pose_net_3d")
