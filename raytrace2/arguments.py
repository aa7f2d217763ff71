"""Arguments as users give them, checked and made plain: arrays of real numbers, numbers, whole numbers."""

from __future__ import annotations

import math
import numbers
from typing import Any

import numpy as np

from .errors import GeometryError, SettingError


def shown(value: Any) -> str:
    """``value`` for a message: one line, and not long."""
    try:
        text = " ".join(repr(value).split())
    except Exception:  # what users pass may not even be printable
        text = f"a {type(value).__name__}"
    return shortened(text, 60)


def shortened(text: str, length: int) -> str:
    """``text`` with its end left out if it has more than ``length`` characters."""
    return text if len(text) <= length else f"{text[: length - 3]}..."


def real_array(value: Any, what: str, error: type[Exception] = GeometryError) -> np.ndarray:
    """``value`` as an array of floats or integers; ``error`` naming ``what`` for anything that holds other things.

    Complex numbers, text, dates, objects, masked entries, rows of different lengths and numbers past float64 are
    refused. Arrays keep their dtype unless that is one of Python objects.
    """
    if isinstance(value, str | bytes | bytearray | dict | set) or value is None:
        raise error(f"{what} must be an array of numbers, not {shown(value)}")
    if isinstance(value, np.ma.MaskedArray):
        if np.ma.getmaskarray(value).any():
            raise error(f"{what} has masked entries; fill them in or leave them out")
        value = value.data
    try:
        array = np.asarray(value)
        if array.dtype.kind == "O":
            # NumPy would read text in it as numbers.
            if not all(isinstance(item, numbers.Real) for item in array.flat):
                raise TypeError
            array = array.astype(np.float64)
    except OverflowError:
        raise error(f"{what} has a number that is too large") from None
    except Exception:  # sequences and buffers of users may raise anything
        raise error(f"{what} must be an array of numbers, not {shown(value)}") from None
    if array.dtype.kind not in "fiub":
        raise error(f"{what} must be an array of real numbers, not of {array.dtype}")
    return array


def real_number(value: Any, what: str, error: type[Exception] = SettingError) -> float:
    """``value`` as a float (perhaps NaN or infinite); ``error`` naming ``what`` unless it is one real number."""
    array = real_array(value, what, error)
    if array.size != 1 or array.ndim > 1:
        raise error(f"{what} must be one number, not {shown(value)}")
    return float(array.reshape(()))


def whole_number(
    value: Any, what: str, *, least: int | None = None, most: int | None = None, error: type[Exception] = SettingError
) -> int:
    """``value`` as an int in [``least``, ``most``]; ``error`` naming ``what`` unless it is an integer in there."""
    if isinstance(value, bool | np.bool_) or not isinstance(value, numbers.Integral):
        raise error(f"{what} must be a whole number, not {shown(value)}")
    result = int(value)
    if (least is not None and result < least) or (most is not None and result > most):
        bounds = f"at least {least}" if most is None else f"between {least} and {most}"
        raise error(f"{what} must be {bounds}, not {shown(result)}")
    return result


def positive_number(value: Any, what: str, error: type[Exception] = GeometryError) -> float:
    """``value`` as a float above zero and below infinity; ``error`` naming ``what`` otherwise."""
    number = real_number(value, what, error)
    if not 0.0 < number < math.inf:
        raise error(f"{what} must be positive and finite, not {number:g}")
    return number
