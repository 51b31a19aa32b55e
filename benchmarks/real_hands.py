"""The whole pipeline on real photographs, beside the bars that it is meant to pass: one markdown table.

    python -m benchmarks.real_hands GE2019 --photos PHOTOGRAPHS --overlays out/sheets --out out/real

GE2019 is a folder with crops of real frames, one left hand in each (test set of Ge et al. 2019)::

    images/00001.jpg ...   256x256, cut from frames of 1280x720
    annotations.json       [{"file", "cam_fx_fy_cx_cy": of the whole frame, "bbox_xywh_in_1280x720": of the crop,
                             "joints_cam_cm": (21, 3) camera frame, our joint order}, ...]

The pipeline gets the picture, the crop's true intrinsics and one hand length for all pictures: the median over the
labels, because those of single pictures are noisy. Its joints are moved to where these labels have them, and its hand
length is theirs in its own skeleton (`geometry.anatomy`). Errors run over the hands that were found on their own side;
in shares a miss is a failure. PHOTOGRAPHS is a folder, with folders below it, of pictures that show no hand.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from twohands.cli.output import write_file
from twohands.datasets.conversion import camera_of, number_array, projected_sample, single_hand
from twohands.datasets.files import existing_folder, read_json, read_picture
from twohands.errors import DataFormatError, InputError, TwoHandsError
from twohands.evaluation import metrics as m
from twohands.evaluation.comparison import REFERENCE_WIDTH_PX, Comparison, compare
from twohands.evaluation.completion import hand_lengths_m
from twohands.evaluation.predictions import Predictions, predict
from twohands.evaluation.summary import markdown_table
from twohands.formats.pictures import IMAGE_SUFFIXES, read_image
from twohands.geometry.anatomy import HAND_LENGTH, anatomical_joints
from twohands.inference.estimator import HandEstimator
from twohands.inference.weights import DEFAULT_PRESET
from twohands.skeleton import LEFT, N_JOINTS, RIGHT, ROOT, SIDES
from twohands.types import HandPose, HandSample, PinholeCamera, TwoHandPose
from twohands.visualization.overlay import draw_overlay

CROP_PX = 256
RANGE_CM = 7.0
PHOTO_FOV = 60.0
"""Horizontal field of view that is assumed for photographs, degrees."""
ABOUT = (
    "What these pictures are: [evaluation.md](../evaluation.md#real-photographs). No network was trained on them; the "
    "crops had a say in that of a constant in the judge of `accurate`, and in none of the decision's weights."
)
SHEET_COLUMNS = 5
SHEET_TILES = 25
CAPTION_PX = 18


@dataclass(frozen=True, slots=True)
class Figure:
    """One line of the table.

    Attributes:
        name: for people.
        value: the number; NaN where there was nothing to measure.
        unit: its unit.
        count: what it runs over.
        at_least, at_most: the bar, None for none.
    """

    name: str
    value: float
    unit: str
    count: str
    at_least: float | None = None
    at_most: float | None = None

    @property
    def row(self) -> list[str]:
        """(figure, value, unit, bar, passed, over)."""
        bar, passed = "", ""
        if self.at_least is not None:
            bar, passed = f">= {self.at_least:g}", "yes" if self.value >= self.at_least else "no"
        if self.at_most is not None:
            bar, passed = f"<= {self.at_most:g}", "yes" if self.value <= self.at_most else "no"
        return [self.name, "n/a" if math.isnan(self.value) else f"{self.value:.1f}", self.unit, bar, passed, self.count]


def read_ge2019(folder: Path) -> list[HandSample]:
    """The labelled crops, in the order of the annotations.

    Raises:
        InputError: no such folder.
        DataFormatError: a file is missing or damaged.
    """
    path = existing_folder(folder) / "annotations.json"
    samples: list[HandSample] = []
    for index, entry in enumerate(read_json(path, list)):
        what = f"{path}, entry {index}"
        try:
            file, intrinsics, box, joints_cm = (
                entry[key] for key in ("file", "cam_fx_fy_cx_cy", "bbox_xywh_in_1280x720", "joints_cam_cm")
            )
        except (KeyError, TypeError):
            raise DataFormatError(f"{what}: not an annotation with picture, camera, box and joints") from None
        image = read_picture(folder / "images" / str(file))
        if image.shape[:2] != (CROP_PX, CROP_PX):
            raise DataFormatError(f"{folder / 'images' / file}: expected {CROP_PX}x{CROP_PX}, got {image.shape[:2]}")
        focal, centre = number_array(intrinsics, (4,), what).reshape(2, 2)
        corner, size = number_array(box, (4,), what).reshape(2, 2)
        if not (size > 0).all():
            raise DataFormatError(f"{what}: box without area, {box}")
        zoom = CROP_PX / size
        camera = camera_of(zoom * focal, zoom * (centre - corner), (CROP_PX, CROP_PX), what, from_centre=False)
        joints_m = 1e-2 * number_array(joints_cm, (N_JOINTS, 3), what)
        samples.append(projected_sample(image, camera, single_hand(joints_m, LEFT), str(file)))
    if not samples:
        raise DataFormatError(f"{path}: no annotation")
    return samples


def typical_hand_length_m(samples: Sequence[HandSample]) -> float:
    """Median distance from wrist to middle knuckle, metres: one person's, freed from the noise of single labels."""
    return float(np.median([hand_lengths_m(sample)[LEFT] for sample in samples]))


def with_anatomical_joints(hand: HandPose) -> HandPose:
    """The same hand in the skeleton of these labels; an absent one stays absent."""
    if hand.joints_px is None or hand.canonical is None:
        return hand
    canonical = anatomical_joints(hand.canonical)
    changes: dict[str, Any] = {"canonical": (canonical - canonical[ROOT]) / HAND_LENGTH}
    if hand.joints_m is not None:
        joints_m = anatomical_joints(hand.joints_m)
        changes |= {"joints_m": joints_m, "range_m": float(np.linalg.norm(joints_m[ROOT]))}
    return dataclasses.replace(hand, joints_px=anatomical_joints(hand.joints_px), **changes)


def measure(
    samples: Sequence[HandSample], estimate: Callable[[HandSample], TwoHandPose], weights: str
) -> tuple[Predictions, Comparison]:
    """What was found in each picture, and its errors."""
    predictions = predict(samples, estimate, dataset="Ge 2019", weights=weights, settings={})
    return predictions, compare(predictions, samples)


def errors_2d_px(comparison: Comparison) -> np.ndarray:
    """(N, 21) errors of the left hands in pixels of the crop."""
    return comparison.joints_px[:, LEFT] * (CROP_PX / REFERENCE_WIDTH_PX)


def hand_figures(samples: Sequence[HandSample], predictions: Predictions, comparison: Comparison) -> list[Figure]:
    """The table's lines about labelled left hands.

    Args:
        samples: N crops with a left hand each.
        predictions, comparison: of the same, from `measure`.
    """
    found, valid = comparison.found[:, LEFT], comparison.valid[:, LEFT]
    truth_mm = 1e3 * np.stack([sample.joints_m[LEFT] for sample in samples])  # (N, 21, 3)
    joints_mm = 1e3 * predictions.joints_m[:, LEFT]
    aligned_mm = m.endpoint_errors(joints_mm - joints_mm[:, [ROOT]], truth_mm - truth_mm[:, [ROOT]], valid)  # (N, 21)
    range_cm = 1e2 * comparison.root[:, LEFT, 3]
    images, hands, placed = f"{len(samples)} images", f"{found.sum()} hands", f"{valid.sum()} hands"
    return [
        Figure("left hand found", _percent(found), "%", images, at_least=95),
        Figure("right hand found, which is not there", _percent(comparison.found[:, RIGHT]), "%", images),
        Figure("2D error, median", m.finite_median(errors_2d_px(comparison)), "px of 256", hands, at_most=8),
        Figure("PA-MPJPE", m.finite_mean(comparison.procrustes_mm[:, LEFT]), "mm", hands, at_most=12),
        Figure("MPJPE, roots aligned", m.finite_mean(aligned_mm), "mm", placed),
        Figure(f"range within {RANGE_CM:g} cm", 100 * m.accuracy_at(range_cm, RANGE_CM), "%", images, at_least=80),
        Figure("range error, median", m.finite_median(range_cm), "cm", placed),
    ]


SHOWING_HANDS = frozenset(
    {
        "185092.jpg",
        "384089.jpg",
        "n02860847_bobsled.jpg",
        "n02965783_car_mirror.jpg",
        "n04065272_recreational_vehicle.jpg",
        "n04486054_triumphal_arch.jpg",
        "n07613480_trifle.jpg",
        "n07615774_ice_lolly.jpg",
    }
)
"""Photographs of BSDS500 and of a sample of ImageNet in which somebody's hand can be seen, by looking at all 818 of
ours."""


def list_photos(folder: Path) -> list[Path]:
    """Pictures in a folder and in those below it, sorted, but for those `SHOWING_HANDS`.

    Raises:
        InputError: there is none.
    """
    found = sorted(path for path in existing_folder(folder).rglob("*") if path.suffix.lower() in IMAGE_SUFFIXES)
    photos = [path for path in found if path.name not in SHOWING_HANDS]
    if not photos:
        raise InputError(f"{folder}: no photograph here or in a folder below")
    return photos


def hands_found(estimator: HandEstimator, photo: np.ndarray) -> list[bool]:
    """Whether the left and the right hand are found in a photograph (H, W, 3) of an unknown camera."""
    height, width = photo.shape[:2]
    pose = estimator.estimate(photo, PinholeCamera.from_fov(PHOTO_FOV, width, height))
    return [hand.present for hand in pose.hands]


def photo_figures(found: np.ndarray) -> list[Figure]:
    """The table's lines about photographs without hands.

    Args:
        found: (P, 2) bool, which hands were found in each.
    """
    photos, slots = f"{len(found)} photographs", f"{found.size} hand slots"
    return [
        Figure("photographs without hands: any hand found", _percent(found.any(axis=1)), "%", photos),
        Figure("photographs without hands: hand slots found", _percent(found), "%", slots),
    ]


def write_sheets(
    folder: Path, samples: Sequence[HandSample], predictions: Predictions, comparison: Comparison
) -> list[Path]:
    """Overlays of all crops as PNG files of 25, the worst first: missed hands, then by mean 2D error."""
    errors_px = errors_2d_px(comparison).mean(axis=1)  # (N,), infinite for a miss
    order = np.argsort(-errors_px, kind="stable")
    paths: list[Path] = []
    for start in range(0, len(order), SHEET_TILES):
        tiles = []
        for index in order[start : start + SHEET_TILES]:
            sample, range_cm = samples[index], 1e2 * comparison.root[index, LEFT, 3]
            picture = draw_overlay(sample.image, predictions.pose(int(index), sample.camera))
            what = f"{errors_px[index]:.1f} px, {range_cm:.1f} cm" if np.isfinite(errors_px[index]) else "missed"
            tiles.append(_captioned(picture, f"{sample.source}  {what}"))
        paths.append(folder / f"sheet_{len(paths) + 1:02d}.png")
        write_file(paths[-1], cv2.imencode(".png", cv2.cvtColor(_grid(tiles), cv2.COLOR_RGB2BGR))[1].tobytes())
    return paths


def _captioned(picture: np.ndarray, text: str) -> np.ndarray:
    """The picture with a line of text below."""
    line = np.full((CAPTION_PX, picture.shape[1], 3), 24, np.uint8)
    cv2.putText(line, text, (4, CAPTION_PX - 5), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (255, 255, 255), 1, cv2.LINE_AA)
    return np.concatenate([picture, line])


def _grid(tiles: list[np.ndarray]) -> np.ndarray:
    """Tiles of one size in rows; the last row is filled up with black."""
    blank = np.zeros_like(tiles[0])
    tiles = tiles + [blank] * (-len(tiles) % SHEET_COLUMNS)
    rows = [np.concatenate(tiles[i : i + SHEET_COLUMNS], axis=1) for i in range(0, len(tiles), SHEET_COLUMNS)]
    return np.concatenate(rows)


def table(figures: Sequence[Figure]) -> str:
    """Markdown: a line per figure, its bar beside it."""
    head = ["", "value", "unit", "bar", "passed", "over"]
    return "\n".join(markdown_table([head, *(figure.row for figure in figures)]))


def _percent(happened: Any) -> float:
    return 100 * float(np.mean(happened))


def _number(value: float) -> float | None:
    """For JSON, which knows neither NaN nor infinity."""
    return float(value) if math.isfinite(value) else None


def main(arguments: Sequence[str] | None = None) -> None:
    """Measures, prints the table, writes what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("ge2019", type=Path, help="folder with annotations.json and images/")
    parser.add_argument("--weights", default=DEFAULT_PRESET, help="preset that ships with the package, or a folder")
    parser.add_argument("--photos", type=Path, help="folder of photographs without hands")
    parser.add_argument("--overlays", type=Path, help="folder for sheets of overlays; earlier ones are replaced")
    parser.add_argument("--out", type=Path, help="the table as OUT.md, with numbers of every picture as OUT.json")
    args = parser.parse_args(arguments)
    samples = read_ge2019(args.ge2019)
    photos = list_photos(args.photos) if args.photos else []
    estimator = HandEstimator.from_preset(args.weights)
    length_m = typical_hand_length_m(samples)

    def estimate(sample: HandSample) -> TwoHandPose:
        pose = estimator.estimate(sample.image, sample.camera, length_m / HAND_LENGTH)
        return dataclasses.replace(
            pose, left=with_anatomical_joints(pose.left), right=with_anatomical_joints(pose.right)
        )

    predictions, comparison = measure(samples, estimate, args.weights)
    figures = hand_figures(samples, predictions, comparison)
    in_photos = np.array([hands_found(estimator, read_image(path)) for path in photos], bool).reshape(-1, 2)
    if photos:
        figures += photo_figures(in_photos)
    title = f"# Real photographs: {args.weights}"
    text = "\n\n".join([title, ABOUT, f"Hand length {100 * length_m:.2f} cm.", table(figures)])
    print(text)
    if args.out:
        errors_px = errors_2d_px(comparison).mean(axis=1)
        content = {
            "weights": args.weights,
            "hand_length_cm": 100 * length_m,
            "figures": [asdict(figure) | {"value": _number(figure.value)} for figure in figures],
            "images": [
                {
                    "file": sample.source,
                    "found": [side for side, there in zip(SIDES, comparison.found[i], strict=True) if there],
                    "error_2d_px": _number(errors_px[i]),
                    "range_error_cm": _number(1e2 * comparison.root[i, LEFT, 3]),
                }
                for i, sample in enumerate(samples)
            ],
            "photos_with_hands": {
                path.relative_to(args.photos).as_posix(): [
                    side for side, there in zip(SIDES, found, strict=True) if there
                ]
                for path, found in zip(photos, in_photos, strict=True)
                if found.any()
            },
        }
        write_file(args.out.with_name(f"{args.out.name}.md"), f"{text}\n".encode())
        write_file(args.out.with_name(f"{args.out.name}.json"), f"{json.dumps(content, indent=1)}\n".encode())
    if args.overlays:
        sheets = write_sheets(args.overlays, samples, predictions, comparison)
        print(f"{len(sheets)} sheets written to {args.overlays}", file=sys.stderr)


if __name__ == "__main__":
    try:
        main()
    except TwoHandsError as error:
        sys.exit(f"error: {error}")
