"""The size of a vector as a power of two: dividing by it is exact, and what is left has harmless squares."""

from __future__ import annotations

from typing import Any

import drjit as dr

from ..types import types_of
from .ordered import greater


def powers_of_two(v: Any) -> tuple[Any, Any]:
    """The power of two next below the largest component of each vector ``v``, and its reciprocal.

    Both are normal numbers, whatever ``v``: an infinite or a NaN vector is not brought to size.
    """
    types = types_of(v)
    size = abs(v)
    largest = greater(greater(size.x, size.y), size.z)
    if types.precision == "float32":
        Bits, digits, bias = types.UInt, 23, 127
    else:
        Bits, digits, bias = types.UInt64, 52, 1023
    exponent = dr.reinterpret_array(Bits, largest) & Bits((2 * bias + 1) << digits)
    exponent = dr.maximum(dr.minimum(exponent, Bits((2 * bias - 1) << digits)), Bits(1 << digits))
    return (
        dr.reinterpret_array(types.Float, exponent),
        dr.reinterpret_array(types.Float, Bits((2 * bias) << digits) - exponent),
    )


def unit(v: Any) -> Any:
    """``v`` at unit length, whatever its own; zero where ``v`` is."""
    v = v * powers_of_two(v)[1]
    length = dr.squared_norm(v)
    present = length > 0
    return dr.select(present, v * dr.rsqrt(dr.select(present, length, 1)), 0)
