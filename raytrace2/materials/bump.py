"""Gradients of height maps, and the normals of surfaces that they displace."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import drjit as dr
import numpy as np

from ..live import STILL, Live, Slot, Values, derived_each
from ..scene.color import linear_pixels
from ..scene.description import BitmapTexture, ConstantTexture, Texture
from ..textures.bitmap import Bitmaps
from ..textures.uv_transform import UvTransforms
from ..types import Types

_LUMINANCE = (0.212671, 0.715160, 0.072169)


class Heights:
    """Height maps by place."""

    def __init__(self, textures: Sequence[Texture], types: Types, live: Live = STILL) -> None:
        maps = [height_map(texture) for texture in textures]
        if any(m.pixels.dtype != np.uint8 for m in maps):
            maps = [replace(m, pixels=linear_pixels(m), raw=True) for m in maps]
        # A flat map stays flat, whatever it is made of.
        live = live.standing_for(maps, [m if is_flat(t) else t for m, t in zip(maps, textures, strict=True)])
        self._bitmaps = Bitmaps(maps, types, live=live)
        self._to_uv = UvTransforms([m.to_uv for m in maps], types, [live.place(m, "to_uv") for m in maps])

    def slots(self) -> list[Slot]:
        """Those of live maps, of which colours count by their luminance."""

        def through(values: Values) -> Values:
            return lambda place: luminances(values(place)) if place.field == "pixels" else values(place)

        found = derived_each(self._bitmaps.slots(moves=True), through)
        return found + self._to_uv.slots(moves=True)

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
    if is_flat(texture):
        return BitmapTexture(np.zeros((1, 1, 1), np.uint8), raw=True)
    if not isinstance(texture, BitmapTexture):
        raise ValueError(f"a {type(texture).__name__} has no gradient for a bump map; use a bitmap")
    if texture.pixels.shape[2] == 1:
        return texture
    return replace(texture, pixels=linear_pixels(texture) @ np.array(_LUMINANCE, np.float32)[:, None], raw=True)


def is_flat(texture: Texture) -> bool:
    """Whether a texture has no gradient anywhere."""
    return isinstance(texture, ConstantTexture) or (
        isinstance(texture, BitmapTexture) and texture.filter_type == "nearest"
    )


def luminances(image: Any) -> Any:
    """An image (TensorXf) of one channel; itself if it has no more."""
    if image.shape[2] == 1:
        return image
    Float = type(image.array)
    texel = dr.arange(dr.uint32_array_t(Float), image.shape[0] * image.shape[1]) * 3
    value = sum(dr.gather(Float, image.array, texel + k) * weight for k, weight in enumerate(_LUMINANCE))
    return type(image)(value, (*image.shape[:2], 1))


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
