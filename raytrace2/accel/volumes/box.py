"""Boxes along the axes: cheap to test, loose around anything slanted.

Words: centre, half extents, the sum of the half extents (the reach from the centre), and one unused.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...surfaces.ordered import greater, lesser
from ...types import Types
from .hulls import Hulls
from .volume import Volume, VolumeRay, relative_error, round_up, volume_ray

_WIDTH = 8


def fit_box(hulls: Hulls, types: Types) -> np.ndarray:
    """The smallest box around each group: words (groups, 8)."""
    lo, hi = hulls.box()
    words = np.zeros((len(hulls), _WIDTH), dtype=types.numpy)
    words[:, :3] = (lo + hi) / 2
    center = words[:, :3].astype(np.float64)
    words[:, 3:6] = round_up(np.maximum(hi - center, center - lo), types)
    words[:, 6] = round_up(words[:, 3:6].astype(np.float64).sum(axis=1), types)
    return words


def meets_box(words: list[Any], ray: VolumeRay, tmax: Any) -> Any:
    """Bool: whether each ray's part from tmin to ``tmax`` may meet the box. (Kay and Kajiya 1986, about the centre.)"""
    fx, fy, fz = words[0] - ray.o.x, words[1] - ray.o.y, words[2] - ray.o.z
    error = (abs(fx) + abs(fy) + abs(fz) + words[6]) * relative_error(ray)
    enter, leave = ray.tmin, tmax
    for k, f in enumerate((fx, fy, fz)):
        middle = f * ray.inverse[k]
        half = (words[3 + k] + error) * ray.size[k]
        # A NaN (of zero times an overflow) must not hide a hit: the running bound is returned in its place.
        enter = greater(middle - half, enter)
        leave = lesser(middle + half, leave)
    return enter <= leave


def box_areas(words: np.ndarray) -> np.ndarray:
    """Surface areas (groups,)."""
    x, y, z = (2 * words[:, 3 + k].astype(np.float64) for k in range(3))
    return 2 * (x * y + y * z + z * x)


BOX = Volume(_WIDTH, fit_box, volume_ray, meets_box, box_areas)
