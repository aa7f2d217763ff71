"""How the records of area lights follow from transforms and vertices that may change.

Points on a light stay at the same place of its parameterisation, so that their densities have derivatives too. Of a
mesh, which triangle is chosen has none: what is found there is weighted by how the chance changes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import pi
from typing import Any

import drjit as dr
import numpy as np

from ..live import Live, Place, Slot, Values, put
from ..scene import description
from ..surfaces.shading_slots import affine_rows
from ..surfaces.vertex_normals import VertexNormals
from ..types import Types, types
from .area_flat import CylinderLights, DiskLights, RectangleLights
from .area_mesh import MeshLights
from .area_sphere import SphereLights

_WIDE = types("float64")
Area = Callable[[Values], Any]


def area_slots(table: Any, shapes: Sequence[Any], live: Live) -> tuple[list[Slot], dict[int, tuple[Place, Area]]]:
    """The slots of the lights of one kind of shape, and the areas of those that may change, by number."""
    if isinstance(table, MeshLights):
        return _mesh_slots(table, shapes, live)
    places = {k: p for k, s in enumerate(shapes) if (p := live.place(s, "to_world")) is not None}
    if not places:
        return [], {}
    if isinstance(table, SphereLights):
        return _sphere_slots(table, places), {k: (p, _sphere_area(p)) for k, p in places.items()}
    flips = [bool(s.flip_normals) for s in shapes]
    unit = {RectangleLights: 4.0, DiskLights: pi, CylinderLights: 2 * pi}[type(table)]
    round_ = isinstance(table, CylinderLights)

    def make(base: Any, values: Values) -> Any:
        buffer = type(base)(base)
        for k, place in places.items():
            x, y, z, at = _columns(values(place))
            normal = dr.cross(x, y)
            length = dr.norm(normal)
            mirrored = dr.detach(dr.dot(normal, z)) < 0
            sign = dr.select(mirrored != flips[k], -1, 1)
            if round_:
                words = [*at, 0, *x, 0, *y, 0, *z, sign]
            else:
                words = [*at, unit * length, *x, 0, *y, 0, *(normal / length * sign), 0]
            put(buffer, 16 * k, words)
        return buffer

    def area(place: Place) -> Area:
        def of(values: Values) -> Any:
            x, y, z, _ = _columns(values(place))
            return unit * (dr.norm(x) * dr.norm(z) if round_ else dr.norm(dr.cross(x, y)))

        return of

    areas = {k: (p, area(p)) for k, p in places.items()}
    return [Slot.of(table, "records", places.values(), make, moves=True)], areas


def _sphere_slots(table: SphereLights, places: dict[int, Place]) -> list[Slot]:
    def records(base: Any, values: Values) -> Any:
        buffer = type(base)(base)
        for k, place in places.items():
            x, _, _, at = _columns(values(place))
            put(buffer, 8 * k, [*at, dr.norm(x)])
        return buffer

    def rotations(base: Any, values: Values) -> Any:
        buffer = type(base)(base)
        for k, place in places.items():
            x, y, z, _ = _columns(values(place))
            for row, axis in enumerate((x, y, z)):
                put(buffer, 12 * k + 4 * row, list(axis / dr.norm(x)))
        return buffer

    found = [Slot.of(table, "records", places.values(), records, moves=True)]
    if table.rotations is not None:
        found.append(Slot.of(table, "rotations", places.values(), rotations, moves=True))
    return found


def _sphere_area(place: Place) -> Area:
    return lambda values: 4 * pi * dr.squared_norm(_columns(values(place))[0])


class _Triangles:
    """The triangles of a mesh in the table of its kind: ``count`` of them, from ``first`` on."""

    def __init__(self, mesh: description.MeshShape, first: int, live: Live, t: Types) -> None:
        self.first, self.count, self.types = first, len(mesh.faces), t
        self.vertices, self.own_normals = live.place(mesh, "vertices"), live.place(mesh, "normals")
        self.uv = live.place(mesh, "uv")
        self.smooth, self.sign = mesh.normals is not None, -1.0 if mesh.flipped else 1.0
        self._faces = t.UInt(np.ascontiguousarray(mesh.faces, np.uint32).ravel())
        self._normals = VertexNormals(mesh.faces, len(mesh.vertices), t) if self.smooth else None

    def corners(self, flat: Any, columns: int) -> list[list[Any]]:
        """The rows of a flat array at the three corners of each triangle, a float64 a component."""
        triangle = dr.arange(self.types.UInt, self.count)
        at = [dr.gather(self.types.UInt, self._faces, triangle * 3 + k) * columns for k in range(3)]
        wide = _WIDE.Float(flat)
        return [[dr.gather(_WIDE.Float, wide, index + axis) for axis in range(columns)] for index in at]

    def edges(self, values: Values) -> tuple[Any, Any, Any]:
        """Vertex 0 and edges 1 and 2."""
        assert self.vertices is not None
        a, b, c = (_WIDE.Array3f(*corner) for corner in self.corners(values(self.vertices), 3))
        return a, b - a, c - a

    def normals(self, values: Values) -> Any:
        """Vertex normals as they are now."""
        if self.own_normals is not None:
            return values(self.own_normals) * self.sign
        assert self.vertices is not None and self._normals is not None
        return self._normals.of(values(self.vertices))

    def write(self, buffer: Any, stride: int, word: int, value: Any) -> None:
        """One word of each triangle's record of ``stride`` words."""
        index = (dr.arange(self.types.UInt, self.count) + self.types.UInt(self.first)) * stride + word
        dr.scatter(buffer, type(buffer)(value), index)


def _mesh_slots(
    table: MeshLights, shapes: Sequence[Any], live: Live
) -> tuple[list[Slot], dict[int, tuple[Place, Area]]]:
    first, meshes = 0, []
    for mesh in shapes:
        meshes.append(_Triangles(mesh, first, live, table.types))
        first += len(mesh.faces)
    moved = {k: m for k, m in enumerate(meshes) if m.vertices is not None}
    found: list[Slot] = []
    if moved:
        places = [m.vertices for m in moved.values() if m.vertices is not None]
        found += [
            Slot.of(table, name, places, make, moves=True)
            for name, make in (
                ("triangles", lambda base, values: _records(base, values, moved)),
                ("chances", lambda base, values: _chances(base, values, moved)),
                ("areas", lambda base, values: _areas(base, values, moved)),
            )
        ]
    turned = {k: m for k, m in enumerate(meshes) if m.own_normals is not None or (m.smooth and m.vertices is not None)}
    if turned and table.normals is not None:
        places = [p for m in turned.values() if (p := m.own_normals or m.vertices) is not None]
        found.append(Slot.of(table, "normals", places, lambda base, v: _corner_normals(base, v, turned), moves=True))
    mapped = {k: m for k, m in enumerate(meshes) if m.uv is not None}
    if mapped and table.uv is not None:
        places = [m.uv for m in mapped.values() if m.uv is not None]
        found.append(Slot.of(table, "uv", places, lambda base, v: _corner_uv(base, v, mapped), moves=False))
    areas: dict[int, tuple[Place, Area]] = {}
    for k, m in moved.items():
        assert m.vertices is not None
        areas[k] = m.vertices, lambda values, m=m: dr.sum(_triangle_areas(m, values))  # type: ignore[misc]
    return found, areas


def _records(base: Any, values: Values, moved: dict[int, _Triangles]) -> Any:
    buffer = type(base)(base)
    for mesh in moved.values():
        a, e1, e2 = mesh.edges(values)
        normal = dr.cross(e1, e2)
        length2 = dr.squared_norm(normal)
        normal = normal * dr.select(length2 > 0, dr.rsqrt(dr.select(length2 > 0, length2, 1)), 0)
        for row, (vector, n) in enumerate(zip((a, e1, e2), normal, strict=True)):
            for word, value in enumerate((*vector, n)):
                mesh.write(buffer, 12, 4 * row + word, value)
    return buffer


def _triangle_areas(mesh: _Triangles, values: Values) -> Any:
    _, e1, e2 = mesh.edges(values)
    length2 = dr.squared_norm(dr.cross(e1, e2))
    return dr.select(length2 > 0, 0.5 * dr.sqrt(dr.select(length2 > 0, length2, 1)), 0)


def _chances(base: Any, values: Values, moved: dict[int, _Triangles]) -> Any:
    buffer = type(base)(base)
    for k, mesh in moved.items():
        areas = dr.detach(_triangle_areas(mesh, values))
        total = dr.sum(areas)
        sums = dr.cumsum(dr.select(total > 0, areas, 1))
        last = dr.gather(_WIDE.Float, sums, mesh.types.UInt(mesh.count - 1))
        rows = dr.concat([_WIDE.Float(0), sums / last])
        # Each light before this one has one more entry than it has triangles.
        index = dr.arange(mesh.types.UInt, mesh.count + 1) + mesh.types.UInt(mesh.first + k)
        dr.scatter(buffer, type(base)(rows), index)
    return buffer


def _areas(base: Any, values: Values, moved: dict[int, _Triangles]) -> Any:
    buffer = type(base)(base)
    for k, mesh in moved.items():
        put(buffer, k, [dr.sum(_triangle_areas(mesh, values))])
    return buffer


def _corner_normals(base: Any, values: Values, turned: dict[int, _Triangles]) -> Any:
    buffer = type(base)(base)
    for mesh in turned.values():
        for row, corner in enumerate(mesh.corners(mesh.normals(values), 3)):
            for word, value in enumerate(corner):
                mesh.write(buffer, 12, 4 * row + word, value)
    return buffer


def _corner_uv(base: Any, values: Values, mapped: dict[int, _Triangles]) -> Any:
    buffer = type(base)(base)
    for mesh in mapped.values():
        assert mesh.uv is not None
        words = [value for corner in mesh.corners(values(mesh.uv), 2) for value in corner]
        for word, value in enumerate(words):
            mesh.write(buffer, 8, word, value)
    return buffer


def _columns(matrix: Any) -> list[Any]:
    rows = affine_rows(matrix)[0]
    return [_WIDE.Array3f(*(_WIDE.Float(rows[4 * i + k]) for i in range(3))) for k in range(4)]
