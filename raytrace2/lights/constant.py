"""The constant environment: the same radiance from every direction."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi
from typing import Any

import drjit as dr

from .. import warp
from ..scene import description
from ..types import Types
from .infinite import BoundingSphere
from .sample import LightSample, finite_or_zero


@dataclass(frozen=True, eq=False)
class ConstantEnvironment:
    """``radiance``: Array3f, opaque."""

    types: Types
    radiance: Any
    sphere: BoundingSphere

    @staticmethod
    def build(light: description.ConstantLight, sphere: BoundingSphere, types: Types) -> ConstantEnvironment:
        radiance = types.Array3f(*(dr.opaque(types.Float, float(c)) for c in light.radiance))
        return ConstantEnvironment(types, radiance, sphere)

    def sample(self, p: Any, u: Any, active: Any) -> LightSample:
        """A direction uniform on the sphere, from ``u`` (Array2f)."""
        types = self.types
        d = warp.square_to_uniform_sphere(u)
        dist = self.sphere.beyond(p)
        weight, pdf = finite_or_zero(self.radiance * (4 * pi), types.Float(warp.INV_FOUR_PI), active)
        return LightSample(d, dist, weight, pdf, types.Bool(False), dr.fma(d, dist, p))

    def eval_pdf(self, d: Any, active: Any) -> tuple[Any, Any]:
        """Radiance from direction ``d`` and the density with which :meth:`sample` takes it."""
        return dr.select(active, self.radiance, 0), dr.select(active, self.types.Float(warp.INV_FOUR_PI), 0)
