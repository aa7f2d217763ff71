"""Images cut into ever larger blocks, each of which knows the bilinear function nearest to the image on it.

Pyramids of means are exact for regions made of whole blocks; at the rim of a region, where blocks are cut, what counts
is how the image runs within a block. So a block keeps, besides its mean, the slope along either axis and the mixed
one: the projection of the *reconstructed* image onto bilinear functions, the best four numbers in the least squares.
On level 0 the blocks are the cells that reconstruction itself works on, and the projection is the image.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import drjit as dr
import numpy as np

from ..buffers import owned
from ..types import Types
from .block_fits import constants, fits
from .block_lines import Side, halvings, side
from .texels import joined
from .wrap import CLAMP, MIRROR

# Texels that are looked at in one go.
_CHUNK = 2**22
_BORDER, _NEAREST, _FLAT_U, _FLAT_V = 1, 2, 4, 8


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
    flags: Any


class BlockMeans:
    """The blocks of every level of every image of one :class:`~raytrace2.textures.texels.Texels`.

    A side of n texels has ceil(n / 2^level) blocks of equal size on each ``level`` from 1 on, so blocks may end within
    a texel. Levels go on until one block is left; there a side that ran out of blocks before (and is not clamped) is
    taken for many periods, whose slope is 0. Level 0 takes no memory of its own; the others hold four numbers a block
    and channel. Beyond the edge of a clamped image lies one more block on every side, without an end.
    What each block's function misses is known only after :meth:`build_deviations`: one more number.

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
        self._sizes, self._srgb, self._wraps, self._nearest = sizes, srgb, modes, nearest
        self._modes = frozenset(modes)
        self._single = len(sizes) == 1
        self.nearest = frozenset(nearest)
        tops = [halvings(int(max(size))) for size in sizes]
        self._levels = 1 + max(tops)
        where = np.zeros((len(sizes), self._levels, 4), np.uint32)
        extents = np.ones((len(sizes), self._levels, 2))
        images = np.zeros((len(sizes), 8))
        end = 0
        for i, (width, height) in enumerate(sizes.tolist()):
            flags = (_BORDER if modes[i] == CLAMP else 0) | (_NEAREST if nearest[i] else 0)
            where[i, 0] = 0, width, height, flags
            images[i, 3] = tops[i]
            for level in range(1, self._levels):
                if level > tops[i]:
                    where[i, level], extents[i, level] = where[i, level - 1], extents[i, level - 1]
                    continue
                u, v = (side(length, level, modes[i], nearest[i]) for length in (width, height))
                flat = (_FLAT_U if u.flat else 0) | (_FLAT_V if v.flat else 0)
                where[i, level], extents[i, level] = (end, u.count, v.count, flags | flat), (u.size, v.size)
                end += u.stored * v.stored
        if end * 4 * texels.channels >= 2**32:
            raise ValueError(f"{end} blocks of texels are more than a table holds; scale the images down")
        self._count = end
        self._deviations: Any = None
        self._spreads: Any = None
        blocks = dr.zeros(types.Float, max(end, 1) * 4 * texels.channels)
        for i, first, made in self._fits(False):
            for c, fit in enumerate(made):
                block = dr.arange(types.UInt, len(fit[0])) + dr.opaque(types.UInt, first)
                dr.scatter(blocks, types.Array4f(*fit), block * texels.channels + c)
            dr.eval(blocks)
            images[i, 4 : 4 + len(made)] = [fit[0][len(fit[0]) // 2] for fit in made]
        for i in range(len(sizes)):
            images[i, : texels.channels] = [float(v[0]) for v in self._reference(i)]
            images[i, 4:7] += images[i, :3]
        self._means = images[:, 4:7]
        self._where = owned(where, types.UInt)
        self._extents = owned(extents, types.Float)
        whole: Any = [owned(v, types.Float) for v in images[0]] if self._single else owned(images, types.Float)
        #: What of this depends on texels: the blocks, and what :meth:`ends` says of images.
        self.data = blocks, whole

    def ends(self, image: Any, active: Any) -> tuple[Any, Any, Any]:
        """Of ``image``: its highest level (Float), a value of it that all of :meth:`block` is relative to, its mean."""
        t = self._types
        if self._single:
            entries = self.data[1]
        else:
            both = [dr.gather(t.Array4f, self.data[1], 2 * image.place + k, active) for k in range(2)]
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
            record.w,
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
        index, sign_u, sign_v = self._index(image, level, column, row)
        channels = self._texels.channels
        stored = [dr.gather(t.Array4f, self.data[0], index * channels + c, part) for c in range(channels)]
        found = [stored[0][k] if channels == 1 else t.Array3f(*(s[k] for s in stored)) for k in range(4)]
        if MIRROR in self._modes:
            found[1], found[2], found[3] = found[1] * sign_u, found[2] * sign_v, found[3] * (sign_u * sign_v)
        return tuple(dr.select(level.full, a, b) for a, b in zip((mean, slope_u, slope_v, mixed), found, strict=True))

    def with_images(self, data: tuple[Any, Any], images: Mapping[int, Any]) -> tuple[Any, Any]:
        """What :attr:`data` is with other images, as :meth:`~raytrace2.textures.texels.Texels.with_images` takes them;
        a function with derivatives. :meth:`deviation` and :meth:`spread` remain those of the images as they were."""
        t, channels = self._types, self._texels.channels
        pieces: list[Any] = []
        whole: list[Any] = []
        end = 0
        for i in range(len(self._sizes)):
            counts = [u.stored * v.stored for u, v in self._sides(i)]
            if i not in images:
                pieces.append((end, end + sum(counts)))
                whole.append((8 * i, 8 * i + 8))
            else:
                planes = self._texels.planes(images[i])
                first = dr.opaque(t.UInt, 0)
                reference = [dr.detach(dr.gather(t.Float, plane, first)) for plane in planes]
                means = [dr.gather(t.Float, plane, first) for plane in planes]
                for made in self._levels_of(i, _Planes(planes, t), reference, False):
                    pieces.append(_packed(made, t))
                    middle = dr.opaque(t.UInt, len(made[0][0]) // 2)
                    means = [dr.gather(t.Float, f[0], middle) + r for f, r in zip(made, reference, strict=True)]
                none = [dr.opaque(t.Float, 0)] * (3 - channels)
                top = dr.opaque(t.Float, len(counts))
                entries = [*reference, *none, top, *means, *none, dr.opaque(t.Float, 0)]
                dr.eval(entries)
                if self._single:
                    whole.append(entries)
                else:
                    whole += entries
            end += sum(counts)
        if end == 0:
            blocks = data[0]
        else:
            blocks = joined(pieces, data[0], 4 * channels, t)
        return blocks, whole[0] if self._single else joined(whole, data[1], 1, t)

    def constants(self, images: Iterable[int]) -> list[Any]:
        """What :meth:`with_images` reads besides texels."""
        return [array for i in images for u, v in self._sides(i) for array in constants(u, v, self._types)]

    def build_deviations(self) -> None:
        """What :meth:`deviation` and :meth:`spread` read, if it is not there yet; not within a symbolic loop."""
        if self._deviations is not None:
            return
        t, channels = self._types, self._texels.channels
        deviations = dr.zeros(t.Float, max(self._count, 1) * channels)
        for _, first, made in self._fits(True):
            for c, fit in enumerate(made):
                block = dr.arange(t.UInt, len(fit[4])) + dr.opaque(t.UInt, first)
                dr.scatter(deviations, dr.sqrt(fit[4]), block * channels + c)
            dr.eval(deviations)
        self._deviations = deviations
        spreads = np.zeros((len(self._sizes), 4))
        for i, (width, height) in enumerate(self._sizes.tolist()):
            for first in range(0, width * height, _CHUNK):
                index = dr.arange(t.UInt, min(_CHUNK, width * height - first)) + dr.opaque(t.UInt, first)
                for c, value in enumerate(self._fetch(i, index)):
                    most = dr.max(dr.abs(value - dr.opaque(t.Float, float(self._means[i, c]))))
                    spreads[i, c] = max(spreads[i, c], float(most[0]))
        self._spreads = owned(spreads, t.Float)

    def spread(self, image: Any, active: Any) -> Any:
        """The largest distance of a texel of ``image`` from its mean (of each channel); built as :meth:`deviation`."""
        t = self._types
        found = dr.gather(t.Array4f, self._spreads, t.UInt(0) if self._single else image.place, active)
        return found.x if self._texels.channels == 1 else t.Array3f(found.x, found.y, found.z)

    def deviation(self, image: Any, level: Level, column: Any, row: Any, active: Any) -> Any:
        """Root mean square of what the image is off from a block's function (as :meth:`block`; of each channel); on
        level 0 it is 0."""
        index, _, _ = self._index(image, level, column, row)
        value_type = self._types.Float if self._texels.channels == 1 else self._types.Array3f
        return dr.gather(value_type, self._deviations, index, active & ~level.full)

    def is_flat(self, level: Level) -> tuple[Any, Any]:
        """Whether blocks have a mean in place of their slope along u, and along v (Bool)."""
        return level.flags & _FLAT_U != 0, level.flags & _FLAT_V != 0

    def _index(self, image: Any, level: Level, column: Any, row: Any) -> tuple[Any, Any, Any]:
        """Where a block is, and -1 for each axis along which it is mirrored, else 1."""
        t = self._types
        border = dr.select(level.clamped, t.UInt(1), 0)
        i, sign_u = _fold(column, level.columns, image.mode, self._modes)
        j, sign_v = _fold(row, level.rows, image.mode, self._modes)
        stride = t.UInt(level.columns) + 2 * border
        return level.offset + dr.fma(t.UInt(j), stride, t.UInt(i)), sign_u, sign_v

    def _reference(self, image: int) -> list[Any]:
        return self._fetch(image, dr.opaque(self._types.UInt, 0))

    def _fetch(self, image: int, index: Any) -> list[Any]:
        t = self._types
        first = dr.opaque(t.UInt, int(self._texels.offsets[image]))
        value = dr.detach(self._texels.fetch(index + first, dr.opaque(t.Bool, bool(self._srgb[image])), True))
        return [value] if self._texels.channels == 1 else [value.x, value.y, value.z]

    def _fits(self, distances: bool) -> Iterator[tuple[int, int, list[Any]]]:
        """Every level above 0 of every image: the image, where its blocks begin, and what they are."""
        end = 0
        for i in range(len(self._sizes)):
            for made in self._levels_of(i, partial(self._fetch, i), self._reference(i), distances):
                yield i, end, made
                end += len(made[0][0])

    def _levels_of(self, image: int, fetch: Any, reference: list[Any], distances: bool) -> Iterator[list[Any]]:
        made: list[Any] = []
        stride = 0
        for u, v in self._sides(image):
            made = fits(fetch, reference, u, v, made, stride, distances, self._types)
            yield made
            stride = u.stored

    def _sides(self, image: int) -> list[tuple[Side, Side]]:
        """The sides of an image on every level above 0."""
        width, height = self._sizes[image].tolist()
        mode, near = self._wraps[image], self._nearest[image]
        levels = range(1, 1 + halvings(max(width, height)))
        return [(side(width, level, mode, near), side(height, level, mode, near)) for level in levels]

    def _flag(self, flags: Any, bit: int, occurring: Collection[bool]) -> Any:
        return flags & bit != 0 if len(occurring) > 1 else self._types.Bool(True in occurring)


class _Planes:
    """The channels of an image, as what gives those of a texel; ``buffers``: what it reads."""

    def __init__(self, planes: list[Any], types: Types) -> None:
        self.buffers = planes
        self._types = types

    def __call__(self, index: Any) -> list[Any]:
        return [dr.gather(self._types.Float, plane, index) for plane in self.buffers]


def _packed(fits_of: list[Any], types: Types) -> Any:
    """Of each channel four planes, as they are stored: the numbers of a block together."""
    count, stride = len(fits_of[0][0]), 4 * len(fits_of)
    place = dr.arange(types.UInt, count * stride)
    block = place // stride
    index = dr.fma(place - block * stride, dr.opaque(types.UInt, count), block)
    flat = dr.concat([plane for fit in fits_of for plane in fit])
    return dr.gather(types.Float, flat, index, mode=dr.ReduceMode.NoConflicts)


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


__all__ = ["BlockMeans", "Level"]
