"""Texture look-ups that pay no heed to a pixel's footprint: the nearest texel, and bilinear interpolation.

``bitmaps`` is a :class:`~raytrace2.textures.bitmap.Bitmaps`, ``uv`` (Array2f) is in the texture's coordinates. Where
one is infinite or NaN, the bilinear look-up gives NaN and the nearest one some texel.
"""

from __future__ import annotations

from typing import Any

import drjit as dr


def nearest(bitmaps: Any, image: Any, uv: Any, footprint: Any = None, settings: Any = None, active: Any = True) -> Any:
    """The texel that ``uv`` lies in."""
    column, _ = bitmaps.columns(image, dr.floor(uv.x * image.width))
    row, _ = bitmaps.rows(image, dr.floor(uv.y * image.height))
    return bitmaps.texel(image, column, row, active)


def bilinear(bitmaps: Any, image: Any, uv: Any, footprint: Any = None, settings: Any = None, active: Any = True) -> Any:
    """The four texels whose centres surround ``uv``, interpolated."""
    x = dr.fma(uv.x, image.width, -0.5)
    y = dr.fma(uv.y, image.height, -0.5)
    left, top = dr.floor(x), dr.floor(y)
    wx, wy = x - left, y - top
    column0, column1 = bitmaps.columns(image, left)
    row0, row1 = bitmaps.rows(image, top)
    places = [(column0, row0), (column1, row0), (column0, row1), (column1, row1)]
    v00, v10, v01, v11 = bitmaps.several(image, places, active)
    # Differences keep constants to the last bit.
    v0 = dr.fma(wx, v10 - v00, v00)
    v1 = dr.fma(wx, v11 - v01, v01)
    return dr.fma(wy, v1 - v0, v0)
