"""Numpy or torch: how a function of this package learns which one it was given."""

from __future__ import annotations

from numbers import Real
from typing import Any

import array_api_compat as compat
import array_api_compat.numpy as compat_numpy
import numpy as np

from twohands.types import Array

_FLOAT64 = np.dtype(np.float64)


def float_arrays(*values: Array) -> tuple[Any, ...]:
    """Bring arguments to one kind and one floating dtype.

    Args:
        values: numpy arrays, torch tensors (of one kind) or plain numbers.

    Returns:
        The array namespace (numpy's if all are numbers), followed by the values: arrays of the widest floating dtype
        among them (the kind's default float if all are integers), numbers as 0-d arrays on the first array's device.
    """
    if _is_plain(values):  # as nearly always: array_api_compat would ask the same thirty times as long
        return compat_numpy, *(np.asarray(value, np.float64) for value in values)
    arrays: list[Any] = [value for value in values if not isinstance(value, Real)] or [
        np.asarray(value) for value in values
    ]
    xp: Any = compat.array_namespace(*arrays)
    dtypes = [array.dtype for array in arrays if xp.isdtype(array.dtype, "real floating")]
    dtype = xp.result_type(*dtypes) if dtypes else xp.asarray(0.0).dtype
    device: Any = compat.device(arrays[0])  # pyright: ignore[reportUnknownMemberType]
    converted = [
        xp.asarray(float(value), dtype=dtype, device=device)
        if isinstance(value, Real)
        else xp.astype(value, dtype, copy=False)
        for value in values
    ]
    return xp, *converted


def _is_plain(values: tuple[Array, ...]) -> bool:
    """Whether all are numpy arrays of float64, or numbers beside at least one of these."""
    arrays: list[Any] = [value for value in values if not isinstance(value, Real)]
    return all(isinstance(value, np.ndarray) for value in arrays) and {array.dtype for array in arrays} == {_FLOAT64}
