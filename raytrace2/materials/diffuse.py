"""Ideally diffuse (Lambertian) reflection off the front of a surface."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr

from ..rays.footprint import shared
from ..scene.description import DiffuseBsdf
from ..textures import TextureParameter, TextureTable
from ..warp import (
    INV_PI,
    square_to_cosine_hemisphere,
    square_to_cosine_hemisphere_pdf,
    square_to_uniform_hemisphere,
)
from .sample import BsdfSample
from .spread import Spread


class Diffuse:
    """All diffuse materials, by place."""

    smooth = True
    delta = False
    transmission = False
    widens = True

    def __init__(self, bsdfs: Sequence[DiffuseBsdf], textures: TextureTable) -> None:
        self._types = textures.types
        self._reflectance = TextureParameter([b.reflectance for b in bsdfs], textures)

    def sample(
        self, si: Any, wi: Any, place: Any, sample1: Any, sample2: Any, active: Any, spread: Spread | None = None
    ) -> BsdfSample:
        """A direction of density cos / pi; with a ``spread`` of normals, some at random."""
        t = self._types
        active = self._front(si, wi, place, active)
        if spread is not None:
            uniform = sample1 < spread.share
            wo = dr.select(uniform, square_to_uniform_hemisphere(sample2), square_to_cosine_hemisphere(sample2))
            value, pdf = self.eval_pdf(si, wi, wo, place, active, spread)
            weight = dr.select(active & (pdf > 0), value / dr.select(pdf > 0, pdf, 1), 0)
            return BsdfSample(wo, weight, pdf, t.Float(1), t.Bool(False), t.Bool(False))
        wo = square_to_cosine_hemisphere(sample2)
        pdf = dr.select(active, square_to_cosine_hemisphere_pdf(wo), 0)
        weight = dr.select(active & (pdf > 0), self._reflectance.eval(place, si, active), 0)
        return BsdfSample(wo, weight, pdf, t.Float(1), t.Bool(False), t.Bool(False))

    def eval_pdf(
        self, si: Any, wi: Any, wo: Any, place: Any, active: Any, spread: Spread | None = None
    ) -> tuple[Any, Any]:
        """Value times cosine, and density, of ``wo``."""
        front = self._front(si, wi, place, active)
        if spread is not None:
            lit = front & (wo.z > 0)
            pdf = dr.select(lit, dr.lerp(wo.z * INV_PI, 0.5 * INV_PI, spread.share), 0)
            return self._reflectance.eval(place, si, front) * dr.select(lit, spread.cosine(wo) * INV_PI, 0), pdf
        pdf = dr.select(front & (wo.z > 0), wo.z * INV_PI, 0)
        # The mask is that of sample(), so that Dr.Jit sees one look-up where a kernel does both.
        return self._reflectance.eval(place, si, front) * pdf, pdf

    def _front(self, si: Any, wi: Any, place: Any, active: Any) -> Any:
        return shared(si, (id(self), "front", place, active), lambda: active & (wi.z > 0))

    def albedo(self, si: Any, place: Any, active: Any) -> Any:
        """The reflectance, on either side."""
        return self._reflectance.eval(place, si, active)
