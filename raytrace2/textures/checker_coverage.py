"""How much of a footprint on a checkerboard its odd fields cover, in closed form."""

from __future__ import annotations

from typing import Any

import drjit as dr

from ..types import types_of
from .replayed import finite, summed

# Footprints are cut to so many fields, and their edges are at least so long where there is an area at all.
_MOST_FIELDS = 128.0
_LEAST = 2.0**-9


def odd_fraction(centre: Any, a: Any, b: Any, active: Any) -> Any:
    """The fraction (Float) of the parallelogram with edges ``a`` and ``b`` (Array2f) about ``centre`` that lies in odd
    fields, the fields being the squares [i, i + 1] x [j, j + 1] and odd where i + j is.

    With the square wave q(x), 1 in even and -1 in odd intervals, and its integral, the triangle wave T, Green's
    theorem makes of the integral of q(x) q(y) one of -q(x) T(y) dx along the edges. Between two lines of the board q is
    constant and T linear there, so the midpoint rule is exact: one turn a line that an edge crosses. Parallelograms
    narrower than 2^-9 fields get that width; those that reach over more than 128 fields are scaled down to that, which
    changes the fraction by less than about 1/128; where something is infinite or NaN it is 1/2.

    Derivatives are those of the fraction, and 0 where they would be infinite or NaN.
    """
    t = types_of(centre.x)
    centre, a, b = finite(centre), finite(a), finite(b)
    reach = dr.abs(a) + dr.abs(b)
    reach = reach.x + reach.y
    known = dr.isfinite(reach) & dr.isfinite(centre.x + centre.y)
    centre, a, b = (dr.select(known, v, 0) for v in (centre, a, b))
    point = reach < 2 * _LEAST
    shrink = dr.select(known & (reach > _MOST_FIELDS), _MOST_FIELDS / reach, 1)
    a, b = _with_area(a * shrink, b * shrink)
    # From here on coordinates count from the corner of the board's period that the centre lies in.
    centre = centre - 2 * dr.floor(centre * 0.5)
    area = a.x * b.y - a.y * b.x
    level = _triangle(centre.y)
    corner = centre - 0.5 * (a + b)

    def edge(k: Any, corner: Any = corner, a: Any = a, b: Any = b) -> tuple[Any, Any]:
        """Start and direction of edge ``k``, counterclockwise where ``a`` and ``b`` are."""
        start = corner + dr.select((k == 1) | (k == 2), a, 0) + dr.select(k >= 2, b, 0)
        along = dr.select((k & 1) == 0, a, b)
        return start, dr.select(k >= 2, -along, along)

    width = dr.width(reach)
    start = dr.zeros(t.UInt, width)
    state = start, _first_lines(*edge(start)), dr.zeros(t.Float, width), active & known & ~point

    def until(start: Any, along: Any, line: Any, at: Any) -> tuple[Any, Any]:
        to = (line - start) / dr.select(along == 0, 1, along)
        to = dr.select(along == 0, dr.inf, to)
        return dr.fmin(dr.fmax(dr.fmin(to.x, to.y), at), 1), to.x <= to.y

    def terms(inputs: Any, k: Any, line: Any, at: Any, _: Any) -> tuple[Any]:
        # How fast an integral over a region grows is its integrand along the rim times how fast that moves outwards
        # (Reynolds), and the integrand is constant between lines.
        moving_start, moving_along = edge(k, *inputs)
        start, along = dr.detach(moving_start), dr.detach(moving_along)
        end, _ = until(start, along, line, at)
        middle = start + along * (0.5 * (at + end))
        sign = _square(middle.x) * _square(middle.y)
        shifted = _cross(moving_start, along) * (end - at)
        return (sign * dr.fma(0.5 * (end * end - at * at), _cross(moving_along, along), shifted),)

    def turn(k: Any, line: Any, at: Any, going: Any, total: Any) -> tuple[Any, ...]:
        start, along = edge(k)
        end, by_x = until(start, along, line, at)
        middle = start + along * (0.5 * (at + end))
        total = dr.fma(along.x * (at - end) * _square(middle.x), _triangle(middle.y) - level, total)
        line = line + t.Array2f(
            dr.select(by_x, dr.mulsign(t.Float(1), along.x), 0), dr.select(by_x, 0, dr.mulsign(t.Float(1), along.y))
        )
        done = ~(end < 1)
        k = dr.select(done, k + 1, k)
        line = dr.select(done, _first_lines(*edge(k)), line)
        return k, line, dr.select(done, 0, end), going & (k < 4), total

    total = summed(
        state, (dr.zeros(t.Float, width),), lambda *s: s[3], turn, terms, (corner, a, b), (), "lines of a checkerboard"
    )[-1]
    even_less_odd = total / dr.select(area == 0, 1, area)
    fraction = dr.fmin(dr.fmax(0.5 - 0.5 * even_less_odd, 0), 1)
    here = dr.select(_square(centre.x) * _square(centre.y) < 0, t.Float(1), 0)
    return dr.select(known, dr.select(point, here, fraction), 0.5)


def _first_lines(start: Any, along: Any) -> Any:
    """The lines of the board that are met first on the way from ``start``."""
    return dr.select(along > 0, dr.floor(start) + 1, dr.ceil(start) - 1)


def _cross(a: Any, b: Any) -> Any:
    return a.x * b.y - a.y * b.x


def _square(x: Any) -> Any:
    half = x * 0.5
    # As fields do where points are looked up, odd ones begin behind their lines.
    return dr.select(half - dr.floor(half) > 0.5, type(x)(-1), 1)


def _triangle(x: Any) -> Any:
    half = x * 0.5
    return 1 - dr.abs(2 * (half - dr.floor(half)) - 1)


def _with_area(a: Any, b: Any) -> tuple[Any, Any]:
    """The edges, the shorter turned away from the longer until the parallelogram is 2^-9 wide."""
    long_a = dr.squared_norm(a) >= dr.squared_norm(b)
    longer, shorter = dr.select(long_a, a, b), dr.select(long_a, b, a)
    length = dr.norm(longer)
    normal = type(a)(-longer.y, longer.x) / dr.select(length > 0, length, 1)
    across = dr.dot(shorter, normal)
    shorter = shorter + normal * dr.mulsign(dr.fmax(_LEAST - dr.abs(across), 0), across)
    return dr.select(long_a, longer, shorter), dr.select(long_a, shorter, longer)
