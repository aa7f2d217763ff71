"""How the buffers that interactions are computed from follow from vertices and transforms that may change."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import drjit as dr

from ..live import Live, Place, Slot, Values, put
from ..types import Types, types
from .vertex_normals import VertexNormals

_Write = Callable[[Any, Any], None]


def shading_slots(shading: Any, shapes: Sequence[Any], instances: Sequence[Any], live: Live) -> list[Slot]:
    """The slots of ``shading`` (:class:`~.shading.Shading`), whose surfaces and instances ``shapes`` and ``instances``
    describe."""
    found: list[Slot] = []
    for attribute, columns, field in (("vertices", 4, "vertices"), ("uvs", 2, "uv")):
        writes = {}
        for k, shape in enumerate(shapes):
            place = live.place(shape, field)
            if place is not None:
                writes[place] = _rows_into(shading.first_vertex[k], {4: 3, 2: 2}[columns], columns, shading.types)
        if writes:
            found.append(_slot(shading, attribute, writes))
    found += _normal_slots(shading, shapes, live)
    for attribute, items, words, inverse in (("quadric_rows", shapes, 32, 16), ("instance_rows", instances, 24, 12)):
        placed = [(k, live.place(item, "to_world")) for k, item in enumerate(items)]
        writes = {place: _maps_into(words * k, inverse) for k, place in placed if place is not None}
        if writes:
            found.append(_slot(shading, attribute, writes))
    return found


def _slot(holder: Any, attribute: str, writes: dict[Place, _Write]) -> Slot:
    def make(base: Any, values: Values) -> Any:
        buffer = type(base)(base)
        for place, write in writes.items():
            write(buffer, values(place))
        return buffer

    return Slot.of(holder, attribute, writes, make, moves=True)


def _normal_slots(shading: Any, shapes: Sequence[Any], live: Live) -> list[Slot]:
    """Normals are what was set, or else follow the positions, as in Mitsuba."""
    t = shading.types
    writes: list[tuple[Place, Callable[[Any], Any], _Write]] = []
    for k, shape in enumerate(shapes):
        if getattr(shape, "normals", None) is None:
            continue
        into = _rows_into(shading.first_vertex[k], 3, 4, t)
        sign = -1.0 if shape.flipped else 1.0
        own, moved = live.place(shape, "normals"), live.place(shape, "vertices")
        if own is not None:
            writes.append((own, _times(sign), into))
        elif moved is not None:
            writes.append((moved, VertexNormals(shape.faces, len(shape.vertices), t).of, into))

    def make(base: Any, values: Values) -> Any:
        buffer = type(base)(base)
        for place, derive, write in writes:
            write(buffer, derive(values(place)))
        return buffer

    places: Iterable[Place] = [place for place, _, _ in writes]
    return [Slot.of(shading, "normals", places, make, moves=True)] if writes else []


def _times(sign: float) -> Callable[[Any], Any]:
    return lambda value: value * sign


def _rows_into(first: int, columns: int, stride: int, t: Types) -> _Write:
    """Writes a flat array of rows of ``columns`` into a buffer of rows of ``stride``, from row ``first`` on."""
    start = dr.opaque(t.UInt, first * stride)

    def write(buffer: Any, value: Any) -> None:
        k = dr.arange(t.UInt, dr.width(value))
        dr.scatter(buffer, value, k // columns * stride + k % columns + start)

    return write


def _maps_into(first: int, inverse: int) -> _Write:
    """Writes the rows of an affine map, and ``inverse`` words later those of its inverse."""

    def write(buffer: Any, value: Any) -> None:
        rows, back = affine_rows(value)
        put(buffer, first, rows)
        put(buffer, first + inverse, back)

    return write


def affine_rows(matrix: Any) -> tuple[list[Any], list[Any]]:
    """The first three rows of an affine 4x4 matrix and of its inverse, each as 12 Floats.

    The inverse is computed in float64, as it is where nothing is live.
    """
    wide = types("float64").Float
    m = [[wide(matrix[i, j]) for j in range(4)] for i in range(3)]
    a, b, c = ([row[k] for row in m] for k in range(3))

    def cross(p: list[Any], q: list[Any]) -> list[Any]:
        return [p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]]

    bc = cross(b, c)
    factor = 1 / (a[0] * bc[0] + a[1] * bc[1] + a[2] * bc[2])
    linear = [[x * factor for x in row] for row in (bc, cross(c, a), cross(a, b))]
    at = [row[3] for row in m]
    back = [[*row, -(row[0] * at[0] + row[1] * at[1] + row[2] * at[2])] for row in linear]
    return [matrix[i, j] for i in range(3) for j in range(4)], [x for row in back for x in row]
