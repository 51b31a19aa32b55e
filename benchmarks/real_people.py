"""The referee: presets and MediaPipe Hands on pictures of real people, one table.

    python -m benchmarks.real_people --systems fast accurate --mediapipe-python mediapipe-env/bin/python --out out/real
    python -m benchmarks.real_people --systems weights/mine --quick --out out/mine       # under a minute
    python -m benchmarks.real_people --systems fast accurate --score-only --out out/real \\
        --insert docs/results.md --insert-short README.md
    python -m benchmarks.real_people --systems fast accurate --score-only --out out/real --check   # before a commit

Predictions are made first (OUT/predictions/SYSTEM/PART.npz) and scored then; `--score-only` scores what is there.
MediaPipe has its column as soon as it has predictions. Written are OUT/real_people.md, OUT/real_people.json, and in
OUT/sheets overlays of every miss. Pictures and parts: `benchmarks.real_pictures`; what counts: `benchmarks.real_scores`
and docs/evaluation.md. Training code calls `quick` and `segmentation_check`.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from benchmarks import real_pictures as pictures
from benchmarks.documents import insert
from benchmarks.real_pictures import SHARED, Part
from benchmarks.real_scores import PALM, SCORES, Figures, Measured
from benchmarks.real_sheets import write_sheets
from benchmarks.real_systems import MEDIAPIPE, MediaPipe, OurWeights, Segment, System, run_part, time_ratio

from twohands.cli.output import write_file
from twohands.errors import DataFormatError, InputError, TwoHandsError
from twohands.evaluation.predictions import load_predictions, save_predictions
from twohands.evaluation.summary import markdown_table
from twohands.inference.estimator import HandEstimator
from twohands.inference.weights import DEFAULT_PRESET
from twohands.skeleton import SIDES

PARTS = ("people", "clips", "digits", "ge2019", "official", "research", "stills", "generated", "paper", "wild")
GENERATED = ("generated", "paper", "wild")
"""Parts that the generator made."""
QUICK_PARTS = ("people", "frames", "digits", "official")
FLOORS = Path(__file__).with_name("figures.json")
"""Figures that new weights must not fall below, by preset."""
MARKER = "real people"
"""Name of the markers between which the table stands in a document."""
TIME = "hand_seg_net.time"
ALLOWANCE = 0.03
"""By so much of its value an error may rise above the one that was accepted: processors do not all compute alike. A
share may be worse by one picture, hand or frame, or by half a percent."""


@dataclass(frozen=True, slots=True)
class Kind:
    """How a figure is read.

    Attributes:
        name: for people.
        form: of its value, after `scale`.
        scale: what the value is multiplied with for people; 100 for shares.
        more: whether more is better.
        words: what stands for 1, and for less; none for the number.
        one: what one picture, hand or frame adds to value times count; 0 for an error.
    """

    name: str
    form: str = "{:.0f} %"
    scale: float = 100.0
    more: bool = True
    words: tuple[str, ...] = ()
    one: float = 1.0

    def text(self, measured: Measured | None) -> str:
        """The value for people."""
        if measured is None:
            return "-"
        if self.words:
            return self.words[measured.value < 1]
        return "n/a" if math.isnan(measured.value) else self.form.format(self.scale * measured.value)


def _share(name: str, *, digits: int = 0, more: bool = True) -> Kind:
    return Kind(name, f"{{:.{digits}f}} %", more=more)


def _fraction(name: str) -> Kind:
    """Shares as the evaluation prints them."""
    return Kind(name, "{:.3f}", 1.0)


def _error(name: str, unit: str, digits: int = 1) -> Kind:
    return Kind(name, f"{{:.{digits}f}} {unit}".rstrip(), 1.0, more=False, one=0.0)


def _matched(part: str, what: str) -> dict[str, Kind]:
    return {
        f"{part}.same_side": _share(f"{what}: same hand, same side"),
        f"{part}.other_side": _share(f"{what}: found as the other hand", more=False),
        f"{part}.none": _share(f"{what}: not found", more=False),
        f"{part}.good": _share(f"{what}: median joint within .1 of the hand's size, of those on their side"),
        f"{part}.good_of_all": _share(f"{what}: the same of all reference hands"),
        f"{part}.error": _error(f"{what}: median joint error over the hand's size", "", 3),
        f"{part}.unexplained": Kind(
            f"{what}: found hands that no reference hand explains, a picture", "{:.2f}", 1.0, more=False
        ),
    }


def _generated(part: str, what: str) -> dict[str, Kind]:
    return {
        f"{part}.presence": _fraction(f"{what}: presence"),
        f"{part}.miou": _fraction(f"{what}: mIoU"),
        f"{part}.side_errors": _share(f"{what}: side errors", digits=1, more=False),
        f"{part}.error_px": _error(f"{what}: 2D", "px"),
        f"{part}.range_cm": _error(f"{what}: range median", "cm", 2),
        f"{part}.within_7cm": _fraction(f"{what}: within 7 cm"),
    }


KINDS: dict[str, Kind] = {
    **_matched("people", "people"),
    **_matched("clips", "clips"),
    **_matched("frames", "single frames of the clips"),
    "clips.book_both": _share("asl_book: frames with both hands"),
    "clips.side_changes": Kind("clips: side changes per 100 frames", "{:.2f}", 1.0, more=False, one=100.0),
    "digits.right": _share("digits: right hand found", digits=1),
    "digits.ghost": _share("digits: false left hand", digits=1, more=False),
    "digits.error": _error("digits: median joint error over the hand's size", "", 3),
    "ge2019.found": _share("ge2019: found"),
    "ge2019.ghosts": _share("ge2019: false right hand", more=False),
    "ge2019.error_px": _error("ge2019: 2D", "px"),
    "ge2019.pa_mm": _error("ge2019: PA", "mm"),
    "ge2019.range_cm": _error("ge2019: range median", "cm"),
    "official.both": Kind("official sample: both hands", words=("both", "no"), one=0.0),
    "official.error_px": _error("official sample: 2D of the worse hand", "px"),
    "official.range_cm": _error("official sample: range of the worse hand", "cm"),
    "research.any": _share("research photographs: any hand found", digits=2, more=False),
    **_generated("generated", "generated people"),
    **_generated("paper", "style paper"),
    **_generated("wild", "style wild"),
    TIME: _error("HandSegNet: time over that of the weights of before", "", 2),
}
"""Every figure."""


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the table.

    Attributes:
        name, now, must, aim: what stands there; `now` is of the weights before they learnt from photographs.
        bars: (figure, must, aim) of each figure in the line, values as measured.
        joint: what separates the figures.
    """

    name: str
    now: str
    must: str
    aim: str
    bars: tuple[tuple[str, float, float], ...]
    joint: str = ", "

    def cell(self, figures: Mapping[str, Measured]) -> str:
        """A system's figures; in bold where all reach what they must."""
        if not any(key in figures for key, _, _ in self.bars):
            return "-"
        text = self.joint.join(KINDS[key].text(figures.get(key)) for key, _, _ in self.bars)
        if all(reaches(KINDS[key], figures.get(key), must) for key, must, _ in self.bars):
            return f"**{text}**"
        return text


ROWS = (
    Row("clips of real_dev (236 hands): same side", "14 %", "80 %", "97 %", (("clips.same_side", 0.80, 0.97),)),
    Row("asl_book: frames with both hands", "0 %", "40 %", "85 %", (("clips.book_both", 0.40, 0.85),)),
    Row(
        "people photographs of real_dev (21 hands): same side",
        "10 %",
        "80 %",
        "95 %",
        (("people.same_side", 0.80, 0.95),),
    ),
    Row(
        "good (median joint within .1 of the hand's size) of those", "-", "75 %", "90 %", (("people.good", 0.75, 0.90),)
    ),
    Row("side changes per 100 frames in the clips", "-", "2", "0.5", (("clips.side_changes", 2.0, 0.5),)),
    Row(
        "digits held out: right hand found / false left",
        "93 / 6 %",
        "98 / 1 %",
        "99.5 / 0.3 %",
        (("digits.right", 0.98, 0.995), ("digits.ghost", 0.01, 0.003)),
        " / ",
    ),
    Row(
        "ge2019: found, false, 2D, PA, range median",
        "97 %, 26 %, 8.6 px, 12.4 mm, 1.9 cm",
        "98 %, 3 %, 6.5 px, 10.5 mm, 1.8 cm",
        "99 %, 1 %, 5 px, 9 mm, 1.5 cm",
        (
            ("ge2019.found", 0.98, 0.99),
            ("ge2019.ghosts", 0.03, 0.01),
            ("ge2019.error_px", 6.5, 5.0),
            ("ge2019.pa_mm", 10.5, 9.0),
            ("ge2019.range_cm", 1.8, 1.5),
        ),
    ),
    Row(
        "official sample: both hands, 2D (270x480), range",
        "no",
        "both, 6 px, 4 cm",
        "both, 3 px, 2 cm",
        (("official.both", 1.0, 1.0), ("official.error_px", 6.0, 3.0), ("official.range_cm", 4.0, 2.0)),
    ),
    Row("research photographs: any hand found", "2.2 %", "1 %", "0.3 %", (("research.any", 0.01, 0.003),)),
    Row(
        "generated people (new test set, 1,000, webcam and room): presence, mIoU, side errors",
        "-",
        ".97, .88, 2 %",
        ".99, .93, .5 %",
        (("generated.presence", 0.97, 0.99), ("generated.miou", 0.88, 0.93), ("generated.side_errors", 0.02, 0.005)),
    ),
    Row(
        "style paper, 1,000: presence, 2D, range median, within 7 cm",
        ".999, 1.7 px, .55 cm, .995",
        ".998, 1.8 px, .60 cm, .995",
        "better than now",
        (
            ("paper.presence", 0.998, 0.999),
            ("paper.error_px", 1.8, 1.7),
            ("paper.range_cm", 0.60, 0.55),
            ("paper.within_7cm", 0.995, 0.995),
        ),
    ),
    Row("HandSegNet, 2-core EPYC, in one run with today's", "1", "0.7 of the time", "0.3", ((TIME, 0.7, 0.3),)),
)
ABOUT = (
    "What each line means, where the pictures come from and where the reference, which is what MediaPipe found, is "
    "wrong: [evaluation.md](evaluation.md#real-people). Before: preset `fast` before it learnt from photographs. Bold: "
    "all that the line must reach is reached. `-`: not measured; `n/a`: nothing to measure."
)


def reaches(kind: Kind, measured: Measured | None, bar: float) -> bool:
    """Whether a figure is as good as a bar, as far as its printed digits say."""
    if measured is None or math.isnan(measured.value):
        return False
    return measured.value >= bar - 1e-9 if kind.more else measured.value <= bar + 1e-9


def table(systems: Mapping[str, Figures]) -> str:
    """The table, a column a system, in Markdown."""
    head = ["figure", "before", "must", "aim", *systems]
    rows = [[row.name, row.now, row.must, row.aim, *map(row.cell, systems.values())] for row in ROWS]
    return "\n".join(markdown_table([head, *rows]))


def short_table(systems: Mapping[str, Figures]) -> str:
    """The table without bars, and without lines that nobody measured."""
    rows = [[row.name, *(row.cell(figures).replace("**", "") for figures in systems.values())] for row in ROWS]
    return "\n".join(markdown_table([["figure", *systems], *(row for row in rows if set(row[1:]) != {"-"})]))


def details(systems: Mapping[str, Figures]) -> str:
    """Every figure that was measured, a column a system, in Markdown."""
    keys = [key for key in KINDS if any(key in figures for figures in systems.values())]
    head = ["figure", "over", *systems]
    rows = []
    for key in keys:
        count = next(figures[key].count for figures in systems.values() if key in figures)
        rows.append([KINDS[key].name, str(count), *(KINDS[key].text(figures.get(key)) for figures in systems.values())])
    return "\n".join(markdown_table([head, *rows]))


def page(systems: Mapping[str, Figures]) -> str:
    """The section on real pictures, without its markers."""
    return "\n\n".join(["## Real people", ABOUT, table(systems), "All figures:", details(systems)])


def to_json(systems: Mapping[str, Figures]) -> dict[str, Any]:
    """The figures as JSON values; None for what was nothing."""
    return {
        name: {key: {"value": None if math.isnan(m.value) else m.value, "count": m.count} for key, m in figures.items()}
        for name, figures in systems.items()
    }


def floor(kind: Kind, measured: Measured) -> float:
    """The worst value that new weights may have once this one was accepted."""
    slack = ALLOWANCE * measured.value
    if kind.one:
        slack = kind.one * max(1 / max(measured.count, 1), 0.005)
    return max(0.0, measured.value - slack) if kind.more else measured.value + slack


def floors(figures: Figures) -> dict[str, float]:
    """Floors of what the table shows, of the share of good hands and of style wild, where something was measured.

    A time does not repeat itself; what is said of found hands alone may get worse because more are found.
    """
    shown = {key for row in ROWS for key, _, _ in row.bars} - {TIME, "people.good"}
    wild = {f"wild.{name}" for name in ("presence", "miou", "error_px", "range_cm", "within_7cm")}
    chosen = shown | {"people.good_of_all", "clips.good_of_all"} | wild
    return {
        key: round(floor(KINDS[key], figures[key]), 4)
        for key in KINDS
        if key in chosen and key in figures and not math.isnan(figures[key].value)
    }


def fallen(figures: Figures, limits: Mapping[str, float]) -> list[str]:
    """What is worse than its floor, a line each; figures that were not measured are not judged.

    Args:
        figures: of one preset.
        limits: its floors, from `benchmarks/figures.json`.
    """
    lines = []
    for key, limit in limits.items():
        kind, measured = KINDS.get(key), figures.get(key)
        if kind is not None and measured is not None and not reaches(kind, measured, limit):
            lines.append(f"{kind.name}: {kind.text(measured)}, but {kind.text(Measured(limit, 1))} is the floor")
    return lines


def read_floors(path: Path = FLOORS) -> dict[str, dict[str, float]]:
    """Floors by preset.

    Raises:
        InputError: no such file, or it holds something else.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: {error}") from None
    unknown = sorted({key for limits in content.values() for key in limits} - KINDS.keys())
    if unknown:
        raise InputError(f"{path}: unknown figures {', '.join(unknown)}")
    return content


def quick(estimator: HandEstimator, shared: Path = SHARED) -> dict[str, float]:
    """Weights judged in less than a minute: the photographs of people, every fourth reference frame of the clips as a
    photograph, 60 digits, the official sample.

    Args:
        estimator: of the weights (a checkpoint is exported first).
        shared: where the pictures lie.

    Returns:
        "people.same_side" and the others of `KINDS` -> value; shares are 0..1, NaN where there was nothing to measure.

    Raises:
        InputError: the pictures are not there.
    """
    tool = pictures.score_people(shared)
    figures: Figures = {}
    for part in parts_of(QUICK_PARTS, shared, quick=True):
        predictions = run_part(OurWeights(estimator, "quick"), part, keep_masks=False)
        figures |= SCORES[part.name](part, predictions, tool)
    return {key: measured.value for key, measured in figures.items()}


def segmentation_check(segment: Segment, shared: Path = SHARED) -> dict[str, float]:
    """HandSegNet alone on whole pictures: the photographs of people and every fourth reference frame of the clips.

    Args:
        segment: (H, W, 3) uint8 RGB -> (h, w) masks of the whole picture, 0 background, 1 left, 2 right
            (`real_systems.segmenter` makes one of a file, `network_segmenter` one of a network in training).
        shared: where the pictures lie.

    Returns:
        "hands": how many reference hands; "any_side", "right_side": share of them whose palm's centre lies in a mask,
        in that of their own side; "area": share of the pictures' pixels that is called hand.

    Raises:
        InputError: the pictures are not there.
    """
    hands, anywhere, own = 0, 0, 0
    areas: list[float] = []
    for part in parts_of(("people", "frames"), shared, quick=True):
        assert part.reference is not None
        for sample in part.samples():
            masks = segment(sample.image)
            areas.append(float(np.mean(masks > 0)))
            to_mask = np.array(masks.shape) / sample.image.shape[:2]  # (row, column)
            for side, name in enumerate(SIDES):
                joints = part.reference[sample.source][name]
                if joints is None:
                    continue
                palm = np.asarray(joints, float)[PALM].mean(axis=0)[::-1]
                row, column = np.clip((palm * to_mask).astype(int), 0, np.array(masks.shape) - 1)
                hands += 1
                anywhere += int(masks[row, column] > 0)
                own += int(masks[row, column] == side + 1)
    return {
        "hands": hands,
        "any_side": anywhere / max(hands, 1),
        "right_side": own / max(hands, 1),
        "area": float(np.mean(areas)),
    }


def parts_of(
    names: Iterable[str],
    shared: Path,
    *,
    quick: bool = False,
    generated: Mapping[str, Path | None] = MappingProxyType({}),
) -> list[Part]:
    """The parts of these names, opened; those of `GENERATED` only where `generated` names their folder.

    Raises:
        InputError: pictures are not there.
        DataFormatError: labels are damaged.
    """
    readers: dict[str, Callable[[], Part]] = {
        "people": lambda: pictures.people(shared),
        "clips": lambda: pictures.clips(shared),
        "frames": lambda: pictures.some_frames(shared),
        "digits": lambda: pictures.digits(shared, pictures.QUICK_DIGITS if quick else None),
        "ge2019": lambda: pictures.ge2019(shared),
        "official": lambda: pictures.official(shared),
        "research": lambda: pictures.research(shared),
        "stills": lambda: pictures.stills(shared),
    }
    for name, folder in generated.items():
        if folder is not None:
            readers[name] = lambda name=name, folder=folder: pictures.generated(folder, name)
    return [readers[name]() for name in names if name in readers]


def heading(system: str) -> str:
    """What a preset or weights folder is called in tables and files."""
    return Path(system).name if "/" in system else system


def predictions_path(out: Path, system: str, part: str) -> Path:
    """Where a system's predictions of a part lie."""
    return out / "predictions" / system / f"{part}.npz"


def make_predictions(out: Path, system: System, parts: Sequence[Part]) -> None:
    """Run a system over all parts; earlier predictions are replaced."""
    for part in parts:
        start = time.perf_counter()
        path = predictions_path(out, system.name, part.name)
        predictions = run_part(system, part, keep_masks=part.name in GENERATED)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{path.parent}: cannot be made ({error.strerror})") from None
        save_predictions(path, predictions, overwrite=True)
        _say(f"{system.name}, {part.name}: {len(predictions)} pictures in {time.perf_counter() - start:.0f} s")


def score(out: Path, systems: Sequence[str], parts: Sequence[Part], shared: Path) -> dict[str, Figures]:
    """Figures of all systems from the predictions that there are."""
    tool = pictures.score_people(shared)
    scored: dict[str, Figures] = {name: {} for name in systems}
    for name in systems:
        for part in parts:
            path = predictions_path(out, name, part.name)
            if part.name in SCORES and path.is_file():
                scored[name] |= SCORES[part.name](part, load_predictions(path), tool)
    return scored


def main(arguments: Sequence[str] | None = None) -> int:
    """Predicts, scores, prints and writes; 1 where `--check` finds something fallen."""
    args = _parser().parse_args(arguments)
    names = [heading(system) for system in args.systems]
    if len(set(names)) < len(names):
        raise InputError(f"--systems: two of one name: {', '.join(names)}")
    chosen = args.only or (QUICK_PARTS if args.quick else PARTS)
    generated = {name: getattr(args, name) for name in GENERATED}
    parts = parts_of(chosen, args.shared, quick=args.quick, generated=generated)
    if not args.score_only:
        for system, name in zip(args.systems, names, strict=True):
            estimator = HandEstimator.from_preset(system, args.threads)
            make_predictions(args.out, OurWeights(estimator, name), parts)
        if args.mediapipe_python:
            make_predictions(args.out, MediaPipe(args.mediapipe_python), parts)
    if (args.out / "predictions" / MEDIAPIPE).is_dir():
        names.append(MEDIAPIPE)
    figures = score(args.out, names, parts, args.shared)
    if args.today:
        for system in args.systems:
            figures[heading(system)][TIME] = Measured(time_ratio(system, args.today, threads=args.threads), 1)
    text = page(figures)
    print(text)
    write_file(args.out / "real_people.md", f"{text}\n".encode())
    write_file(args.out / "real_people.json", f"{json.dumps(to_json(figures), indent=1)}\n".encode())
    if args.sheets != "none":
        _write_all_sheets(args.out, names, parts, args.shared, everything=args.sheets == "all")
    for path in args.insert or ():
        insert(path, text, MARKER)
    for path in args.insert_short or ():
        insert(path, short_table(figures), MARKER)
    if args.accept:
        _accept(figures)
    return _check(figures) if args.check else 0


def _write_all_sheets(
    out: Path, names: Sequence[str], parts: Sequence[Part], shared: Path, *, everything: bool
) -> None:
    tool = pictures.score_people(shared)
    for name in names:
        for part in parts:
            path = predictions_path(out, name, part.name)
            if path.is_file() and part.name not in GENERATED:
                folder = out / "sheets" / name
                count = len(write_sheets(folder, part, load_predictions(path), tool, everything=everything))
                _say(f"{count} sheets of {part.name} written to {folder}")


def _accept(figures: Mapping[str, Figures]) -> None:
    """Writes the floors of the measured presets; those of figures that were not measured stay."""
    known = read_floors() if FLOORS.exists() else {}
    for name, measured in figures.items():
        if name != MEDIAPIPE:
            known[name] = known.get(name, {}) | floors(measured)
    write_file(FLOORS, f"{json.dumps(known, indent=1, sort_keys=True)}\n".encode())


def _check(figures: Mapping[str, Figures]) -> int:
    known = read_floors()
    lines = [f"{name}: {line}" for name in figures if name in known for line in fallen(figures[name], known[name])]
    judged = [name for name in figures if name in known]
    if not judged:
        raise InputError(f"{FLOORS} has no figures of {', '.join(figures)}; known: {', '.join(known)}")
    for line in lines:
        _say(line)
    _say(
        f"{len(lines)} figures of {', '.join(judged)} have fallen"
        if lines
        else f"{', '.join(judged)}: nothing has fallen"
    )
    return 1 if lines else 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    option = parser.add_argument
    option("--systems", nargs="*", default=[DEFAULT_PRESET], help="presets that ship with the package, or folders")
    option("--mediapipe-python", type=Path, help="interpreter of an environment with mediapipe (docs/evaluation.md)")
    option("--shared", type=Path, default=SHARED, help="folder of the pictures")
    option("--only", type=_parts, metavar="PART,...", help=f"of {', '.join(PARTS)}, frames")
    option("--quick", action="store_true", help=f"{', '.join(QUICK_PARTS)}; fewer frames and digits, no tracking")
    option("--generated", type=Path, help="generated test set of people, with part labels")
    option("--paper", type=Path, help="generated test set of style paper")
    option("--wild", type=Path, help="the same of style wild")
    option("--today", help="weights folder or preset whose HandSegNet is timed in turns with the others'")
    option("--threads", type=int, default=0, help="CPU threads of the networks; 0 takes all cores")
    option("--out", type=Path, default=Path("out/real_people"), help="folder for everything that is written")
    option("--score-only", action="store_true", help="score the predictions in OUT; no network is run")
    option("--sheets", choices=("misses", "all", "none"), default="misses", help="overlays of which pictures")
    option("--insert", type=Path, nargs="+", help="documents that get all figures, between their markers")
    option("--insert-short", type=Path, nargs="+", help="documents that get the table without bars")
    option("--check", action="store_true", help=f"compare with {FLOORS.name}; status 1 if a figure has fallen")
    option("--accept", action="store_true", help=f"write these figures, less an allowance, to {FLOORS.name}")
    return parser


def _parts(text: str) -> tuple[str, ...]:
    names = tuple(text.split(","))
    if unknown := sorted(set(names) - {*PARTS, "frames"}):
        raise argparse.ArgumentTypeError(f"no part {', '.join(unknown)}; known: {', '.join(PARTS)}, frames")
    return names


def _say(message: str) -> None:
    print(message, file=sys.stderr, flush=True)


if __name__ == "__main__":
    try:
        sys.exit(main())
    except (TwoHandsError, DataFormatError) as error:
        sys.exit(f"error: {error}")
