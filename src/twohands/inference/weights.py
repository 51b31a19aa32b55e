"""Shipped weights: one folder per preset, with ONNX networks and a card that says how to use them.

A preset is a folder::

    <preset>/hand_seg_net.onnx   (B, 3, h, w) -> seg_logits (B, 3, h', w'), energy_logits (B, 2, h', w'); if it says
                                 how a picture is turned, also turn_maps (B, 36, h'', w'')
             pose_net_2d.onnx    (B, 3, S, S) -> heatmaps (B, 21 + cues, M, M), as the third network takes them; with a
                                 hand classifier, also hand_logit (B, 1)
             pose_net_3d.onnx    (B, 21 + cues, M, M) -> canonical (B, 21, 3), left-like hand
             card.json
             hand_check.onnx     optional, (B, 3, S, S) -> hand_logit (B, 1)
             body_finder.tflite, body_joints.tflite  optional, `inference.body.BodyNetworks`
             palm_detector.tflite  optional, `inference.palm.PalmDetector`

The card holds what inference must know; every other key (recipe, seed, accuracy, ...) is for the reader::

    {
      "version": 2,
      "name": "fast",
      "hand_seg_net": {"input_size": [224, 384], "network_input": "(x - 128) / 256"},
      "pose_net_2d": {"crop_size": 128, "crop_kind": "perspective", "crop_margin": 1.5, "heatmap_decode": "softargmax"},
      "placement": {"range_errors": [0.046, 0.143], "range_sigma": [0.038, 0.91, 0.05, 1.51]},
      "decision": {"first": {"hand": -1.2, "pose": 0.4, ...}, "last": {"first": 0.6, ...}, "fit": {...}},
      "int8": {"hand_seg_net": {"node_relu": 21.5, ...}, ...}
    }

A preset may take networks of another one; its card names the folder beside its own where they are::

    {
      "version": 2,
      "name": "accurate",
      "networks": {"hand_seg_net": "fast"},
      ...
      "views": {"tta_views": [{"size": [288, 512], "mirrored": true}, ...], "tta_score_range": [0, 1],
                "tta_rolls_deg": [15, -15]}
    }

A preset may have second pose networks, which know hands that its own do not (`inference.second_look`); its card names
their folder, beside its own and like it a preset's, as "second". Where there is no such folder, that of the shipped
weights with this name is meant: weights that were trained on from shipped ones keep their second networks. If its card
has a section "hand_check", it holds a fourth network, which says of candidates whether they are hands
(`models.hand_check`). If it has one "body", it holds two more, of people's bodies (`inference.body`);
if it has one "palm", it holds one of palms (`inference.palm`).

"views", "decision" and "placement" override any field of `inference.decision`'s records. Cards of version 1 had four of
these elsewhere, under other names, and are read as well. Without weights in "decision" (scripts/fit_handedness.py),
HandSegNet alone decides which hands are there, and whose.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

from twohands.errors import CheckpointError, DataFormatError
from twohands.files import write_whole
from twohands.formats.structured import parse_json
from twohands.geometry.network_input import STRIDE
from twohands.inference.decision import DecisionConfig, PictureView, PlacementConfig, ViewConfig, overridden

DEFAULT_PRESET = "fast"
CARD_VERSION = 2
NETWORK_INPUT = "(x - 128) / 256"
"""What `geometry.network_input.network_input` does with a picture's values; a card may say so, and nothing else."""
NETWORK_NAMES = ("hand_seg_net", "pose_net_2d", "pose_net_3d")
HAND_CHECK = "hand_check"
BODY_NETWORKS = ("body_finder", "body_joints")
PALM_DETECTOR = "palm_detector"
CROP_KINDS = ("square", "perspective")
HEATMAP_DECODERS = ("subpixel", "softargmax")
MAX_INPUT = 4096
"""Pixels of a side of a network's input."""


@dataclass(frozen=True, slots=True)
class WeightsCard:
    """What inference must know about one set of weights.

    Attributes:
        name: the preset's name, written into results.
        seg_input_size: (height, width) of HandSegNet's input in pixels, for the first view of a picture.
        says_turn: whether HandSegNet also says by how many quarters a picture is turned; "turn" of its config.
        crop_size: side of the square PoseNet2D input in pixels.
        crop_kind: "square" (the paper's crop) or "perspective" (a virtual camera looking at the hand).
        crop_margin: crop side over the larger side of the hand's box.
        heatmap_decode: "subpixel" for maps with linear output, "softargmax" for probability maps.
        background: brightness of the background in the crop, 0..1; 0 where the card does not say.
        hand_logit: whether PoseNet2D also says if its crops show hands; "judge" of the network's config.
        cues: number of maps that PoseNet2D gives beside those of the joints, for PoseNet3D.
        surround: pixels at each side of PoseNet2D's input of which there are no maps.
        published_layers: whether PoseNet2D has those of a published network, which then says whether there is a hand.
        networks: networks that the preset takes of another one -> name of that one's folder, beside its own.
        int8: networks that run in 8 bits -> name of an activation -> its largest size (`inference.int8`).
        check_size: side of the square input of HandCheck in pixels; 0 where the folder has none.
        check_margin: side of its crop over the larger side of the hand's box.
        body: whether the folder has networks of people's bodies.
        palm: whether it has one of palms.
        second: name of the folder, beside its own or among the shipped ones, of its second pose networks; "" without.
        views, decision, placement: every hand-tuned number of the pipeline.
        network_input: how the values of pictures are normalised for both networks that see them.
    """

    name: str
    seg_input_size: tuple[int, int]
    crop_size: int
    crop_kind: str
    crop_margin: float
    heatmap_decode: str
    background: float = 0.0
    hand_logit: bool = False
    cues: int = 0
    says_turn: bool = False
    surround: int = 0
    published_layers: bool = False
    networks: Mapping[str, str] = field(default_factory=dict)
    int8: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    check_size: int = 0
    check_margin: float = 1.0
    body: bool = False
    palm: bool = False
    second: str = ""
    views: ViewConfig = field(default_factory=ViewConfig)
    decision: DecisionConfig = field(default_factory=DecisionConfig)
    placement: PlacementConfig = field(default_factory=PlacementConfig)
    network_input: str = NETWORK_INPUT

    def __post_init__(self) -> None:
        if len(self.seg_input_size) != 2 or min(self.seg_input_size) < 1 or max(self.seg_input_size) > MAX_INPUT:
            raise CheckpointError(f"card: hand_seg_net.input_size must be [height, width], got {self.seg_input_size}")
        if not 1 <= self.crop_size <= MAX_INPUT:
            raise CheckpointError(f"card: pose_net_2d.crop_size must be 1 to {MAX_INPUT}, got {self.crop_size}")
        if self.crop_kind not in CROP_KINDS:
            raise CheckpointError(f"card: pose_net_2d.crop_kind must be one of {CROP_KINDS}, got {self.crop_kind!r}")
        if not self.crop_margin > 0:
            raise CheckpointError(f"card: pose_net_2d.crop_margin must be positive, got {self.crop_margin}")
        if not (0 <= self.check_size <= MAX_INPUT and self.check_margin > 0):
            raise CheckpointError(
                f"card: hand_check needs a crop_size of 1 to {MAX_INPUT} and a crop_margin above 0, got "
                f"{self.check_size} and {self.check_margin}"
            )
        if not 0 <= self.background <= 1:
            raise CheckpointError(f"card: pose_net_2d.background must lie in 0..1, got {self.background}")
        if self.network_input != NETWORK_INPUT:
            raise CheckpointError(f"card: network_input must be {NETWORK_INPUT!r}, got {self.network_input!r}")
        for key, named in (("networks", self.networks), ("int8", self.int8)):
            unknown = sorted(set(named) - set(NETWORK_NAMES))
            if unknown:
                raise CheckpointError(f"card: {key} names unknown networks, {', '.join(unknown)}")
        for key, folders in (("networks", self.networks.values()), ("second", [self.second] if self.second else [])):
            for folder in folders:
                if not folder or Path(folder).name != folder:
                    raise CheckpointError(f"card: {key} must name folders beside the card's, got {folder!r}")
        if not 0 <= 2 * self.surround < self.crop_size:
            raise CheckpointError(
                f"card: pose_net_2d.surround must leave some of the crop's {self.crop_size} pixels, got {self.surround}"
            )
        if self.cues < 0:
            raise CheckpointError(f"card: pose_net_2d.cues must not be negative, got {self.cues}")
        if self.heatmap_decode not in HEATMAP_DECODERS:
            raise CheckpointError(
                f"card: pose_net_2d.heatmap_decode must be one of {HEATMAP_DECODERS}, got {self.heatmap_decode!r}"
            )

    @property
    def decides(self) -> bool:
        """Whether the decision is fitted to these networks, so that PoseNet2D has a say in which hands are there."""
        return self.hand_logit and bool(self.decision.first and self.decision.last)

    @property
    def seen_size(self) -> int:
        """Side of the middle of the crop of which there are maps, pixels."""
        return self.crop_size - 2 * self.surround

    def settings(self) -> dict[str, Any]:
        """Every hand-tuned number, as a card's sections "views", "decision" and "placement" hold them."""
        return {section: asdict(getattr(self, section)) for section in ("views", "decision", "placement")}

    @classmethod
    def from_dict(cls, card: dict[str, Any]) -> WeightsCard:
        """Read the keys that inference needs.

        Raises:
            CheckpointError: a key is missing or holds something else.
        """
        version = card.get("version")
        if version not in (1, CARD_VERSION):
            raise CheckpointError(f"card: version {CARD_VERSION} expected, found {version!r}; update twohands")
        try:
            if version == 1:
                card = _of_version_1(card)
            seg, pose, check = card["hand_seg_net"], card["pose_net_2d"], card.get(HAND_CHECK)
            height, width = (int(n) for n in seg["input_size"])
            return cls(
                name=str(card["name"]),
                seg_input_size=(height, width),
                crop_size=int(pose["crop_size"]),
                crop_kind=str(pose["crop_kind"]),
                crop_margin=float(pose["crop_margin"]),
                heatmap_decode=str(pose["heatmap_decode"]),
                background=float(pose.get("background", 0.0)),
                hand_logit=bool(pose.get("judge", False)),
                cues=int(pose.get("cues", 0)),
                surround=int(pose.get("surround", 0)),
                published_layers=float(pose.get("landmark_spread", 0)) > 0,
                says_turn=bool(seg.get("turn", False)),
                networks={str(name): str(folder) for name, folder in card.get("networks", {}).items()},
                int8=_peaks(card.get("int8", {})),
                check_size=0 if check is None else int(check["crop_size"]),
                check_margin=1.0 if check is None else float(check["crop_margin"]),
                body="body" in card,
                palm="palm" in card,
                second=str(card.get("second", "")),
                views=overridden(ViewConfig(), _views(card.get("views", {}), (height, width)), "views"),
                decision=overridden(DecisionConfig(), card.get("decision", {}), "decision"),
                placement=overridden(PlacementConfig(), card.get("placement", {}), "placement"),
                network_input=str(seg.get("network_input", NETWORK_INPUT)),
            )
        except KeyError as error:
            raise CheckpointError(f"card: key {error} is missing") from error
        except (TypeError, ValueError, OverflowError, AttributeError) as error:
            raise CheckpointError(f"card: {error}") from error


def _of_version_1(card: Mapping[str, Any]) -> dict[str, Any]:
    """A card of version 1 as one of version 2: four settings have moved."""
    seg, pose = card["hand_seg_net"], card["pose_net_2d"]
    moved = {
        "tta_views": (seg, "further_looks"),
        "tta_score_range": (seg, "doubt"),
        "tta_rolls_deg": (pose, "rolls_deg"),
    }
    views = {name: section[old] for name, (section, old) in moved.items() if old in section}
    return {**card, "views": views, "placement": {"range_errors": card.get("range_errors")}}


def _views(section: Mapping[str, Any], size: tuple[int, int]) -> dict[str, Any]:
    """The card's "views" with its "tta_views", checked; of the mirror image in the size of the first if it has none.

    Raises:
        ValueError: a size is none that HandSegNet takes.
    """
    if "tta_views" not in section:
        return {**section, "tta_views": (PictureView(size, mirrored=True),)}
    views = []
    for view in section["tta_views"]:
        height, width = (int(n) for n in view["size"])
        if min(height, width) < 1 or height % STRIDE or width % STRIDE:
            raise ValueError(f"the size of a view must be positive multiples of {STRIDE}, got {view['size']}")
        views.append(PictureView((height, width), bool(view.get("mirrored", False))))
    return {**section, "tta_views": tuple(views)}


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
    """Names of the presets that ship with the package, sorted; what another one names as its second is none."""
    root = resources.files("twohands") / "weights"
    if not root.is_dir():
        return []
    cards = {entry.name: entry / "card.json" for entry in root.iterdir() if (entry / "card.json").is_file()}
    seconds = {parse_json(card.read_bytes()).get("second") for card in cards.values()}
    return sorted(cards.keys() - seconds)


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
        return _shipped(str(preset))
    known = ", ".join(names) or "none"
    raise CheckpointError(f"weights '{preset}' not found: neither a folder with a card.json nor a preset ({known})")


def _shipped(name: str) -> Path:
    """Where the shipped weights of a name are; the folder need not exist."""
    return Path(str(resources.files("twohands") / "weights" / name))


def read_card(folder: Path) -> WeightsCard:
    """Read `card.json` of a preset's folder.

    Raises:
        CheckpointError: the card cannot be read, or a network's file is missing; those of its second included.
    """
    card = _read_card_alone(folder)
    if card.second:
        _read_card_alone(second_folder(folder, card))
    return card


def _read_card_alone(folder: Path) -> WeightsCard:
    """`read_card`, whatever its second is."""
    path = folder / "card.json"
    try:
        card = parse_json(path.read_bytes())
    except (OSError, DataFormatError) as error:
        raise CheckpointError(f"{path}: not a readable card: {error}") from error
    if not isinstance(card, dict):
        raise CheckpointError(f"{path}: a JSON object expected, found {type(card).__name__}")
    found = WeightsCard.from_dict(card)
    files = network_files(folder, found)
    missing = [path for path in files.values() if not path.is_file()]
    if missing:
        raise CheckpointError(f"{missing[0].parent}: {missing[0].name} is missing")
    return found


def write_card(folder: Path, card: Mapping[str, Any]) -> None:
    """Write a preset's `card.json`; it appears whole or not at all, and an old one is replaced."""
    write_whole(folder / "card.json", (json.dumps(card, indent=2) + "\n").encode())


def network_files(folder: Path, card: WeightsCard) -> dict[str, Path]:
    """Where the networks of a preset's folder are, by name; the files need not exist."""
    homes = {
        name: folder.resolve().parent / card.networks[name] if name in card.networks else folder
        for name in (*NETWORK_NAMES, *([HAND_CHECK] if card.check_size else []))
    }
    files = {name: home / f"{name}.onnx" for name, home in homes.items()}
    published = (*(BODY_NETWORKS if card.body else ()), *((PALM_DETECTOR,) if card.palm else ()))
    return files | {name: folder / f"{name}.tflite" for name in published}


def second_folder(folder: Path, card: WeightsCard) -> Path:
    """Where the second pose networks of a preset's folder are, of a card that names some; it need not exist."""
    beside = folder.resolve().parent / card.second
    return beside if beside.is_dir() else _shipped(card.second)


def weights_id(folder: Path, card: WeightsCard) -> str:
    """Name and fingerprint of the weights in a preset's folder, the latter from its networks' bytes."""
    digest = hashlib.sha256()
    files = list(network_files(folder, card).values())
    if card.second:
        other = second_folder(folder, card)
        files += network_files(other, read_card(other)).values()
    for path in files:
        digest.update(path.read_bytes())
    return f"{card.name}@{digest.hexdigest()[:12]}"
