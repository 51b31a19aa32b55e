"""The package's version, and those that results depend on: who writes them into a file need not import the package's
public names."""

from __future__ import annotations

import platform
from collections.abc import Iterable

__version__ = "0.1.0"


def made_with(packages: Iterable[str]) -> dict[str, str]:
    """Versions of Python, the platform and these packages; "not installed" for one that is not."""
    from importlib.metadata import PackageNotFoundError, version  # here, for it takes longer than all of this module

    found = {"python": platform.python_version(), "platform": f"{platform.system()} {platform.machine()}"}
    for name in packages:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found
