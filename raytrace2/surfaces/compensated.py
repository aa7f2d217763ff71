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


def difference_of_products(a: Any, b: Any, c: Any, d: Any) -> Any:
    """``a b - c d`` with a relative error of two units of round-off, so with the right sign, and zero only where it is
    (Jeannerod, Louvet and Muller, "Further analysis of Kahan's algorithm", Math. Comp. 82, 2013)."""
    product = c * d
    lost = dr.fma(-c, d, product)
    return dr.fma(a, b, -product) + lost


def sum_of(terms: list[Any], rest: Any) -> Any:
    """The sum of ``terms`` and of ``rest``, as if in twice the digits and then rounded."""
    total = terms[0]
    for term in terms[1:]:
        total, lost = two_sum(total, term)
        rest = rest + lost
    return total + rest


def dot(a: Any, b: Any, b_lost: Any) -> tuple[Any, Any]:
    """The dot product of ``a`` and ``b + b_lost`` (three components each), and about what its rounding loses."""
    total, lost = two_product(a[0], b[0])
    lost = dr.fma(a[0], b_lost[0], lost)
    for k in (1, 2):
        product, lost_product = two_product(a[k], b[k])
        total, lost_sum = two_sum(total, product)
        lost += dr.fma(a[k], b_lost[k], lost_product) + lost_sum
    return two_sum(total, lost)


def squares_minus_square(v: list[Any], v_lost: list[Any], radius: Any) -> Any:
    """The squared length of ``v + v_lost`` less ``radius`` squared: as if in twice the digits and then rounded."""
    square, lost = two_product(radius, -radius)
    terms = [square]
    for component, rest in zip(v, v_lost, strict=True):
        square, lost_square = two_product(component, component)
        terms.append(square)
        lost = dr.fma(2 * component, rest, lost) + lost_square
    return sum_of(terms, lost)


def point_on_ray(o: Any, o_lost: Any, d: Any, t: Any) -> tuple[list[Any], list[Any]]:
    """The components of ``o + o_lost + t d``, and about what their rounding loses."""
    point, lost = [], []
    for k in range(3):
        way, lost_way = two_product(t, d[k])
        total, lost_sum = two_sum(o[k], way)
        total, rest = two_sum(total, lost_sum + (o_lost[k] + lost_way))
        point.append(total)
        lost.append(rest)
    return point, lost


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
