"""Records and boxes of triangles whose vertices have moved, on the device."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import drjit as dr
import numpy as np

from ..buffers import owned
from ..surfaces.mesh import TriangleMesh
from ..surfaces.primitives import DevicePrimitives
from ..surfaces.record import GEOMETRY, WORDS
from ..surfaces.surface import Surface
from .sah_boxes import store
from .topology import Topology


def moved_triangles(
    meshes: Sequence[Surface], topology: Topology, before: DevicePrimitives
) -> tuple[DevicePrimitives, Any]:
    """The triangles of ``meshes`` in the order of the leaves, and packets of their boxes. ``before`` holds them as
    they were."""
    types = topology.types
    UInt, Float = types.UInt, types.Float
    vertices = np.concatenate([m.vertices for m in meshes if isinstance(m, TriangleMesh)]).astype(types.numpy)
    positions, faces = Float(vertices.ravel()) * 2.0**-before.exponent, _faces(meshes, topology)
    n = len(topology.order)
    row = dr.arange(UInt, n)
    corners = []
    for k in range(3):
        vertex = dr.gather(UInt, faces, row * 3 + k)
        corners.append([dr.gather(Float, positions, vertex * 3 + axis) for axis in range(3)])
    rest = dr.gather(types.ArrayXf, before.buffer, row * (WORDS // 4) + GEOMETRY // 4, shape=(WORDS - GEOMETRY, n))
    record = dr.zeros(types.ArrayXf, shape=(WORDS, n))
    for k, word in enumerate([x for corner in corners for x in corner]):
        record[k] = word
    for k in range(WORDS - GEOMETRY):
        record[GEOMETRY + k] = rest[k]
    buffer, boxes = dr.empty(Float, n * WORDS), dr.empty(Float, n * 8)
    dr.scatter(buffer, record, row)
    a, b, c = corners
    low = [dr.fmin(dr.fmin(x, y), z) for x, y, z in zip(a, b, c, strict=True)]
    high = [dr.fmax(dr.fmax(x, y), z) for x, y, z in zip(a, b, c, strict=True)]
    store(types, boxes, row, [*low, *(-x for x in high)])
    dr.eval(buffer, boxes)
    return replace(before, buffer=buffer), boxes


def _faces(meshes: Sequence[Surface], topology: Topology) -> Any:
    """The vertices of each triangle in the order of the leaves, kept with the topology while the faces are the same
    arrays."""
    tables = [m.faces for m in meshes if isinstance(m, TriangleMesh)]
    kept = topology.__dict__.get("_faces")
    if (
        kept is not None
        and len(kept[0]) == len(tables)
        and all(a is b or np.array_equal(a, b) for a, b in zip(kept[0], tables, strict=True))
    ):
        return kept[1]
    starts = np.cumsum([0, *(len(m.vertices) for m in meshes if isinstance(m, TriangleMesh))])[:-1]
    faces = np.concatenate([table + np.uint32(start) for table, start in zip(tables, starts, strict=True)])
    made = owned(faces.take(topology.order, axis=0), topology.types.UInt)
    topology.__dict__["_faces"] = (tables, made)
    return made
