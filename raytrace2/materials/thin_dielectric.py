"""Reflection off, and straight passage through, a dielectric pane too thin to shift a ray."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr

from ..chances import by_choice
from ..live import Slot
from ..scene.description import ThinDielectricBsdf
from ..textures import TextureParameter, TextureTable
from .fresnel import fresnel_dielectric
from .index_of_refraction import RelativeIndices
from .sample import BsdfSample


class ThinDielectric:
    """All thin dielectrics, by place."""

    smooth = False
    delta = True
    transmission = True
    widens = False

    def __init__(self, bsdfs: Sequence[ThinDielectricBsdf], textures: TextureTable) -> None:
        self._types = textures.types
        self._eta = RelativeIndices(bsdfs, textures.types, textures.live)
        self._reflectance = TextureParameter([b.specular_reflectance for b in bsdfs], textures)
        self._transmittance = TextureParameter([b.specular_transmittance for b in bsdfs], textures)

    def slots(self) -> list[Slot]:
        """Those of live indices of refraction."""
        return self._eta.slots(moves=False)

    def sample(self, si: Any, wi: Any, place: Any, sample1: Any, sample2: Any, active: Any) -> BsdfSample:
        """Reflects where ``sample1`` is at most the reflectance of the pane, and goes straight on elsewhere."""
        t = self._types
        once = fresnel_dielectric(dr.abs(wi.z), self._eta.eval(place, active)).reflectance
        # All reflections between the two faces, summed: R + T R T + T R^3 T + ... = 2 R / (1 + R).
        reflectance = once * (2 / (1 + once))
        reflected = sample1 <= reflectance
        wo = t.Array3f(-wi.x, -wi.y, dr.select(reflected, wi.z, -wi.z))
        weight = dr.select(
            reflected,
            self._reflectance.eval(place, si, active & reflected),
            self._transmittance.eval(place, si, active & ~reflected),
        )
        pdf = dr.select(reflected, reflectance, 1 - reflectance)
        weight = by_choice(weight, pdf)
        return BsdfSample(wo, dr.select(active, weight, 0), pdf, t.Float(1), t.Bool(True), ~reflected)
