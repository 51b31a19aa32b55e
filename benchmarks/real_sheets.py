"""Overlay sheets of `benchmarks.real_people`: pictures with the reference's joints (white) and ours, as PNG files."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from types import ModuleType

import cv2
import numpy as np
from benchmarks.real_pictures import Part, reference_of
from benchmarks.real_scores import found_hands

from twohands.cli.output import write_file
from twohands.evaluation.predictions import Predictions
from twohands.skeleton import BONES, SIDES
from twohands.types import HandSample
from twohands.visualization.overlay import draw_overlay

COLUMNS = 5
ROWS = 4
TILE_PX = 360
"""Side of the square that a picture is fitted into."""
CAPTION_PX = 18
BAD_SHARE = 0.1
"""A hand is drawn as a miss too if its median joint is farther off than this share of the hand's size."""
NO_HANDS = dict.fromkeys(SIDES)


def write_sheets(
    folder: Path, part: Part, predictions: Predictions, tool: ModuleType, *, everything: bool = False
) -> list[Path]:
    """Sheets of a part's misses: reference hands that were not found on their own side or badly, and found hands that
    no reference hand explains.

    Args:
        folder: for the sheets, PART_01.png and so on; those of an earlier run are removed.
        part, predictions: as scored.
        tool: `score_people.py`.
        everything: all pictures, not only misses.

    Returns:
        The files written.
    """
    for old in folder.glob(f"{part.name}_[0-9][0-9].png"):
        old.unlink()
    paths: list[Path] = []
    for page in _pages(_tiles(part, predictions, tool, everything)):
        paths.append(folder / f"{part.name}_{len(paths) + 1:02d}.png")
        write_file(paths[-1], cv2.imencode(".png", cv2.cvtColor(page, cv2.COLOR_RGB2BGR))[1].tobytes())
    return paths


def verdict(reference: dict | None, found: dict, tool: ModuleType) -> str:
    """What is wrong with a picture, in few words; "" for nothing, or where nothing is known about it."""
    if reference is None:
        return ""
    score = tool.score({"": reference}, {"": found})
    words = []
    if score["none"]:
        words.append(f"{score['none']} not found")
    if score["other_side"]:
        words.append(f"{score['other_side']} other side")
    if score["unexplained"]:
        words.append(f"{score['unexplained']} unexplained")
    if score["same_side"] and score["error_median_of_size"] >= BAD_SHARE:
        words.append(f"error {score['error_median_of_size']:.2f}")
    return ", ".join(words)


def _tiles(part: Part, predictions: Predictions, tool: ModuleType, everything: bool) -> Iterator[np.ndarray]:
    found = found_hands(predictions)
    for index, sample in enumerate(part.samples()):
        known = part.name != "stills"
        reference = reference_of(sample)
        if part.reference is not None:
            reference, known = part.reference.get(sample.source, NO_HANDS), sample.source in part.reference
        what = verdict(reference if known else None, found[sample.source], tool)
        if what or everything or part.name == "stills":
            yield _tile(sample, reference, predictions, index, what)


def _tile(sample: HandSample, reference: dict, predictions: Predictions, index: int, what: str) -> np.ndarray:
    """(TILE_PX + CAPTION_PX, TILE_PX, 3) picture with reference, result and a line of text."""
    height, width = sample.image.shape[:2]
    picture = draw_overlay(sample.image, predictions.pose(index, sample.camera))
    scale = TILE_PX / max(height, width)
    size = max(1, round(width * scale)), max(1, round(height * scale))
    picture = cv2.resize(picture, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)
    for side in SIDES:
        if reference[side] is not None:
            _draw_reference(picture, scale * np.asarray(reference[side], float), side[0].upper())
    tile = np.zeros((TILE_PX + CAPTION_PX, TILE_PX, 3), np.uint8)
    tile[: size[1], : size[0]] = picture
    name = sample.source.split("/", 1) if len(sample.source) > 24 else [sample.source]
    text = f"{name[-1][:24]}  {what}"
    at = (3, TILE_PX + CAPTION_PX - 5)
    cv2.putText(tile, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.4, (255, 255, 255), 1, cv2.LINE_AA)
    return tile


def _draw_reference(picture: np.ndarray, joints: np.ndarray, letter: str) -> None:
    """Thin white bones with a dark rim, and the side's letter at the wrist."""
    points = [tuple(int(c) for c in np.rint(point - 0.5)) for point in joints]
    for colour, width in (((0, 0, 0), 3), ((255, 255, 255), 1)):
        for start, end in BONES:
            cv2.line(picture, points[start], points[end], colour, width, cv2.LINE_AA)
        cv2.putText(picture, letter, points[0], cv2.FONT_HERSHEY_SIMPLEX, 0.5, colour, width, cv2.LINE_AA)


def _pages(tiles: Iterable[np.ndarray]) -> Iterator[np.ndarray]:
    """Tiles in rows of `COLUMNS`; the last row is filled up with black."""
    page: list[np.ndarray] = []
    for tile in tiles:
        page.append(tile)
        if len(page) == COLUMNS * ROWS:
            yield _grid(page)
            page = []
    if page:
        yield _grid(page)


def _grid(tiles: list[np.ndarray]) -> np.ndarray:
    tiles = tiles + [np.zeros_like(tiles[0])] * (-len(tiles) % COLUMNS)
    rows = [np.concatenate(tiles[i : i + COLUMNS], axis=1) for i in range(0, len(tiles), COLUMNS)]
    return np.concatenate(rows)
