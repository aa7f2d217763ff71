"""Triangle meshes as lights: points uniform over their area."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from .. import warp
from ..chances import by_choice
from ..scene import description
from ..types import Types
from . import cdf
from .sample import pack
from .shape_sample import ShapeSample, from_area


@dataclass(frozen=True, eq=False)
class MeshLights:
    """``ranges``: per light its first triangle and how many it has. ``triangles``: per triangle vertex 0, edges 1 and
    2, with the unit normal down the fourth places. ``chances``: cumulative areas, one row of count + 1 a light.
    ``areas`` per light. ``normals`` (three a triangle) and ``uv`` (three a triangle, in 8 places) are None where no
    light needs them."""

    types: Types
    ranges: Any
    triangles: Any
    chances: Any
    areas: Any
    halvings: int
    normals: Any
    uv: Any

    @staticmethod
    def build(shapes: Sequence[description.MeshShape], needs_uv: bool, types: Types) -> MeshLights:
        smooth = any(s.normals is not None for s in shapes)
        parts = [_triangles(s, types) for s in shapes]
        counts = np.array([len(t) for t, _ in parts])
        ranges = np.stack([np.cumsum(counts) - counts, counts], axis=1)
        return MeshLights(
            types,
            ranges=types.UInt(np.ascontiguousarray(ranges, dtype=np.uint32).ravel()),
            triangles=pack(np.concatenate([t for t, _ in parts]), types),
            chances=pack(np.concatenate([cdf.cumulative(area) for _, area in parts]), types),
            areas=pack(np.array([area.sum() for _, area in parts]), types),
            halvings=cdf.steps(int(counts.max())),
            normals=pack(np.concatenate([_normals(s, t) for s, (t, _) in zip(shapes, parts, strict=True)]), types)
            if smooth
            else None,
            uv=pack(np.concatenate([_uv(s) for s in shapes]), types) if needs_uv else None,
        )

    def sample(self, p: Any, index: Any, u: Any, active: Any) -> ShapeSample:
        """Uniform over the area. The emitting side is that of the shading normal, as for hits; the density is that of
        the true area."""
        types = self.types
        span = dr.gather(types.Array2u, self.ranges, index, active)
        # Each light before this one added one more entry than it has triangles.
        local, rest = cdf.invert(self.chances, span.x + index, span.y, self.halvings, u.y, active)
        triangle = span.x + local
        b = warp.square_to_uniform_triangle(types.Array2f(u.x, rest))
        p0, e1, e2 = (dr.gather(types.Array4f, self.triangles, triangle * 3 + k, active) for k in range(3))
        point = p0.xyz + e1.xyz * b.x + e2.xyz * b.y
        n = types.Array3f(p0.w, e1.w, e2.w)
        side, uv, b0 = n, b, 1 - b.x - b.y
        if self.normals is not None:
            corner = [dr.gather(types.Array4f, self.normals, triangle * 3 + k, active).xyz for k in range(3)]
            side = corner[0] * b0 + corner[1] * b.x + corner[2] * b.y
        if self.uv is not None:
            first = dr.gather(types.Array4f, self.uv, triangle * 2, active)
            last = dr.gather(types.Array4f, self.uv, triangle * 2 + 1, active)
            uv = first.xy * b0 + first.zw * b.x + last.xy * b.y
        area = dr.gather(types.Float, self.areas, index, active)
        found = from_area(p, point, n, side, area, uv)
        if dr.grad_enabled(e1, e2):
            size2 = dr.squared_norm(dr.cross(e1.xyz, e2.xyz))
            size = dr.sqrt(dr.select(size2 > 0, size2, 1))
            # The density stays that of hits, for the weights of the two to add up to one wherever they move.
            found.inverse = by_choice(found.inverse, dr.select(size2 > 0, 0.5 * size / area, 0))
        return found


def _triangles(shape: description.MeshShape, types: Types) -> tuple[np.ndarray, np.ndarray]:
    """Records (m, 12) and areas (m,), of the vertices as they are in ``types``' precision."""
    vertices = shape.vertices.astype(types.numpy).astype(np.float64)[shape.faces]
    e1, e2 = vertices[:, 1] - vertices[:, 0], vertices[:, 2] - vertices[:, 0]
    normal = np.cross(e1, e2)
    length = np.linalg.norm(normal, axis=1)
    rows = np.stack([vertices[:, 0], e1, e2], axis=1)
    unit = normal / np.where(length > 0, length, 1)[:, None]
    return np.concatenate([rows, unit[:, :, None]], axis=2).reshape(-1, 12), 0.5 * length


def _normals(shape: description.MeshShape, triangles: np.ndarray) -> np.ndarray:
    rows = np.zeros((len(triangles), 3, 4))
    flat = triangles.reshape(-1, 3, 4)[:, None, :, 3]
    rows[:, :, :3] = flat if shape.normals is None else shape.normals[shape.faces]
    return rows


def _uv(shape: description.MeshShape) -> np.ndarray:
    rows = np.zeros((len(shape.faces), 8))
    # Without coordinates of its own a mesh uses barycentric ones, those of vertices 1 and 2.
    corners = [[0, 0], [1, 0], [0, 1]] if shape.uv is None else shape.uv[shape.faces]
    rows[:, :6] = np.broadcast_to(corners, (len(rows), 3, 2)).reshape(-1, 6)
    return rows
