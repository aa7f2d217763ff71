"""How much of a parallelogram lies in each cell of a grid, and where in the cell: moments in closed form, and sums over
the cells of a pixel filter by quadrature."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

# Inverse of a slope that has none: products with grid coordinates stay finite in single precision.
_STEEP = 1e30
# Edges flatter than this (cells) do not bound the columns of a row: rounding would, and rows are bounded without them.
_FLAT = 1e-3


@dataclass
class Parallelogram:
    """``centre`` (Array2f) and edges ``a`` and ``b`` (Array2f) of a parallelogram on a grid of unit cells."""

    centre: Any
    a: Any
    b: Any

    def extent(self) -> Any:
        """Width and height (Array2f) of its bounding box."""
        return dr.abs(self.a) + dr.abs(self.b)

    def area(self) -> Any:
        """Its area (Float), negative where ``a`` and ``b`` are clockwise."""
        return self.a.x * self.b.y - self.a.y * self.b.x

    def transposed(self) -> Parallelogram:
        """The same with x for y."""
        return Parallelogram(*(type(v)(v.y, v.x) for v in (self.centre, self.a, self.b)))

    def columns(self, bottom: Any, top: Any) -> tuple[Any, Any]:
        """Least and greatest x (Float) among its points with y in [bottom, top], which must be met; more of them where
        edges are nearly level."""
        a, b, c = self.a, self.b, self.centre
        half = 0.5 * self.extent()
        left = 0.5 * (dr.mulsign(a.y, a.x) + dr.mulsign(b.y, b.x))
        bottom, top = dr.fmax(bottom - c.y, -half.y), dr.fmin(top - c.y, half.y)
        area = dr.abs(self.area())
        least, greatest = -half.x, half.x
        # The left side bulges leftwards, so its leftmost point in the band is the one nearest to the leftmost corner.
        low, high = dr.fmin(dr.fmax(-left, bottom), top), dr.fmin(dr.fmax(left, bottom), top)
        for edge in (a, b):
            bounds = dr.abs(edge.y) > _FLAT
            inverse = dr.rcp(dr.select(bounds, edge.y, 1))
            slope, reach = edge.x * inverse, 0.5 * area * dr.abs(inverse)
            least = dr.select(bounds, dr.fmax(least, dr.fma(low, slope, -reach)), least)
            greatest = dr.select(bounds, dr.fmin(greatest, dr.fma(high, slope, reach)), greatest)
        return c.x + least, c.x + greatest

    def chord(self, y: Any) -> tuple[Any, Any]:
        """Least and greatest x among its points at ``y`` (Float), which must be met; as :meth:`columns`."""
        half, y = 0.5 * self.extent().x, y - self.centre.y
        area = dr.abs(self.area())
        least, greatest = -half, half
        for edge in (self.a, self.b):
            bounds = dr.abs(edge.y) > _FLAT
            inverse = dr.rcp(dr.select(bounds, edge.y, 1))
            middle, reach = y * (edge.x * inverse), 0.5 * area * dr.abs(inverse)
            least = dr.select(bounds, dr.fmax(least, middle - reach), least)
            greatest = dr.select(bounds, dr.fmin(greatest, middle + reach), greatest)
        return self.centre.x + least, self.centre.x + greatest

    def moments(self, left: Any, bottom: Any, width: Any, height: Any) -> tuple[Any, Any, Any, Any]:
        """Integrals of 1, x, y and x y over the part that lies in a cell, from whose middle x and y count: exact up to
        round-off, and negative where ``a`` and ``b`` are clockwise. Those of x are right for cells of width 1, those of
        y for cells of height 1.

        By Green's theorem they are signed sums over the edges of integrals along x, of powers of y clamped to the cell.
        What is clamped is linear on at most one piece of an edge, so two Gauss points integrate it exactly.

        Derivatives by the parallelogram are integrals along its rim, which do not cancel where edges are steep.
        """
        if dr.grad_enabled(self.centre, self.a, self.b):
            still = Parallelogram(*(dr.detach(v) for v in (self.centre, self.a, self.b)))
            cell = [dr.detach(v) for v in (left, bottom, width, height)]
            values, rim = still.moments(*cell), self._rim(still, *cell)
            return tuple(dr.replace_grad(m, g) for m, g in zip(values, rim, strict=True))
        corner = self.centre - 0.5 * (self.a + self.b) - type(self.a)(left, bottom)
        total = [dr.zeros(type(left)) for _ in range(4)]
        for edge, start in ((self.a, corner), (self.b, corner)):
            other = self.b if edge is self.a else self.a
            inverse_x, inverse_y = _inverse(edge.x), _inverse(edge.y)
            for at, sign in ((start, 1), (start + other, -1)):
                if edge is self.b:
                    sign = -sign
                for k, part in enumerate(_edge_moments(at, edge, inverse_x, inverse_y, width, height)):
                    total[k] = total[k] - sign * part
        return total[0], total[1], total[2], total[3]

    def _rim(self, still: Parallelogram, left: Any, bottom: Any, width: Any, height: Any) -> list[Any]:
        """What has the derivatives of :meth:`moments`, ``still`` being this without any: an integral over a region
        grows by its integrand along the rim times how fast that moves outwards (Reynolds' theorem), which is a cubic
        polynomial along an edge."""
        origin = type(self.a)(left, bottom)
        moving, fixed = (p.centre - 0.5 * (p.a + p.b) - origin for p in (self, still))
        total = [dr.zeros(type(left)) for _ in range(4)]
        for k in range(2):
            (edge, other), (along, across) = ((p.a, p.b) if k == 0 else (p.b, p.a) for p in (self, still))
            inverse_x, inverse_y = _inverse(along.x), _inverse(along.y)
            for far in range(2):
                sign = 1 if k == far else -1
                start, at = (moving + other, fixed + across) if far else (moving, fixed)
                t0, t1 = _within(at, inverse_x, inverse_y, width, height)
                middle, reach = 0.5 * (t0 + t1), (t1 - t0) * (0.5 / 3**0.5)
                for t in (middle - reach, middle + reach):
                    place = start + edge * t
                    out = (place.x * along.y - place.y * along.x) * (sign * 0.5 * (t1 - t0))
                    x, y = dr.fma(t, along.x, at.x) - 0.5, dr.fma(t, along.y, at.y) - 0.5
                    total = [dr.fma(out, b, s) for b, s in zip((1, x, y, x * y), total, strict=True)]
        return total


def _within(at: Any, inverse_x: Any, inverse_y: Any, width: Any, height: Any) -> tuple[Any, Any]:
    """Which part of an edge, from 0 to 1, lies in a cell."""
    to_left, to_right = -at.x * inverse_x, (width - at.x) * inverse_x
    to_bottom, to_top = -at.y * inverse_y, (height - at.y) * inverse_y
    t0 = dr.fmax(dr.fmax(dr.fmin(to_left, to_right), dr.fmin(to_bottom, to_top)), 0)
    t1 = dr.fmin(dr.fmin(dr.fmax(to_left, to_right), dr.fmax(to_bottom, to_top)), 1)
    return t0, dr.fmax(t0, t1)


def _edge_moments(at: Any, edge: Any, inverse_x: Any, inverse_y: Any, width: Any, height: Any) -> tuple[Any, ...]:
    to_left, to_right = -at.x * inverse_x, (width - at.x) * inverse_x
    t0 = dr.fmax(dr.fmin(to_left, to_right), 0)
    t1 = dr.fmax(dr.fmin(dr.fmax(to_left, to_right), 1), t0)
    to_bottom, to_top = -at.y * inverse_y, (height - at.y) * inverse_y
    m0 = dr.fmin(dr.fmax(dr.fmin(to_bottom, to_top), t0), t1)
    m1 = dr.fmin(dr.fmax(dr.fmax(to_bottom, to_top), t0), t1)
    rises = inverse_y > 0
    above0, above1 = dr.select(rises, m1, t0), dr.select(rises, t1, m0)
    # The piece above the cell, where clamped y is the cell's height.
    above = edge.x * (above1 - above0)
    x = dr.fma(0.5 * (above0 + above1), edge.x, at.x) - 0.5
    above = above * height
    zeroth, first_x = above, above * x
    first_y = mixed = dr.zeros(type(above))
    weight = edge.x * (m1 - m0) * 0.5
    middle, reach = 0.5 * (m0 + m1), (m1 - m0) * (0.5 / 3**0.5)
    for t in (middle - reach, middle + reach):
        x = dr.fma(t, edge.x, at.x) - 0.5
        y = dr.fma(t, edge.y, at.y)
        area = weight * y
        moment = 0.5 * area * (y - 1)
        zeroth, first_x = zeroth + area, dr.fma(area, x, first_x)
        first_y, mixed = first_y + moment, dr.fma(moment, x, mixed)
    return zeroth, first_x, first_y, mixed


def _inverse(x: Any) -> Any:
    level = dr.abs(x) < 1 / _STEEP
    return dr.select(level, type(x)(_STEEP), dr.rcp(dr.select(level, 1, x)))


__all__ = ["Parallelogram"]
