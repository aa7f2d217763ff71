"""Vertex normals of meshes whose vertices move, with derivatives."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np

from ..types import Types, types, types_of


class VertexNormals:
    """The mean of the normals of the faces around each vertex, weighted by the face's angle there (Thuermer and
    Wuethrich, "Computing Vertex Normals from Polygonal Facets", JGT 3(1), 1998).

    ``faces`` (m, 3); a vertex that no face of any area uses gets (1, 0, 0), as in Mitsuba. Sums run in a fixed order.
    """

    def __init__(self, faces: np.ndarray, count: int, t: Types) -> None:
        UInt = t.UInt
        corners = np.ascontiguousarray(faces, np.uint32).ravel()
        self._faces = _table(corners, UInt)
        # The corners at each vertex one after the other, and how many there are.
        self._corners = _table(np.argsort(corners, kind="stable").astype(np.uint32), UInt)
        number = np.bincount(corners, minlength=count)
        self._number = _table(number.astype(np.uint32), UInt)
        self._first = _table((np.cumsum(number) - number).astype(np.uint32), UInt)
        self._most, self._count = int(number.max()), count

    def of(self, positions: Any) -> Any:
        """The unit normals (flat Float) for ``positions`` (flat Float), computed in float64."""
        wide = types("float64")
        Float, UInt = wide.Float, wide.UInt
        given = Float(positions)
        # Where nothing is large nothing overflows.
        given = given / dr.detach(dr.fmax(dr.max(dr.abs(given)), 1e-300))
        corner = dr.arange(UInt, dr.width(self._faces))
        face, k = corner // 3, corner % 3

        def vertex(step: int) -> Any:
            index = dr.gather(UInt, self._faces, face * 3 + (k + step) % 3)
            return wide.Array3f(*(dr.gather(Float, given, index * 3 + axis) for axis in range(3)))

        here, after, before = vertex(0), vertex(1), vertex(2)
        ahead, back = _unit(after - here), _unit(before - here)
        cross = dr.cross(ahead, back)
        size2, cosine = dr.squared_norm(cross), dr.dot(ahead, back)
        sine = dr.sqrt(dr.select(size2 > 0, size2, 1))
        weighted = dr.select(size2 > 0, cross * (dr.atan2(sine, cosine) / sine), 0)
        dr.eval(weighted)
        vertices = dr.arange(UInt, self._count)
        first, number = (dr.gather(UInt, table, vertices) for table in (self._first, self._number))
        total = dr.zeros(wide.Array3f, self._count)
        for turn in range(self._most):
            more = number > turn
            at = dr.gather(UInt, self._corners, first + turn, more)
            total += wide.Array3f(*(dr.gather(Float, c, at, more) for c in weighted))
        found = dr.any(total != 0)
        normal = dr.select(found, _unit(total), wide.Array3f(1, 0, 0))
        return types_of(positions).Float(dr.ravel(normal))


def _unit(v: Any) -> Any:
    length2 = dr.squared_norm(v)
    return dr.select(length2 > 0, v * dr.rsqrt(dr.select(length2 > 0, length2, 1)), 0)


def _table(values: np.ndarray, UInt: Any) -> Any:
    result = UInt(values) + dr.opaque(UInt, 0)
    dr.eval(result)
    return result
