"""What lights at infinity share: a finite stand-in for their distance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from ..types import Types
from .sample import towards


@dataclass(frozen=True, eq=False)
class BoundingSphere:
    """``center`` Array3f and ``radius`` Float of a sphere around the scene, opaque."""

    center: Any
    radius: Any

    @staticmethod
    def of_box(lo: np.ndarray, hi: np.ndarray, types: Types) -> BoundingSphere:
        """Around the box from ``lo`` to ``hi`` (float64, (3,)); the unit sphere if the box is empty."""
        lo, hi = np.asarray(lo, dtype=np.float64), np.asarray(hi, dtype=np.float64)
        center, radius = np.zeros(3), 1.0
        if np.isfinite(lo).all() and np.isfinite(hi).all() and (lo <= hi).all():
            center = 0.5 * lo + 0.5 * hi
            margin = 8 * types.epsilon
            radius = max(float(np.linalg.norm(hi - center)) * (1 + margin), margin * float(abs(center).max()), margin)
        return BoundingSphere(
            types.Array3f(*(dr.opaque(types.Float, float(c)) for c in center)), dr.opaque(types.Float, radius)
        )

    def beyond(self, p: Any) -> Any:
        """A distance (Float) from ``p`` at which every direction has left the scene."""
        return 2 * dr.fmax(self.radius, towards(p, self.center)[1])
