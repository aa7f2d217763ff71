"""The integral of the reconstructed texture over an affine footprint, weighted by the film's own pixel filter.

A pixel at distance sees a parallelogram of the texture. Its cells between four texel centres, on which bilinear
reconstruction is one polynomial, are clipped to it and integrated in closed form; where they are too many, blocks of a
coarser level take their place (:mod:`~raytrace2.textures.block_means`), whose means are those of the reconstructed
texture, so that only blocks which the rim cuts are approximate.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import drjit as dr

from ...types import types_of
from ..wrap import CLAMP
from .exact_cells import Parallelogram
from .exact_kernel import Kernel, make_kernel
from .exact_walk import Grid, integrate, make_grid
from .point import bilinear, nearest

# Footprints smaller than this (texels) count as points: the slope of a bilinear texture changes from texel to texel,
# and less than 1/8 of the change times this is the error.
_POINT = 2.0**-10
# Footprints narrower than this (texels; blocks of coarser levels) are given this width, so that areas stay areas.
_NARROW, _NARROW_BLOCK = 2.0**-6, 2.0**-9
# Footprints on clamped images beyond this multiple of the image are cut down to it.
_BEYOND = 1024.0
# Footprints and places beyond this (texels) are no case for a sum.
_LARGEST = 1e15
# Numbers that a block or a cell holds.
_NUMBERS = 4
# Blocks that a footprint meets of which no more than the size is known.
_OF_A_GUESS = 4
# Blocks that a look-up may read for each that its level was chosen for.
_TURNS = 16


def exact(bitmaps: Any, image: Any, uv: Any, footprint: Any, settings: Any, active: Any = True) -> Any:
    """The texture over the parallelogram ``footprint.dx``, ``footprint.dy`` about ``uv``, weighted by the pixel filter
    ``settings.pixel`` (box, tent or gaussian).

    A footprint that is too large for level 0 meets blocks of about ``settings.budget`` numbers a channel (between 0.7
    and 1.4 of it, on average over its places). On level 0 the box filter's integral is exact up to round-off, and the
    others' up to a quadrature of 4 x 4 points a cell; of Gaussians what lies beyond 2.9 deviations, 1.5 % of their
    weight, is seen only in part. On coarser levels what errs is how the image differs, within the blocks that the rim
    cuts, from the nearest bilinear function (:func:`exact_with_error` bounds it). Beyond the edges of a clamped image
    its outermost texels go on for ever, which is integrated as well. Footprints far below a texel give the texture's
    own reconstruction to the last bit; infinite and NaN ones, and those of many periods, the image's mean.
    """
    return exact_with_reads(bitmaps, image, uv, footprint, settings, active)[0]


def exact_with_reads(
    bitmaps: Any, image: Any, uv: Any, footprint: Any, settings: Any, active: Any = True
) -> tuple[Any, Any]:
    """As :func:`exact`, and how many numbers a channel it read (UInt)."""
    kernel = make_kernel(settings.pixel)
    look_up = LookUp(bitmaps, image, uv, footprint, settings, kernel, active)
    total, weight, blocks = integrate(
        bitmaps, look_up.grid, look_up.edges, look_up.shape, None, look_up.walks, look_up.most
    )
    return look_up.value(total, weight), look_up.reads(blocks)


def exact_with_error(
    bitmaps: Any, image: Any, uv: Any, footprint: Any, settings: Any, active: Any = True
) -> tuple[Any, Any]:
    """As :func:`exact`, and a bound on what coarser levels make it err (of the value's type; 0 on level 0).

    On a block let r be what the image is off from the block's bilinear function, d the root of its mean square, which
    is stored, and w the pixel filter. The integral of r times any bilinear function is 0, so what the block misses is
    the integral of r (w - p), p being the bilinear function nearest to w, and by Cauchy and Schwarz at most d times
    the norm of w - p. The bound is the sum of these over the integral of w; blocks wholly inside a box add nothing. An
    image that looks like w - p on every block attains it. Where the image's mean stands for many periods, the bound is
    the largest distance of a texel from it.

    For the box it holds up to round-off, for footprints at least as wide as :func:`exact` makes them; those that count
    as points have 0. For the tent and the Gaussian quadrature and cut-off come on top. The deviations of the blocks are
    made on the first call, which thus may not be within a symbolic loop unless
    :meth:`~raytrace2.textures.block_means.BlockMeans.build_deviations` came before.
    """
    bitmaps.blocks.build_deviations()
    kernel = make_kernel(settings.pixel)
    look_up = LookUp(bitmaps, image, uv, footprint, settings, kernel, active)
    shape = partial(look_up.shape, squares=True)
    total, weight, _, missed = integrate(
        bitmaps, look_up.grid, look_up.edges, shape, None, look_up.walks, look_up.most, bounds=True
    )
    return look_up.value(total, weight), look_up.error(missed, weight)


class LookUp:
    """What comes before and after the sum over blocks: which level, where on it, and what is no case for a sum.

    ``grid`` and on it the ``footprint``, whose centre and edges are the ``edges``; ``narrow`` is its least width;
    ``walks`` (Bool): there is something to sum. ``second`` (Array2f, texels) widens what is reckoned to be seen.
    """

    grid: Grid

    def __init__(
        self,
        bitmaps: Any,
        image: Any,
        uv: Any,
        footprint: Any,
        settings: Any,
        kernel: Kernel,
        active: Any,
        second: Sequence[Any] = (),
    ) -> None:
        dx, dy = footprint.dx, footprint.dy
        t = types_of(uv.x)
        size = t.Array2f(image.width, image.height)
        centre = uv * size
        extent = dr.abs(dx) + dr.abs(dy)
        finite = (extent.x + extent.y < _LARGEST) & (dr.abs(centre.x) + dr.abs(centre.y) < _LARGEST)
        dx, dy = dr.select(finite, dx, 0), dr.select(finite, dy, 0)
        centre = dr.select(finite, centre, 0)
        self._point = finite & (extent.x + extent.y < _POINT)
        top, reference, self._mean = bitmaps.blocks.ends(image, active)
        # It adds as much as blocks leave out, so it counts as constant.
        reference = dr.detach(reference)
        if bitmaps.wraps(CLAMP):
            clamped = bitmaps.is_clamped(image)
            centre, dx, dy = _cut(centre, dx, dy, 2 * kernel.radius, size, clamped)
        seen = kernel.support(centre, dx * kernel.radius, dy * kernel.radius)
        wide, area = seen.extent(), dr.abs(seen.area())
        for v in second:
            wide = wide + kernel.radius * dr.abs(v)
        if bitmaps.wraps(CLAMP):
            wide = dr.select(clamped, dr.fmin(wide, size + 2), wide)
            area = dr.select(clamped, dr.fmin(area, wide.x * wide.y), area)
        budget = max(settings.budget // _NUMBERS - 1, 1)
        guess = footprint.is_guess()
        # What is not known to half its size is not worth many texels.
        spent = budget if guess is None else dr.select(guess, t.Float(min(budget, _OF_A_GUESS)), budget)
        level = _level(wide.x + wide.y, area, spent)
        # No region of a level comes near it, but a kernel must end.
        self.most = min(_TURNS * (budget + 4), 2**31)
        if bitmaps.wraps(CLAMP):
            level = dr.select(clamped, dr.fmin(level, top), level)
        self.walks = active & finite & ~self._point & (level <= top)
        # Comparisons with NaN are false: the level is in range in any case.
        found = bitmaps.blocks.level(image, t.UInt(dr.select(level <= top, level, top)), active)
        self.grid, at = make_grid(bitmaps, image, found, centre, reference)
        narrow = dr.fmax(_NARROW / dr.fmin(found.size.x, found.size.y), _NARROW_BLOCK)
        if kernel.sampled:
            narrow = dr.fmax(narrow, kernel.narrowest)
        self.scale, self.narrow = found.size, narrow
        a, b = widened(dx / found.size, dy / found.size, narrow)
        self.footprint = Parallelogram(at, a, b)
        self.edges = at, a, b
        self._kernel = kernel
        self._known = bitmaps, image, uv, active

    def shape(self, at: Any, a: Any, b: Any, squares: bool = False) -> tuple[Any, Any]:
        """What :func:`~raytrace2.textures.filters.exact_walk.integrate` takes for an affine footprint's edges."""
        region = self._kernel.support(at, a * self._kernel.radius, b * self._kernel.radius)
        return lambda k: region, self._kernel.moments(Parallelogram(at, a, b), squares=squares)

    def value(self, total: Any, weight: Any) -> Any:
        """The look-up's result from the sums."""
        filled = dr.isfinite(weight) & (weight != 0)
        value = self.grid.reference + total / dr.select(filled, weight, 1)
        value = dr.select(self.walks & filled, value, self._mean)
        return dr.select(self._point, self._at_point(), value)

    def error(self, missed: Any, weight: Any) -> Any:
        """A bound on the error of :meth:`value` from one on that of the sum."""
        bitmaps, image, _, active = self._known
        filled = dr.isfinite(weight) & (weight != 0)
        error = missed / dr.select(filled, dr.abs(weight), 1)
        error = dr.select(self.walks & filled, error, bitmaps.blocks.spread(image, active))
        return dr.select(self._point, 0, error)

    def reads(self, blocks: Any) -> Any:
        """Numbers a channel that were read for ``blocks`` blocks."""
        each = dr.select(self.grid.level.full & self.grid.level.nearest, type(blocks)(1), _NUMBERS)
        return dr.select(self._point, each, dr.select(self.walks, blocks * each, 1))

    def _at_point(self) -> Any:
        bitmaps, image, uv, active = self._known
        active = active & self._point
        near = self.grid.level.nearest
        result = None
        for is_nearest in sorted(bitmaps.blocks.nearest):
            value = (nearest if is_nearest else bilinear)(bitmaps, image, uv, None, None, active)
            result = value if result is None else dr.select(near, value, result)
        return result


def _level(wide: Any, area: Any, budget: Any) -> Any:
    """The finest level (Float from 0, infinite or NaN for what has none) on which a convex region meets ``budget``
    blocks on average: on a grid of unit cells one meets its area, plus the width and height of its bounding box, plus
    1 (the Minkowski sum with a cell, Santalo 1976, chapter 8)."""
    scale = 2 * budget / (wide + dr.sqrt(dr.fma(4 * budget, area, wide * wide)))
    return dr.fmax(dr.round(-dr.log2(scale)), 0)


def widened(a: Any, b: Any, width: Any) -> tuple[Any, Any]:
    """A parallelogram's edges, the shorter turned away from the longer until the parallelogram has the ``width``."""
    long_a = dr.squared_norm(a) >= dr.squared_norm(b)
    longer, shorter = dr.select(long_a, a, b), dr.select(long_a, b, a)
    length = dr.norm(longer)
    scale = dr.rcp(dr.select(length > 0, length, 1))
    normal = dr.select(length > 0, type(a)(-longer.y, longer.x) * scale, type(a)(0, 1))
    longer = dr.select(length >= width, longer, type(a)(normal.y, -normal.x) * width)
    across = dr.dot(shorter, normal)
    lacking = dr.fmax(width - dr.abs(across), 0)
    shorter = shorter + normal * dr.mulsign(lacking, across)
    return dr.select(long_a, longer, shorter), dr.select(long_a, shorter, longer)


def _cut(centre: Any, dx: Any, dy: Any, reach: float, size: Any, clamped: Any) -> tuple[Any, Any, Any]:
    """A footprint on a clamped image, far beyond whose edges nothing changes: as large and as far off as that shows."""
    extent = reach * (dr.abs(dx) + dr.abs(dy))
    most = _BEYOND * (size.x + size.y)
    longest = dr.fmax(extent.x, extent.y)
    shrink = dr.select(clamped & (longest > most), most / longest, 1)
    dx, dy, extent = dx * shrink, dy * shrink, extent * shrink
    inside = dr.fmin(dr.fmax(centre * shrink, -1 - extent), size + 1 + extent)
    return dr.select(clamped, inside, centre), dx, dy
