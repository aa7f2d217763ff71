"""Pixel filters over the cells of a grid."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from ...scene.description import ReconstructionFilter
from .exact_cells import Parallelogram
from .exact_ellipse import Ellipse, Region

_POINTS = 4
# The least standard deviation (cells) that the points tell from none.
_SHARPEST = 0.1
# Blocks are read as far as Gaussians reach within so many deviations, all around: 1.5 % of the weight is beyond.
_ROUND_REACH = 2.9
# And of these blocks, what is within this multiple of it.
_FURTHER = 1.1


@dataclass(frozen=True)
class Kernel:
    """A pixel filter: ``radius`` and standard ``deviation`` in pixels, ``eval`` the weight along one axis; None for the
    box, whose integrals have a closed form."""

    radius: float
    deviation: float
    eval: Callable[[Any], Any] | None = None
    is_round: bool = False

    @property
    def sampled(self) -> bool:
        """Whether integrals are sums over points."""
        return self.eval is not None

    def support(self, centre: Any, a: Any, b: Any) -> Region:
        """What the filter sees if it reaches from ``centre`` as far as ``a`` and ``b`` (Array2f)."""
        return Ellipse(centre, a, b) if self.is_round else Parallelogram(centre, 2 * a, 2 * b)

    @property
    def narrowest(self) -> float:
        """The least width (cells a pixel) of a footprint whose integrals come out right."""
        return _SHARPEST / self.deviation

    def moments(self, footprint: Parallelogram, invert: Any = None, squares: bool = False) -> Any:
        """``(region, left, bottom, width, height)`` to integrals of 1, x, y, x y over the part of a cell in the region,
        x and y counted from the middle of the cell; with ``squares`` that of the weight's square as well."""
        if self.eval is None and squares:
            return lambda region, *cell: _with_area(region.moments(*cell))
        if self.eval is None:
            return lambda region, *cell: region.moments(*cell)
        invert = invert or _inverse_of(footprint)
        return lambda region, *cell: self._sums(invert, squares, region, *cell)

    def _sums(
        self, invert: Any, squares: bool, region: Region, left: Any, bottom: Any, width: Any, height: Any
    ) -> tuple[Any, ...]:
        assert self.eval is not None
        nodes, weights = np.polynomial.legendre.leggauss(_POINTS)
        c = region.centre
        if self.is_round:
            region = Ellipse(c, region.a * _FURTHER, region.b * _FURTHER)
        # Points go on lines of the cell where they meet the region: of a needle a cell's own points would hit nothing,
        # and endless cells have none.
        least, greatest = region.transposed().columns(left, left + width)
        y0, y1 = dr.fmax(bottom, least), dr.fmin(bottom + height, greatest)
        dy, my = dr.fmax(y1 - y0, 0) * 0.5, 0.5 * (y0 + y1)
        total = [dr.zeros(type(left)) for _ in range(4)]
        square = dr.zeros(type(left))
        for node_y, weight_y in zip(nodes.tolist(), weights.tolist(), strict=True):
            y = dr.fma(dy, node_y, my)
            least, greatest = region.chord(y)
            x0, x1 = dr.fmax(left, least), dr.fmin(left + width, greatest)
            dx, mx = dr.fmax(x1 - x0, 0) * 0.5, 0.5 * (x0 + x1)
            row = row_x = dr.zeros(type(left))
            for node_x, weight_x in zip(nodes.tolist(), weights.tolist(), strict=True):
                x = dr.fma(dx, node_x, mx)
                s, t, density = invert(x - c.x, y - c.y)
                weight = self.eval(s) * self.eval(t) * weight_x
                if density is not None:
                    weight = weight * density
                row = row + weight
                row_x = dr.fma(weight, x - left - 0.5, row_x)
                if squares:
                    square = dr.fma(weight * weight, weight_y / weight_x * dx, square)
            row, row_x = row * (weight_y * dx), row_x * (weight_y * dx)
            y = y - bottom - 0.5
            total = [total[0] + row, total[1] + row_x, dr.fma(row, y, total[2]), dr.fma(row_x, y, total[3])]
        return tuple(v * dy for v in ([*total, square] if squares else total))


def _with_area(moments: tuple[Any, ...]) -> tuple[Any, ...]:
    return *moments, dr.abs(moments[0])


def _inverse_of(footprint: Parallelogram) -> Callable[[Any, Any], tuple[Any, Any, None]]:
    a, b = footprint.a, footprint.b
    inverse = dr.rcp(a.x * b.y - a.y * b.x)
    sx, sy, tx, ty = b.y * inverse, -b.x * inverse, -a.y * inverse, a.x * inverse
    return lambda x, y: (dr.fma(sx, x, sy * y), dr.fma(tx, x, ty * y), None)


def make_kernel(pixel: ReconstructionFilter) -> Kernel:
    """The pixel filter that ``pixel`` describes (one of ``EXACT_PIXEL_FILTERS``)."""
    if pixel.name == "box":
        return Kernel(0.5, math.sqrt(1 / 12))
    if pixel.name == "tent":
        radius = 1.0 if pixel.radius is None else pixel.radius
        return Kernel(radius, radius / math.sqrt(6), lambda x: dr.fmax(0, 1 - dr.abs(x) * (1 / radius)))
    assert pixel.name == "gaussian"
    # As the film's: less its value at four deviations, where it ends.
    scale, pedestal = -0.5 / (pixel.stddev**2 * math.log(2)), math.exp(-8)
    return Kernel(
        _ROUND_REACH * pixel.stddev,
        pixel.stddev,
        lambda x: dr.fmax(dr.exp2(dr.square(x) * scale) - pedestal, 0),
        is_round=True,
    )
