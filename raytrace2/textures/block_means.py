"""Images cut into ever larger blocks, each of which knows the bilinear function nearest to the image on it.

Pyramids of means are exact for regions made of whole blocks; at the rim of a region, where blocks are cut, what counts
is how the image runs within a block. So a block keeps, besides its mean, the slope along either axis and the mixed
one: the projection of the *reconstructed* image onto bilinear functions, the best four numbers in the least squares.
On level 0 the blocks are the cells that reconstruction itself works on, and the projection is the image.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from ..buffers import owned
from ..types import Types
from .wrap import CLAMP, MIRROR

_BORDER, _NEAREST = 1, 2


@dataclass
class Level:
    """One level of one image a lane. ``columns``, ``rows`` (Float): blocks along the image's sides; ``size`` (Array2f)
    of a block in texels; ``start`` (Float): where block 0 begins, in texels; ``full`` (Bool): this is level 0."""

    offset: Any
    columns: Any
    rows: Any
    size: Any
    start: Any
    full: Any
    nearest: Any
    clamped: Any


class BlockMeans:
    """The blocks of every level of every image of one :class:`~raytrace2.textures.texels.Texels`.

    A side of n texels has ceil(n / 2^level) blocks of equal size on each ``level`` from 1 on, so blocks may end within
    a texel. Levels go on until one block is left; there a side that ran out of blocks before (and is not clamped) is
    taken for many periods, whose slope is 0. Level 0 takes no memory of its own; the others hold four numbers a block
    and channel. Beyond the edge of a clamped image lies one more block on every side, without an end.

    ``sizes`` is (images, 2): width and height; ``nearest`` says which images are not interpolated.
    """

    def __init__(
        self,
        texels: Any,
        sizes: np.ndarray,
        srgb: Sequence[bool],
        modes: Sequence[int],
        nearest: Sequence[bool],
        types: Types,
    ) -> None:
        self._types = types
        self._texels = texels
        self._modes = frozenset(modes)
        self._single = len(sizes) == 1
        self.nearest = frozenset(nearest)
        tops = [_halvings(int(max(size))) for size in sizes]
        self._levels = 1 + max(tops)
        where = np.zeros((len(sizes), self._levels, 4), np.uint32)
        extents = np.ones((len(sizes), self._levels, 2))
        images = np.zeros((len(sizes), 8))
        blocks: list[np.ndarray] = []
        end = 0
        for i, (width, height) in enumerate(sizes.tolist()):
            values = _linear(texels, int(texels.offsets[i]), width * height, srgb[i], types)
            reference = values[:, 0].copy()
            planes = (values - reference[:, None]).reshape(-1, height, width)
            images[i, :3], images[i, 3] = reference, tops[i]
            images[i, 4:7] = reference + planes.mean((1, 2))
            flags = (_BORDER if modes[i] == CLAMP else 0) | (_NEAREST if nearest[i] else 0)
            where[i, 0] = 0, width, height, flags
            along = _Line(planes, modes[i], nearest[i])
            for level in range(1, self._levels):
                if level > tops[i]:
                    where[i, level], extents[i, level] = where[i, level - 1], extents[i, level - 1]
                    continue
                block, counts, extents[i, level] = _blocks(along, height, width, level, modes[i], nearest[i])
                where[i, level] = end, *counts, flags
                blocks.append(block.astype(types.numpy).reshape(-1))
                end += block.shape[0] * block.shape[1]
        if end * 4 * texels.channels >= 2**32:
            raise ValueError(f"{end} blocks of texels are more than a table holds; scale the images down")
        self._blocks = owned(np.concatenate([*blocks, np.zeros(4)]), types.Float)
        self._where = owned(where, types.UInt)
        self._extents = owned(extents, types.Float)
        self._images: Any = [owned(v, types.Float) for v in images[0]] if self._single else owned(images, types.Float)

    def ends(self, image: Any, active: Any) -> tuple[Any, Any, Any]:
        """Of ``image``: its highest level (Float), a value of it that all of :meth:`block` is relative to, its mean."""
        t = self._types
        if self._single:
            entries = self._images
        else:
            both = [dr.gather(t.Array4f, self._images, 2 * image.place + k, active) for k in range(2)]
            entries = [v[k] for v in both for k in range(4)]
        if self._texels.channels == 1:
            return entries[3], entries[0], entries[4]
        return entries[3], t.Array3f(*entries[:3]), t.Array3f(*entries[4:7])

    def level(self, image: Any, level: Any, active: Any) -> Level:
        """Level ``level`` (UInt, at most the highest) of ``image``."""
        t = self._types
        index = level if self._single else dr.fma(image.place, self._levels, level)
        record = dr.gather(dr.uint32_array_t(t.Array4f), self._where, index, active)
        size = dr.gather(t.Array2f, self._extents, index, active)
        nearest = self._flag(record.w, _NEAREST, self.nearest)
        full = level == 0
        return Level(
            record.x,
            t.Float(record.y),
            t.Float(record.z),
            size,
            dr.select(full & ~nearest, t.Float(0.5), 0),
            full,
            nearest,
            self._flag(record.w, _BORDER, {m == CLAMP for m in self._modes}),
        )

    def block(
        self, bitmaps: Any, image: Any, level: Level, reference: Any, column: Any, row: Any, active: Any
    ) -> tuple[Any, Any, Any, Any]:
        """Mean, slope along u, slope along v and mixed slope of a block: it holds ``mean + x * slope_u + y * slope_v +
        x * y * mixed`` with x and y from -1/2 to 1/2.

        ``column`` and ``row`` are integer-valued Floats, wrapped here; of clamped images at most one beyond the edge.
        """
        t = self._types
        part = active & level.full
        columns, rows = bitmaps.columns(image, column), bitmaps.rows(image, row)
        v00 = bitmaps.texel(image, columns[0], rows[0], part) - reference
        mean = v00
        slope_u = slope_v = mixed = dr.zeros(type(v00))
        if False in self.nearest:
            smooth = part & ~level.nearest
            v10 = bitmaps.texel(image, columns[1], rows[0], smooth) - reference
            v01 = bitmaps.texel(image, columns[0], rows[1], smooth) - reference
            v11 = bitmaps.texel(image, columns[1], rows[1], smooth) - reference
            top, bottom, rise0, rise1 = v00 + v10, v01 + v11, v10 - v00, v11 - v01
            mean = dr.select(smooth, (top + bottom) * 0.25, v00)
            slope_u = dr.select(smooth, (rise0 + rise1) * 0.5, 0)
            slope_v = dr.select(smooth, (bottom - top) * 0.5, 0)
            mixed = dr.select(smooth, rise1 - rise0, 0)
        part = active & ~level.full
        border = dr.select(level.clamped, t.UInt(1), 0)
        i, sign_u = _fold(column, level.columns, image.mode, self._modes)
        j, sign_v = _fold(row, level.rows, image.mode, self._modes)
        stride = t.UInt(level.columns) + 2 * border
        index = level.offset + dr.fma(t.UInt(j), stride, t.UInt(i))
        channels = self._texels.channels
        stored = [dr.gather(t.Array4f, self._blocks, index * channels + c, part) for c in range(channels)]
        found = [stored[0][k] if channels == 1 else t.Array3f(*(s[k] for s in stored)) for k in range(4)]
        if MIRROR in self._modes:
            found[1], found[2], found[3] = found[1] * sign_u, found[2] * sign_v, found[3] * (sign_u * sign_v)
        return tuple(dr.select(level.full, a, b) for a, b in zip((mean, slope_u, slope_v, mixed), found, strict=True))

    def _flag(self, flags: Any, bit: int, occurring: Collection[bool]) -> Any:
        return flags & bit != 0 if len(occurring) > 1 else self._types.Bool(True in occurring)


def _fold(x: Any, size: Any, mode: Any, modes: Collection[int]) -> tuple[Any, Any]:
    """The block (Float from 0; borders of clamped images counted) that block ``x`` of the plane shows, and -1 where it
    is mirrored, else 1."""
    periods = dr.floor(x / size)
    inside = dr.fma(-size, periods, x)
    sign = type(x)(1)
    result = inside
    if MIRROR in modes:
        odd = periods - 2 * dr.floor(periods * 0.5) != 0
        if len(modes) > 1:
            odd &= mode == MIRROR
        result = dr.select(odd, size - 1 - inside, inside)
        sign = dr.select(odd, type(x)(-1), 1)
    last = size - 1
    if CLAMP in modes:
        clamped = mode == CLAMP if len(modes) > 1 else dr.mask_t(x)(True)
        result = dr.select(clamped, x + 1, result)
        last = dr.select(clamped, size + 1, last)
    return dr.fmin(dr.fmax(result, 0), last), sign


def _halvings(size: int) -> int:
    return max(0, size - 1).bit_length()


def _linear(texels: Any, offset: int, count: int, srgb: bool, types: Types) -> np.ndarray:
    """The linear values that kernels see: (channels, count), float64."""
    index = dr.arange(types.UInt, count) + dr.opaque(types.UInt, offset)
    return np.array(texels.fetch(index, types.Bool(srgb), True), dtype=np.float64).reshape(-1, count)


def _blocks(
    along: _Line, height: int, width: int, level: int, mode: int, nearest: bool
) -> tuple[np.ndarray, tuple[int, int], tuple[float, float]]:
    """Of one level: the blocks (rows, columns, channels, 4) with the borders, how many there are along u and v without
    them, and the size of one."""
    counts, sizes = [], []
    for length in (width, height):
        count = -(-length // 2**level)
        counts.append(count)
        beyond = max(0, level - _halvings(length)) if mode != CLAMP else 0
        sizes.append(length * 2.0**beyond / count)
    flat = [mode != CLAMP and level > _halvings(length) for length in (width, height)]
    parts = []
    for moment in along.moments(counts[0], flat[0]):
        across = _Line(np.swapaxes(moment, 1, 2), mode, nearest)
        parts.append([np.swapaxes(m, 1, 2) for m in across.moments(counts[1], flat[1])])
    (mean, slope_v), (slope_u, mixed) = parts
    return (
        np.moveaxis(np.stack([mean, slope_u, slope_v, mixed], -1), 0, 2),
        (counts[0], counts[1]),
        (sizes[0], sizes[1]),
    )


class _Line:
    """Lines of texels along the last axis as functions, with their first and second integrals at any place."""

    def __init__(self, values: np.ndarray, mode: int, nearest: bool) -> None:
        self._clamped, self._nearest = mode == CLAMP, nearest
        self._n = values.shape[-1]
        if nearest:
            self._left = self._right = values
        else:
            before, after = {MIRROR: (0, -1), CLAMP: (0, -1)}.get(mode, (-1, 0))
            padded = np.concatenate([values[..., [before]], values, values[..., [after]]], -1)
            self._left, self._right = padded[..., :-1], padded[..., 1:]
        whole = (self._left + self._right) / 2
        zero = np.zeros_like(whole[..., :1])
        self._first = np.concatenate([zero, np.cumsum(whole, -1)], -1)
        steps = self._first[..., :-1] + self._left / 2 + (self._right - self._left) / 6
        self._second = np.concatenate([zero, np.cumsum(steps, -1)], -1)
        self._edges = values[..., [0]], values[..., [-1]]

    def moments(self, count: int, flat: bool) -> tuple[np.ndarray, np.ndarray]:
        """Means of ``count`` equal blocks, and their slopes (zeros if ``flat``)."""
        size = self._n / count
        at = np.arange(count + 1) * size + (0.0 if self._nearest else 0.5)
        cell = np.minimum(at.astype(np.int64), self._left.shape[-1] - 1)
        t = at - cell
        left, rise = self._left[..., cell], self._right[..., cell] - self._left[..., cell]
        first = self._first[..., cell] + left * t + rise * (t**2 / 2)
        second = self._second[..., cell] + self._first[..., cell] * t + left * (t**2 / 2) + rise * (t**3 / 6)
        mean = np.diff(first, axis=-1) / size
        about_middle = (first[..., 1:] + first[..., :-1]) * (size / 2) - np.diff(second, axis=-1)
        slope = np.zeros_like(mean) if flat else 12 * about_middle / size**2
        if self._clamped:
            mean = np.concatenate([self._edges[0], mean, self._edges[1]], -1)
            slope = np.pad(slope, [(0, 0)] * (slope.ndim - 1) + [(1, 1)])
        return mean, slope


__all__ = ["BlockMeans", "Level"]
