"""Bump and normal maps over footprints: not only the mean of their normals, which makes a smooth surface of a rough
one, but how they spread about it.

The first and second moments of slopes filter linearly, as colours do (Olano and Baker, "LEAN mapping", 2010), by
whatever filter textures have. Materials that can be widened take the covariance into themselves (``widens``: see
:mod:`.spread`); others see the surface with one slope drawn from the Gaussian of these moments, whose expectation is
the widened shading of any material.

Two things differ from that paper. Texels hold the moments of the map as it is *interpolated*, integrated over the
texel's square (not those of the texel itself, whose variance exceeds that of the interpolation by up to 9/4). And
footprints shorter than a texel go over to the map itself, by the square of their length as the variance of a smooth
function does: under magnification there is no filtering at all.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, TypeAlias

import drjit as dr
import numpy as np

from ..live import STILL, Live, Place, Slot, Values, derived_each
from ..scene.color import linear_pixels
from ..scene.description import BitmapTexture, Texture
from ..textures.bitmap import Bitmaps
from ..textures.filter_settings import FilterSettings
from ..textures.uv_transform import UvTransforms
from ..types import Types, types_of
from ..types import types as wide_types
from .bump import Heights, height_map, is_flat, luminances
from .spread import Slopes

#: Normals of a map that lean farther than this slope (87 degrees) count as leaning so far in its moments.
STEEPEST = 20.0
WIDE = wide_types("float64")
_Slopes: TypeAlias = Callable[[list[Any], float, float, int, int], tuple[Any, Any]]


class ReliefMoments:
    """The moments of height maps and of normal maps, each by place, filtered as ``settings`` say."""

    def __init__(
        self,
        heights: Sequence[Texture],
        normals: Sequence[BitmapTexture],
        types: Types,
        settings: FilterSettings,
        live: Live = STILL,
    ) -> None:
        self._bumps = self._normals = None
        if heights:
            maps = [_tiled(height_map(t)) for t in heights]
            self._bumps = _Moments(maps, heights, gradients, types, settings, live)
        if normals:
            self._normals = _Moments(normals, normals, slopes, types, settings, live)

    def slots(self) -> list[Slot]:
        """Those of live maps."""
        return [slot for table in (self._bumps, self._normals) if table is not None for slot in table.slots()]

    def bumps(self, heights: Heights, place: Any, si: Any, axes: tuple[Any, Any], active: Any) -> tuple[Slopes, Any]:
        """The slopes in the footprint, along the axes of the shading frame, and how far (Float in [0, 1]) they shall
        replace the map's own; ``axes`` take gradients by u and v to slopes."""
        assert self._bumps is not None
        mean, (xx, xy, yy), share = self._bumps.at(place, si, active)
        Vector = type(mean)
        # The columns of the map from gradients by the texture's coordinates to slopes.
        by_u, by_v = (heights.to_surface(place, Vector(*e), active) for e in ((1, 0), (0, 1)))
        a, b = (axes[0] * g.x + axes[1] * g.y for g in (by_u, by_v))
        turned = tuple(
            p * q * xx + (p * s + q * r) * xy + r * s * yy
            for p, q, r, s in ((a.x, a.x, b.x, b.x), (a.x, a.y, b.x, b.y), (a.y, a.y, b.y, b.y))
        )
        return Slopes(a * mean.x + b * mean.y, *turned), share

    def normals(self, place: Any, si: Any, active: Any) -> tuple[Slopes, Any]:
        """As :meth:`bumps`, of a normal map."""
        assert self._normals is not None
        mean, covariance, share = self._normals.at(place, si, active)
        return Slopes(mean, *covariance), share


class _Moments:
    """The moments of ``maps``, which were made of ``textures``."""

    def __init__(
        self,
        maps: Sequence[BitmapTexture],
        textures: Sequence[Texture],
        values: _Slopes,
        types: Types,
        settings: FilterSettings,
        live: Live,
    ) -> None:
        images = [WIDE.TensorXf(np.ascontiguousarray(linear_pixels(m), np.float64)) for m in maps]
        found = [moments(i, m.wrap_mode, values) for i, m in zip(images, maps, strict=True)]
        raw = [replace(m, raw=True, filter_type="bilinear") for m in maps]
        pixels = [[f[k].numpy().astype(np.float32) for f in found] for k in (0, 1)]
        first, second = ([replace(m, pixels=p) for m, p in zip(raw, some, strict=True)] for some in pixels)
        owners = [m if is_flat(t) else t for m, t in zip(maps, textures, strict=True)]
        self._first = Bitmaps(first, types, settings, live.standing_for(first, owners))
        self._second = Bitmaps(second, types, settings, live.standing_for(second, owners))
        live = live.standing_for(maps, owners)
        self._to_uv = UvTransforms([m.to_uv for m in maps], types, [live.place(m, "to_uv") for m in maps])
        self._values, self._types = values, types
        #: By place: whether the map is four copies of its texture, its wrap mode and its channels.
        self._made: dict[Place, tuple[bool, str, int]] = {}
        for m, t in zip(maps, textures, strict=True):
            four = isinstance(t, BitmapTexture) and t.wrap_mode != m.wrap_mode
            for field in ("pixels", "to_uv"):
                if (place := live.place(m, field)) is not None:
                    self._made[place] = four, m.wrap_mode, m.pixels.shape[2]

    def slots(self) -> list[Slot]:
        """Those of live maps."""
        found = derived_each(self._first.slots(moves=True), self._through(0))
        found += derived_each(self._second.slots(moves=True), self._through(1))
        return found + derived_each(self._to_uv.slots(moves=True), self._through(0))

    def _through(self, which: int) -> Callable[[Values], Values]:
        def value_of(place: Place, values: Values) -> Any:
            four, mode, channels = self._made[place]
            value = values(place)
            if place.field == "to_uv":
                half = type(value)(0.5, 0, 0, 0, 0.5, 0, 0, 0, 1)
                return half @ value if four else value
            value = WIDE.TensorXf(WIDE.Float(value.array), value.shape)
            value = luminances(value) if channels == 1 else value
            image = moments(four_copies(value) if four else value, mode, self._values)[which]
            return self._types.TensorXf(self._types.Float(image.array), image.shape)

        return lambda values: lambda place: value_of(place, values)

    def at(self, place: Any, si: Any, active: Any) -> tuple[Any, tuple[Any, Any, Any], Any]:
        """Mean (Array2f), covariance (xx, xy, yy) and how much of a texel the footprint covers (Float, at most 1)."""
        first = self._first.eval(place, si.uv, si.footprint, active)
        second = self._second.eval(place, si.uv, si.footprint, active)
        mean = types_of(first).Array2f(first.x, first.y)
        xx, yy = dr.fmax(second.x - mean.x * mean.x, 0), dr.fmax(second.y - mean.y * mean.y, 0)
        image = self._first.image(place, active)
        linear = self._to_uv.apply_linear(place, active)
        longest: Any = 0
        for v in (si.footprint.dx, si.footprint.dy):
            v = linear(v)
            longest = dr.fmax(longest, dr.square(v.x * image.width) + dr.square(v.y * image.height))
        return mean, (xx, first.z - mean.x * mean.y, yy), dr.fmin(longest, 1)


def moments(image: Any, mode: str, values: _Slopes) -> tuple[Any, Any]:
    """Means over each texel's square of x, y, x y and of x x, y y, 0: two images for one, TensorXf in float64.

    ``values`` (:func:`gradients` or :func:`slopes`) gives x and y of the interpolated map. It is smooth on each quarter
    of a texel, where two Gauss points a side integrate the squares of what is bilinear exactly.
    """
    height, width, channels = image.shape
    UInt, Float = WIDE.UInt, WIDE.Float
    texel = dr.arange(UInt, height * width)
    x, y = WIDE.Int(texel % width), WIDE.Int(texel // width)

    def beside(dx: int, dy: int) -> list[Any]:
        column, row = _wrapped(x + dx, width, mode), _wrapped(y + dy, height, mode)
        index = UInt(row * width + column) * channels
        return [dr.gather(Float, image.array, index + k) for k in range(channels)]

    near = {(dx, dy): beside(dx, dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1)}
    total = [Float(0)] * 5
    points = [0.25 + side * 0.25 / math.sqrt(3) for side in (-1, 1)]
    for dy in (0, 1):
        for dx in (0, 1):
            # The cell of four texel centres that this quarter of the texel lies in.
            corners = [near[dx + i - 1, dy + j - 1] for j in (0, 1) for i in (0, 1)]
            for v in points:
                for u in points:
                    a, b = values(corners, u if dx else 1 - u, v if dy else 1 - v, width, height)
                    total = [t + m / 16 for t, m in zip(total, (a, b, a * b, a * a, b * b), strict=True)]
    return _image(total[:3], height, width), _image([*total[3:], Float(0)], height, width)


def _wrapped(at: Any, size: int, mode: str) -> Any:
    """``at``, at most one texel outside, as a texel of the image."""
    if mode == "repeat":
        return dr.select(at < 0, at + size, dr.select(at >= size, at - size, at))
    # An edge goes on as itself, mirrored or not.
    return dr.clip(at, 0, size - 1)


def _image(planes: list[Any], height: int, width: int) -> Any:
    flat = dr.zeros(WIDE.Float, 3 * height * width)
    index = dr.arange(WIDE.UInt, height * width) * 3
    for k, plane in enumerate(planes):
        dr.scatter(flat, plane, index + k)
    return WIDE.TensorXf(flat, (height, width, 3))


def gradients(corners: list[Any], u: float, v: float, width: int, height: int) -> tuple[Any, Any]:
    """The derivatives of a height map by its coordinates at ``u``, ``v`` within cells of four texels."""
    h00, h10, h01, h11 = (c[0] for c in corners)
    return ((1 - v) * (h10 - h00) + v * (h11 - h01)) * width, ((1 - u) * (h01 - h00) + u * (h11 - h10)) * height


def slopes(corners: list[Any], u: float, v: float, width: int, height: int) -> tuple[Any, Any]:
    """The slopes that the normals of a normal map stand for."""
    x, y, z = (
        2 * ((1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * c + u * d)) - 1
        for a, b, c, d in zip(*corners, strict=True)
    )
    across2 = x * x + y * y
    across = dr.sqrt(dr.select(across2 > 0, across2, 1))
    across = dr.select(across2 > 0, across, 0)
    z = dr.fmax(z, dr.fmax(across / STEEPEST, 1e-6))
    return -x / z, -y / z


def four_copies(image: Any) -> Any:
    """An image (TensorXf), mirrored to the right and down."""
    height, width, channels = image.shape
    texel = dr.arange(WIDE.UInt, 4 * height * width * channels)
    k, x, y = texel % channels, texel // channels % (2 * width), texel // (channels * 2 * width)
    x, y = dr.select(x < width, x, 2 * width - 1 - x), dr.select(y < height, y, 2 * height - 1 - y)
    flat = dr.gather(WIDE.Float, image.array, (y * width + x) * channels + k)
    return type(image)(flat, (2 * height, 2 * width, channels))


def _tiled(image: BitmapTexture) -> BitmapTexture:
    """A mirrored image as one that repeats: its gradients change sign in the mirror, which no wrap mode does."""
    if image.wrap_mode != "mirror":
        return image
    pixels = np.concatenate([image.pixels, image.pixels[:, ::-1]], axis=1)
    pixels = np.concatenate([pixels, pixels[::-1]], axis=0)
    return replace(image, pixels=pixels, wrap_mode="repeat", to_uv=np.diag([0.5, 0.5, 1.0]) @ image.to_uv)
