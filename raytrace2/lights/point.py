"""Point lights: the same intensity in every direction from one position."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from ..scene import description
from ..types import Types
from .sample import LightSample, finite_or_zero, pack, towards


@dataclass(frozen=True, eq=False)
class PointLights:
    """``records``: per light position, 0, intensity, 0."""

    types: Types
    records: Any

    @staticmethod
    def build(lights: Sequence[description.PointLight], types: Types) -> PointLights:
        rows = np.zeros((len(lights), 8))
        for row, light in zip(rows, lights, strict=True):
            row[0:3], row[4:7] = light.position, light.intensity
        return PointLights(types, pack(rows, types))

    def sample(self, p: Any, index: Any, active: Any) -> LightSample:
        """Towards light ``index`` from ``p``; the weight is ``intensity / dist^2``."""
        types = self.types
        position = dr.gather(types.Array4f, self.records, index * 2, active).xyz
        intensity = dr.gather(types.Array4f, self.records, index * 2 + 1, active).xyz
        d, dist = towards(p, position)
        inverse = dr.rcp(dist)
        weight, pdf = finite_or_zero(intensity * inverse * inverse, types.Float(1), active)
        return LightSample(d, dist, weight, pdf, types.Bool(True), position)
