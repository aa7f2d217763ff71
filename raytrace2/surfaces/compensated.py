"""Sums and products with what their rounding loses (Ogita, Rump and Oishi, "Accurate sum and dot product", SIAM J. Sci.
Comput. 26(6), 2005): digits for the few places where cancellation would eat all of them."""

from __future__ import annotations

from typing import Any

import drjit as dr

from ..types import types_of


def two_sum(a: Any, b: Any) -> tuple[Any, Any]:
    """``a + b`` rounded, and what that loses: exact, whichever is larger (Knuth)."""
    total = a + b
    back = total - a
    return total, (a - (total - back)) + (b - back)


def two_product(a: Any, b: Any) -> tuple[Any, Any]:
    """``a b`` rounded, and what that loses: exact."""
    product = a * b
    return product, dr.fma(a, b, -product)


def sum_of(terms: list[Any], rest: Any) -> Any:
    """The sum of ``terms`` and of ``rest``, as if in twice the digits and then rounded."""
    total = terms[0]
    for term in terms[1:]:
        total, lost = two_sum(total, term)
        rest = rest + lost
    return total + rest


def next_toward(x: Any, up: Any) -> Any:
    """The floating-point number next to ``x``: the larger one where the Bool ``up``, else the smaller one. Zero is next
    to the smallest normal numbers: kernels take smaller ones for zero."""
    types = types_of(x)
    Bits = types.UInt if types.precision == "float32" else types.UInt64
    smallest = 2.0**-126 if types.precision == "float32" else 2.0**-1022
    bits = dr.reinterpret_array(Bits, x)
    away = (x > 0) == up
    moved = dr.reinterpret_array(types.Float, dr.select(away, bits + 1, bits - 1))
    return dr.select(x == 0, dr.select(up, types.Float(smallest), types.Float(-smallest)), moved)
