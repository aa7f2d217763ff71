"""Environment maps over footprints of directions.

The image is laid twice around the sphere: from pole to pole, and on beyond the pole on the other side, back to the
first. So it is seamless as a texture that repeats, in azimuth as over the poles, and any texture filter may read it.
Means are those over the image's own coordinates; a footprint that reaches a pole covers at most a turn in azimuth.
Where textures are to be read at random, the sky is read by the filter that is sampled there.
"""

from __future__ import annotations

from dataclasses import replace
from math import pi
from typing import Any

import drjit as dr
import numpy as np

from ..live import STILL, Live, Place, Slot
from ..rays.footprint import Footprint
from ..scene.description import BitmapTexture
from ..textures.bitmap import Bitmaps
from ..textures.filter_settings import FilterSettings
from ..types import Types


class FilteredMap:
    """``radiance``: (height, width, 3), linear, its first and last rows the poles; at least 3 rows.
    ``live``: it may change."""

    def __init__(self, radiance: np.ndarray, types: Types, settings: FilterSettings, live: bool = False) -> None:
        height, width = radiance.shape[:2]
        beyond = _half_turned(radiance[-2:0:-1])
        pixels = np.concatenate([radiance, beyond]).astype(types.numpy)
        if settings.name == "stochastic":
            settings = replace(settings, name=settings.of)
        image = BitmapTexture(pixels, raw=True)
        place = Place(image, "pixels")
        self._bitmaps = Bitmaps([image], types, settings, Live([place]) if live else STILL)
        self._types = types
        self._row = dr.opaque(types.Float, 0.5 / len(pixels))
        self._per_theta = dr.opaque(types.Float, (height - 1) / (pi * len(pixels)))

    def slots(self) -> list[Slot]:
        """Those of the image laid twice around the sphere, the only value that they ask for, if it is live."""
        return self._bitmaps.slots(moves=False)

    def eval(self, d: Any, turns: tuple[Any, Any], active: Any) -> Any:
        """Radiance (Array3f) around the local unit direction ``d``, which changes by ``turns``."""
        t = self._types
        across2 = d.x * d.x + d.z * d.z
        off_pole = across2 > 0
        sin_theta = dr.select(off_pole, dr.sqrt(dr.select(off_pole, across2, 1)), 0)
        inverse = dr.rcp(dr.select(off_pole, sin_theta, 1))
        theta = dr.atan2(sin_theta, dr.select(active, d.y, 1))
        phi = dr.select(off_pole, dr.atan2(d.x, dr.select(off_pole, -d.z, 1)), 0)
        uv = t.Array2f(phi * (0.5 / pi), dr.fma(theta, self._per_theta, self._row))
        steps = []
        for turn in turns:
            outward = (d.x * turn.x + d.z * turn.z) * inverse
            around = (d.z * turn.x - d.x * turn.z) * -(inverse * inverse)
            # At the pole itself every direction is away from it.
            size = dr.norm(turn)
            down = dr.select(off_pole, d.y * outward - sin_theta * turn.y, size)
            u = dr.fmax(dr.fmin(around * (0.5 / pi), 0.5), -0.5)
            u = dr.select(off_pole, u, dr.select(size > 0, 0.5, 0))
            steps.append(t.Array2f(u, down * self._per_theta))
        return self._bitmaps.eval(t.UInt(0), uv, Footprint(steps[0], steps[1]), active)


def _half_turned(rows: np.ndarray) -> np.ndarray:
    """``rows`` of azimuths, half a turn on; between columns where their number is odd."""
    width = rows.shape[1]
    turned = np.roll(rows, width // 2, axis=1)
    if width % 2:
        turned = 0.5 * (turned + np.roll(turned, 1, axis=1))
    return turned
