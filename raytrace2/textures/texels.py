"""Texels of many images of one storage format in one buffer, and how one of them is fetched and decoded."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import drjit as dr
import numpy as np

from ..buffers import owned
from ..types import Types
from .color import srgb_byte_to_linear

# Packets of four address up to 2^32 scalars.
_MOST_TEXELS = 2**30
_LARGEST_HALF = 65504.0


class Texels:
    """Images of one format (dtype and 1 or 3 channels) end to end, row by row; image ``i`` starts at ``offsets[i]``.

    uint8 stays 8 bits a channel (colours as one 32-bit word, which takes one gather), float16 stays half, anything
    else has the table's precision. ``srgb[i]``: image ``i`` is decoded from sRGB, as only uint8 can be. ``ValueError``
    when there are more than 2^30 texels.
    """

    def __init__(self, images: Sequence[np.ndarray], srgb: Sequence[bool], types: Types) -> None:
        sizes = [image.shape[0] * image.shape[1] for image in images]
        self.offsets = np.concatenate(([0], np.cumsum(sizes)))[:-1]
        self.channels = images[0].shape[2]
        if sum(sizes) > _MOST_TEXELS:
            raise ValueError(f"{sum(sizes)} texels of one format are more than the {_MOST_TEXELS} that a table holds")
        self._types = types
        self._appended: list[int] = []
        self.count = sum(sizes)
        self.is_bytes = images[0].dtype == np.uint8
        self._srgb: bool | None = srgb[0] if len(set(srgb)) == 1 else None
        flat = np.concatenate([image.reshape(-1, self.channels) for image in images])
        padded = np.pad(flat, ((0, 0), (0, 1))) if self.channels == 3 else flat
        if self.is_bytes and self.channels == 3:
            padded, scalar = np.ascontiguousarray(padded).view("<u4").astype(np.uint32), types.UInt
        elif self.is_bytes:
            scalar = dr.uint8_array_t(types.Float)
        elif images[0].dtype == np.float16:
            scalar = dr.float16_array_t(types.Float)
        else:
            padded, scalar = padded.astype(types.numpy), types.Float
        self._buffer = owned(padded, scalar)

    def fetch(self, index: Any, srgb: Any, active: Any) -> Any:
        """The texel ``index`` (counted over all images), linear: Array3f, or Float where there is one channel.

        ``srgb`` (Bool) tells how to decode it where images differ in that. Inactive lanes give zero.
        """
        t = self._types
        if not self.is_bytes:
            if self.channels == 1:
                return t.Float(dr.gather(type(self._buffer), self._buffer, index, active))
            packet = dr.gather(_packet_of(t.Array4f, self._buffer), self._buffer, index, active)
            return t.Array3f(t.Float(packet.x), t.Float(packet.y), t.Float(packet.z))
        stored = dr.gather(type(self._buffer), self._buffer, index, active)
        if self.channels == 1:
            return self._decode(t.UInt(stored), srgb)
        return t.Array3f(*(self._decode((stored >> shift) & 0xFF, srgb) for shift in (0, 8, 16)))

    def append(self, images: Sequence[Sequence[Any]]) -> Any:
        """Adds linear ``images``, of each its channels (Floats), as halves or in the table's precision.

        They follow what is there, or where that is 8-bit form a buffer of halves of their own, which is returned.
        ``ValueError`` as above.
        """
        t = self._types
        self._appended = [len(image[0]) for image in images]
        first = 0 if self.is_bytes else self.count
        count = first + sum(len(image[0]) for image in images)
        if count > _MOST_TEXELS:
            raise ValueError(f"{count} texels of one format are more than the {_MOST_TEXELS} that a table holds")
        scalar = dr.float16_array_t(t.Float) if self.is_bytes else type(self._buffer)
        is_half = dr.type_v(scalar) == dr.VarType.Float16
        packet = scalar if self.channels == 1 else _packet_of(t.Array4f, scalar)
        buffer = dr.empty(scalar, max(count, 1) * (1 if self.channels == 1 else 4))
        if first:
            dr.scatter(buffer, self._buffer, dr.arange(t.UInt, len(self._buffer)))
        for image in images:
            values = [scalar(dr.fmin(dr.fmax(c, -_LARGEST_HALF), _LARGEST_HALF) if is_half else c) for c in image]
            value = values[0] if self.channels == 1 else packet(*values, 0)
            dr.scatter(buffer, value, dr.arange(t.UInt, len(image[0])) + dr.opaque(t.UInt, first))
            first += len(image[0])
        dr.eval(buffer)
        if self.is_bytes:
            return buffer
        self._buffer, self.count = buffer, count
        return None

    def with_images(self, buffer: Any, images: Mapping[int, Any], appended: Mapping[int, Sequence[Any]]) -> Any:
        """What kernels read in place of ``buffer`` for other ``images`` by number (flat, channels beside each other)
        and other channels of what was ``appended`` by number: a function with derivatives.

        It has the table's precision: halves are no good for sums of derivatives. Not for 8-bit images.
        """
        first = [*self.offsets.tolist(), self.count - sum(self._appended)]
        ends = np.cumsum([first[-1], *self._appended]).tolist()
        pieces: list[Any] = [
            self._padded(images[i], end - start) if i in images else (start, end)
            for i, (start, end) in enumerate(itertools.pairwise(first))
        ]
        pieces += [
            self._interleaved(appended[i]) if i in appended else (start, end)
            for i, (start, end) in enumerate(itertools.pairwise(ends))
        ]
        return joined(pieces, buffer, 1 if self.channels == 1 else 4, self._types)

    def planes(self, image: Any) -> list[Any]:
        """The channels of one of the images that :meth:`with_images` takes."""
        if self.channels == 1:
            return [image]
        index = dr.arange(self._types.UInt, len(image) // 3) * 3
        return [dr.gather(self._types.Float, image, index + c, mode=dr.ReduceMode.NoConflicts) for c in range(3)]

    def _padded(self, image: Any, count: int) -> Any:
        if self.channels == 1:
            return image
        place = dr.arange(self._types.UInt, 4 * count)
        texel, channel = place >> 2, place & 3
        index = dr.select(channel < 3, dr.fma(texel, 3, channel), 0)
        return dr.gather(self._types.Float, image, index, channel < 3, mode=dr.ReduceMode.NoConflicts)

    def _interleaved(self, planes: Sequence[Any]) -> Any:
        if self.channels == 1:
            return planes[0]
        count = len(planes[0])
        place = dr.arange(self._types.UInt, 4 * count)
        channel = place & 3
        index = dr.select(channel < 3, dr.fma(channel, dr.opaque(self._types.UInt, count), place >> 2), 0)
        flat = dr.concat(list(planes))
        return dr.gather(self._types.Float, flat, index, channel < 3, mode=dr.ReduceMode.NoConflicts)

    def _decode(self, byte: Any, srgb: Any) -> Any:
        linear = self._types.Float(byte) * (1.0 / 255.0)
        if self._srgb is False:
            return linear
        decoded = srgb_byte_to_linear(byte, self._types.Float)
        return decoded if self._srgb else dr.select(srgb, decoded, linear)


def joined(pieces: Sequence[Any], given: Any, stride: int, types: Types) -> Any:
    """One buffer of ``pieces``: Floats, or (first, end) for what ``given`` holds there, in units of ``stride``."""
    merged: list[Any] = []
    for piece in pieces:
        if isinstance(piece, tuple) and merged and isinstance(merged[-1], tuple) and merged[-1][1] == piece[0]:
            merged[-1] = merged[-1][0], piece[1]
        else:
            merged.append(piece)
    parts = []
    for piece in merged:
        if isinstance(piece, tuple):
            first, end = (stride * k for k in piece)
            if end == first:
                continue
            index = dr.arange(types.UInt, end - first) + dr.opaque(types.UInt, first)
            piece = types.Float(dr.gather(type(given), given, index))
        parts.append(piece)
    result = parts[0] if len(parts) == 1 else dr.concat(parts)
    dr.eval(result)
    return result


def _packet_of(array4: Any, buffer: Any) -> Any:
    return dr.float16_array_t(array4) if dr.type_v(buffer) == dr.VarType.Float16 else array4
