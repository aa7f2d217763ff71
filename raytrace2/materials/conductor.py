"""Mirror reflection off the front of a smooth conductor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr

from ..live import STILL, Live
from ..scene.description import ConductorBsdf, ConstantTexture, Texture
from ..textures import TextureParameter, TextureTable
from .fresnel import fresnel_conductor
from .sample import BsdfSample


class Conductor:
    """All smooth conductors, by place; without Fresnel's equations if all are perfect mirrors (eta = 0)."""

    smooth = False
    delta = True
    transmission = False
    widens = False

    def __init__(self, bsdfs: Sequence[ConductorBsdf], textures: TextureTable) -> None:
        self._types = textures.types
        self._reflectance = TextureParameter([b.specular_reflectance for b in bsdfs], textures)
        self._perfect = all(is_perfect(b.eta, b.k, textures.live) for b in bsdfs)
        if not self._perfect:
            self._eta = TextureParameter([b.eta for b in bsdfs], textures)
            self._k = TextureParameter([b.k for b in bsdfs], textures)

    def sample(self, si: Any, wi: Any, place: Any, sample1: Any, sample2: Any, active: Any) -> BsdfSample:
        """The mirror direction."""
        t = self._types
        active = active & (wi.z > 0)
        weight = self._reflectance.eval(place, si, active)
        if not self._perfect:
            eta, k = self._eta.eval(place, si, active), self._k.eval(place, si, active)
            weight = weight * fresnel_conductor(wi.z, eta, k)
        wo = t.Array3f(-wi.x, -wi.y, wi.z)
        pdf = dr.select(active, t.Float(1), 0)
        return BsdfSample(wo, dr.select(active, weight, 0), pdf, t.Float(1), t.Bool(True), t.Bool(False))


def is_perfect(eta: Texture, k: Texture, live: Live = STILL) -> bool:
    """Whether a conductor reflects all light, which Fresnel's equations need not say, and always will."""
    return (
        isinstance(eta, ConstantTexture)
        and isinstance(k, ConstantTexture)
        and not (live.has(eta, "value") or live.has(k, "value"))
        and not any(eta.value)
        and all(channel != 0 for channel in k.value)
    )
