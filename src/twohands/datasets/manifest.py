"""What a generated set says of itself; official data has nothing of the kind."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from twohands.errors import DataFormatError
from twohands.formats import ego3dhands as fmt
from twohands.formats.instance_index import INDEX_FILE, MANIFEST_FILE, IndexEntry, parse_index


def read_manifest(root: Path) -> dict[str, Any]:
    """The manifest of a set, or of the set that holds this instance or sequence of instances, which lies one or two
    levels above; empty where there is none, or it is damaged."""
    for folder in (root, *root.absolute().parents[:2]):
        try:
            content = json.loads((folder / MANIFEST_FILE).read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError):
            continue
        if isinstance(content, dict) and isinstance(content.get("config"), dict):
            return content
    return {}


def expected_hand_length_m(root: Path) -> float | None:
    """|wrist - root| that every hand of a set must have, metres: that of its config, else that of the official data;
    None where every person has their own."""
    length = read_manifest(root).get("config", {}).get("hand_length", fmt.HAND_LENGTH_M)
    return float(length) if isinstance(length, int | float) else None


def read_index(root: Path) -> dict[str, IndexEntry]:
    """The index of a set, by the instances' names; empty where there is none.

    Raises:
        DataFormatError: it is damaged.
    """
    try:
        text = (root / INDEX_FILE).read_text(encoding="utf-8")
    except FileNotFoundError:
        return {}
    except (OSError, UnicodeDecodeError) as error:
        raise DataFormatError(f"{root / INDEX_FILE}: cannot be read ({error})") from None
    return {entry.instance: entry for entry in parse_index(text)}
