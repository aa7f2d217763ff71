"""The parts of triangles on either side of a plane across an axis, as boxes that enclose them."""

from __future__ import annotations

import numpy as np

from ..surfaces import record
from ..surfaces.primitives import Primitives


def triangle_corners(parts: Primitives) -> tuple[np.ndarray, np.ndarray]:
    """Corners (n, 3, 3) in float64 of the primitives that are triangles (zeros for others), and which (n,) are."""
    words = np.ascontiguousarray(parts.records[:, record.KIND])
    codes = words.view(np.uint32) if words.dtype == np.float32 else words
    is_triangle = codes == record.TRIANGLE
    corners = parts.records[:, :9].astype(np.float64).reshape(-1, 3, 3)
    return np.where(is_triangle[:, None, None], corners, 0), is_triangle


def part_boxes(
    corners: np.ndarray, axis: np.ndarray, plane: np.ndarray, dtype: np.dtype
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Boxes ((m, 3), (m, 3)) around the parts of triangles ``corners`` (m, 3, 3; float64) below and above ``plane``
    (m,) across ``axis`` (m,), rounded outwards to ``dtype``; lo > hi where there is no part.

    A cut of an edge carries a rounding error below four units of the sizes of its ends, by which boxes are widened.
    """
    rows = np.arange(len(axis))
    plane = plane.astype(np.float64)
    along = np.take_along_axis(corners, axis[:, None, None], axis=2)[:, :, 0]
    ends = [[np.full((len(axis), 3), sign) for sign in (np.inf, -np.inf)] for _ in range(2)]

    def include(side: int, least: np.ndarray, most: np.ndarray, which: np.ndarray) -> None:
        low, high = ends[side]
        np.minimum(low, least, out=low, where=which[:, None])
        np.maximum(high, most, out=high, where=which[:, None])

    for k in range(3):
        p, q = corners[:, k], corners[:, (k + 1) % 3]
        x, y = along[:, k], along[:, (k + 1) % 3]
        include(0, p, p, x <= plane)
        include(1, p, p, x >= plane)
        crosses = (x < plane) != (y < plane)
        share = np.divide(plane - x, y - x, out=np.zeros(len(x)), where=crosses)
        at = p + share[:, None] * (q - p)
        error = 2.0**-50 * (np.abs(p) + np.abs(q))
        at[rows, axis], error[rows, axis] = plane, 0
        for side in range(2):
            include(side, at - error, at + error, crosses)
    found = []
    for low, high in ends:
        below, above = low.astype(dtype), high.astype(dtype)
        below = np.where(below > low, np.nextafter(below, dtype.type(-np.inf)), below)
        above = np.where(above < high, np.nextafter(above, dtype.type(np.inf)), above)
        found.append((below, above))
    return found
