"""Ellipses on a grid of unit cells: what round pixel filters see."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, TypeAlias

import drjit as dr

from .exact_cells import Parallelogram


@dataclass
class Ellipse:
    """The points ``centre + a cos w + b sin w`` (Array2f each) and what they surround."""

    centre: Any
    a: Any
    b: Any

    def extent(self) -> Any:
        """Width and height (Array2f) of its bounding box."""
        return 2 * dr.sqrt(self.a * self.a + self.b * self.b)

    def area(self) -> Any:
        """Its area (Float), negative where ``a`` and ``b`` are clockwise."""
        return math.pi * (self.a.x * self.b.y - self.a.y * self.b.x)

    def transposed(self) -> Ellipse:
        """The same with x for y."""
        return Ellipse(*(type(v)(v.y, v.x) for v in (self.centre, self.a, self.b)))

    def columns(self, bottom: Any, top: Any) -> tuple[Any, Any]:
        """Least and greatest x (Float) among its points with y in [bottom, top], which must be met."""
        a, b, c = self.a, self.b, self.centre
        half = 0.5 * self.extent()
        bottom, top = dr.fmax(bottom - c.y, -half.y), dr.fmin(top - c.y, half.y)
        mixed = dr.fma(a.x, a.y, b.x * b.y)
        # The sides bulge, so the outermost point in the band is the one nearest to the outermost of all.
        rightmost = mixed / half.x
        low, high = dr.fmin(dr.fmax(-rightmost, bottom), top), dr.fmin(dr.fmax(rightmost, bottom), top)
        (left, _), (_, right) = self.chord(c.y + low), self.chord(c.y + high)
        return left, right

    def chord(self, y: Any) -> tuple[Any, Any]:
        """Least and greatest x among its points at ``y`` (Float)."""
        a, b = self.a, self.b
        square = dr.fma(a.y, a.y, b.y * b.y)
        inverse = dr.rcp(square)
        y = y - self.centre.y
        middle = dr.fma(y, dr.fma(a.x, a.y, b.x * b.y) * inverse, self.centre.x)
        reach = dr.abs(a.x * b.y - a.y * b.x) * inverse * dr.sqrt(dr.fmax(square - y * y, 0))
        return middle - reach, middle + reach


Region: TypeAlias = Parallelogram | Ellipse
