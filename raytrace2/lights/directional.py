"""Directional lights: parallel light from infinity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from ..scene import description
from ..types import Types
from .infinite import BoundingSphere
from .sample import LightSample, finite_or_zero, pack


@dataclass(frozen=True, eq=False)
class DirectionalLights:
    """``records``: per light the unit direction towards it, 0, irradiance, 0."""

    types: Types
    records: Any
    sphere: BoundingSphere

    @staticmethod
    def build(
        lights: Sequence[description.DirectionalLight], sphere: BoundingSphere, types: Types
    ) -> DirectionalLights:
        rows = np.zeros((len(lights), 8))
        for row, light in zip(rows, lights, strict=True):
            direction = np.asarray(light.direction, dtype=np.float64)
            direction = direction / np.abs(direction).max()
            row[0:3], row[4:7] = -direction / np.linalg.norm(direction), light.irradiance
        return DirectionalLights(types, pack(rows, types), sphere)

    def sample(self, p: Any, index: Any, active: Any) -> LightSample:
        """Towards light ``index`` from ``p``; the weight is its irradiance on a surface that faces it."""
        types = self.types
        d = dr.gather(types.Array4f, self.records, index * 2, active).xyz
        irradiance = dr.gather(types.Array4f, self.records, index * 2 + 1, active).xyz
        dist = self.sphere.beyond(p)
        weight, pdf = finite_or_zero(irradiance, types.Float(1), active)
        return LightSample(d, dist, weight, pdf, types.Bool(True), dr.fma(d, dist, p))
