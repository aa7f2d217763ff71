"""Ideally diffuse (Lambertian) reflection off the front of a surface."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr

from ..scene.description import DiffuseBsdf
from ..textures import TextureParameter, TextureTable
from ..warp import INV_PI, square_to_cosine_hemisphere, square_to_cosine_hemisphere_pdf
from .sample import BsdfSample


class Diffuse:
    """All diffuse materials, by place."""

    smooth = True
    delta = False
    transmission = False

    def __init__(self, bsdfs: Sequence[DiffuseBsdf], textures: TextureTable) -> None:
        self._types = textures.types
        self._reflectance = TextureParameter([b.reflectance for b in bsdfs], textures)

    def sample(self, si: Any, wi: Any, place: Any, sample1: Any, sample2: Any, active: Any) -> BsdfSample:
        """A direction of density cos / pi."""
        t = self._types
        active = active & (wi.z > 0)
        wo = square_to_cosine_hemisphere(sample2)
        pdf = dr.select(active, square_to_cosine_hemisphere_pdf(wo), 0)
        weight = dr.select(active & (pdf > 0), self._reflectance.eval(place, si, active), 0)
        return BsdfSample(wo, weight, pdf, t.Float(1), t.Bool(False), t.Bool(False))

    def eval_pdf(self, si: Any, wi: Any, wo: Any, place: Any, active: Any) -> tuple[Any, Any]:
        """Value times cosine, and density, of ``wo``."""
        front = active & (wi.z > 0)
        pdf = dr.select(front & (wo.z > 0), wo.z * INV_PI, 0)
        # The mask is that of sample(), so that Dr.Jit sees one look-up where a kernel does both.
        return self._reflectance.eval(place, si, front) * pdf, pdf

    def albedo(self, si: Any, place: Any, active: Any) -> Any:
        """The reflectance, on either side."""
        return self._reflectance.eval(place, si, active)
