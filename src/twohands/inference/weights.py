"""Shipped weights: one folder per preset, with three ONNX networks and a card that says how to use them.

A preset is a folder::

    <preset>/hand_seg_net.onnx   (B, 3, h, w) -> seg_logits (B, 3, h', w'), energy_logits (B, 2, h', w')
             pose_net_2d.onnx    (B, 3, S, S) -> heatmaps (B, 21 + cues, M, M), as the third network takes them; if it
                                 judges its crops, also hand_logit (B, 1)
             pose_net_3d.onnx    (B, 21 + cues, M, M) -> canonical (B, 21, 3), left-like hand
             card.json

The card holds what inference must know; every other key (recipe, seed, accuracy, ...) is for the reader::

    {
      "version": 1,
      "name": "fast",
      "hand_seg_net": {"input_size": [224, 384]},
      "pose_net_2d": {"crop_size": 128, "crop_kind": "perspective", "crop_margin": 1.5, "heatmap_decode": "softargmax"},
      "range_errors": [0.046, 0.143],
      "int8": {"hand_seg_net": {"node_relu": 21.5, ...}, ...}
    }

A preset may take networks of another one; its card names the folder beside its own where they are::

    {
      "version": 1,
      "name": "accurate",
      "networks": {"hand_seg_net": "fast"},
      "hand_seg_net": {..., "further_looks": [{"size": [288, 512], "mirrored": true}, ...], "doubt": [0, 1]},
      "pose_net_2d": {..., "rolls_deg": [15, -15]}
    }
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

from twohands.errors import CheckpointError
from twohands.files import write_whole

DEFAULT_PRESET = "fast"
CARD_VERSION = 1
NETWORK_NAMES = ("hand_seg_net", "pose_net_2d", "pose_net_3d")
CROP_KINDS = ("square", "perspective")
HEATMAP_DECODERS = ("subpixel", "softargmax")
DOUBT = (0.03, 0.97)
"""Scores of a hand between which HandSegNet looks at a picture again, if the card does not say otherwise: at its mirror
image; the mean of all looks counts.

Ours. It concerns three of ten pictures of preset paper and most of preset wild. On 850 generated pictures with
`inference.sides` chosen for either, presence before a webcam was right for 93.5 instead of 90.5 % of the hands; two
looks at all pictures bring a little more, and cost twice as much.
"""
STRIDE = 32
"""What both sides of HandSegNet's input must be multiples of."""


@dataclass(frozen=True, slots=True)
class PictureLook:
    """How HandSegNet is shown a picture.

    Attributes:
        size: (height, width) of the input in pixels.
        mirrored: whether it is shown the mirror image.
    """

    size: tuple[int, int]
    mirrored: bool = False


@dataclass(frozen=True, slots=True)
class WeightsCard:
    """What inference must know about one set of weights.

    Attributes:
        name: the preset's name, written into results.
        seg_input_size: (height, width) of HandSegNet's input in pixels, for the first look at a picture.
        crop_size: side of the square PoseNet2D input in pixels.
        crop_kind: "square" (the paper's crop) or "perspective" (a virtual camera looking at the hand).
        crop_margin: crop side over the larger side of the hand's box.
        heatmap_decode: "subpixel" for maps with linear output, "softargmax" for probability maps.
        background: brightness of the background in the crop, 0..1; 0 where the card does not say.
        judge: whether PoseNet2D also says if its crops show hands.
        cues: number of maps that PoseNet2D gives beside those of the joints, for PoseNet3D.
        further_looks: of HandSegNet at a picture, where it is in doubt.
        doubt: scores of a hand between which it is in doubt.
        rolls_deg: further looks of the pose networks at a hand, as cameras see it that are rolled so far about their
            line of sight.
        range_errors: of `inference.range_prior.likely_ranges`, as scripts/fit_range_errors.py finds them; None to take
            ranges as the projection gives them.
        networks: networks that the preset takes of another one -> name of that one's folder, beside its own.
        int8: networks that run in 8 bits -> name of every ReLU -> largest value after it (`inference.int8`).
    """

    name: str
    seg_input_size: tuple[int, int]
    crop_size: int
    crop_kind: str
    crop_margin: float
    heatmap_decode: str
    background: float = 0.0
    judge: bool = False
    cues: int = 0
    further_looks: tuple[PictureLook, ...] = ()
    doubt: tuple[float, float] = DOUBT
    rolls_deg: tuple[float, ...] = ()
    range_errors: tuple[float, float] | None = None
    networks: Mapping[str, str] = field(default_factory=dict)
    int8: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if len(self.seg_input_size) != 2 or min(self.seg_input_size) < 1:
            raise CheckpointError(f"card: hand_seg_net.input_size must be [height, width], got {self.seg_input_size}")
        if self.crop_size < 1:
            raise CheckpointError(f"card: pose_net_2d.crop_size must be positive, got {self.crop_size}")
        if self.crop_kind not in CROP_KINDS:
            raise CheckpointError(f"card: pose_net_2d.crop_kind must be one of {CROP_KINDS}, got {self.crop_kind!r}")
        if not self.crop_margin > 0:
            raise CheckpointError(f"card: pose_net_2d.crop_margin must be positive, got {self.crop_margin}")
        if not 0 <= self.background <= 1:
            raise CheckpointError(f"card: pose_net_2d.background must lie in 0..1, got {self.background}")
        if len(self.doubt) != 2:
            raise CheckpointError(f"card: hand_seg_net.doubt must be [low, high], got {list(self.doubt)}")
        for key, named in (("networks", self.networks), ("int8", self.int8)):
            unknown = sorted(set(named) - set(NETWORK_NAMES))
            if unknown:
                raise CheckpointError(f"card: {key} names unknown networks, {', '.join(unknown)}")
        for folder in self.networks.values():
            if not folder or Path(folder).name != folder:
                raise CheckpointError(f"card: networks must name folders beside the card's, got {folder!r}")
        if not all(map(math.isfinite, self.rolls_deg)):
            raise CheckpointError(f"card: pose_net_2d.rolls_deg must be angles, got {list(self.rolls_deg)}")
        errors = self.range_errors
        if errors is not None and not (len(errors) == 2 and all(0 < error < math.inf for error in errors)):
            raise CheckpointError(f"card: range_errors must be two numbers larger than 0, got {list(errors)}")
        if self.cues < 0:
            raise CheckpointError(f"card: pose_net_2d.cues must not be negative, got {self.cues}")
        if self.heatmap_decode not in HEATMAP_DECODERS:
            raise CheckpointError(
                f"card: pose_net_2d.heatmap_decode must be one of {HEATMAP_DECODERS}, got {self.heatmap_decode!r}"
            )

    @classmethod
    def from_dict(cls, card: dict[str, Any]) -> WeightsCard:
        """Read the keys that inference needs.

        Raises:
            CheckpointError: a key is missing or holds something else.
        """
        version = card.get("version")
        if version != CARD_VERSION:
            raise CheckpointError(f"card: version {CARD_VERSION} expected, found {version!r}; update twohands")
        try:
            seg, pose = card["hand_seg_net"], card["pose_net_2d"]
            height, width = (int(n) for n in seg["input_size"])
            return cls(
                name=str(card["name"]),
                seg_input_size=(height, width),
                crop_size=int(pose["crop_size"]),
                crop_kind=str(pose["crop_kind"]),
                crop_margin=float(pose["crop_margin"]),
                heatmap_decode=str(pose["heatmap_decode"]),
                background=float(pose.get("background", 0.0)),
                judge=bool(pose.get("judge", False)),
                cues=int(pose.get("cues", 0)),
                further_looks=_further_looks(seg, (height, width)),
                doubt=tuple(float(score) for score in seg.get("doubt", DOUBT)),  # type: ignore[arg-type]
                rolls_deg=tuple(float(angle) for angle in pose.get("rolls_deg", ())),
                range_errors=_numbers(card.get("range_errors")),  # type: ignore[arg-type]
                networks={str(name): str(folder) for name, folder in card.get("networks", {}).items()},
                int8=_peaks(card.get("int8", {})),
            )
        except KeyError as error:
            raise CheckpointError(f"card: key {error} is missing") from error
        except (TypeError, ValueError, OverflowError, AttributeError) as error:
            raise CheckpointError(f"card: {error}") from error


def _further_looks(seg: Any, size: tuple[int, int]) -> tuple[PictureLook, ...]:
    """The card's "further_looks", checked; at the mirror image in the size of the first look if it has none.

    Raises:
        ValueError: a size is none that HandSegNet takes.
    """
    if "further_looks" not in seg:
        return (PictureLook(size, mirrored=True),)
    looks = []
    for look in seg["further_looks"]:
        height, width = (int(n) for n in look["size"])
        if min(height, width) < 1 or height % STRIDE or width % STRIDE:
            raise ValueError(f"the size of a further look must be positive multiples of {STRIDE}, got {look['size']}")
        looks.append(PictureLook((height, width), bool(look.get("mirrored", False))))
    return tuple(looks)


def _numbers(values: Any) -> tuple[float, ...] | None:
    """A list of numbers, or None."""
    return None if values is None else tuple(float(value) for value in values)


def _peaks(int8: Any) -> dict[str, dict[str, float]]:
    """The card's "int8", checked.

    Raises:
        ValueError: it is something else.
    """
    peaks = {str(net): {str(name): float(peak) for name, peak in of_net.items()} for net, of_net in int8.items()}
    if not all(0 < peak < math.inf for of_net in peaks.values() for peak in of_net.values()):
        raise ValueError("int8 must hold peaks larger than 0")
    return peaks


def preset_names() -> list[str]:
    """Names of the presets that ship with the package, sorted."""
    root = resources.files("twohands") / "weights"
    if not root.is_dir():
        return []
    return sorted(entry.name for entry in root.iterdir() if (entry / "card.json").is_file())


def preset_folder(preset: str | Path) -> Path:
    """Find a preset by its name, or take a folder as it is.

    Args:
        preset: name of a shipped preset, or path of a folder with the same layout. Where both exist, a `str` is the
            name and a `Path` the folder; "./fast" is no name.

    Raises:
        CheckpointError: there is neither.
    """
    names = preset_names()
    folder, is_name = Path(preset), str(preset) in names
    if (folder / "card.json").is_file() and not (is_name and isinstance(preset, str)):
        return folder
    if is_name:
        return Path(str(resources.files("twohands") / "weights" / str(preset)))
    known = ", ".join(names) or "none"
    raise CheckpointError(f"weights '{preset}' not found: neither a folder with a card.json nor a preset ({known})")


def read_card(folder: Path) -> WeightsCard:
    """Read `card.json` of a preset's folder.

    Raises:
        CheckpointError: the card cannot be read, or a network's file is missing.
    """
    path = folder / "card.json"
    try:
        card = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise CheckpointError(f"{path}: not a readable card: {error}") from error
    if not isinstance(card, dict):
        raise CheckpointError(f"{path}: a JSON object expected, found {type(card).__name__}")
    found = WeightsCard.from_dict(card)
    files = network_files(folder, found)
    missing = [path for path in files.values() if not path.is_file()]
    if missing:
        raise CheckpointError(f"{missing[0].parent}: {missing[0].name} is missing; it must hold all three networks")
    return found


def write_card(folder: Path, card: Mapping[str, Any]) -> None:
    """Write a preset's `card.json`; it appears whole or not at all, and an old one is replaced."""
    write_whole(folder / "card.json", (json.dumps(card, indent=2) + "\n").encode())


def network_files(folder: Path, card: WeightsCard) -> dict[str, Path]:
    """Where the networks of a preset's folder are, by name; the files need not exist."""
    homes = {
        name: folder.resolve().parent / card.networks[name] if name in card.networks else folder
        for name in NETWORK_NAMES
    }
    return {name: home / f"{name}.onnx" for name, home in homes.items()}


def weights_id(folder: Path, card: WeightsCard) -> str:
    """Name and fingerprint of the weights in a preset's folder, the latter from its networks' bytes."""
    digest = hashlib.sha256()
    for path in network_files(folder, card).values():
        digest.update(path.read_bytes())
    return f"{card.name}@{digest.hexdigest()[:12]}"
