"""Boxes turned to fit: tight around slanted and thin things, the dearest to test.

Words: three unit axes (rows), centre, half extents along the axes, and the sum of the extents of the box along the
world's axes (the reach from the centre).
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np

from ...surfaces.ordered import greater, lesser
from ...types import Types
from .box_axes import box_axes
from .hulls import Hulls
from .volume import Volume, VolumeRay, relative_error, round_up, volume_ray

_WIDTH = 16


def fit_oriented_box(hulls: Hulls, types: Types) -> np.ndarray:
    """A small oriented box around each group: words (groups, 16)."""
    axes = box_axes(hulls.samples()).astype(types.numpy)
    exact = axes.astype(np.float64)
    lo, hi = hulls.box()
    origin = (lo + hi) / 2
    lower, upper = _extents(hulls, exact, origin)
    words = np.zeros((len(hulls), _WIDTH), dtype=types.numpy)
    words[:, :9] = axes.reshape(-1, 9)
    words[:, 9:12] = origin + np.einsum("gki,gk->gi", exact, (lower + upper) / 2)
    center = words[:, 9:12].astype(np.float64)
    # With the axes and the centre as they are rounded: whatever they are, the slabs hold every point.
    lower, upper = _extents(hulls, exact, center)
    lost = 16 * 2.0**-53 * (np.maximum(hi - center, center - lo).sum(axis=1))
    half = round_up(np.maximum(np.maximum(upper, -lower), 0) + lost[:, None], types)
    words[:, 12:15] = half
    words[:, 15] = round_up(np.einsum("gki,gk->g", np.abs(exact), half.astype(np.float64)) * (1 + 1e-6), types)
    return words


def _extents(hulls: Hulls, axes: np.ndarray, origin: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """From where to where each group (groups, 3) reaches along its axes (groups, 3, 3) from ``origin``."""
    counts = hulls.counts
    offset = hulls.points - np.repeat(origin, counts, axis=0)
    lower, upper = (np.empty((len(hulls), 3)) for _ in range(2))
    for k in range(3):
        along = np.einsum("ij,ij->i", offset, np.repeat(axes[:, k], counts, axis=0))
        margin: np.ndarray | float = 0.0
        if hulls.radii is not None:
            margin = hulls.radii * np.repeat(np.linalg.norm(axes[:, k], axis=1), counts)
        lower[:, k] = np.minimum.reduceat(along - margin, hulls.starts)
        upper[:, k] = np.maximum.reduceat(along + margin, hulls.starts)
    return lower, upper


def meets_oriented_box(words: list[Any], ray: VolumeRay, tmax: Any) -> Any:
    """Bool: whether each ray's part from tmin to ``tmax`` may meet the box: its slabs, in its own axes."""
    Vector = type(ray.o)
    f = Vector(words[9], words[10], words[11]) - ray.o
    error = (abs(f.x) + abs(f.y) + abs(f.z) + words[15]) * relative_error(ray)
    enter, leave = ray.tmin, tmax
    for k in range(3):
        axis = Vector(*words[3 * k : 3 * k + 3])
        slope = dr.dot(axis, ray.d)
        inverse = dr.rcp(dr.select(abs(slope) < ray.least, dr.copysign(ray.least, slope), slope))
        middle = dr.dot(axis, f) * inverse
        half = (words[12 + k] + error) * abs(inverse)
        # A NaN (of infinity less infinity) must not hide a hit: the running bound is returned in its place.
        enter = greater(middle - half, enter)
        leave = lesser(middle + half, leave)
    return enter <= leave


def oriented_box_areas(words: np.ndarray) -> np.ndarray:
    """Surface areas (groups,)."""
    x, y, z = (2 * words[:, 12 + k].astype(np.float64) for k in range(3))
    return 2 * (x * y + y * z + z * x)


ORIENTED_BOX = Volume(_WIDTH, fit_oriented_box, volume_ray, meets_oriented_box, oriented_box_areas)
