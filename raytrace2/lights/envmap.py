"""Environment maps: latitude-longitude images at infinity, sampled in proportion to luminance times sin(theta).

The image has texel centres at phi = 2 pi (x + 1/2) / width, periodic, and at theta = pi y / (height - 1), so that its
first and last rows are the poles; local y points to the top row and -z to phi = 0. Between centres both the radiance
and the sampling density are bilinear, and they share the four texels of one lookup. All of this agrees with Mitsuba's
``envmap`` but for the density in the two rows of cells at the poles, which is kept above 0.

With a texture filter that heeds footprints, rays that leave the scene see the mean over theirs (:mod:`.filtered_map`)
where they come from the camera or from mirrors and glass; those that a rough surface chose see the image itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, sin
from typing import Any

import drjit as dr
import numpy as np

from ..errors import FileError, Location, Problem, SceneError
from ..live import STILL, Live
from ..scene import description
from ..textures.filter_settings import FilterSettings
from ..types import Types, types_of
from . import cdf
from .filtered_map import FilteredMap
from .infinite import BoundingSphere
from .sample import LightSample, finite_or_zero, pack

_LUMINANCE = (0.212671, 0.715160, 0.072169)


@dataclass(frozen=True, eq=False)
class EnvironmentMap:
    """``texels``: (height, width + 1) records of radiance (3) and density over the unit square; the last column repeats
    the first. ``rows`` and ``columns``: cumulative distributions of the rows of cells, and of the cells in each row.
    ``rotation``: the rows of local to world."""

    types: Types
    sphere: BoundingSphere
    texels: Any
    rows: Any
    columns: Any
    width: Any
    height: Any
    halvings: tuple[int, int]
    rotation: tuple[Any, ...]
    filtered: FilteredMap | None = None

    @staticmethod
    def build(
        light: description.EnvironmentLight,
        sphere: BoundingSphere,
        types: Types,
        settings: FilterSettings | None = None,
        live: Live = STILL,
    ) -> EnvironmentMap:
        """Looked up as ``settings`` say.

        Raises ``FileError`` for pixels that are not finite, ``SceneError`` for a ``to_world`` that is not a rotation
        and uniform scale, under which densities would not keep their meaning.
        """
        radiance = _padded(np.asarray(light.pixels, dtype=np.float64)) * light.scale
        if not np.isfinite(radiance).all() or np.abs(radiance).max() > types.largest:
            raise FileError(
                "environment map with NaN, infinite or overflowing pixels",
                light.filename or "envmap",
                remedy="replace those pixels by finite values",
            )
        height, width = radiance.shape[:2]
        filtered = None
        if settings is not None and settings.needs_footprint:
            filtered = FilteredMap(radiance, types, settings, live.has(light, "pixels", "scale"))
        sines = np.sin(np.arange(height) * (pi / (height - 1)))
        # A density of 0 at the poles would never find a bright pole beside a dark row, and give it unbounded weights.
        sines[[0, -1]] = sin(pi / (4 * (height - 1)))
        radiance = np.concatenate([radiance, radiance[:, :1]], axis=1)
        density = np.abs(radiance @ np.array(_LUMINANCE)) * sines[:, None]
        peak = density.max()
        density = density / peak if peak > 0 else density
        across = density[:, :-1] + density[:, 1:]
        cells = 0.25 * (across[:-1] + across[1:])
        mean = cells.mean()
        density = density / mean if peak > 0 else density
        rotation = check_rotation(light)
        return EnvironmentMap(
            types,
            sphere,
            texels=pack(np.concatenate([radiance, density[..., None]], axis=-1), types),
            rows=pack(cdf.cumulative(cells.sum(axis=1)), types),
            columns=pack(cdf.cumulative(cells), types),
            width=dr.opaque(types.UInt, width),
            height=dr.opaque(types.UInt, height),
            halvings=(cdf.steps(height - 1), cdf.steps(width)),
            rotation=tuple(types.Array3f(*(dr.opaque(types.Float, float(c)) for c in row)) for row in rotation),
            filtered=filtered,
        )

    def sample(self, p: Any, u: Any, active: Any) -> LightSample:
        """A direction drawn with the map's density, from ``u`` (Array2f)."""
        types = self.types
        y, v = cdf.invert(self.rows, types.UInt(0), self.height - 1, self.halvings[0], u.y, active)
        x, s = cdf.invert(self.columns, y * (self.width + 1), self.width, self.halvings[1], u.x, active)
        corners = self._corners(x, y, active)
        density = [c.w for c in corners]
        v = _sample_linear(density[0] + density[1], density[2] + density[3], v)
        s = _sample_linear(dr.lerp(density[0], density[2], v), dr.lerp(density[1], density[3], v), s)
        texel = _bilinear(corners, s, v)

        theta = (types.Float(y) + v) * (pi / types.Float(self.height - 1))
        phi = (types.Float(x) + s + 0.5) * (2 * pi / types.Float(self.width))
        sin_theta, cos_theta = dr.sincos(theta)
        sin_phi, cos_phi = dr.sincos(phi)
        sin_theta = dr.fmax(sin_theta, 0)
        local = types.Array3f(sin_phi * sin_theta, cos_theta, -cos_phi * sin_theta)
        d = types.Array3f(*(dr.dot(row, local) for row in self.rotation))
        pdf = _per_steradian(texel.w, sin_theta)
        dist = self.sphere.beyond(p)
        weight, pdf = finite_or_zero(texel.xyz / pdf, pdf, active)
        return LightSample(d, dist, weight, pdf, types.Bool(False), dr.fma(d, dist, p))

    def eval_pdf(self, d: Any, active: Any) -> tuple[Any, Any]:
        """Radiance (Array3f) from the world direction ``d``, and the density with which :meth:`sample` takes it."""
        types = self.types
        local = self.rotation[0] * d.x + self.rotation[1] * d.y + self.rotation[2] * d.z
        # The angle from the pole by atan2, not acos: texels at the poles span less than acos can resolve.
        sin_theta = dr.safe_sqrt(local.x * local.x + local.z * local.z)
        off_pole = sin_theta > 0
        theta = dr.atan2(sin_theta, dr.select(active, local.y, 1))
        phi = dr.select(off_pole, dr.atan2(local.x, dr.select(off_pole, -local.z, 1)), 0)
        width, height = types.Float(self.width), types.Float(self.height)
        column = phi * (width * (0.5 / pi)) - 0.5
        column = dr.select(column < 0, column + width, column)
        row = theta * ((height - 1) * (1 / pi))
        x = dr.fmax(dr.fmin(dr.floor(column), width - 1), 0)
        y = dr.fmax(dr.fmin(dr.floor(row), height - 2), 0)
        texel = _bilinear(self._corners(types.UInt(x), types.UInt(y), active), column - x, dr.fmin(row - y, 1))
        pdf = _per_steradian(texel.w, sin_theta)
        return dr.select(active, texel.xyz, 0), dr.select(active, pdf, 0)

    def eval_over(self, d: Any, turns: tuple[Any, Any], active: Any) -> Any:
        """Radiance (Array3f) from around the world direction ``d``, which changes by ``turns`` (two Array3f) towards
        the next samples."""
        assert self.filtered is not None
        local, right, down = (
            self.rotation[0] * v.x + self.rotation[1] * v.y + self.rotation[2] * v.z for v in (d, *turns)
        )
        return dr.select(active, self.filtered.eval(local, (right, down), active), 0)

    def _corners(self, x: Any, y: Any, active: Any) -> list[Any]:
        stride = self.width + 1
        first = y * stride + x
        return [dr.gather(self.types.Array4f, self.texels, first + step, active) for step in (0, 1, stride, stride + 1)]


def _bilinear(corners: list[Any], s: Any, v: Any) -> Any:
    return dr.lerp(dr.lerp(corners[0], corners[1], s), dr.lerp(corners[2], corners[3], s), v)


def _sample_linear(a: Any, b: Any, u: Any) -> Any:
    """Inverts the distribution on [0, 1] whose density is linear from ``a`` to ``b``, both >= 0."""
    divisor = a + dr.safe_sqrt(dr.lerp(a * a, b * b, u))
    return dr.fmin(u * (a + b) / dr.select(divisor > 0, divisor, 1), 1)


def _padded(pixels: np.ndarray) -> np.ndarray:
    """At least 2 columns and 3 rows, by repeating the last; poles and periods need that many."""
    rows, columns = max(3 - pixels.shape[0], 0), max(2 - pixels.shape[1], 0)
    return np.pad(pixels, ((0, rows), (0, columns), (0, 0)), mode="edge")


def check_rotation(light: description.EnvironmentLight) -> np.ndarray:
    """The rotation of ``light``; ``SceneError`` if its ``to_world`` is none but for an even scale."""
    linear = np.asarray(light.to_world, dtype=np.float64)[:3, :3]
    rotation: np.ndarray = linear / max(abs(np.linalg.det(linear)) ** (1 / 3), np.finfo(float).tiny)
    if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-4):
        location = Location(light.filename) if light.filename else None
        raise SceneError(
            [
                Problem(
                    "environment map whose to_world is not a rotation",
                    location,
                    "leave shear and uneven scale out of to_world",
                )
            ]
        )
    return rotation


def _per_steradian(density: Any, sin_theta: Any) -> Any:
    # The floor keeps the quotient finite at the poles.
    return density / ((2 * pi * pi) * dr.fmax(sin_theta, types_of(density).epsilon ** 2))
