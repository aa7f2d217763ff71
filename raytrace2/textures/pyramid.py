"""Images at half, a quarter, ... of their size, for filters that read many texels as one (Williams 1983, SIGGRAPH)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import drjit as dr
import numpy as np

from ..buffers import owned
from ..types import Types
from .halving import constants, half, halve
from .texels import Texels

# What the brightest texel of a channel is in the coarser levels of 8-bit images, which hold halves: kernels with
# negative lobes may go beyond it by as much again.
_WHITE = 2.0**15
# The last word of a level's record: where the next level begins, or that there is none; and whether the level itself
# holds halves beside 8-bit texels. Offsets are below 2^30.
_COARSE, _NO_NEXT = np.uint32(1 << 31), np.uint32((1 << 31) - 1)


class Pyramid:
    """Every level of every image of one :class:`~raytrace2.textures.texels.Texels`, down to a single texel.

    Level 0 is the image itself in its own storage; each further one has half the width and half the height, rounded
    up (:func:`~raytrace2.textures.halving.half`), and averages linear values. ``sizes`` is (images, 2): width and
    height. Levels of 8-bit and half images are halves, with relative error 2^-11 (of 8-bit images, where a channel is
    below 2^-29 of its largest value, absolute 2^-40 of that), others have the table's precision. Levels of
    a constant image are that constant to the last bit. Half values beyond 65504, which only ``"lanczos"`` can make,
    become that.
    """

    def __init__(
        self,
        texels: Texels,
        sizes: np.ndarray,
        srgb: Sequence[bool],
        modes: Sequence[int],
        types: Types,
        kernel: str = "box",
    ) -> None:
        self._types = types
        self._texels = texels
        self._single = len(sizes) == 1
        #: Levels that each image has; those beyond an image's last repeat it.
        self.levels = max(level_count(width, height) for width, height in sizes.tolist())
        records = np.zeros((len(sizes), self.levels, 4), np.uint32)
        scales = np.ones((len(sizes), 4))
        self._sizes, self._modes, self._kernel = sizes.tolist(), modes, kernel
        made: list[list[Any]] = []
        self._parts = [0]
        end = 0 if texels.is_bytes else texels.count
        for i, (width, height) in enumerate(sizes.tolist()):
            records[i, :] = int(texels.offsets[i]), width, height, _NO_NEXT
            planes = self._planes(i, width * height, srgb[i])
            if texels.is_bytes:
                scales[i, : len(planes)] = [float(np.asarray(p).max()) / _WHITE or 1.0 for p in planes]
            for level, smaller in enumerate(self._coarser(i, planes), 1):
                width, height = half(width), half(height)
                records[i, level - 1, 3] = end | records[i, level - 1, 3] & _COARSE
                records[i, level:] = end, width, height, _COARSE | _NO_NEXT
                made.append([p / types.Float(s) for p, s in zip(smaller, scales[i].tolist(), strict=False)])
                end += width * height
            self._parts.append(len(made))
        self._records = owned(records, types.UInt)
        self._coarse = texels.append(made)
        self._scales: Any = None
        if texels.is_bytes:
            self._scales = [owned(s, types.Float) for s in scales[0]] if self._single else owned(scales, types.Float)

    def appended(self, images: Mapping[int, Any]) -> dict[int, list[Any]]:
        """What :meth:`~raytrace2.textures.texels.Texels.with_images` takes as such for its ``images``."""
        made = {}
        for i, image in images.items():
            for k, planes in enumerate(self._coarser(i, self._texels.planes(image)), self._parts[i]):
                made[k] = planes
        return made

    def constants(self, images: Iterable[int]) -> list[Any]:
        """What :meth:`appended` reads besides texels."""
        found = []
        for i in images:
            width, height = self._sizes[i]
            for _ in range(1, level_count(width, height)):
                found += constants(width, height, self._kernel, self._modes[i], self._types)
                width, height = half(width), half(height)
        return found

    def _coarser(self, image: int, planes: list[Any]) -> Iterator[list[Any]]:
        """Levels 1 and on of an image of the size of number ``image`` that has these ``planes``."""
        width, height = self._sizes[image]
        for _ in range(1, level_count(width, height)):
            planes = halve(planes, width, height, self._modes[image], self._kernel, self._types)
            width, height = half(width), half(height)
            yield planes

    def level(self, image: Any, level: Any, active: Any) -> Any:
        """``image`` (:class:`~raytrace2.textures.bitmap.Image`) at ``level`` (UInt; beyond the last there is the last):
        what point filters and ``texel`` take for an image."""
        return self._at(image, self._record(image, level, active), active)

    def two_levels(self, image: Any, level: Any, active: Any) -> tuple[Any, Any, Any]:
        """``image`` at ``level`` and at the next one, and whether there is a next one (Bool)."""
        u = self._types.UInt
        record = self._record(image, level, active)
        fine = self._at(image, record, active)
        after = record.w & u(int(_NO_NEXT))
        width, height = (self._types.Float((size + 1) >> 1) for size in (record.y, record.z))
        # Only level 0 may be in a storage of its own.
        coarse = None if fine.coarse is None else True
        return fine, replace(fine, offset=after, width=width, height=height, coarse=coarse), after != u(int(_NO_NEXT))

    def _record(self, image: Any, level: Any, active: Any) -> Any:
        level = dr.select(level < self.levels, level, self.levels - 1)
        index = level if self._single else dr.fma(image.place, self.levels, level)
        return dr.gather(dr.uint32_array_t(self._types.Array4f), self._records, index, active)

    def _at(self, image: Any, record: Any, active: Any) -> Any:
        t = self._types
        coarse, scale = None, None
        if self._texels.is_bytes:
            coarse = record.w >= self._types.UInt(int(_COARSE))
            scale = self._scales if self._single else dr.gather(t.Array4f, self._scales, image.place, active)
        return replace(
            image, offset=record.x, width=t.Float(record.y), height=t.Float(record.z), coarse=coarse, scale=scale
        )

    def fetch(self, image: Any, indices: Sequence[Any], active: Any) -> list[Any]:
        """The texels ``indices`` of one of the levels that :meth:`level` gave: each an Array3f, or Float where there is
        one channel."""
        if image.coarse is None:
            return [self._texels.fetch(k, image.srgb, active) for k in indices]
        if image.coarse is True:
            return [self._half(image, k, active) for k in indices]
        # As wide as the texels: the branches need that.
        coarse = image.coarse & dr.full(self._types.Bool, True, dr.width(indices[0]))
        # Most packets of lanes are in one storage, and decoding is dear: a branch is worth it, one for all texels.
        return list(
            dr.if_stmt(
                tuple(indices),
                active & ~coarse,
                lambda *some: tuple(self._texels.fetch(k, image.srgb, True) for k in some),
                lambda *some: tuple(self._half(image, k, active & coarse) for k in some),
            )
        )

    def _half(self, image: Any, index: Any, active: Any) -> Any:
        """A texel of a level that holds halves beside 8-bit texels."""
        t = self._types
        if self._texels.channels == 1:
            return t.Float(dr.gather(type(self._coarse), self._coarse, index, active)) * image.scale[0]
        packet = dr.gather(dr.float16_array_t(t.Array4f), self._coarse, index, active)
        return t.Array3f(*(t.Float(packet[c]) * image.scale[c] for c in range(3)))

    def _planes(self, image: int, count: int, srgb: bool) -> list[Any]:
        u = self._types.UInt
        index = dr.arange(u, count) + dr.opaque(u, int(self._texels.offsets[image]))
        value = self._texels.fetch(index, self._types.Bool(srgb), True)
        planes = [value] if self._texels.channels == 1 else [value.x, value.y, value.z]
        dr.eval(planes)
        return planes


def level_count(width: int, height: int) -> int:
    """How many levels an image has."""
    return 1 + (max(width, height) - 1).bit_length()
