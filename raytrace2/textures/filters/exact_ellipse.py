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

    def columns(self, bottom: Any, top: Any) -> tuple[Any, Any]:
        """Least and greatest x (Float) among its points with y in [bottom, top], which must be met."""
        a, b, c = self.a, self.b, self.centre
        half = 0.5 * self.extent()
        bottom, top = dr.fmax(bottom - c.y, -half.y), dr.fmin(top - c.y, half.y)
        mixed = dr.fma(a.x, a.y, b.x * b.y)
        # The sides bulge, so the outermost point in the band is the one nearest to the outermost of all.
        rightmost = mixed / half.x
        low, high = dr.fmin(dr.fmax(-rightmost, bottom), top), dr.fmin(dr.fmax(rightmost, bottom), top)
        slope = mixed / (half.y * half.y)
        reach = dr.abs(a.x * b.y - a.y * b.x) / half.y

        def chord(y: Any) -> Any:
            return reach * dr.sqrt(dr.fmax(1 - dr.square(y / half.y), 0))

        return c.x + (slope * low - chord(low)), c.x + (slope * high + chord(high))


Region: TypeAlias = Parallelogram | Ellipse
