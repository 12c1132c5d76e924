"""Values that a caller passes: checked and converted once, and shown in one line."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from docdepth.errors import InputError

_SHOWN_NUMBERS = 9  # of an array: those of K
_SHOWN_ITEMS = 3


class ShortRepr:
    """A dataclass in one line: of large arrays dtype and shape, of long lists the length."""

    def __repr__(self) -> str:
        shown = ((f.name, getattr(self, f.name)) for f in fields(self))  # type: ignore[arg-type]
        given = ", ".join(f"{name}={_short(value)}" for name, value in shown if value is not None)
        return f"{type(self).__name__}({given})"


def _short(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return (
            str(value.tolist()) if value.size <= _SHOWN_NUMBERS else f"{value.dtype} {value.shape}"
        )
    if isinstance(value, list | tuple | dict) and len(value) > _SHOWN_ITEMS:
        return f"{type(value).__name__} of {len(value)}"
    return repr(value)


def float_array(name: str, values: ArrayLike) -> NDArray[np.float64]:
    """A copy of ``values`` as float64.

    Raises
    ------
    InputError
        They are no numbers, or rows differ in length.
    """
    try:
        return np.array(values, np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{name} must be an array of numbers") from None


def nanoseconds(name: str, values: ArrayLike) -> NDArray[np.int64]:
    """A copy of times as int64 nanoseconds; NumPy's ``datetime64`` is converted.

    Raises
    ------
    InputError
        They are no whole numbers of nanoseconds. A float holds those of today to 256 ns only, and
        is more likely to be meant in seconds.
    """
    try:
        array = np.asarray(values)
    except ValueError:
        raise InputError(f"{name} must be an array of integers, nanoseconds") from None
    if array.dtype.kind == "M":
        array = array.astype("datetime64[ns]").view(np.int64)
    if array.size and array.dtype.kind not in "iu":
        raise InputError(
            f"{name} must be integers, nanoseconds; got {array.dtype}. "
            "Of seconds: np.round(seconds * 1e9).astype(np.int64)"
        )
    if array.dtype == np.uint64 and array.size and array.max() > np.iinfo(np.int64).max:
        raise InputError(f"{name}: {array.max()} is too large for int64 nanoseconds")
    return array.astype(np.int64)
