"""Track the example images that ship with the package, and say where the results are."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Annotated

import tyro

from twohands.cli.output import check_output_folder
from twohands.cli.track import Picture, print_table, track_pictures
from twohands.errors import InputError
from twohands.formats.camera_files import camera_for_image, read_camera
from twohands.formats.pictures import list_images, read_image
from twohands.inference.estimator import DEFAULT_HAND_LENGTH_M, HandEstimator
from twohands.inference.weights import DEFAULT_PRESET


@dataclass(frozen=True)
class DemoArgs:
    """Arguments of `twohands demo`."""

    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("out/demo")
    """Folder for the results; earlier results of the demo there are replaced."""
    weights: Annotated[str, tyro.conf.arg(metavar="NAME")] = DEFAULT_PRESET
    """Preset that ships with the package, or a weights folder."""


def examples_folder() -> Path:
    """Folder of the packaged example images and their camera.json."""
    return Path(str(resources.files("twohands") / "examples_data"))


def run(args: DemoArgs) -> int:
    """Carry out `twohands demo`."""
    check_output_folder(args.out, overwrite=True)
    folder = examples_folder()
    if not folder.is_dir():
        raise InputError("the example images are not installed; reinstall twohands")
    camera = read_camera(folder / "camera.json")
    files = list_images(folder)
    images = [read_image(path) for path in files]
    record = track_pictures(
        [
            Picture(path, i, image, camera_for_image(camera, image.shape[1], image.shape[0]), "file")
            for i, (path, image) in enumerate(zip(files, images, strict=True))
        ],
        HandEstimator.from_preset(args.weights),
        hand_length_m=DEFAULT_HAND_LENGTH_M,
        out=args.out,
        files=files,
        source="examples",
    )
    print_table(record)
    print(f"results written to {args.out.resolve()}")
    return 0
