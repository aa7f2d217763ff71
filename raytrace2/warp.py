"""Maps from the unit square to disks, triangles, spheres, hemispheres and cones that keep areas in proportion.

Samples are Array2f in [0, 1)^2; directions are Array3f of unit length about +z. Every map agrees with Mitsuba's of the
same name, so that equal samples give equal directions. Densities that are constant are Python floats.
"""

from __future__ import annotations

import math
from typing import Any

import drjit as dr

from .types import types_of

INV_PI = 1.0 / math.pi
INV_FOUR_PI = 0.25 / math.pi


def square_to_uniform_disk_concentric(sample: Any) -> Any:
    """Points (Array2f) uniform on the unit disk, by the concentric map (Shirley and Chiu 1997, JGT 2(3))."""
    x = dr.fma(sample.x, 2, -1)
    y = dr.fma(sample.y, 2, -1)
    steep = dr.abs(x) < dr.abs(y)
    radius = dr.select(steep, y, x)
    other = dr.select(steep, x, y)
    # The centre has no angle: a divisor of 1 there keeps the value 0 and the derivative finite.
    angle = (math.pi / 4) * (other / dr.select(radius == 0, 1, radius))
    angle = dr.select(steep, math.pi / 2 - angle, angle)
    sine, cosine = dr.sincos(angle)
    return type(sample)(radius * cosine, radius * sine)


def square_to_cosine_hemisphere(sample: Any) -> Any:
    """Directions of density ``cos(theta) / pi`` on the hemisphere z >= 0 (Malley's method on the concentric map)."""
    p = square_to_uniform_disk_concentric(sample)
    z = dr.safe_sqrt(1 - dr.squared_norm(p))
    return _array3(sample)(p.x, p.y, z)


def square_to_cosine_hemisphere_pdf(direction: Any) -> Any:
    """Density, per steradian, of :func:`square_to_cosine_hemisphere`; meaningful for ``direction.z >= 0`` only."""
    return direction.z * INV_PI


def square_to_uniform_hemisphere(sample: Any) -> Any:
    """Directions uniform on the hemisphere z >= 0; their density is ``1 / (2 pi)``."""
    p = square_to_uniform_disk_concentric(sample)
    z = 1 - dr.squared_norm(p)
    p = p * dr.safe_sqrt(z + 1)
    return _array3(sample)(p.x, p.y, z)


def square_to_uniform_sphere(sample: Any) -> Any:
    """Directions uniform on the sphere; their density is ``INV_FOUR_PI``."""
    z = dr.fma(sample.y, -2, 1)
    radius = dr.safe_sqrt(dr.fma(-z, z, 1))
    sine, cosine = dr.sincos((2 * math.pi) * sample.x)
    return _array3(sample)(radius * cosine, radius * sine, z)


def square_to_uniform_cone(sample: Any, cos_cutoff: Any) -> Any:
    """Directions uniform in the cone about +z whose half angle has the cosine ``cos_cutoff``."""
    p = square_to_uniform_disk_concentric(sample)
    height = 1 - cos_cutoff
    squared = dr.squared_norm(p)
    z = cos_cutoff + height * (1 - squared)
    p = p * dr.safe_sqrt(height * (2 - height * squared))
    return _array3(sample)(p.x, p.y, z)


def square_to_uniform_cone_pdf(cos_cutoff: Any) -> Any:
    """Density, per steradian, of :func:`square_to_uniform_cone` inside its cone."""
    return (0.5 * INV_PI) / (1 - cos_cutoff)


def square_to_uniform_triangle(sample: Any) -> Any:
    """Barycentric coordinates (Array2f: weights of vertices 1 and 2) uniform on a triangle, by area."""
    root = dr.safe_sqrt(1 - sample.x)
    return type(sample)(1 - root, root * sample.y)


def _array3(sample: Any) -> Any:
    return types_of(sample).Array3f
