"""Texels of many images of one storage format in one buffer, and how one of them is fetched and decoded."""

from __future__ import annotations

from collections.abc import Sequence
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

    def _decode(self, byte: Any, srgb: Any) -> Any:
        linear = self._types.Float(byte) * (1.0 / 255.0)
        if self._srgb is False:
            return linear
        decoded = srgb_byte_to_linear(byte, self._types.Float)
        return decoded if self._srgb else dr.select(srgb, decoded, linear)


def _packet_of(array4: Any, buffer: Any) -> Any:
    return dr.float16_array_t(array4) if dr.type_v(buffer) == dr.VarType.Float16 else array4
