"""Gradients of height maps, and the normals of surfaces that they displace."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import drjit as dr
import numpy as np

from ..scene.color import linear_pixels
from ..scene.description import BitmapTexture, ConstantTexture, Texture
from ..textures.bitmap import Bitmaps
from ..textures.uv_transform import UvTransforms
from ..types import Types

_LUMINANCE = (0.212671, 0.715160, 0.072169)


class Heights:
    """Height maps by place."""

    def __init__(self, textures: Sequence[Texture], types: Types) -> None:
        maps = [height_map(texture) for texture in textures]
        if any(m.pixels.dtype != np.uint8 for m in maps):
            maps = [replace(m, pixels=linear_pixels(m), raw=True) for m in maps]
        self._bitmaps = Bitmaps(maps, types)
        self._to_uv = UvTransforms([m.to_uv for m in maps], types)

    def gradient(self, place: Any, uv: Any, active: Any) -> Any:
        """The derivatives (Array2f) of the bilinear height by u and v of the surface.

        They are exact, and may be differentiated once more where ``uv`` carries derivatives.
        """
        bitmaps = self._bitmaps
        image = bitmaps.image(place, active)
        at = self._to_uv.apply(place, uv, active)
        x, y = dr.fma(at.x, image.width, -0.5), dr.fma(at.y, image.height, -0.5)
        left, top = dr.floor(x), dr.floor(y)
        wx, wy = x - left, y - top
        columns, rows = bitmaps.columns(image, left), bitmaps.rows(image, top)
        h00, h10, h01, h11 = (bitmaps.texel(image, c, r, active) for r in rows for c in columns)
        du = dr.fma(1 - wy, h10 - h00, wy * (h11 - h01)) * image.width
        dv = dr.fma(1 - wx, h01 - h00, wx * (h11 - h10)) * image.height
        return self.to_surface(place, type(uv)(du, dv), active)

    def to_surface(self, place: Any, gradient: Any, active: Any) -> Any:
        """A gradient by the texture's coordinates as one by those of the surface."""
        if self._to_uv.identity:
            return gradient
        linear = self._to_uv.apply_linear(place, active)
        Vector = type(gradient)
        return Vector(dr.dot(linear(Vector(1, 0)), gradient), dr.dot(linear(Vector(0, 1)), gradient))


def height_map(texture: Texture) -> BitmapTexture:
    """``texture`` as an image of one channel: luminance of colours; a flat one for constants and for images that are
    looked up by their nearest texel. ``ValueError`` for what is no image."""
    if isinstance(texture, ConstantTexture) or (
        isinstance(texture, BitmapTexture) and texture.filter_type == "nearest"
    ):
        return BitmapTexture(np.zeros((1, 1, 1), np.uint8), raw=True)
    if not isinstance(texture, BitmapTexture):
        raise ValueError(f"a {type(texture).__name__} has no gradient for a bump map; use a bitmap")
    if texture.pixels.shape[2] == 1:
        return texture
    return replace(texture, pixels=linear_pixels(texture) @ np.array(_LUMINANCE, np.float32)[:, None], raw=True)


def tangent_slopes(dp_du: Any, dp_dv: Any) -> tuple[Any, Any]:
    """The derivatives of u and of v (Array2f each) along the two axes of the shading frame, in which ``dp_du`` and
    ``dp_dv`` are given; zero where the parameterisation is singular.

    With ``h`` the gradient of a height by uv, its slopes along the axes are ``h.x * du + h.y * dv``.
    """
    from ..types import types_of

    Vector = types_of(dp_du).Array2f
    determinant = dp_du.x * dp_dv.y - dp_du.y * dp_dv.x
    regular = determinant != 0
    inverse = dr.select(regular, dr.rcp(dr.select(regular, determinant, 1)), 0)
    return Vector(dp_dv.y, -dp_dv.x) * inverse, Vector(-dp_du.y, dp_du.x) * inverse
