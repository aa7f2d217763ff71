"""Balls: four words and no division to test; loose around anything long or flat.

Words: centre and radius.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np

from ...surfaces.ordered import greater, lesser
from ...types import Types, types_of
from .enclosing_ball import enclosing_balls
from .hulls import Hulls
from .volume import Volume, VolumeRay, relative_error, round_up

_WIDTH = 4


def fit_sphere(hulls: Hulls, types: Types) -> np.ndarray:
    """The smallest ball around each group (near to it where primitives are spheres): words (groups, 4)."""
    words = np.zeros((len(hulls), _WIDTH), dtype=types.numpy)
    words[:, :3] = enclosing_balls(hulls.samples())
    words[:, 3] = round_up(hulls.farthest(words[:, :3].astype(np.float64)), types)
    return words


def _prepare(ray: Any, types: Types) -> VolumeRay:
    """The direction scaled to a largest component of 1, so that no square overflows; ``inverse`` is that of its
    squared norm."""
    size = abs(ray.d)
    scale = dr.fmax(dr.fmax(size.x, size.y), size.z)
    d = ray.d / scale
    inverse = dr.rcp(dr.squared_norm(d))
    return VolumeRay(ray.o, d, inverse, None, None, scale, ray.tmin * scale)


def meets_sphere(words: list[Any], ray: VolumeRay, tmax: Any) -> Any:
    """Bool: whether each ray's part from tmin to ``tmax`` comes as near to the centre as the radius.

    That takes the nearest point of the segment, but neither root: *whether*, not *where*.
    """
    f = type(ray.o)(words[0], words[1], words[2]) - ray.o
    t = dr.dot(f, ray.d) * ray.inverse
    t = lesser(greater(t, ray.tmin), tmax * ray.scale)
    nearest = dr.fma(-t, ray.d, f)
    reach = abs(f.x) + abs(f.y) + abs(f.z) + 3 * words[3]
    radius = dr.fma(relative_error(ray), reach, words[3])
    # Squares of numbers this small lose their digits, and could order the sides wrongly.
    squared = dr.fma(radius, radius, _tiny(ray))
    return dr.squared_norm(nearest) <= squared


def _tiny(ray: VolumeRay) -> float:
    return 1e-36 if types_of(ray.o).precision == "float32" else 1e-300


def sphere_areas(words: np.ndarray) -> np.ndarray:
    """Surface areas (groups,)."""
    return 4 * np.pi * np.square(words[:, 3].astype(np.float64))


SPHERE = Volume(_WIDTH, fit_sphere, _prepare, meets_sphere, sphere_areas)
