"""Spot lights: a point that shines into a cone along its local +z, with a linear falloff at the rim."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import radians, tan
from typing import Any

import drjit as dr
import numpy as np

from ..scene import description
from ..types import Types
from .sample import LightSample, finite_or_zero, pack, towards

_NONE = 0xFFFFFFFF


@dataclass(frozen=True, eq=False)
class SpotLights:
    """``records``: per light three rows of the world-to-local matrix, position and intensity, each with one angle in
    the fourth place: tan(cutoff), cutoff, beam width, 1 / (cutoff - beam width), 0. ``texture``: UInt indices, or None
    if no spot light has one; ``reach``: what they can meet."""

    types: Types
    records: Any
    texture: Any
    reach: Any
    textures: Any

    @staticmethod
    def build(lights: Sequence[description.SpotLight], textures: Any, types: Types) -> SpotLights:
        rows = np.zeros((len(lights), 5, 4))
        texture = np.full(len(lights), _NONE, dtype=np.uint32)
        for i, light in enumerate(lights):
            cutoff, beam = radians(light.cutoff_angle), radians(light.beam_width)
            rows[i, 0:3, 0:3] = np.linalg.inv(light.to_world[:3, :3])
            rows[i, 3, 0:3] = light.to_world[:3, 3]
            rows[i, 4, 0:3] = light.intensity
            rows[i, 0:4, 3] = tan(cutoff), cutoff, beam, 1.0 / (cutoff - beam) if cutoff > beam else 0.0
            if light.texture is not None:
                texture[i] = textures.add(light.texture)
        textured = bool((texture != _NONE).any())
        reach = textures.reach(texture[texture != _NONE].tolist()) if textured else None
        return SpotLights(types, pack(rows, types), types.UInt(texture) if textured else None, reach, textures)

    def sample(self, p: Any, index: Any, active: Any) -> LightSample:
        """Towards light ``index`` from ``p``; the weight is ``intensity * falloff * texture / dist^2``."""
        types = self.types
        rows = [dr.gather(types.Array4f, self.records, index * 5 + k, active) for k in range(5)]
        position, intensity = rows[3].xyz, rows[4].xyz
        d, dist = towards(p, position)
        local = types.Array3f(*(-dr.dot(rows[k].xyz, d) for k in range(3)))
        # The angle by atan2 stays exact for beams so narrow that their cosine rounds to 1.
        across = dr.safe_sqrt(local.x * local.x + local.y * local.y)
        angle = dr.atan2(across, dr.select(dist > 0, local.z, 1))
        cutoff, beam, steepness = rows[1].w, rows[2].w, rows[3].w
        falloff = dr.select(angle <= beam, 1, dr.select(angle < cutoff, (cutoff - angle) * steepness, 0))
        active = active & (falloff > 0)
        if self.texture is not None:
            texture = dr.gather(types.UInt, self.texture, index, active)
            textured = active & (texture != _NONE)
            scale = 0.5 / dr.select(textured, local.z * rows[0].w, 1)
            uv = types.Array2f(0.5 + local.x * scale, 0.5 + local.y * scale)
            texel = self.textures.eval_uv(dr.select(textured, texture, 0), uv, textured, reach=self.reach)
            intensity = dr.select(textured, intensity * texel, intensity)
        inverse = dr.rcp(dist)
        weight, pdf = finite_or_zero(intensity * (falloff * inverse) * inverse, types.Float(1), active)
        return LightSample(d, dist, weight, pdf, types.Bool(True), position)
