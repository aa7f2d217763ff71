"""Distributions of microfacet normals: Beckmann and GGX, anisotropic, with Smith's shadowing (Walter et al. 2007; Heitz
2014), sampled by all normals or by visible ones.

Directions are in the shading frame. Where a table holds both kinds, ``ggx`` is a Bool per lane; else a Python bool, and
the other kind is not in the kernel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import drjit as dr

from ..types import types_of
from ..warp import square_to_uniform_disk_concentric

_INV_SQRT_PI = 1 / math.sqrt(math.pi)
#: Mitsuba's: densities below it count as none, and roughness is at least this.
_LEAST_DENSITY, _LEAST_ALPHA = 1e-20, 1e-4


@dataclass
class Microfacets:
    """``alpha_u`` and ``alpha_v`` (Float) are the roughness along x and y; ``ggx`` and ``visible`` tell the kind of
    distribution and of sampling (Bool, or bool where all agree)."""

    alpha_u: Any
    alpha_v: Any
    ggx: Any
    visible: Any

    def __post_init__(self) -> None:
        self.alpha_u = dr.fmax(self.alpha_u, _LEAST_ALPHA)
        self.alpha_v = dr.fmax(self.alpha_v, _LEAST_ALPHA)

    def density(self, m: Any) -> Any:
        """Microfacets of normal ``m``, per steradian and area of the surface."""
        area = self.alpha_u * self.alpha_v
        stretched = dr.square(m.x / self.alpha_u) + dr.square(m.y / self.alpha_v)
        cos2 = m.z * m.z

        def ggx() -> Any:
            return dr.rcp(math.pi * area * dr.square(stretched + cos2))

        def beckmann() -> Any:
            safe = dr.select(cos2 > 0, cos2, 1)
            return dr.select(cos2 > 0, dr.exp(-stretched / safe) / (math.pi * area * safe * safe), 0)

        result = _choose(self.ggx, ggx, beckmann)
        return dr.select(result * m.z > _LEAST_DENSITY, result, 0)

    def visibility(self, v: Any, m: Any) -> Any:
        """The share of microfacets of normal ``m`` that is seen from ``v`` (Smith's G1)."""
        xy2 = dr.square(self.alpha_u * v.x) + dr.square(self.alpha_v * v.y)
        tan2 = xy2 / (v.z * v.z)
        upright = xy2 == 0

        def ggx() -> Any:
            return 2 / (1 + dr.sqrt(1 + tan2))

        def beckmann() -> Any:
            # A rational fit, within 0.35 % (Walter et al. 2007, section 5.2).
            a = dr.rsqrt(dr.select(upright, 1, tan2))
            a2 = a * a
            return dr.select(a >= 1.6, 1, (3.535 * a + 2.181 * a2) / (1 + 2.276 * a + 2.577 * a2))

        result = dr.select(upright, 1, _choose(self.ggx, ggx, beckmann))
        return dr.select(dr.dot(v, m) * v.z <= 0, 0, result)

    def sample(self, wi: Any, u: Any) -> Any:
        """A microfacet normal (Array3f) for light towards ``wi``, from ``u`` (Array2f)."""
        return _choose(self.visible, lambda: self._sample_visible(wi, u), lambda: self._sample_all(u))

    def pdf(self, wi: Any, m: Any) -> Any:
        """The density per steradian with which :meth:`sample` takes ``m``."""
        d = self.density(m)
        return _choose(
            self.visible,
            lambda: d * self.visibility(wi, m) * dr.abs(dr.dot(wi, m)) / wi.z,
            lambda: d * m.z,
        )

    def _sample_all(self, u: Any) -> Any:
        angle = (2 * math.pi) * u.y
        # The angle of an ellipse's point: of one of a circle, stretched.
        sine, cosine = dr.sincos(angle)
        x, y = self.alpha_u * cosine, self.alpha_v * sine
        inverse = dr.rsqrt(x * x + y * y)
        cos_phi, sin_phi = x * inverse, y * inverse
        alpha2 = dr.rcp(dr.square(cos_phi / self.alpha_u) + dr.square(sin_phi / self.alpha_v))
        rest = 1 - u.x
        tan2 = _choose(self.ggx, lambda: alpha2 * u.x / rest, lambda: -alpha2 * dr.log(rest))
        cos2 = dr.rcp(1 + tan2)
        sin_theta = dr.safe_sqrt(1 - cos2)
        return types_of(u).Array3f(cos_phi * sin_theta, sin_phi * sin_theta, dr.sqrt(cos2))

    def _sample_visible(self, wi: Any, u: Any) -> Any:
        stretched = type(wi)(self.alpha_u * wi.x, self.alpha_v * wi.y, wi.z)
        stretched = stretched * dr.rsqrt(dr.squared_norm(stretched))
        across2 = stretched.x * stretched.x + stretched.y * stretched.y
        upright = dr.abs(across2) <= 4 * types_of(wi).epsilon
        inverse = dr.rsqrt(dr.select(upright, 1, across2))
        cos_phi = dr.select(upright, 1, stretched.x * inverse)
        sin_phi = dr.select(upright, 0, stretched.y * inverse)
        slope = _choose(self.ggx, lambda: _ggx_slope(stretched.z, u), lambda: _beckmann_slope(stretched.z, u))
        x = (cos_phi * slope.x - sin_phi * slope.y) * self.alpha_u
        y = (sin_phi * slope.x + cos_phi * slope.y) * self.alpha_v
        return type(wi)(-x, -y, 1) * dr.rsqrt(1 + x * x + y * y)


def _ggx_slope(cos_theta: Any, u: Any) -> Any:
    """A visible slope of a GGX surface of roughness 1 seen under ``cos_theta`` (Heitz 2018, JCGT 7(4))."""
    p = square_to_uniform_disk_concentric(u)
    side = 0.5 * (1 + cos_theta)
    y = dr.lerp(dr.safe_sqrt(1 - p.x * p.x), p.y, side)
    z = dr.safe_sqrt(1 - p.x * p.x - y * y)
    sin_theta = dr.safe_sqrt(1 - cos_theta * cos_theta)
    norm = dr.rcp(dr.fma(sin_theta, y, cos_theta * z))
    return type(u)((cos_theta * y - sin_theta * z) * norm, p.x * norm)


def _beckmann_slope(cos_theta: Any, u: Any) -> Any:
    """The same of a Beckmann surface: the cumulative distribution inverted by three steps of Newton's method in the
    domain of erf (after Jakob 2014, "An improved visible normal sampling routine for the Beckmann distribution")."""
    tangent = dr.safe_sqrt(1 - cos_theta * cos_theta) / cos_theta
    # Seen straight on, the cotangent is infinite and erf of it 1: any large number does.
    cotangent = dr.rcp(dr.fmax(tangent, 1e-10))
    most = dr.erf(cotangent)
    first = dr.fmax(dr.fmin(u.x, 1 - 1e-6), 1e-6)
    second = dr.fmax(dr.fmin(u.y, 1 - 1e-6), 1e-6)
    x = most - (most + 1) * dr.erf(dr.sqrt(-dr.log(first)))
    target = first * (1 + most + _INV_SQRT_PI * tangent * dr.exp(-cotangent * cotangent))
    for _ in range(3):
        slope = dr.erfinv(x)
        value = 1 + x + _INV_SQRT_PI * tangent * dr.exp(-slope * slope) - target
        x = x - value / (1 - slope * tangent)
    return type(u)(dr.erfinv(x), dr.erfinv(2 * second - 1))


def _choose(which: Any, yes: Any, no: Any) -> Any:
    """``yes()`` or ``no()``; both, and a selection, only where lanes differ."""
    if isinstance(which, bool):
        return yes() if which else no()
    return dr.select(which, yes(), no())
