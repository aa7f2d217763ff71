"""Rectangles, disks and cylinders as lights: points uniform over their area."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi
from typing import Any

import drjit as dr
import numpy as np

from .. import warp
from ..scene import description
from ..types import Types
from .sample import pack
from .shape_sample import ShapeSample, from_area


@dataclass(frozen=True, eq=False)
class RectangleLights:
    """``records``: per light centre, area; half-edges u and v, 0; unit normal of the emitting side, 0."""

    types: Types
    records: Any

    @staticmethod
    def build(shapes: Sequence[description.RectangleShape], types: Types) -> RectangleLights:
        return RectangleLights(types, pack(np.stack([_planar(s, 4.0) for s in shapes]), types))

    def sample(self, p: Any, index: Any, u: Any, active: Any) -> ShapeSample:
        q = 2 * u - 1
        return _planar_sample(self.types, self.records, p, index, q, u, active)


@dataclass(frozen=True, eq=False)
class DiskLights:
    """``records``: per light centre, area; the radii along local x and y, 0; unit normal of the emitting side, 0."""

    types: Types
    records: Any
    needs_uv: bool

    @staticmethod
    def build(shapes: Sequence[description.DiskShape], needs_uv: bool, types: Types) -> DiskLights:
        return DiskLights(types, pack(np.stack([_planar(s, pi) for s in shapes]), types), needs_uv)

    def sample(self, p: Any, index: Any, u: Any, active: Any) -> ShapeSample:
        q = warp.square_to_uniform_disk_concentric(u)
        uv = dr.zeros(self.types.Array2f)
        if self.needs_uv:
            uv = self.types.Array2f(dr.safe_sqrt(dr.squared_norm(q)), turn(q.x, q.y))
        return _planar_sample(self.types, self.records, p, index, q, uv, active)


@dataclass(frozen=True, eq=False)
class CylinderLights:
    """``records``: per light base centre, 0; radii along local x and y, 0; the axis, and 1 or -1 as it emits outwards
    or inwards. Transforms may be uneven: the density follows the stretched area."""

    types: Types
    records: Any

    @staticmethod
    def build(shapes: Sequence[description.CylinderShape], types: Types) -> CylinderLights:
        rows = np.zeros((len(shapes), 4, 4))
        for row, shape in zip(rows, shapes, strict=True):
            row[0, :3] = shape.to_world[:3, 3]
            row[1:, :3] = shape.to_world[:3, :3].T
            row[3, 3] = _sign(shape)
        return CylinderLights(types, pack(rows, types))

    def sample(self, p: Any, index: Any, u: Any, active: Any) -> ShapeSample:
        base, x, y, axis = (dr.gather(self.types.Array4f, self.records, index * 4 + k, active) for k in range(4))
        sine, cosine = dr.sincos((2 * pi) * u.y)
        point = base.xyz + x.xyz * cosine + y.xyz * sine + axis.xyz * u.x
        n, area = self._normal_and_area(x, y, axis, cosine, sine)
        return from_area(p, point, n, n * axis.w, area, self.types.Array2f(u.y, u.x))

    def area(self, index: Any, uv: Any, active: Any) -> Any:
        """The inverse of the area density at surface coordinates ``uv``."""
        _, x, y, axis = (dr.gather(self.types.Array4f, self.records, index * 4 + k, active) for k in range(4))
        sine, cosine = dr.sincos((2 * pi) * uv.x)
        return self._normal_and_area(x, y, axis, cosine, sine)[1]

    @staticmethod
    def _normal_and_area(x: Any, y: Any, axis: Any, cosine: Any, sine: Any) -> tuple[Any, Any]:
        normal = dr.cross(y.xyz * cosine - x.xyz * sine, axis.xyz)
        length = dr.safe_sqrt(dr.squared_norm(normal))
        return normal / dr.select(length > 0, length, 1), (2 * pi) * length


def turn(x: Any, y: Any) -> Any:
    """The angle of (x, y) as a fraction of a full turn in [0, 1]; 0 at the origin."""
    angle = dr.atan2(y, dr.select((x == 0) & (y == 0), 1, x)) * (0.5 / pi)
    return dr.select(angle < 0, angle + 1, angle)


def _planar(shape: description.RectangleShape | description.DiskShape, unit_area: float) -> np.ndarray:
    x, y = shape.to_world[:3, 0], shape.to_world[:3, 1]
    normal = np.cross(x, y)
    length = float(np.linalg.norm(normal))
    row = np.zeros((4, 4))
    row[0, :3], row[0, 3] = shape.to_world[:3, 3], unit_area * length
    row[1, :3], row[2, :3] = x, y
    row[3, :3] = normal / (length or 1.0) * _sign(shape)
    return row


def _planar_sample(types: Types, records: Any, p: Any, index: Any, q: Any, uv: Any, active: Any) -> ShapeSample:
    centre, x, y, normal = (dr.gather(types.Array4f, records, index * 4 + k, active) for k in range(4))
    point = centre.xyz + x.xyz * q.x + y.xyz * q.y
    return from_area(p, point, normal.xyz, normal.xyz, centre.w, uv)


def _sign(shape: description.RectangleShape | description.DiskShape | description.CylinderShape) -> float:
    # Normals transform by the inverse transpose, so a mirroring turns the cross product of the tangents against them.
    mirrored = np.linalg.det(shape.to_world[:3, :3]) < 0
    return -1.0 if mirrored != shape.flip_normals else 1.0
