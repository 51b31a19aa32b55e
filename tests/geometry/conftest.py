"""Every law of the geometry is checked twice: on numpy arrays and on torch tensors."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest


@pytest.fixture(params=["numpy", "torch"])
def to(request: pytest.FixtureRequest) -> Callable[[Any], Any]:
    """Converts a numpy array to the kind of array under test."""
    if request.param == "numpy":
        return np.asarray
    torch = pytest.importorskip("torch")
    return lambda array: torch.from_numpy(np.array(array))


@pytest.fixture(autouse=True)
def warnings_are_errors() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield
