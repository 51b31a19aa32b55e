"""Fixtures of every test."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Third-party samples beside the checkout, in `shared/data`; the test is skipped where there are none."""
    folder = Path(__file__).resolve().parents[2] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"no sample data beside the checkout: expected the folder {folder}")
    return folder


@pytest.fixture
def run_program(monkeypatch, capsys) -> Callable[..., tuple[int, str]]:
    """Calls the `main` of a script with words of a command line, in this process, and gives exit code and stderr; an
    interpreter of its own takes seconds to import what scripts need."""

    def run(main: Callable[[], int], *words: object) -> tuple[int, str]:
        monkeypatch.setattr(sys, "argv", ["program", *map(str, words)])
        return main(), capsys.readouterr().err

    return run
