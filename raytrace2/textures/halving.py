"""Images of half the size: which texels each texel of the smaller image gathers, and with what weights."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import drjit as dr
import numpy as np

from ..buffers import owned
from ..types import Types
from .wrap import CLAMP, MIRROR, REPEAT

KERNELS = ("box", "lanczos")
_LOBES = 3
# After these the means are kept to 1.1e-4 for any size.
_BALANCINGS = 30


def half(size: int) -> int:
    """Half the ``size``, rounded up: no level is coarser than its number says."""
    return (size + 1) // 2


def taps(size: int, kernel: str, mode: int) -> tuple[np.ndarray, np.ndarray]:
    """For each texel of a line of ``half(size)`` the texels of the full line that it gathers, (half, taps) of indices,
    and their weights (float64).

    ``"box"`` weighs by covered length, so means are kept for any size. ``"lanczos"`` (three lobes of the smaller grid,
    Duchon 1979) reaches over the edges as ``mode`` says; it keeps means, to 1.1e-4 of the largest value, where the
    image is repeated or mirrored, while a clamped one has its edge beyond. The weights of a texel sum to 1.
    """
    smaller = half(size)
    if size == 1:
        return np.zeros((1, 1), np.int64), np.ones((1, 1))
    i = np.arange(smaller)[:, None]
    if kernel == "box":
        # In units of 1/smaller texels every edge is a whole number.
        count = 2 if size % 2 == 0 else 3
        index = i * size // smaller + np.arange(count)
        covered = np.minimum((i + 1) * size, (index + 1) * smaller) - np.maximum(i * size, index * smaller)
        return np.minimum(index, size - 1), np.maximum(covered, 0) / size
    ratio = size / smaller
    centre = (i + 0.5) * ratio - 0.5
    index = np.ceil(centre - _LOBES * ratio).astype(np.int64) + np.arange(int(2 * _LOBES * ratio) + 1)
    x = (index - centre) / ratio
    weights = np.where(np.abs(x) < _LOBES, np.sinc(x) * np.sinc(x / _LOBES), 0.0)
    index = _wrapped(index, size, mode)
    weights /= weights.sum(axis=1, keepdims=True)
    if mode != CLAMP:
        # The nearest weights that do: alternating projections, as scaling by rows and columns diverges where weights
        # are negative.
        met = np.bincount(index.ravel(), minlength=size)
        for _ in range(_BALANCINGS):
            excess = np.bincount(index.ravel(), weights.ravel(), size) - smaller / size
            weights -= (excess / met)[index]
            weights -= (weights.sum(axis=1, keepdims=True) - 1) / index.shape[1]
    return index, weights


def halve(planes: list[Any], width: int, height: int, modes: int, kernel: str, types: Types) -> list[Any]:
    """The ``planes`` (Floats of ``width * height``, evaluated) of an image at half its size.

    A constant stays what it is to the last bit. Derivatives go through.
    """
    lines = dr.arange(types.UInt, half(width) * height)
    w = dr.opaque(types.UInt, half(width))
    row = lines // w
    planes = _gathered(planes, row * dr.opaque(types.UInt, width), lines - row * w, 1, width, kernel, modes, types)
    texels = dr.arange(types.UInt, half(width) * half(height))
    row = texels // w
    return _gathered(planes, texels - row * w, row, w, height, kernel, modes, types)


def _gathered(
    planes: list[Any], start: Any, place: Any, step: Any, size: int, kernel: str, mode: int, types: Types
) -> list[Any]:
    if size == 1:
        return planes
    indices, factors, count, apart = _buffers(size, kernel, mode, types)
    # Which says how derivatives come back: where no texel is gathered twice, no atomic operation is called for.
    gathers = dr.ReduceMode.NoConflicts if apart else dr.ReduceMode.Auto
    first: list[Any] = []
    sums: list[Any] = []
    for k in range(count):
        entry = place * count + k
        texel = start + dr.gather(types.UInt, indices, entry) * step
        values = [dr.gather(types.Float, plane, texel, mode=gathers) for plane in planes]
        if k == 0:
            first = sums = values
        else:
            # Differences to one of the texels: equal texels give that texel, whatever the weights round to.
            factor = dr.gather(types.Float, factors, entry)
            sums = [dr.fma(factor, v - f, s) for v, f, s in zip(values, first, sums, strict=True)]
    dr.eval(sums)
    return sums


def constants(width: int, height: int, kernel: str, mode: int, types: Types) -> list[Any]:
    """What :func:`halve` reads besides texels, for functions that are to be frozen, which must know of it."""
    sizes = [size for size in (width, height) if size > 1]
    return [array for size in sizes for array in _buffers(size, kernel, mode, types)[:2]]


@lru_cache(maxsize=256)
def _buffers(size: int, kernel: str, mode: int, types: Types) -> tuple[Any, Any, int, bool]:
    """The :func:`taps` for kernels, how many a texel has, and whether all are different texels.

    An optimisation halves the same sizes at every step.
    """
    index, weights = taps(size, kernel, mode)
    indices, factors = owned(index.astype(np.uint32), types.UInt), owned(weights.astype(types.numpy), types.Float)
    return indices, factors, index.shape[1], len(np.unique(index)) == index.size


def _wrapped(index: np.ndarray, size: int, mode: int) -> np.ndarray:
    if mode == REPEAT:
        return index % size
    if mode == MIRROR:
        index = index % (2 * size)
        return np.where(index < size, index, 2 * size - 1 - index)
    return np.clip(index, 0, size - 1)
