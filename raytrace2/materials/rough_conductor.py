"""Reflection off the front of a conductor made of microfacets."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import numpy as np

from ..buffers import owned
from ..rays.footprint import shared
from ..scene.description import ConductorBsdf, ConstantTexture, RoughConductorBsdf
from ..textures import TextureParameter, TextureTable
from .conductor import is_perfect
from .fresnel import fresnel_conductor
from .microfacet import Microfacets
from .sample import BsdfSample
from .spread import Spread

_POLISHED = ConstantTexture((0.0, 0.0, 0.0))
#: The roughness below which a smooth conductor under a map is left one.
_SMOOTHEST = 2e-3


def polished(bsdf: ConductorBsdf) -> RoughConductorBsdf:
    """What a smooth conductor is where a spread of normals may roughen it, and itself where none does."""
    return RoughConductorBsdf("beckmann", _POLISHED, _POLISHED, True, bsdf.eta, bsdf.k, bsdf.specular_reflectance)


class RoughConductor:
    """All rough conductors, by place (Torrance and Sparrow 1967; Walter et al. 2007)."""

    smooth = True
    transmission = False
    widens = True

    def __init__(self, bsdfs: Sequence[RoughConductorBsdf], textures: TextureTable) -> None:
        self._types = textures.types
        self._reflectance = TextureParameter([b.specular_reflectance for b in bsdfs], textures)
        self._alpha_u = TextureParameter([b.alpha_u for b in bsdfs], textures, moves=True)
        isotropic = all(b.alpha_u is b.alpha_v for b in bsdfs)
        if isotropic:
            self._alpha_v = self._alpha_u
        else:
            self._alpha_v = TextureParameter([b.alpha_v for b in bsdfs], textures, moves=True)
        self._perfect = all(is_perfect(b.eta, b.k, textures.live) for b in bsdfs)
        if not self._perfect:
            self._eta = TextureParameter([b.eta for b in bsdfs], textures)
            self._k = TextureParameter([b.k for b in bsdfs], textures)
        ggx, visible = [b.distribution == "ggx" for b in bsdfs], [b.sample_visible for b in bsdfs]
        self._ggx: bool | None = ggx[0] if len(set(ggx)) == 1 else None
        self._visible: bool | None = visible[0] if len(set(visible)) == 1 else None
        smooth = [b.alpha_u is _POLISHED for b in bsdfs]
        self.delta = any(smooth)
        flags = np.array([ggx, visible, smooth], dtype=np.uint32).T @ np.array([1, 2, 4], dtype=np.uint32)
        mixed = self._ggx is None or self._visible is None or len(set(smooth)) > 1
        self._flags = owned(flags, self._types.UInt) if mixed else None

    def sample(
        self, si: Any, wi: Any, place: Any, sample1: Any, sample2: Any, active: Any, spread: Spread | None = None
    ) -> BsdfSample:
        """The mirror direction about a sampled microfacet normal."""
        t = self._types
        active = shared(si, (id(self), "front", place, active), lambda: active & (wi.z > 0))
        facets, turn, turn_back = self._facets(si, place, active, spread)
        mirrors = self._mirrors(place, facets, active)
        wi = turn(wi)
        m = facets.sample(wi, sample2)
        if self.delta:
            m = dr.select(mirrors, t.Array3f(0, 0, 1), m)
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
        if self.delta:
            wo = dr.select(mirrors, t.Array3f(-wi.x, -wi.y, wi.z), wo)
            pdf, weight = dr.select(mirrors & active, 1, pdf), dr.select(mirrors, 1, weight)
        wo = turn_back(wo)
        return BsdfSample(wo, dr.select(active, color * weight, 0), pdf, t.Float(1), mirrors, t.Bool(False))

    def eval_pdf(
        self, si: Any, wi: Any, wo: Any, place: Any, active: Any, spread: Spread | None = None
    ) -> tuple[Any, Any]:
        """Value times cosine, and density, of ``wo``."""
        active = shared(si, (id(self), "front", place, active), lambda: active & (wi.z > 0))
        facets, turn, _ = self._facets(si, place, active, spread)
        if self.delta:
            active = active & ~self._mirrors(place, facets, active)
        wi, wo = turn(wi), turn(wo)
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
        """Black: nothing of it is diffuse."""
        return dr.zeros(self._types.Array3f)

    def _facets(self, si: Any, place: Any, active: Any, spread: Spread | None) -> tuple[Microfacets, Any, Any]:
        """The microfacets, and the turns of the frame to their axes and back."""
        alpha_u = self._alpha_u.eval_1(place, si, active)
        alpha_v = alpha_u if self._alpha_v is self._alpha_u else self._alpha_v.eval_1(place, si, active)
        ggx: Any = self._ggx
        visible: Any = self._visible
        if self._flags is not None:
            flags = dr.gather(self._types.UInt, self._flags, place, active)
            ggx = flags & 1 != 0 if ggx is None else ggx
            visible = flags & 2 != 0 if visible is None else visible
        if spread is None:
            return Microfacets(alpha_u, alpha_v, ggx, visible), _same, _same
        first, second, cosine, sine = spread.roughened(alpha_u, alpha_v)
        return Microfacets(first, second, ggx, visible), _turn(cosine, sine), _turn(cosine, -sine)

    def _mirrors(self, place: Any, facets: Microfacets, active: Any) -> Any:
        """Where what stands for a smooth conductor is one (Bool)."""
        if not self.delta:
            return self._types.Bool(False)
        even = facets.alpha_u < _SMOOTHEST
        if self._flags is None:
            return even
        return even & (dr.gather(self._types.UInt, self._flags, place, active) & 4 != 0)

    def _fresnel(self, si: Any, place: Any, cos_theta: Any, active: Any) -> Any:
        if self._perfect:
            return self._types.Array3f(1)
        return fresnel_conductor(cos_theta, self._eta.eval(place, si, active), self._k.eval(place, si, active))


def _same(v: Any) -> Any:
    return v


def _turn(cosine: Any, sine: Any) -> Any:
    return lambda v: type(v)(v.x * cosine + v.y * sine, v.y * cosine - v.x * sine, v.z)
