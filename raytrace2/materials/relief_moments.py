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
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import drjit as dr
import numpy as np

from ..scene.color import linear_pixels
from ..scene.description import BitmapTexture, Texture
from ..textures.bitmap import Bitmaps
from ..textures.filter_settings import FilterSettings
from ..textures.uv_transform import UvTransforms
from ..types import Types, types_of
from .bump import Heights, height_map
from .spread import Slopes

#: Normals of a map that lean farther than this slope (87 degrees) count as leaning so far in its moments.
STEEPEST = 20.0
_PAD = {"repeat": "wrap", "mirror": "symmetric", "clamp": "edge"}


class ReliefMoments:
    """The moments of height maps and of normal maps, each by place, filtered as ``settings`` say."""

    def __init__(
        self, heights: Sequence[Texture], normals: Sequence[BitmapTexture], types: Types, settings: FilterSettings
    ) -> None:
        self._bumps = (
            _Moments([_tiled(height_map(t)) for t in heights], gradients, types, settings) if heights else None
        )
        self._normals = _Moments(normals, slopes, types, settings) if normals else None

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
    def __init__(self, maps: Sequence[BitmapTexture], values: Any, types: Types, settings: FilterSettings) -> None:
        found = [moments(m, values) for m in maps]
        raw = [replace(m, raw=True, filter_type="bilinear") for m in maps]
        self._first = Bitmaps([replace(m, pixels=f[..., :3]) for m, f in zip(raw, found, strict=True)], types, settings)
        self._second = Bitmaps(
            [replace(m, pixels=f[..., 3:]) for m, f in zip(raw, found, strict=True)], types, settings
        )
        self._to_uv = UvTransforms([m.to_uv for m in maps], types)

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


def moments(image: BitmapTexture, values: Any) -> np.ndarray:
    """Means over each texel's square of x, y, x y, x x, y y and 0, float32 (height, width, 6).

    ``values`` (:func:`gradients` or :func:`slopes`) gives x and y of the interpolated map. It is smooth on each quarter
    of a texel, where two Gauss points a side integrate the squares of what is bilinear exactly.
    """
    pixels = linear_pixels(image).astype(np.float64)
    mode: Any = _PAD[image.wrap_mode]
    padded = np.pad(pixels, ((1, 1), (1, 1), (0, 0)), mode=mode)
    total = np.zeros((*pixels.shape[:2], 6))
    points = [0.25 + side * 0.25 / math.sqrt(3) for side in (-1, 1)]
    height, width = pixels.shape[:2]
    for dy in (0, 1):
        for dx in (0, 1):
            # The cell of four texel centres that this quarter of the texel lies in.
            corners = [padded[dy + j : dy + j + height, dx + i : dx + i + width] for j in (0, 1) for i in (0, 1)]
            for v in points:
                for u in points:
                    x, y = values(corners, u if dx else 1 - u, v if dy else 1 - v, width, height)
                    for k, moment in enumerate((x, y, x * y, x * x, y * y)):
                        total[..., k] += moment / 16
    return total.astype(np.float32)


def gradients(corners: list[np.ndarray], u: float, v: float, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    """The derivatives of a height map by its coordinates at ``u``, ``v`` within cells of four texels."""
    h00, h10, h01, h11 = (c[..., 0] for c in corners)
    return ((1 - v) * (h10 - h00) + v * (h11 - h01)) * width, ((1 - u) * (h01 - h00) + u * (h11 - h10)) * height


def slopes(corners: list[np.ndarray], u: float, v: float, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    """The slopes that the normals of a normal map stand for."""
    c00, c10, c01, c11 = corners
    n = 2 * ((1 - v) * ((1 - u) * c00 + u * c10) + v * ((1 - u) * c01 + u * c11)) - 1
    across = np.hypot(n[..., 0], n[..., 1])
    z = np.maximum(n[..., 2], np.maximum(across / STEEPEST, 1e-6))
    return -n[..., 0] / z, -n[..., 1] / z


def _tiled(image: BitmapTexture) -> BitmapTexture:
    """A mirrored image as one that repeats: its gradients change sign in the mirror, which no wrap mode does."""
    if image.wrap_mode != "mirror":
        return image
    pixels = np.concatenate([image.pixels, image.pixels[:, ::-1]], axis=1)
    pixels = np.concatenate([pixels, pixels[::-1]], axis=0)
    return replace(image, pixels=pixels, wrap_mode="repeat", to_uv=np.diag([0.5, 0.5, 1.0]) @ image.to_uv)
