"""Spheres as lights: directions uniform in the cone that a sphere fills, or points uniform over it from inside."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi
from typing import Any

import drjit as dr
import numpy as np

from .. import warp
from ..scene import description
from ..surfaces.frame import Frame, coordinate_system
from ..types import Types
from .area_flat import turn
from .sample import pack, towards
from .shape_sample import ShapeSample, from_area, solid_angle


@dataclass(frozen=True, eq=False)
class SphereLights:
    """``records``: per light centre and radius; sign (1 emits outwards, -1 inwards), 0, 0, 0. ``rotations``: per light
    the rows of world to local, or None if no light needs surface coordinates."""

    types: Types
    records: Any
    rotations: Any

    @staticmethod
    def build(shapes: Sequence[description.SphereShape], needs_uv: bool, types: Types) -> SphereLights:
        rows = np.zeros((len(shapes), 2, 4))
        rotations = np.zeros((len(shapes), 3, 4))
        for i, shape in enumerate(shapes):
            linear = shape.to_world[:3, :3]
            radius = float(np.linalg.norm(linear[:, 0]))
            rows[i, 0] = *shape.to_world[:3, 3], radius
            rows[i, 1, 0] = -1.0 if shape.flip_normals else 1.0
            rotations[i, :, :3] = linear.T / (radius or 1.0)
        return SphereLights(types, pack(rows, types), pack(rotations, types) if needs_uv else None)

    def sample(self, p: Any, index: Any, u: Any, active: Any) -> ShapeSample:
        types = self.types
        center, radius, sign = self.sphere(index, active)
        axis, distance, outside, span, sine = _cone(p, center, radius, sign)

        # 1 - cos(theta) is uniform over the cone; written so that nothing cancels however small the cone.
        versine = u.x * span
        cos_theta = 1 - versine
        sin_theta = dr.safe_sqrt(versine * (2 - versine))
        fraction = u.x * (2 - versine) / (2 - span)  # (sin(theta) / sin(theta_max))^2
        rest = dr.safe_sqrt(1 - fraction)
        sin_phi, cos_phi = dr.sincos((2 * pi) * u.y)
        farther = dr.select(outside, distance * cos_theta + radius * rest, 1)
        nearest = (distance - radius) * ((distance + radius) / farther)
        frame = Frame(*coordinate_system(axis), axis)
        d = frame.to_world(types.Array3f(sin_theta * cos_phi, sin_theta * sin_phi, cos_theta))
        sin_alpha = dr.safe_sqrt(fraction) * nearest / dr.select(outside, distance, 1)
        cos_alpha = fraction * sine + cos_theta * rest
        n = frame.to_world(types.Array3f(sin_alpha * cos_phi, sin_alpha * sin_phi, -cos_alpha))

        inner = warp.square_to_uniform_sphere(u)
        n = dr.select(outside, n, inner)
        point = dr.fma(n, radius, center)
        result = from_area(p, point, n, n * sign, (4 * pi) * radius * radius, self._uv(index, n, active))
        solid = (2 * pi) * span
        cone = ShapeSample(point, d, nearest, dr.rcp(solid), solid, sign > 0, result.uv)
        return dr.select(outside, cone, result)

    def inverse(self, p: Any, index: Any, hit: Any, active: Any) -> Any:
        """The ``u`` for which :meth:`sample` from ``p`` finds the point ``hit`` of light ``index``, or, where
        the sphere itself hides that from ``p``, the point that hides it."""
        center, radius, sign = self.sphere(index, active)
        axis, _, outside, span, _ = _cone(p, center, radius, sign)
        d, _ = towards(p, hit)
        local = Frame(*coordinate_system(axis), axis).to_local(d)
        # 1 - cos(theta) of unit vectors, where nothing cancels.
        versine = dr.squared_norm(d - axis) / 2
        seen = dr.fmin(versine / dr.select(outside, span, 1), 1), turn(local.x, local.y)
        n = (hit - center) / radius
        return dr.select(outside, self.types.Array2f(*seen), self.types.Array2f(turn(n.x, n.y), (1 - n.z) / 2))

    def inverse_pdf(self, p: Any, index: Any, hit: Any, n: Any, active: Any) -> Any:
        """The inverse of the density per steradian at the point ``hit`` with normal ``n``, from ``p``."""
        center, radius, sign = self.sphere(index, active)
        _, _, outside, span, _ = _cone(p, center, radius, sign)
        d, dist = towards(p, hit)
        return dr.select(outside, (2 * pi) * span, solid_angle((4 * pi) * radius * radius, d, dist, n))

    def sphere(self, index: Any, active: Any) -> tuple[Any, Any, Any]:
        """Centre, radius and sign of light ``index``."""
        record = dr.gather(self.types.Array4f, self.records, index * 2, active)
        return record.xyz, record.w, dr.gather(self.types.Array4f, self.records, index * 2 + 1, active).x

    def _uv(self, index: Any, n: Any, active: Any) -> Any:
        types = self.types
        if self.rotations is None:
            return dr.zeros(types.Array2f)
        local = [dr.dot(dr.gather(types.Array4f, self.rotations, index * 3 + k, active).xyz, n) for k in range(3)]
        across = dr.safe_sqrt(local[0] * local[0] + local[1] * local[1])
        polar = dr.atan2(across, dr.select(active, local[2], 1)) * (1 / pi)
        return types.Array2f(turn(local[0], local[1]), polar)


def _cone(p: Any, center: Any, radius: Any, sign: Any) -> tuple[Any, Any, Any, Any, Any]:
    """The sphere's axis and distance from ``p``; if it is met from outside; ``1 - cos`` and ``sin`` of its half
    angle."""
    axis, distance = towards(p, center)
    # A sphere that shines inwards is met from inside only: points on it are not outside, wherever rounding puts them.
    outside = (distance > radius) & (sign > 0)
    sine = radius / dr.select(outside, distance, 1)
    near = dr.select(outside, (distance - radius) / distance, 0)
    cosine = dr.safe_sqrt(near * (1 + sine))
    return axis, distance, outside, sine * sine / (1 + cosine), sine
