"""Elliptical weighted averages (Greene and Heckbert 1986; Heckbert 1989, Fundamentals of Texture Mapping)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr

from ...types import types_of
from ..filter_settings import FilterSettings
from ..replayed import summed
from .axes import anisotropy, principal_axes, shape, variance
from .point import bilinear

# By pixel filter, how far the Gaussian counts, in standard deviations, and the variance of what is left over that of
# the pixel filter: for the box and the Gaussian those that gave the least error to a supersampled truth on a grazing
# floor of checks, 1/f noise and white noise; the tent's variance is matched. A box is so unlike a Gaussian that more
# reach gains nothing, while a Gaussian's error goes on falling (0.0066, 0.0056, 0.0046 at 2.5, 2.75, 3 on checks) as
# the texels read grow by a fifth each.
_KERNELS = {"box": (2.0, 1.08), "tent": (2.5, 1.0), "gaussian": (2.5, 0.94)}
# The least standard deviation in texels of the level that is read: at 0.5, a sampled Gaussian's sum ripples by 1.4 %.
_LEAST = 0.5
# Footprints between one texel and this many are a mixture with the bilinear look-up.
_MIXED = 1.5


@dataclass
class Ellipse:
    """Texels of one level of an image around a point, and the Gaussian that weighs them.

    ``column`` and ``row`` (Float, whole numbers) are those of a texel near the middle, which is at ``(x, y)`` from it.
    ``slant``, ``deviation_x`` and ``deviation_y``: in the row ``v`` below the middle, the Gaussian is that of
    ``deviation_x`` around ``slant * v``, times that of ``deviation_y`` at ``v``. It ends at ``reach`` deviations.
    """

    reach: float
    image: Any
    column: Any
    row: Any
    x: Any
    y: Any
    slant: Any
    deviation_x: Any
    deviation_y: Any

    def line(self, j: Any) -> tuple[Any, Any, Any, Any]:
        """Of row ``j``: the first ``i`` and the last, which is before the first where the row holds none, where the
        Gaussian has its middle, and the square of the row's distance in deviations."""
        v = j - self.y
        along = dr.square(v * (1 / self.deviation_y))
        half = self.deviation_x * dr.sqrt(dr.fmax(self.reach**2 - along, 0))
        middle = dr.fma(self.slant, v, self.x)
        return dr.ceil(middle - half), dr.floor(middle + half), middle, along


def ewa(bitmaps: Any, image: Any, uv: Any, footprint: Any, settings: FilterSettings, active: Any) -> Any:
    """The mean of the texels in the ellipse that the pixel is mapped to, weighted by a Gaussian.

    The level is the coarsest in which the Gaussian across has a deviation of half a texel or more; where the footprint
    is longer than ``max_anisotropy`` times its width (no bound: than the largest image of the table has texels a side)
    it is widened to that. With a as the anisotropy at most 5.2 reach^2 a + 2.4 reach (a + 1) + 2 texels are read, reach
    being 2 for the box and 2.5 for other filters (up to four times as many in the last levels of images whose sides
    are no powers of two). Footprints up to a texel are bilinear to the last bit, those up to 1.5 texels a mixture.
    """
    major, ellipse = ellipse_of(bitmaps, image, uv, footprint, settings, active)
    wide = active & (major > 1)
    first = bitmaps.texel(ellipse.image, *texel_at(bitmaps, ellipse, 0, 0), wide)
    constant = dr.detach(first)

    def visit(i: Any, j: Any, weight: Any, state: tuple[Any, Any]) -> tuple[Any, Any]:
        total, weights = state
        value = bitmaps.texel(ellipse.image, *texel_at(bitmaps, ellipse, i, j), weight > 0)
        # Differences to one of them: equal texels give that texel, whatever the weights round to.
        return dr.fma(weight, value - constant, total), weights + weight

    zero = dr.zeros(type(major), dr.width(major, uv))
    total, weights = each_texel(ellipse, wide, (dr.zeros(type(first), dr.width(zero)), zero), visit, bitmaps.buffers)
    value = constant + total / dr.select(weights > 0, weights, 1)
    near = active & ~(major >= _MIXED)
    point = bilinear(bitmaps, image, uv, active=near)
    mixed = dr.fma(mixture(major), value - point, point)
    return dr.select(wide, dr.select(near, mixed, value), point)


def mixture(major: Any) -> Any:
    """What the ellipse counts beside the bilinear look-up, in [0, 1], for footprints ``major`` texels long."""
    return dr.clip((major - 1) * (1 / (_MIXED - 1)), 0, 1)


def ellipse_of(
    bitmaps: Any, image: Any, uv: Any, footprint: Any, settings: FilterSettings, active: Any
) -> tuple[Any, Ellipse]:
    """The footprint's longer axis in texels (Float), and the texels that ``footprint`` covers."""
    axes = principal_axes(footprint)
    reach, share = _KERNELS[shape(settings.pixel)]
    pixel = variance(settings.pixel) * share / _kept(reach)
    # Bilinear interpolation is a tent of variance 1/6 before the pixel filter. The texels of a coarser level stand for
    # boxes of variance (q^2 - 1) / 12, q being their size: the Gaussian that weighs them is narrower by that.
    major2 = dr.fma(pixel * axes.major, axes.major, 1 / 6)
    minor2 = dr.fma(pixel * axes.minor, axes.minor, 1 / 6)
    least_ratio = 1 / anisotropy(bitmaps, settings) ** 2
    guess = footprint.is_guess()
    minor2 = dr.fmax(minor2, major2 * (least_ratio if guess is None else dr.select(guess, 1, least_ratio)))
    u = types_of(major2).UInt
    number = 0.5 * dr.log2(dr.fmax((minor2 + 1 / 12) * (1 / (_LEAST**2 + 1 / 12)), 1))
    level = bitmaps.level(image, u(dr.fmin(number, float(bitmaps.pyramid.levels - 1))), active)
    sx, sy = level.width / image.width, level.height / image.height
    d = axes.direction
    more, less = major2 - minor2, minor2 + 1 / 12
    xx = dr.fma(sx * sx, dr.fma(more, d.x * d.x, less), -1 / 12)
    yy = dr.fma(sy * sy, dr.fma(more, d.y * d.y, less), -1 / 12)
    xy = sx * sy * more * d.x * d.y
    # An image is at least one deviation long: further out, everything repeats or is the edge.
    fx, fy = _shrink(xx, level.width), _shrink(yy, level.height)
    lost = dr.fma(-dr.square(dr.fmin(fx, fy)), _LEAST**2, _LEAST**2)
    xx, yy, xy = xx * fx * fx + lost, yy * fy * fy + lost, xy * fx * fy
    # What is narrower than the least Gaussian, as level 0 under short axes is, is widened to it.
    half = 0.5 * (xx - yy)
    least = 0.5 * (xx + yy) - dr.safe_sqrt(dr.fma(half, half, xy * xy))
    narrow = dr.fmax(_LEAST**2 - least, 0)
    xx, yy = xx + narrow, yy + narrow
    x, y = dr.fma(uv.x, level.width, -0.5), dr.fma(uv.y, level.height, -0.5)
    column, row = dr.round(x), dr.round(y)
    slant = xy / yy
    return axes.major, Ellipse(
        reach, level, column, row, x - column, y - row, slant, dr.safe_sqrt(dr.fmax(xx - slant * xy, 1e-3)), dr.sqrt(yy)
    )


def _kept(reach: float) -> float:
    """The variance of a Gaussian in the plane that ends at ``reach`` deviations, over that of the whole."""
    edge = math.exp(-(reach**2) / 2)
    return 1 - reach**2 / 2 * edge / (1 - edge)


def _shrink(variance_of: Any, size: Any) -> Any:
    return dr.fmin(size * dr.rsqrt(dr.fmax(variance_of, 1e-3)), 1)


def texel_at(bitmaps: Any, ellipse: Ellipse, i: Any, j: Any) -> tuple[Any, Any]:
    """Column and row, in range, of the texel at ``(i, j)`` from the ellipse's."""
    column, _ = bitmaps.columns(ellipse.image, ellipse.column + i)
    row, _ = bitmaps.rows(ellipse.image, ellipse.row + j)
    return column, row


def each_texel(
    ellipse: Ellipse,
    active: Any,
    state: tuple[Any, ...],
    visit: Callable[..., tuple[Any, ...]],
    buffers: Sequence[Any] = (),
) -> Any:
    """``visit(i, j, weight, state)`` for every texel of the ellipse, row by row, one an iteration; rows that hold none
    take an iteration too (with the weight 0).

    Where ``visit`` adds to ``state`` what it reads of ``buffers``, and no more, the result has derivatives.
    """
    shape = ellipse.x, ellipse.y, ellipse.slant, ellipse.deviation_x, ellipse.deviation_y
    reach = ellipse.reach * ellipse.deviation_y
    top, bottom = dr.ceil(ellipse.y - reach), dr.floor(ellipse.y + reach)
    inverse = 1 / ellipse.deviation_x

    def more(i: Any, j: Any, *_: Any) -> Any:
        return active & (j <= bottom)

    def terms(inputs: Sequence[Any], i: Any, j: Any, end: Any, *_: Any) -> tuple[Any, ...]:
        x, y, slant, deviation_x, deviation_y = inputs
        local = replace(ellipse, x=x, y=y, slant=slant, deviation_x=deviation_x, deviation_y=deviation_y)
        _, _, middle, along = local.line(j)
        distance2 = dr.square((i - middle) / deviation_x) + along
        weight = dr.select(i <= end, dr.exp2(-0.5 / math.log(2) * distance2), 0)
        return visit(i, j, weight, tuple(dr.zeros(type(s)) for s in state))

    def step(i: Any, j: Any, end: Any, middle: Any, along: Any, *state: Any) -> tuple[Any, ...]:
        distance2 = dr.square((i - middle) * inverse) + along
        state = visit(i, j, dr.select(i <= end, dr.exp2(-0.5 / math.log(2) * distance2), 0), state)
        i += 1
        done = ~(i <= end)  # rows whose ends are NaN end too
        below = ellipse.line(j + 1)
        old = i, end, middle, along
        i, *rest = (dr.select(done, new, kept) for new, kept in zip(below, old, strict=True))
        return i, dr.select(done, j + 1, j), *rest, *state

    start, *first = ellipse.line(top)
    return summed((start, top, *first), state, more, step, terms, shape, buffers, "texels of an ellipse")[5:]
