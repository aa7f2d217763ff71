"""Sums over the blocks of an image that a parallelogram meets: one loop, row by row."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr

from ...types import types_of
from ..block_means import Level
from ..replayed import summed
from ..wrap import CLAMP
from .exact_ellipse import Region


@dataclass
class Grid:
    """Where a look-up meets the blocks of one level: ``base`` (Array2f, integers) is the block that coordinates of
    parallelograms count from. Of images that are clamped, blocks ``lowest`` to ``highest`` (Array2f, from ``base``)
    are there, and those at the ends go on for ever; else both are None."""

    image: Any
    level: Level
    reference: Any
    base: Any
    lowest: Any
    highest: Any


def make_grid(bitmaps: Any, image: Any, level: Any, centre: Any, reference: Any) -> tuple[Grid, Any]:
    """The grid of ``level`` (:class:`~raytrace2.textures.block_means.Level`) about ``centre`` (Array2f, texels), and
    ``centre`` on it (Array2f)."""
    at = (centre - level.start) / level.size
    base = dr.floor(at)
    if not bitmaps.wraps(CLAMP):
        return Grid(image, level, reference, base, None, None), at - base
    t = types_of(base.x)
    count = t.Array2f(level.columns, level.rows)
    # Between the centres of texels there is one cell less than there are texels.
    last = count - dr.select(level.start > 0, t.Float(1), 0)
    lowest, highest = dr.select(level.clamped, -1 - base, -dr.inf), dr.select(level.clamped, last - base, dr.inf)
    return Grid(image, level, reference, base, lowest, highest), at - base


Moments = Callable[[Any, Any, Any, Any, Any], tuple[Any, ...]]


def integrate(
    bitmaps: Any,
    grid: Grid,
    inputs: Sequence[Any],
    shape: Callable[..., tuple[Callable[[Any], Region], Moments]],
    count: Any,
    active: Any,
    most: int,
    bounds: bool = False,
) -> tuple[Any, ...]:
    """Integral of the image (less ``grid.reference``) over parallelograms, that of 1, and how many blocks were read
    (UInt).

    ``shape(*inputs)`` gives ``pieces`` and ``moments``: there are ``count`` parallelograms (UInt, or None for one),
    ``pieces(k)`` being one, and ``moments`` integrates 1, x, y, x y over the part in a cell given by ``(piece, left,
    bottom, width, height)``. The integrals have derivatives by ``inputs`` (Dr.Jit arrays) and texels, while level and
    ``count`` are constants. No lane reads more than ``most`` blocks; a piece with a coordinate that is NaN takes no
    turn. With ``bounds`` ``moments`` has the integral of its weight's square as well, and a bound on what the blocks'
    functions make the first integral err follows.
    """
    zero = grid.base.x * 0
    t = types_of(zero)
    pieces, moments = shape(*inputs)
    piece = pieces(dr.zeros(t.UInt, dr.width(zero)))
    row, last_row = _rows(grid, piece)
    column, last = _columns(grid, piece, row)
    state: tuple[Any, ...] = (
        dr.zeros(t.UInt, dr.width(zero)), row, last_row, column, last,
        dr.zeros(t.UInt, dr.width(zero)), t.Bool(active) & (row <= last_row),
    )  # fmt: skip
    sums: tuple[Any, ...] = dr.zeros(type(grid.reference), dr.width(zero)), dr.zeros(t.Float, dr.width(zero))
    if bounds:
        state = (*state[:-1], dr.zeros(type(grid.reference), dr.width(zero)), state[-1])

    def integral(numbers: tuple[Any, ...], column: Any, row: Any, going: Any) -> Any:
        m, mx, my, mxy = numbers
        mean, slope_u, slope_v, mixed = bitmaps.blocks.block(
            bitmaps, grid.image, grid.level, grid.reference, grid.base.x + column, grid.base.y + row, going
        )
        return mean * m + slope_u * mx + (slope_v * my + mixed * mxy)

    def terms(local: Sequence[Any], k: Any, row: Any, _: Any, column: Any, *rest: Any) -> tuple[Any, Any]:
        pieces, moments = shape(*local)
        here = pieces(k)
        numbers = moments(here, *_cell(grid, here, column, row))[:4]
        return integral(numbers, column, row, rest[-1]), numbers[0]

    def turn(k: Any, row: Any, last_row: Any, column: Any, last: Any, reads: Any, *rest: Any) -> tuple[Any, ...]:
        *bound, going, total, weight = rest
        here = piece if count is None else pieces(k)
        left, bottom, width, height = _cell(grid, here, column, row)
        m, mx, my, mxy, *square = moments(here, left, bottom, width, height)
        total = total + integral((m, mx, my, mxy), column, row, going)
        if bounds:
            deviation = bitmaps.blocks.deviation(grid.image, grid.level, grid.base.x + column, grid.base.y + row, going)
            beyond = _beyond_bilinear(bitmaps, grid, (m, mx, my, mxy), square[0], width, height)
            bound[0] = bound[0] + deviation * beyond
        column = column + 1
        next_row = column > last
        row = dr.select(next_row, row + 1, row)
        going = row <= last_row
        following = here
        if count is not None:
            done = next_row & ~going
            k = dr.select(done, k + 1, k)
            going = k < count
            following = pieces(k)
            first_row, end_row = _rows(grid, following)
            row, last_row = dr.select(done, first_row, row), dr.select(done, end_row, last_row)
            going &= row <= last_row
        going &= reads < most - 1
        first, end = _columns(grid, following, row)
        column, last = dr.select(next_row, first, column), dr.select(next_row, end, last)
        return k, row, last_row, column, last, reads + 1, *bound, going, total, weight + m

    found = summed(state, sums, lambda *s: s[-3], turn, terms, inputs, bitmaps.buffers, label="blocks of a footprint")
    *_, total, weight = found
    return (total, weight, found[5], found[6]) if bounds else (total, weight, found[5])


def _beyond_bilinear(bitmaps: Any, grid: Grid, moments: tuple[Any, ...], square: Any, width: Any, height: Any) -> Any:
    """What a weight (of these ``moments``, and the integral of its ``square``) is off from the nearest bilinear
    function on the cell, as the root of an integral, times that of the cell's area.

    That function integrates to 0 with what a block leaves of the image, so this times the block's deviation bounds the
    integral of weight and image that the block misses (Cauchy and Schwarz).
    """
    m, mx, my, mxy = moments
    area = width * height
    flat_u, flat_v = bitmaps.blocks.is_flat(grid.level)
    # Moments across endless cells are none.
    along_u, along_v = dr.select(flat_u | (width != 1), 0, m * 0 + 12), dr.select(flat_v | (height != 1), 0, m * 0 + 12)
    within = (m * m + along_u * mx * mx) + along_v * (my * my + along_u * mxy * mxy)
    return dr.sqrt(dr.fmax(square * area - within, 0))


def _rows(grid: Grid, piece: Region) -> tuple[Any, Any]:
    half = 0.5 * piece.extent().y
    return _within(grid, 1, dr.floor(piece.centre.y - half), dr.floor(piece.centre.y + half))


def _columns(grid: Grid, piece: Region, row: Any) -> tuple[Any, Any]:
    bottom, top = row, row + 1
    if grid.lowest is not None:
        bottom = dr.select(row <= grid.lowest.y, -dr.inf, bottom)
        top = dr.select(row >= grid.highest.y, dr.inf, top)
    least, greatest = piece.columns(bottom, top)
    return _within(grid, 0, dr.floor(least), dr.floor(greatest))


def _within(grid: Grid, axis: int, first: Any, last: Any) -> tuple[Any, Any]:
    if grid.lowest is None:
        return first, last
    lowest, highest = grid.lowest[axis], grid.highest[axis]
    return dr.fmin(dr.fmax(first, lowest), highest), dr.fmin(dr.fmax(last, lowest), highest)


def _cell(grid: Grid, piece: Region, column: Any, row: Any) -> tuple[Any, Any, Any, Any]:
    """Left and bottom, width and height of a cell, of endless ones of the part that matters."""
    one = type(column)(1)
    if grid.lowest is None:
        return column, row, one, one
    half = 0.5 * piece.extent()
    result = []
    for at, lowest, highest, centre, reach in (
        (column, grid.lowest.x, grid.highest.x, piece.centre.x, half.x),
        (row, grid.lowest.y, grid.highest.y, piece.centre.y, half.y),
    ):
        least = dr.select(at <= lowest, dr.fmin(centre - reach, at), at)
        most = dr.select(at >= highest, dr.fmax(centre + reach, at + 1), at + 1)
        result.append((least, most - least))
    return result[0][0], result[1][0], result[0][1], result[1][1]
