"""Reflection and refraction at a smooth interface between dielectrics."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr

from ..chances import by_choice
from ..live import Slot
from ..scene.description import DielectricBsdf
from ..textures import TextureParameter, TextureTable
from .fresnel import fresnel_dielectric
from .index_of_refraction import RelativeIndices
from .sample import BsdfSample


class Dielectric:
    """All smooth dielectrics, by place. Weights are those of radiance, which 1 / eta^2 scales at a refraction."""

    smooth = False
    delta = True
    transmission = True
    widens = False

    def __init__(self, bsdfs: Sequence[DielectricBsdf], textures: TextureTable) -> None:
        self._types = textures.types
        self._eta = RelativeIndices(bsdfs, textures.types, textures.live)
        self._reflectance = TextureParameter([b.specular_reflectance for b in bsdfs], textures)
        self._transmittance = TextureParameter([b.specular_transmittance for b in bsdfs], textures)

    def slots(self) -> list[Slot]:
        """Those of live indices of refraction."""
        return self._eta.slots(moves=True)

    def sample(self, si: Any, wi: Any, place: Any, sample1: Any, sample2: Any, active: Any) -> BsdfSample:
        """Reflects where ``sample1`` is at most Fresnel's reflectance, and refracts elsewhere."""
        t = self._types
        f = fresnel_dielectric(wi.z, self._eta.eval(place, active))
        reflected = sample1 <= f.reflectance
        refracted = t.Array3f(-f.inverse_eta * wi.x, -f.inverse_eta * wi.y, f.cos_theta_t)
        wo = dr.select(reflected, t.Array3f(-wi.x, -wi.y, wi.z), refracted)
        weight = dr.select(
            reflected,
            self._reflectance.eval(place, si, active & reflected),
            self._transmittance.eval(place, si, active & ~reflected) * (f.inverse_eta * f.inverse_eta),
        )
        pdf = dr.select(reflected, f.reflectance, 1 - f.reflectance)
        weight = by_choice(weight, pdf)
        eta = dr.select(reflected, 1, f.eta)
        return BsdfSample(wo, dr.select(active, weight, 0), pdf, eta, t.Bool(True), t.Bool(False))
