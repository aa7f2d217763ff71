"""Fractional Brownian motion: octaves of gradient noise (Perlin, "Improving Noise", 2002), faded out by footprints.

Over a footprint an octave is multiplied by the factor that keeps closest to its mean there: exp(-r |d|^2 / 24), with r
the mean square of the noise's derivative over that of its value, and |d|^2 the sum of squares of the footprint's edges
in cells of the octave's lattice. (It is the first term of the mean over a parallelogram, and within 0.003 of the best
factor for squares of any size.) What is left of a distant pattern is its mean: frequency clamping (Norton, Rockwood and
Skolmoski 1982; "FBm" in Pharr, Jakob and Humphreys) without its steps. Magnified, nothing is filtered.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import drjit as dr
import numpy as np

from ..buffers import owned
from ..live import STILL, Live, Slot
from ..rays.random import mix
from ..scene.description import FbmTexture
from ..types import Types
from .filter_settings import FilterSettings
from .replayed import finite
from .uv_transform import UvTransforms

#: Mean square of the derivative of the noise in a direction, over that of its value.
ROUGHNESS = 8.377
_DIRECTIONS = 256
_SHIFT = 0.618034


class Fbms:
    """Textures of noise, by place. ``settings`` tell whether footprints are heeded.

    ``ValueError`` for a number of octaves not in 1 to 32, a persistence not in (0, 1], a lacunarity not in [1, 16].
    """

    def __init__(
        self,
        textures: Sequence[FbmTexture],
        types: Types,
        settings: FilterSettings | None = None,
        live: Live = STILL,
    ) -> None:
        for x in textures:
            if not (1 <= x.octaves <= 32 and 0 < x.persistence <= 1 and 1 <= x.lacunarity <= 16):
                raise ValueError("a noise has 1 to 32 octaves, a persistence in (0, 1] and a lacunarity in [1, 16]")
        self._types = types
        self._filters = settings is not None and settings.needs_footprint
        self._to_uv = UvTransforms([x.to_uv for x in textures], types, [live.place(x, "to_uv") for x in textures])
        self._octaves = max(x.octaves for x in textures)
        rows = [[*x.color0, x.octaves, *x.color1, x.persistence, x.lacunarity, _total(x), 0, 0] for x in textures]
        self._records = owned(np.array(rows, dtype=types.numpy), types.Float)
        self._seeds = owned(np.array([x.seed & 0xFFFFFFFF for x in textures], dtype=np.uint32), types.UInt)
        angle = (np.arange(_DIRECTIONS) + 0.5) * (2 * math.pi / _DIRECTIONS)
        self._gradients = owned(np.stack([np.cos(angle), np.sin(angle)], axis=1).astype(types.numpy), types.Float)

    def slots(self, *, moves: bool) -> list[Slot]:
        """Those of live maps of uv."""
        return self._to_uv.slots(moves=moves)

    def eval(self, place: Any, uv: Any, footprint: Any, active: Any) -> Any:
        """The colour (Array3f) at ``uv`` of the surface, over the ``footprint`` there (None: a point)."""
        t = self._types
        first, second, third = (dr.gather(t.Array4f, self._records, 3 * place + k, active) for k in range(3))
        octaves, persistence, lacunarity, total = first.w, second.w, third.x, third.y
        seed = dr.gather(t.UInt, self._seeds, place, active)
        at = self._to_uv.apply(place, finite(uv), active)
        size2: Any = None
        if self._filters and footprint is not None:
            linear = self._to_uv.apply_linear(place, active)
            dx, dy = finite(footprint.dx), finite(footprint.dy)
            size2 = dr.squared_norm(linear(dx)) + dr.squared_norm(linear(dy))
            size2 = dr.select(size2 >= 0, size2, 0)
        value, weight = t.Float(0), t.Float(1)
        for k in range(self._octaves):
            term = self.noise(at, mix(seed + mix(t.UInt(k + 1))), active) * weight
            if size2 is not None:
                term = term * dr.exp(size2 * (-ROUGHNESS / 24))
                size2 = size2 * lacunarity * lacunarity
            value = value + dr.select(k < octaves, term, 0)
            weight = weight * persistence
            # Shifted, so that the zeros of all octaves do not meet at whole numbers.
            at = at * lacunarity + _SHIFT
        share = dr.fma(value / dr.select(total > 0, total, 1), 0.5, 0.5)
        color0, color1 = t.Array3f(first.x, first.y, first.z), t.Array3f(second.x, second.y, second.z)
        return dr.lerp(color0, color1, share)

    def noise(self, at: Any, seed: Any, active: Any) -> Any:
        """Gradient noise (Float) in [-1, 1] of mean 0 at ``at`` (Array2f); its lattice is shuffled by ``seed``."""
        t = self._types
        # What cannot be counted is somewhere in the lattice all the same.
        at = dr.select(dr.abs(at) < 2.0**30, at, 0)
        corner = dr.floor(at)
        f = at - corner
        x, y = (t.UInt(dr.int32_array_t(t.Float)(c)) for c in corner)
        fade = f * f * f * (f * (f * 6 - 15) + 10)
        rows = []
        for j in range(2):
            along = mix((y + j) ^ seed)
            pair = []
            for i in range(2):
                direction = mix((x + i) ^ along) & (_DIRECTIONS - 1)
                g = dr.gather(t.Array2f, self._gradients, direction, active)
                pair.append(g.x * (f.x - i) + g.y * (f.y - j))
            rows.append(dr.lerp(pair[0], pair[1], fade.x))
        return dr.lerp(rows[0], rows[1], fade.y) * math.sqrt(2)


def _total(x: FbmTexture) -> float:
    return sum(x.persistence**k for k in range(x.octaves))
