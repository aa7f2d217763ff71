"""The bilinear functions nearest to an image on the blocks of its levels, and how far the image is from them.

Sums over texels are in double precision, along u and then along v, for one band of rows after another.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import drjit as dr
import numpy as np

from ..buffers import owned
from ..types import Types
from .block_lines import Side, pairs, texel_taps
from .replayed import summed

# Sums along u that are kept at a time: about 50 MB of colours.
_BAND = 2**20


def fits(
    fetch: Any, reference: Any, u: Side, v: Side, before: list[Any], columns_before: int, distances: bool, types: Types
) -> list[Any]:
    """Of each channel the blocks of one level, row by row, relative to ``reference`` (a Float a channel): mean, slopes
    along u and v, mixed slope and, with ``distances``, the mean square of what the image is off from these (Floats).

    ``fetch`` gives the channels of a texel (UInt, from the image's first); ``before`` is this of the level before (of
    level 1: anything), with ``columns_before`` blocks in a row.
    """
    if u.halves and v.halves:
        return _merged(before, columns_before, u, v, types)
    return _summed(fetch, reference, u, v, distances, types)


def constants(u: Side, v: Side, types: Types) -> list[Any]:
    """What :func:`fits` reads besides texels, for functions that are to be frozen, which must know of it."""
    make: Any = _halves if u.halves and v.halves else _sums
    return [array for side in (u, v) for array in make(side, types).constants()]


def _merged(before: list[Any], stride: int, u: Side, v: Side, types: Types) -> list[Any]:
    across, down = _halves(u, types), _halves(v, types)
    row, column = _places(u.stored, v.stored, types)
    columns, rows = across.at(column), down.at(row)
    result = []
    wide = dr.opaque(types.UInt, stride)
    # Which says how derivatives come back: where no block is gathered twice, no atomic operation is called for.
    mode = dr.ReduceMode.NoConflicts if across.apart and down.apart else dr.ReduceMode.Auto
    for values in before:
        found = [
            [[dr.gather(types.Float, plane, dr.fma(j, wide, i), mode=mode) for plane in values] for i in columns.index]
            for j in rows.index
        ]
        lines = []
        for line in found:
            mean, slope_u, slope_v, mixed = ([block[k] for block in line] for k in range(4))
            lines.append((
                _sum(columns.mean, mean), _sum(columns.lift, mean) + _sum(columns.slope, slope_u),
                _sum(columns.mean, slope_v), _sum(columns.lift, slope_v) + _sum(columns.slope, mixed),
            ))  # fmt: skip
        mean, slope_u, slope_v, mixed = ([line[k] for line in lines] for k in range(4))
        fit = (
            _sum(rows.mean, mean), _sum(rows.mean, slope_u),
            _sum(rows.lift, mean) + _sum(rows.slope, slope_v), _sum(rows.lift, slope_u) + _sum(rows.slope, mixed),
        )  # fmt: skip
        if len(values) == 4:
            result.append([*fit])
            continue
        # What a part is off from its own fit is at right angles to what that is off from the whole's.
        off = dr.zeros(types.Float)
        for j, line in enumerate(found):
            for i, block in enumerate(line):
                x, y = columns.place[i], rows.place[j]
                part = (
                    fit[0] + x * fit[1] + y * fit[2] + x * y * fit[3],
                    (fit[1] + y * fit[3]) * columns.share, (fit[2] + x * fit[3]) * rows.share,
                    fit[3] * (columns.share * rows.share),
                )  # fmt: skip
                square = _mean_square([a - b for a, b in zip(part, block[:4], strict=True)])
                off = off + columns.mean[i] * rows.mean[j] * (block[4] + square)
        result.append([*fit, off])
    dr.eval(result)
    return result


@dataclass(frozen=True)
class _Pairs:
    """:class:`~raytrace2.textures.block_lines.Pairs` at some blocks."""

    index: list[Any]
    mean: list[Any]
    lift: list[Any]
    slope: list[Any]
    place: list[Any]
    share: Any


class _Halves:
    """:class:`~raytrace2.textures.block_lines.Pairs` of a side for kernels."""

    def __init__(self, side: Side, types: Types) -> None:
        self._types = types
        made = pairs(side)
        self.apart = len(np.unique(made.index)) == made.index.size
        self._index = owned(made.index, types.UInt)
        self._weights = owned(
            np.column_stack([made.mean, made.lift, made.slope, made.place, made.share, 0 * made.share]), types.Float
        )

    def at(self, block: Any) -> _Pairs:
        t = self._types
        index = list(dr.gather(t.Array2u, self._index, block))
        mean, lift, slope, place, share = (list(dr.gather(t.Array2f, self._weights, block * 5 + k)) for k in range(5))
        return _Pairs(index, mean, lift, slope, place, share[0])

    def constants(self) -> list[Any]:
        return [self._index, self._weights]


# An optimisation makes blocks of the same sides at every step.
_halves = lru_cache(maxsize=256)(_Halves)


def _summed(fetch: Any, reference: Any, u: Side, v: Side, distances: bool, types: Types) -> list[Any]:
    UInt = types.UInt
    along_u, along_v = _sums(u, types), _sums(v, types)
    firsts = along_v.firsts
    channels = len(reference)
    bands: list[list[Any]] = []
    reach = along_v.taps
    start = 0
    while start < v.stored:
        end = start + 1
        while end < v.stored and (np.ptp(firsts[start : end + 1]) + reach) * u.stored <= _BAND:
            end += 1
        first = int(firsts[start:end].min())
        count = int(firsts[start:end].max()) + reach - first
        lines = _lines(fetch, reference, along_u, along_v, first, count, u, distances, types)
        row, column = _places(u.stored, end - start, types)
        block = row + dr.opaque(UInt, start)
        sums = _down(lines, along_v, block, column, first, u.stored, types)
        band = [[types.Float(value) for value in values] for values in sums]
        dr.eval(band)
        bands.append(band)
        start = end
    if len(bands) == 1:
        return bands[0]
    total = [[dr.concat([band[c][k] for band in bands]) for k in range(4 + distances)] for c in range(channels)]
    dr.eval(total)
    return total


def _lines(
    fetch: Any, reference: Any, along_u: _Sums, along_v: _Sums, first: int, count: int, u: Side, distances: bool,
    types: Types,
) -> list[Any]:  # fmt: skip
    """Of texel rows, ``count`` from ``first`` on, summed along u: of each channel the mean, the slope and, with
    ``distances``, the mean square and the mean product with the row below, each (count * columns)."""
    UInt, zero = types.UInt, dr.zeros(dr.float64_array_t(types.Float), count * u.stored)
    local, column = _places(u.stored, count, types)
    width = dr.opaque(UInt, u.length)
    line = local + dr.opaque(UInt, first)
    row, below = along_v.texel(line) * width, along_v.texel(line + 1) * width
    start = along_u.first(column)

    def turn(k: Any, before: Any, sums: Any) -> tuple[Any, ...]:
        texel = along_u.texel(start + k)
        mean, slope, square, cross = along_u.weights(column, k)
        here = fetch(row + texel)
        under = fetch(below + texel) if distances else here
        result, values = [], []
        for c, total in enumerate(sums):
            a = type(zero)(here[c] - reference[c])
            total = [dr.fma(mean, a, total[0]), dr.fma(slope, a, total[1]), *total[2:]]
            if distances:
                b = type(zero)(under[c] - reference[c])
                a0, b0 = before[c]
                total[2] = total[2] + a * dr.fma(square, a, 2 * cross * a0)
                total[3] = total[3] + dr.fma(square, a * b, cross * (a0 * b + a * b0))
                values.append([a, b])
            result.append(total)
        return k + 1, values, result

    channels = len(reference)
    before = [[zero] * 2 for _ in range(channels * distances)]
    sums = [[zero] * (4 if distances else 2) for _ in range(channels)]
    last = dr.opaque(UInt, along_u.taps)
    sums = _turned(turn, before, sums, last, getattr(fetch, "buffers", ()), "texels of blocks along u")
    dr.eval(sums)
    return sums


def _down(
    lines: list[Any], along_v: _Sums, block: Any, column: Any, first: int, stride: int, types: Types
) -> list[list[Any]]:
    """Blocks (rows ``block``) from the sums of rows, of which ``lines`` has those from ``first`` on."""
    UInt = types.UInt
    zero = dr.zeros(dr.float64_array_t(types.Float), len(block))
    start = along_v.first(block) - dr.opaque(UInt, first)
    wide = dr.opaque(UInt, stride)

    def turn(k: Any, before: Any, sums: Any) -> tuple[Any, ...]:
        index = dr.fma(start + k, wide, column)
        mean, slope, square, cross = along_v.weights(block, k)
        result, products = [], []
        for c, (planes, total) in enumerate(zip(lines, sums, strict=True)):
            level, rise, *rest = (dr.gather(type(zero), plane, index) for plane in planes)
            total = [
                dr.fma(mean, level, total[0]), dr.fma(mean, rise, total[1]), dr.fma(slope, level, total[2]),
                dr.fma(slope, rise, total[3]), *total[4:],
            ]  # fmt: skip
            if rest:
                total[4] = total[4] + dr.fma(square, rest[0], 2 * cross * before[c])
                products.append(rest[1])
            result.append(total)
        return k + 1, products, result

    distances = len(lines[0]) > 2
    last = dr.opaque(UInt, along_v.taps)
    before = [zero] * (len(lines) * distances)
    zeros = [[zero] * (4 + distances) for _ in lines]
    sums = _turned(turn, before, zeros, last, [p for planes in lines for p in planes], "rows of blocks along v")
    return [[*s[:4], *(dr.fmax(square - _mean_square(s[:4]), 0) for square in s[4:])] for s in sums]


def _turned(turn: Any, before: Any, sums: list[list[Any]], last: Any, buffers: Sequence[Any], label: str) -> Any:
    """``turn(k, before, sums)`` for each k below ``last``; of the ``sums``, which it adds to, what it made.

    Where ``buffers`` carry derivatives, nothing but sums is left from turn to turn.
    """
    zero, each = dr.zeros(type(last), dr.width(sums)), len(sums[0])

    def flat(k: Any, kept: Any, *values: Any) -> tuple[Any, ...]:
        k, kept, made = turn(k, kept, [list(values[c * each : (c + 1) * each]) for c in range(len(sums))])
        return k, kept, *(v for total in made for v in total)

    def terms(_: Any, k: Any, kept: Any) -> tuple[Any, ...]:
        return flat(k, kept, *zeros)[2:]

    zeros = [v for total in sums for v in total]
    result = summed((zero, before), tuple(zeros), lambda k, *_: k < last, flat, terms, (), buffers, label)[2:]
    return [list(result[c * each : (c + 1) * each]) for c in range(len(sums))]


class _Sums:
    """:class:`~raytrace2.textures.block_lines.Taps` of a side for kernels."""

    def __init__(self, side: Side, types: Types) -> None:
        taps = texel_taps(side)
        self.taps = taps.mean.shape[1]
        self.firsts = taps.first
        self._types = types
        self._double = dr.float64_array_t(types.Float)
        self._texels = owned(np.append(taps.texels, taps.texels[-1]), types.UInt)
        self._first = owned(taps.first, types.UInt)
        packed = np.stack([taps.mean, taps.slope, taps.square, taps.cross], -1)
        self._weights = owned(packed, self._double)
        self._count = dr.opaque(types.UInt, self.taps)

    def first(self, block: Any) -> Any:
        return dr.gather(self._types.UInt, self._first, block)

    def texel(self, k: Any) -> Any:
        return dr.gather(self._types.UInt, self._texels, k)

    def weights(self, block: Any, k: Any) -> list[Any]:
        entry = dr.fma(block, self._count, k)
        return list(dr.gather(dr.float64_array_t(self._types.Array4f), self._weights, entry))

    def constants(self) -> list[Any]:
        return [self._texels, self._first, self._weights, self._count]


_sums = lru_cache(maxsize=256)(_Sums)


def _places(columns: int, rows: int, types: Types) -> tuple[Any, Any]:
    block = dr.arange(types.UInt, columns * rows)
    wide = dr.opaque(types.UInt, columns)
    row = block // wide
    return row, block - row * wide


def _sum(weights: list[Any], values: list[Any]) -> Any:
    return dr.fma(weights[1], values[1], weights[0] * values[0])


def _mean_square(fit: Any) -> Any:
    """The mean square over a block of a bilinear function."""
    return dr.square(fit[0]) + (dr.square(fit[1]) + dr.square(fit[2])) * (1 / 12) + dr.square(fit[3]) * (1 / 144)


__all__ = ["constants", "fits"]
