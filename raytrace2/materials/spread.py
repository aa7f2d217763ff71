"""How normals spread over a footprint, and what that does to a material.

A conductor's microfacets lean by the map's slopes besides their own: covariances add, and roughness is twice the
covariance (Olano and Baker 2010, section 4; for GGX, which has none, the same ellipse is widened). A diffuse surface
shows the mean of the clamped cosines, which for a Gaussian is known. What cannot be widened gets a slope at random.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import drjit as dr

from ..rays.random import sample_tea
from ..surfaces.frame import Frame
from ..types import Types, types_of


@dataclass
class Slopes:
    """Slopes along x and y of a frame: their ``mean`` (Array2f) and covariance ``xx``, ``xy``, ``yy`` (Float)."""

    mean: Any
    xx: Any
    xy: Any
    yy: Any

    @property
    def variance(self) -> Any:
        """The sum of the variances along x and y (Float)."""
        return self.xx + self.yy

    def selected(self, mask: Any, other: Slopes) -> Slopes:
        """These where ``mask``, and ``other`` elsewhere."""
        pairs = ((self.mean, other.mean), (self.xx, other.xx), (self.xy, other.xy), (self.yy, other.yy))
        return Slopes(*(dr.select(mask, a, b) for a, b in pairs))

    def fading(self, share: Any) -> Slopes:
        """The same mean with ``share`` of the covariance."""
        return Slopes(self.mean, self.xx * share, self.xy * share, self.yy * share)

    def normal(self) -> Any:
        """The unit normal (Array3f) of the mean slope."""
        return slope_normal(self.mean)

    def drawn(self, si: Any) -> Any:
        """The unit normal of a slope drawn from the Gaussian of these moments, for the hit ``si``."""
        types = types_of(self.mean)
        a = dr.safe_sqrt(self.xx)
        most = dr.safe_sqrt(self.yy)
        b = dr.fmax(dr.fmin(dr.select(self.xx > 0, self.xy / dr.select(self.xx > 0, a, 1), 0), most), -most)
        c = dr.safe_sqrt(self.yy - b * b)
        g, h = _gaussian_pair(si, types)
        return slope_normal(types.Array2f(dr.fma(a, g, self.mean.x), self.mean.y + b * g + c * h))

    def seen_from(self, frame: Frame) -> Spread:
        """The covariance of slopes against the plane of ``frame``, whose normal is that of the mean slope, to first
        order in what they deviate."""
        inverse = frame.n.z * frame.n.z
        s, t = frame.s, frame.t

        def along(p: Any, q: Any) -> Any:
            return inverse * (p.x * q.x * self.xx + (p.x * q.y + p.y * q.x) * self.xy + p.y * q.y * self.yy)

        return Spread(along(s, s), along(s, t), along(t, t))


@dataclass
class Spread:
    """The covariance (Float ``xx``, ``xy``, ``yy``) of slopes about a frame's normal."""

    xx: Any
    xy: Any
    yy: Any

    def where(self, mask: Any) -> Spread:
        """This one, and none where ``mask`` is false."""
        return Spread(*(dr.select(mask, v, 0) for v in (self.xx, self.xy, self.yy)))

    def roughened(self, alpha_u: Any, alpha_v: Any) -> tuple[Any, Any, Any, Any]:
        """Roughness with this spread added: along two axes, and cosine and sine of the angle from x to the first."""
        a, c = dr.fma(alpha_u, alpha_u, 2 * self.xx), dr.fma(alpha_v, alpha_v, 2 * self.yy)
        b = 2 * self.xy
        half_sum, half_difference = 0.5 * (a + c), 0.5 * (a - c)
        squared = half_difference * half_difference + b * b
        round_ = squared <= 1e-12 * half_sum * half_sum
        # Safe roots have no derivatives below Dr.Jit's epsilon, where spreads often lie.
        radius = dr.sqrt(dr.select(round_, 1, squared))
        with dr.suspend_grad():
            inverse = dr.rcp(radius)
            # Smaller ones follow from larger ones: as differences they would lose their digits.
            larger = dr.sqrt(0.5 + 0.5 * dr.select(round_, 1, dr.abs(half_difference) * inverse))
            smaller = dr.select(round_, 0, 0.5 * b * inverse) / larger
            along = round_ | (half_difference >= 0)
            cosine, sine = dr.select(along, larger, smaller), dr.select(along, smaller, larger)
        if dr.grad_enabled(half_difference, b):
            # So would the derivatives of cosine and sine, each by itself: they are those of a turn.
            way = dr.detach(half_difference) * b - dr.detach(b) * half_difference
            angle = dr.replace_grad(dr.zeros(type(b)), dr.select(round_, 0, 0.5 * way * inverse * inverse))
            cosine, sine = cosine - sine * angle, sine + cosine * angle
        # A round one keeps its axes, so that no spread changes nothing.
        first = dr.select(round_, a, half_sum + radius)
        second = dr.select(round_, c, dr.fma(a, c, -b * b) / first)
        return dr.safe_sqrt(first), dr.safe_sqrt(second), cosine, sine

    def cosine(self, wo: Any) -> Any:
        """The mean over normals of their clamped cosines (Float) with the unit vector ``wo``."""
        shortened = dr.rsqrt(1 + self.xx + self.yy)
        mean = wo.z * shortened
        variance = wo.x * wo.x * self.xx + 2 * wo.x * wo.y * self.xy + wo.y * wo.y * self.yy
        deviation = dr.safe_sqrt(variance) * shortened
        some = deviation > 1e-6
        x = mean / dr.select(some, deviation, 1)
        below = 0.5 * (1 + dr.erf(x * math.sqrt(0.5)))
        density = dr.exp(-0.5 * x * x) * (1 / math.sqrt(2 * math.pi))
        return dr.select(some, dr.fma(mean, below, deviation * density), dr.fmax(mean, 0))

    @property
    def share(self) -> Any:
        """The part (Float) of a diffuse surface's directions that is better drawn without heed to cosines."""
        variance = self.xx + self.yy
        return variance / (1 + variance)


def slope_normal(slope: Any) -> Any:
    """The unit normal (Array3f) of a surface with slopes (Array2f) along x and y."""
    n = types_of(slope).Array3f(-slope.x, -slope.y, 1)
    return n * dr.rsqrt(dr.squared_norm(n))


def _gaussian_pair(si: Any, types: Types) -> tuple[Any, Any]:
    """Two independent normal deviates (Box and Muller 1958) that depend on nothing but the place of the hit: sampling
    and evaluating a material there see the same slope, as weighing the two against each other demands."""
    bits = []
    for coordinate in (*si.uv, si.t):
        single = dr.float32_array_t(types.Float)(dr.detach(coordinate))
        bits.append(dr.reinterpret_array(types.UInt, single))
    first, second = sample_tea(bits[0] ^ (bits[2] * 0x9E3779B1), bits[1])
    u, v = ((types.Float(x >> 8) + 0.5) * 2.0**-24 for x in (first, second))
    radius = dr.sqrt(-2 * dr.log(u))
    sine, cosine = dr.sincos((2 * math.pi) * v)
    return radius * cosine, radius * sine
