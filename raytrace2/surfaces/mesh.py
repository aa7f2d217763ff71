"""Triangle meshes."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..arguments import real_array
from ..errors import GeometryError
from ..types import Types
from . import record
from .primitives import Primitives
from .surface import Surface


@dataclass(frozen=True, eq=False)
class TriangleMesh(Surface):
    """Triangles with shared vertices, in world coordinates.

    ``vertices`` (n, 3) float, ``faces`` (m, 3) int, ``uv`` (n, 2) or None, ``normals`` (n, 3) or None (then shading
    is flat). Dr.Jit arrays are accepted too. ``GeometryError`` for other shapes, no faces, indices out of range, NaN
    or infinite numbers.
    """

    vertices: Any
    faces: Any
    uv: Any = None
    normals: Any = None
    name: str = field(default="mesh", kw_only=True)

    def __post_init__(self) -> None:
        set_ = object.__setattr__
        set_(self, "vertices", _numbers(self.vertices, 3, self.name, "vertices"))
        set_(self, "faces", self._checked_faces())
        for key, columns in (("uv", 2), ("normals", 3)):
            value = getattr(self, key)
            if value is not None:
                array = _numbers(value, columns, self.name, key)
                if len(array) != len(self.vertices):
                    counts = f"{len(array)} {key} for {len(self.vertices)} vertices"
                    raise GeometryError(f"{self.name}: {counts}; give one each")
                set_(self, key, array)

    def _checked_faces(self) -> np.ndarray:
        faces = _host(self.faces, f"{self.name}: faces")
        if faces.ndim == 1 and faces.size % 3 == 0:
            faces = faces.reshape(-1, 3)
        if faces.ndim != 2 or faces.shape[1] != 3:
            raise GeometryError(f"{self.name}: faces must have shape (m, 3), not {faces.shape}")
        if len(faces) == 0:
            raise GeometryError(f"{self.name}: the mesh has no faces; leave it out or give it some")
        if faces.dtype.kind == "f":
            if not (np.isfinite(faces).all() and np.array_equal(faces, np.floor(faces))):
                raise GeometryError(f"{self.name}: faces must be integers")
        elif faces.dtype.kind not in "iu":
            raise GeometryError(f"{self.name}: faces must be integers, not {faces.dtype}")
        bad = (faces < 0) | (faces >= len(self.vertices))
        if bad.any():
            row = int(np.flatnonzero(bad.any(axis=1))[0])
            index, count = int(faces[row][bad[row]][0]), len(self.vertices)
            raise GeometryError(f"{self.name}: face {row} has index {index}, but there are {count} vertices")
        faces = np.ascontiguousarray(faces, dtype=np.uint32)
        faces.setflags(write=False)
        return faces

    @property
    def primitive_count(self) -> int:
        return len(self.faces)

    def primitives(self, types: Types, first_id: int = 0) -> Primitives:
        corners = self.vertices.astype(types.numpy)[self.faces]
        ids = np.arange(first_id, first_id + len(corners), dtype=np.uint32)
        records = record.make_records(corners.reshape(-1, 9), ids, record.TRIANGLE, types)
        # Pairwise: NumPy is slow at reducing axes this short.
        a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
        lo, hi = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
        return Primitives(types, records, lo, hi, (record.TRIANGLE,))


def _host(value: Any, what: str) -> np.ndarray:
    """``value`` as NumPy; Dr.Jit arrays of vectors come transposed."""
    array = real_array(value, what)
    is_vectors = hasattr(type(value), "IsDrJit") or type(value).__module__.startswith(("drjit", "mitsuba"))
    if is_vectors and array.ndim == 2 and array.shape[0] in (2, 3) and "Tensor" not in type(value).__name__:
        array = array.T
    return array


def _numbers(value: Any, columns: int, name: str, key: str) -> np.ndarray:
    array = np.array(_host(value, f"{name}: {key}"), dtype=np.float64)
    if array.ndim == 1 and array.size % columns == 0:
        array = array.reshape(-1, columns)
    if array.ndim != 2 or array.shape[1] != columns:
        raise GeometryError(f"{name}: {key} must have shape (n, {columns}), not {array.shape}")
    if not np.isfinite(array).all():
        row = int(np.flatnonzero(~np.isfinite(array).all(axis=1))[0])
        raise GeometryError(f"{name}: {key} {row} is {array[row].tolist()}; every number must be finite")
    if np.abs(array).max(initial=0) > 1e30:
        largest = f"{np.abs(array).max():g}"
        raise GeometryError(f"{name}: {key} reach {largest}; scale them down to 1e30 or less")
    array.setflags(write=False)
    return array
