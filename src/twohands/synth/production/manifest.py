"""The folder of one run: claimed before anything is written, locked while it is written to, never another run's."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from twohands.errors import InputError
from twohands.files import locked, partial_path, write_whole
from twohands.formats.instance_index import MANIFEST_FILE
from twohands.version import __version__, made_with

MADE_WITH = "made_with"
"""Key of the manifest that lists the environments that have written to the folder; all others must not change."""
_PACKAGES = ("numpy", "opencv-python-headless", "moderngl")
_SHOWN = 3


def environment(renderer: str | None = None) -> dict[str, str]:
    """Versions of everything that the bytes of a picture depend on.

    Args:
        renderer: `render.choice.renderer_version`.
    """
    return made_with(_PACKAGES) | ({"renderer": renderer} if renderer else {})


@contextmanager
def claimed_folder(folder: Path, identity: dict[str, Any], made_with: dict[str, str]) -> Iterator[None]:
    """Makes a folder the home of one run, or checks that it already is; nothing else is ever written to.

    Args:
        folder: made if missing; must be empty or hold a manifest with the same identity.
        identity: plain JSON values that tell one set from another; the package's version is added.
        made_with: `environment`; added to the manifest's list if new there.

    Raises:
        InputError: the folder belongs to another set or to something else, another process is writing to it, or it
            cannot be written.
    """
    path = folder / MANIFEST_FILE
    identity = json.loads(json.dumps({**identity, "twohands": __version__}))
    with ExitStack() as stack:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            stack.enter_context(locked(folder))
            environments: list[dict[str, str]] = []
            if path.is_file():
                environments = _check_identity(folder, path, identity)
            elif any(there != partial_path(path) for there in folder.iterdir()):
                raise InputError(f"output {folder} is not empty and holds no set of ours: choose another folder")
            if made_with not in environments:
                content = json.dumps({**identity, MADE_WITH: [*environments, made_with]}, indent=2) + "\n"
                write_whole(path, content.encode())
        except OSError as error:
            raise InputError(f"output {folder}: cannot be written: {error.strerror}") from error
        yield


def _check_identity(folder: Path, path: Path, identity: dict[str, Any]) -> list[dict[str, str]]:
    """The environments of a manifest whose identity is as given."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except ValueError:
        found = None
    if not isinstance(found, dict) or not isinstance(environments := found.pop(MADE_WITH, []), list):
        raise InputError(f"{path} is damaged: choose another folder")
    differences = _differences(found, identity)
    if differences:
        shown = "; ".join(differences[:_SHOWN]) + ("; ..." if len(differences) > _SHOWN else "")
        raise InputError(f"{folder} holds another set ({shown}): choose another folder")
    return environments


def _differences(there: dict[str, Any], here: dict[str, Any], prefix: str = "") -> list[str]:
    """ "key is 1 there, 2 here" for every value that differs."""
    found = []
    for key in sorted({*there, *here}):
        old, new = there.get(key), here.get(key)
        if isinstance(old, dict) and isinstance(new, dict):
            found += _differences(old, new, f"{prefix}{key}.")
        elif old != new:
            found.append(f"{prefix}{key} is {json.dumps(old)} there, {json.dumps(new)} here")
    return found
