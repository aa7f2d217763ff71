"""Cubic interpolation of the texels around a point, whatever the footprint."""

from __future__ import annotations

from typing import Any

import drjit as dr


def bicubic(bitmaps: Any, image: Any, uv: Any, footprint: Any = None, settings: Any = None, active: Any = True) -> Any:
    """Catmull and Rom's cubic (1974) in both directions over 4 x 4 texels.

    It passes through the texels' values, as users of image editors expect of "bicubic", and may go beyond them beside
    edges; the B-spline would blur. A constant stays what it is to the last bit.
    """
    x, y = dr.fma(uv.x, image.width, -0.5), dr.fma(uv.y, image.height, -0.5)
    left, top = dr.floor(x), dr.floor(y)
    columns = (*bitmaps.columns(image, left - 1), *bitmaps.columns(image, left + 1))
    rows = (*bitmaps.rows(image, top - 1), *bitmaps.rows(image, top + 1))
    wx, wy = weights(x - left), weights(y - top)
    first = bitmaps.texel(image, columns[1], rows[1], active)
    result = first
    for j, row in enumerate(rows):
        for i, column in enumerate(columns):
            if (i, j) != (1, 1):
                result = dr.fma(wx[i] * wy[j], bitmaps.texel(image, column, row, active) - first, result)
    return result


def weights(t: Any) -> tuple[Any, Any, Any, Any]:
    """The weights of the texels at -1, 0, 1 and 2 for a point at ``t`` in [0, 1); they sum to 1."""
    s = 1 - t
    before, after = -0.5 * t * s * s, -0.5 * s * t * t
    return before, dr.fma(dr.fma(1.5, t, -2.5), t * t, 1), dr.fma(dr.fma(1.5, s, -2.5), s * s, 1), after
