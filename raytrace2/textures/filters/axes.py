"""The principal axes of a footprint, and the widths of the pixel filter along them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import drjit as dr

from ...rays.footprint import Footprint
from ...scene.description import ReconstructionFilter
from ..filter_settings import FilterSettings

# Footprints beyond this many texels, which is 64 times the largest image, and those that are no numbers: their
# squares' squares still are numbers of single precision.
_LARGEST = 2.0**30


@dataclass
class Axes:
    """Singular values (Float, in texels) and the direction (Array2f, a unit vector in uv) of the larger one's axis of
    the map from pixels to texels: the shape that a pixel's inscribed circle is mapped to, times two."""

    major: Any
    minor: Any
    direction: Any


def principal_axes(footprint: Footprint) -> Axes:
    """The axes of ``footprint``; of one beyond 2^30 texels, infinite or NaN, those of a circle of that size."""
    dx, dy = footprint.dx, footprint.dy
    sane = dr.abs(dx.x) + dr.abs(dx.y) + dr.abs(dy.x) + dr.abs(dy.y) < _LARGEST
    a, b = dr.select(sane, dx.x, _LARGEST), dr.select(sane, dy.x, 0)
    c, d = dr.select(sane, dx.y, 0), dr.select(sane, dy.y, _LARGEST)
    xx, xy, yy = dr.fma(a, a, b * b), dr.fma(a, c, b * d), dr.fma(c, c, d * d)
    half = 0.5 * (xx - yy)
    root = dr.safe_sqrt(dr.fma(half, half, xy * xy))
    squared = 0.5 * (xx + yy) + root
    major = dr.safe_sqrt(squared)
    # The determinant, as the difference of the eigenvalues' halves would cancel.
    minor = dr.abs(a * d - b * c) / dr.select(major > 0, major, 1)
    # Of the two rows of the matrix less its smaller eigenvalue, the longer one.
    long = dr.abs(half) + root
    x, y = dr.select(half >= 0, long, xy), dr.select(half >= 0, xy, long)
    length2 = dr.fma(x, x, y * y)
    scale = dr.select(length2 > 0, dr.rsqrt(dr.select(length2 > 0, length2, 1)), 0)
    direction = type(dx)(dr.select(length2 > 0, x * scale, 1), y * scale)
    return Axes(major, dr.fmin(minor, major), direction)


def variance(pixel: ReconstructionFilter) -> float:
    """The variance of ``pixel`` along one axis, in pixels squared. Filters with negative lobes are taken for the box,
    whose pass band they approach, and so is every filter of radius 1/2, as in films."""
    if pixel.name == "tent":
        radius = 1.0 if pixel.radius is None else pixel.radius
        return 1 / 12 if radius == 0.5 else radius**2 / 6
    if pixel.name == "gaussian":
        return 1 / 12 if pixel.stddev == 0.125 else pixel.stddev**2
    return 1 / 12


def anisotropy(bitmaps: Any, settings: FilterSettings) -> float:
    """The largest ratio of axes that is heeded. Whatever is asked for, no longer a line of texels than the largest
    image of the table has, or 64."""
    return min(settings.max_anisotropy or math.inf, max(float(bitmaps.longest), 64.0))


def shape(pixel: ReconstructionFilter) -> str:
    """Which weights stand for ``pixel``: box, tent or gaussian."""
    return pixel.name if pixel.name in ("tent", "gaussian") and variance(pixel) != 1 / 12 else "box"


def width(pixel: ReconstructionFilter, spacing: Any) -> Any:
    """The width of the box of the same variance as ``pixel``, for pixels ``spacing`` texels apart.

    Below a texel it is the spacing itself, whatever the filter, so that magnification is bilinear; from two texels on
    it is in proportion.
    """
    factor = math.sqrt(12 * variance(pixel))
    if abs(factor - 1) < 1e-12:
        return spacing
    return spacing * dr.lerp(1.0, factor, dr.clip(spacing - 1, 0, 1))
