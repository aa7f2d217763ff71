"""The curves on surfaces along which something may begin to hide something else: edges of meshes, rims, and outlines
of what is round."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, fields
from typing import Any

import drjit as dr
import numpy as np

from ..buffers import owned
from ..surfaces.geometry import Geometry
from ..surfaces.mesh import TriangleMesh
from ..surfaces.quadrics import Cylinder, Disk, Quadric, Rectangle, Sphere
from ..surfaces.record import NONE
from ..surfaces.shading import Rows
from .mesh_edges import NO_VERTEX, mesh_edges, welded
from .round_curves import CODES, Eye, round_curve

#: Curves of each kind of surface other than meshes, by their codes in :mod:`.round_curves`.
_OF_KIND: dict[type, tuple[int, ...]] = {
    Rectangle: (CODES["side"], CODES["side"] + 1, CODES["side"] + 2, CODES["side"] + 3),
    Disk: (CODES["rim"],),
    Sphere: (CODES["outline"],),
    Cylinder: (CODES["rim"], CODES["top"], CODES["line"], CODES["line"] + 1),
}


@dataclass
class CurvePoint:
    """A point ``x`` of a curve and how it moves along it (``along``, per unit of the parameter), Array3f; ``inner``, a
    point of the surface that the curve bounds; ``hides`` Bool: as seen from the eye the surface ends there; ``bend``
    Float: the sine of the angle between the surface's normals on either side, 1 where it ``hides`` or another mesh goes
    on."""

    x: Any
    along: Any
    inner: Any
    hides: Any
    bend: Any


class Curves:
    """The curves of the ``surfaces`` (numbers) of ``geometry``; ``count`` of them, numbered from 0.

    Points of them follow what the buffers of ``geometry.shading`` hold at the time, with derivatives.
    """

    def __init__(self, geometry: Geometry, surfaces: Collection[int]) -> None:
        self.types, self._shading = geometry.types, geometry.shading
        faces, places, rounds = [], [np.zeros((0, 3))], []
        for k in surfaces:
            surface = geometry.surfaces[k]
            if isinstance(surface, TriangleMesh):
                faces.append((surface.faces, sum(map(len, places)), geometry.shading.first_vertex[k]))
                places.append(surface.vertices)
            elif isinstance(surface, Quadric):
                rounds += [(k, code, 0, NO_VERTEX) for code in _OF_KIND[type(surface)]]
        edges, copies, joins = _edges(faces, np.concatenate(places))
        self.edge_count = len(edges)
        self.count = self.edge_count + len(rounds)
        self._codes = sorted({code for _, code, _, _ in rounds})
        words = np.concatenate([edges, np.array(rounds, np.uint32).reshape(-1, 4)])
        UInt = self.types.UInt
        self._words = owned(words.astype(np.uint32), UInt)
        self._edges = dr.opaque(UInt, self.edge_count)
        shares = np.r_[1 / copies, np.ones(len(rounds))]
        self._shares = owned(shares, self.types.Float) if (copies > 1).any() else None
        self._joins = owned(joins.astype(np.uint32), UInt) if joins.any() else None

    @staticmethod
    def of(geometry: Geometry, surfaces: Collection[int]) -> Curves | None:
        """Those of ``surfaces``, made once while only their places change; None if there are none."""
        key = Curves, tuple(surfaces)
        kept = geometry.shading.kept
        if key not in kept:
            kept[key] = Curves(geometry, surfaces)
        return kept[key] if kept[key].count else None

    def at(self, index: Any, s: Any, eye: Eye, active: Any = True) -> CurvePoint:
        """The point at parameter ``s`` (Float in [0, 1]) of curve ``index`` (UInt), for what is seen from ``eye``."""
        words = dr.gather(self.types.Array4u, self._words, index, active)
        parts = []
        if self.edge_count:
            parts.append(self._on_edge(index, words, s, eye, active & (index < self._edges)))
        if self._codes:
            parts.append(self._on_round(words, s, eye, active & (index >= self._edges)))
        point = parts[0]
        if len(parts) == 2:
            is_edge, (point, other) = index < self._edges, parts
            pairs = ((getattr(point, f.name), getattr(other, f.name)) for f in fields(CurvePoint))
            point = CurvePoint(*(dr.select(is_edge, a, b) for a, b in pairs))
        return point

    def share(self, index: Any, active: Any = True) -> Any:
        """Which part of a jump is for curve ``index`` to account for: edges that lie on one another share it."""
        if self._shares is None:
            return self.types.Float(1)
        return dr.gather(self.types.Float, self._shares, index, active)

    def outlined(self, index: Any, active: Any = True) -> Any:
        """The surface (UInt) of which curve ``index`` is an outline, which none of its own points sees; or NONE."""
        if not any(code >= CODES["outline"] for code in self._codes):
            return self.types.UInt(NONE)
        words = dr.gather(self.types.Array4u, self._words, index, active)
        return dr.select((index >= self._edges) & (words.y >= CODES["outline"]), words.x, NONE)

    def straight(self, index: Any) -> Any:
        """Bool: whether curve ``index`` is an edge of a mesh."""
        return index < self._edges

    def lengths(self) -> Any:
        """About how long each curve is (Float, detached)."""
        Float = self.types.Float
        index = dr.arange(self.types.UInt, self.count)
        words = dr.gather(self.types.Array4u, self._words, index)
        length = dr.zeros(Float, self.count)
        if self.edge_count:
            on_edge = index < self._edges
            length = dr.select(on_edge, dr.norm(self._vertex(words.y, on_edge) - self._vertex(words.x, on_edge)), 0)
        if self._codes:
            rows = Rows(self._quadric(words, index >= self._edges)[0]).rows
            sizes = [dr.norm(self.types.Array3f(*(row[k] for row in rows))) for k in range(3)]
            code, widest = words.y, dr.fmax(sizes[0], sizes[1])
            side = dr.select((code & 1) == 0, sizes[0], sizes[1]) * 2
            found = dr.select(code < CODES["rim"], side, widest * dr.two_pi)
            found = dr.select(code >= CODES["line"], sizes[2], found)
            length = dr.select(index < self._edges, length, found)
        return dr.detach(length)

    def _vertex(self, index: Any, active: Any) -> Any:
        q = dr.gather(self.types.Array4f, self._shading.vertices, index, active)
        return self.types.Array3f(q.x, q.y, q.z)

    def _on_edge(self, index: Any, words: Any, s: Any, eye: Eye, active: Any) -> CurvePoint:
        lone = words.w == NO_VERTEX
        a, b, c = (self._vertex(k, active) for k in (words.x, words.y, words.z))
        d = self._vertex(words.w, active & ~lone)
        along = b - a
        # Normals of the faces as if they went round the edge in opposite ways.
        edge, way = dr.detach(along), eye.way_from(dr.detach(a))
        first, second = dr.cross(edge, dr.detach(c - a)), dr.cross(dr.detach(d - a), edge)
        near, far = dr.dot(first, way), dr.dot(second, way)
        # Faces seen from the edge on may be on either side of it, for all that rounding tells.
        slack = 16 * self.types.epsilon
        faint = dr.abs(near) <= slack * dr.norm(first) * dr.norm(way)
        faint |= dr.abs(far) <= slack * dr.norm(second) * dr.norm(way)
        hides = lone | faint | ((near < 0) != (far < 0))
        size = dr.norm(first) * dr.norm(second)
        bend = dr.norm(dr.cross(first, second)) / dr.select(size > 0, size, 1)
        bend = dr.select(active & (size > 0), bend, 0)
        if self._joins is not None:
            # What two meshes are made of may differ, however flat they join.
            bend = dr.select(active & (dr.gather(self.types.UInt, self._joins, index, active) != 0), 1, bend)
        hides &= active
        return CurvePoint(dr.fma(along, s, a), along, dr.detach(c), hides, dr.select(hides, 1, bend))

    def _on_round(self, words: Any, s: Any, eye: Eye, active: Any) -> CurvePoint:
        to_world, to_local = (Rows(r) for r in self._quadric(words, active))
        local = Eye(to_local.vector(eye.at) if eye.parallel else to_local.point(eye.at), eye.parallel)
        x, along, inner, hides = round_curve(self._codes, words.y, s, local)
        world = to_world.point(x), to_world.vector(along), dr.detach(to_world.point(inner))
        hides &= active
        return CurvePoint(*world, hides, dr.select(hides, self.types.Float(1), 0))

    def _quadric(self, words: Any, active: Any) -> tuple[Any, Any]:
        rows, width = self._shading.quadric_rows, dr.width(words)
        first, second = (
            dr.gather(self.types.ArrayXf, rows, words.x * 2 + k, active, shape=(16, width)) for k in range(2)
        )
        return first, second


def _edges(faces: list[tuple[np.ndarray, int, int]], places: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The edges of several meshes, each given by faces, its first vertex among ``places``, and that in the buffers; how
    many lie on one another; and where two meshes join."""
    if not faces:
        return np.zeros((0, 4), np.uint32), np.zeros(0, np.int64), np.zeros(0, bool)
    corners = np.concatenate([f.astype(np.int64) + start for f, start, _ in faces])
    edges, copies = mesh_edges(corners, welded(places))
    starts = [start for _, start, _ in faces]
    mesh = np.searchsorted(starts, np.minimum(edges[:, 2:], len(places) - 1), side="right")
    joins = (edges[:, 3] != NO_VERTEX) & (mesh[:, 0] != mesh[:, 1])
    numbers = np.zeros(len(places), np.uint32)
    for which, start, first in faces:
        count = int(which.max()) + 1
        numbers[start : start + count] = np.arange(first, first + count)
    known = edges != NO_VERTEX
    edges[known] = numbers[edges[known]]
    return edges, copies, joins
