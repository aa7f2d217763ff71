"""Primitives in the order of a space-filling curve."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np

from ..types import types
from .binary_layout import middles


def sorted_codes(lo: np.ndarray, hi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sorted keys (n,) uint64, all different, and the order of the primitives that sorts them.

    A key is the Morton code of the middle of a box, of as many bits as fit above the primitive's number, and that
    number: primitives at one place are told apart by it. Cells of the code are cubes. The highest bit is zero.
    """
    n = len(lo)
    number_bits = max(1, (n - 1).bit_length())
    bits = min(20, (63 - number_bits) // 3)
    middle = middles(lo, hi)
    least, most = middle.min(axis=0), middle.max(axis=0)
    side = float(np.max(most * 0.5 - least * 0.5))
    kinds = types(str(lo.dtype))
    scale = 2.0 ** (bits - 1) / side if side > 0 else 0.0
    keys = _keys(kinds, middle, least, scale if np.isfinite(scale) else 0.0, bits, number_bits)
    keys.sort()
    return keys, (keys & np.uint64((1 << number_bits) - 1)).astype(np.int64)


def _keys(kinds: Any, middle: np.ndarray, least: np.ndarray, scale: float, bits: int, number_bits: int) -> np.ndarray:
    Float, UInt, UInt64 = kinds.Float, kinds.UInt, kinds.UInt64
    code = UInt64(0)
    for axis in range(3):
        offset, factor, limit = (dr.opaque(Float, float(x)) for x in (least[axis], scale, 2**bits - 1))
        place = (Float(np.ascontiguousarray(middle[:, axis])) - offset) * factor
        code |= _spread(UInt64(UInt(dr.fmin(dr.fmax(place, 0), limit)))) << (2 - axis)
    code = (code << dr.opaque(UInt64, number_bits)) | UInt64(dr.arange(UInt, len(middle)))
    return code.numpy()


def _spread(x: Any) -> Any:
    """The low 21 bits of each number, three apart (Lauterbach et al. 2009)."""
    for shift, mask in (
        (32, 0x001F00000000FFFF),
        (16, 0x001F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    ):
        x = (x | (x << shift)) & mask
    return x
