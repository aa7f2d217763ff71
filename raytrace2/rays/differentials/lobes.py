"""The three maps by which a ray leaves a smooth surface, and how what leaves moves with what arrives.

A ray of direction ``d`` (unit) that meets a shading normal ``n`` goes straight on, is mirrored, or is refracted. The
derivatives are those of Igehy ("Tracing Ray Differentials", 1999, section 3), written for normals of either side.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr


@dataclass
class Lobe:
    """What a sample did with its ray: straight on where ``null``, through the surface where ``transmitted`` (Bools) and
    off it elsewhere. ``ratio`` is the index of refraction on the side of the old ray over that of the new one, and
    None where nothing refracts."""

    null: Any
    transmitted: Any
    ratio: Any

    @staticmethod
    def of(si: Any, sample: Any) -> Lobe:
        """That of ``sample``, which was taken at ``si``."""
        null, eta = sample.null, sample.eta
        if _is_one(eta):
            return Lobe(null, type(null)(False), None)
        return Lobe(null, ~null & (si.wi.z * sample.wo.z < 0), dr.rcp(eta))

    def onward(self, d: Any, n: Any) -> Any:
        """The direction that goes on. Where refraction is impossible, it grazes."""
        c = dr.dot(d, n)
        result = dr.fma(n, -2 * c, d)
        if self.ratio is not None:
            result = dr.select(self.transmitted, self._refracted(d, n, c), result)
        return dr.select(self.null, d, result)

    def _refracted(self, d: Any, n: Any, c: Any) -> Any:
        cos_t = dr.sqrt(dr.fmax(self._cos2_t(c), 0))
        return dr.fma(d, self.ratio, n * (dr.copysign(cos_t, c) - self.ratio * c))

    def moved(self, d: Any, n: Any, d_moved: Any, n_moved: Any) -> Any:
        """The derivative of :meth:`onward`, for derivatives of its arguments."""
        c = dr.dot(d, n)
        c_moved = dr.dot(d_moved, n) + dr.dot(d, n_moved)
        result = d_moved - 2 * dr.fma(n, c_moved, n_moved * c)
        if self.ratio is not None:
            # d' = ratio d + m n with m = sign(c) cos_t - ratio c.
            cos2_t = self._cos2_t(c)
            passes = cos2_t > 0
            per_cos_t = dr.rsqrt(dr.select(passes, cos2_t, 1))
            m = dr.copysign(cos2_t * per_cos_t, c) - self.ratio * c
            m_moved = (self.ratio * self.ratio * abs(c) * per_cos_t - self.ratio) * c_moved
            refracted = dr.fma(d_moved, self.ratio, dr.fma(n, m_moved, n_moved * m))
            result = dr.select(self.transmitted, dr.select(passes, refracted, 0), result)
        return dr.select(self.null, d_moved, result)

    def _cos2_t(self, c: Any) -> Any:
        sin2 = dr.fma(-c, c, 1)
        return dr.fma(-sin2, self.ratio * self.ratio, 1)


def _is_one(eta: Any) -> bool:
    """Whether ``eta`` is the number 1 wherever it is, known when the kernel is made."""
    return eta.state == dr.VarState.Literal and dr.width(eta) == 1 and bool(eta[0] == 1)
