"""Reflection off the front of a conductor made of microfacets."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import numpy as np

from ..buffers import owned
from ..scene.description import RoughConductorBsdf
from ..textures import TextureParameter, TextureTable
from .conductor import is_perfect
from .fresnel import fresnel_conductor
from .microfacet import Microfacets
from .sample import BsdfSample


class RoughConductor:
    """All rough conductors, by place (Torrance and Sparrow 1967; Walter et al. 2007)."""

    smooth = True
    delta = False
    transmission = False

    def __init__(self, bsdfs: Sequence[RoughConductorBsdf], textures: TextureTable) -> None:
        self._types = textures.types
        self._reflectance = TextureParameter([b.specular_reflectance for b in bsdfs], textures)
        self._alpha_u = TextureParameter([b.alpha_u for b in bsdfs], textures)
        isotropic = all(b.alpha_u is b.alpha_v for b in bsdfs)
        self._alpha_v = self._alpha_u if isotropic else TextureParameter([b.alpha_v for b in bsdfs], textures)
        self._perfect = all(is_perfect(b.eta, b.k) for b in bsdfs)
        if not self._perfect:
            self._eta = TextureParameter([b.eta for b in bsdfs], textures)
            self._k = TextureParameter([b.k for b in bsdfs], textures)
        ggx, visible = [b.distribution == "ggx" for b in bsdfs], [b.sample_visible for b in bsdfs]
        self._ggx: bool | None = ggx[0] if len(set(ggx)) == 1 else None
        self._visible: bool | None = visible[0] if len(set(visible)) == 1 else None
        flags = np.array(ggx, dtype=np.uint32) + 2 * np.array(visible, dtype=np.uint32)
        self._flags = owned(flags, self._types.UInt) if self._ggx is None or self._visible is None else None

    def sample(self, si: Any, wi: Any, place: Any, sample1: Any, sample2: Any, active: Any) -> BsdfSample:
        """The mirror direction about a sampled microfacet normal."""
        t = self._types
        active = active & (wi.z > 0)
        facets = self._facets(si, place, active)
        m = facets.sample(wi, sample2)
        wo = m * (2 * dr.dot(wi, m)) - wi
        cos_m = dr.dot(wo, m)
        pdf = facets.pdf(wi, m)
        active = active & (pdf > 0) & (wo.z > 0) & (cos_m > 0)
        visible = facets.visible
        weight = facets.visibility(wo, m)
        if visible is not True:
            share = facets.visibility(wi, m) * dr.dot(wi, m) / (wi.z * m.z)
            weight = weight * (share if visible is False else dr.select(visible, 1, share))
        color = self._fresnel(si, place, dr.dot(wi, m), active) * self._reflectance.eval(place, si, active)
        pdf = dr.select(active, pdf / (4 * dr.select(active, cos_m, 1)), 0)
        return BsdfSample(wo, dr.select(active, color * weight, 0), pdf, t.Float(1), t.Bool(False), t.Bool(False))

    def eval_pdf(self, si: Any, wi: Any, wo: Any, place: Any, active: Any) -> tuple[Any, Any]:
        """Value times cosine, and density, of ``wo``."""
        active = active & (wi.z > 0)
        facets = self._facets(si, place, active)
        half = wi + wo
        length2 = dr.squared_norm(half)
        m = half * dr.rsqrt(dr.select(length2 > 0, length2, 1))
        cos_m = dr.dot(wo, m)
        met = active & (wo.z > 0) & (dr.dot(wi, m) > 0) & (cos_m > 0)
        seen = facets.density(m) / (4 * dr.select(met, wi.z, 1))
        value = seen * facets.visibility(wi, m) * facets.visibility(wo, m)
        color = self._fresnel(si, place, dr.dot(wi, m), active) * self._reflectance.eval(place, si, active)
        pdf = facets.pdf(wi, m) / (4 * dr.select(met, cos_m, 1))
        return dr.select(met, color * value, 0), dr.select(met, pdf, 0)

    def albedo(self, si: Any, place: Any, active: Any) -> Any:
        """Black: nothing of it is diffuse... see Mitsuba's ``eval_diffuse_reflectance``."""
        return dr.zeros(self._types.Array3f)

    def _facets(self, si: Any, place: Any, active: Any) -> Microfacets:
        alpha_u = self._alpha_u.eval_1(place, si, active)
        alpha_v = alpha_u if self._alpha_v is self._alpha_u else self._alpha_v.eval_1(place, si, active)
        ggx: Any = self._ggx
        visible: Any = self._visible
        if self._flags is not None:
            flags = dr.gather(self._types.UInt, self._flags, place, active)
            ggx = flags & 1 != 0 if ggx is None else ggx
            visible = flags & 2 != 0 if visible is None else visible
        return Microfacets(alpha_u, alpha_v, ggx, visible)

    def _fresnel(self, si: Any, place: Any, cos_theta: Any, active: Any) -> Any:
        if self._perfect:
            return self._types.Array3f(1)
        return fresnel_conductor(cos_theta, self._eta.eval(place, si, active), self._k.eval(place, si, active))
