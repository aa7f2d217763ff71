"""The parts of primitives on the two sides of a plane across an axis, as boxes that enclose them."""

from __future__ import annotations

import numpy as np

from ..surfaces import record
from ..surfaces.primitives import Primitives


def triangle_corners(parts: Primitives) -> tuple[np.ndarray, np.ndarray]:
    """Corners (n, 3, 3) in float64 of the primitives that are triangles, and which (n,) are; others' mean nothing."""
    words = np.ascontiguousarray(parts.records[:, record.KIND])
    codes = words.view(np.uint32) if words.dtype == np.float32 else words.astype(np.uint32)
    return parts.records[:, :9].astype(np.float64).reshape(-1, 3, 3), codes == record.TRIANGLE


def clip_boxes(
    lo: np.ndarray, hi: np.ndarray, axis: np.ndarray, begin: np.ndarray, end: np.ndarray, corners: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Boxes around triangles ``corners`` (m, 3, 3) between the planes ``begin`` and ``end`` (m,) across ``axis`` (m,),
    each within the box ``lo``, ``hi`` (m, 3) that it had; a box with lo > hi holds nothing.

    A cut of an edge carries a rounding error below eight units of its ends' sizes; boxes are widened by as much and
    rounded outwards, so that they enclose.
    """
    rows = np.arange(len(axis))
    begin, end = begin.astype(np.float64), end.astype(np.float64)
    least, most = np.full(lo.shape, np.inf), np.full(lo.shape, -np.inf)
    for k in range(3):
        p, q = corners[:, k], corners[:, (k + 1) % 3]
        x, y = p[rows, axis], q[rows, axis]
        step = q - p
        error = 2.0**-50 * (np.abs(p) + np.abs(q))
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            inverse = 1 / (y - x)
            meets = (np.minimum(x, y) <= end) & (np.maximum(x, y) >= begin)
            for at in (begin, end):
                crosses = meets & ((x < at) != (y < at))
                cut = p + ((at - x) * inverse)[:, None] * step
                cut[~crosses] = np.nan
                least, most = np.fmin(least, cut - error), np.fmax(most, cut + error)
        inside = (x >= begin) & (x <= end)
        corner = np.where(inside[:, None], p, np.nan)
        least, most = np.fmin(least, corner), np.fmax(most, corner)
    below, above = least.astype(lo.dtype), most.astype(lo.dtype)
    below = np.where(below > least, np.nextafter(below, lo.dtype.type(-np.inf)), below)
    above = np.where(above < most, np.nextafter(above, lo.dtype.type(np.inf)), above)
    below, above = np.maximum(below, lo), np.minimum(above, hi)
    # The cut itself is where it was made, whatever the rounding.
    below[rows, axis] = np.maximum(lo[rows, axis], begin.astype(lo.dtype))
    above[rows, axis] = np.minimum(hi[rows, axis], end.astype(lo.dtype))
    return below, above
