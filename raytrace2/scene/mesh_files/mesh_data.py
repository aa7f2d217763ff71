"""What a mesh file holds, and the checks that every mesh passes before anything indexes with it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ...errors import FileError

LineOf = Callable[[str, int], int | None]
"""``line_of("vertex" | "face", index)``: the line of a text file that holds that record, if there is one."""


@dataclass(frozen=True, eq=False)
class MeshData:
    """A triangle mesh as its file has it, in the file's own coordinate system.

    ``vertices`` (n, 3) float32 or float64; ``faces`` (m, 3) uint32; ``normals`` (n, 3) or None, neither transformed
    nor normalised, where a row of zeros means that the file gives that vertex none; ``uv`` (n, 2) or None;
    ``attributes`` maps ``vertex_...`` and ``face_...`` names to (n, c) and (m, c) arrays. Arrays are read-only.
    """

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray | None = None
    uv: np.ndarray | None = None
    attributes: dict[str, np.ndarray] = field(default_factory=dict)


def checked_mesh(mesh: MeshData, path: str, line_of: LineOf | None = None) -> MeshData:
    """``mesh`` with its arrays made read-only, once it has faces, indices within range and finite numbers.

    :class:`FileError` names ``path`` (and the line, where ``line_of`` knows it) and the first offender.
    """

    def line(kind: str, index: int) -> int | None:
        return line_of(kind, index) if line_of else None

    n, m = len(mesh.vertices), len(mesh.faces)
    if n == 0 or m == 0:
        remedy = "a mesh needs at least one triangle; remove the shape or fix the file"
        raise FileError(f"the mesh is empty: {n} vertices, {m} faces", path, remedy=remedy)
    if int(mesh.faces.max()) >= n:
        face = int(np.argmax((mesh.faces >= n).any(axis=1)))
        message = f"face {face} refers to vertex {int(mesh.faces[face].max())}, but there are only {n} vertices"
        raise FileError(message, path, line("face", face), "fix the face or re-export the mesh")
    per_vertex = [("coordinates", mesh.vertices), ("normal", mesh.normals), ("texture coordinates", mesh.uv)]
    for what, array in per_vertex:
        if array is not None:
            _require_finite(array, "vertex", what, path, line)
    for name, array in mesh.attributes.items():
        _require_finite(array, name.partition("_")[0], f"attribute {name!r}", path, line)
    for array in (mesh.vertices, mesh.faces, mesh.normals, mesh.uv, *mesh.attributes.values()):
        if array is not None:
            array.setflags(write=False)
    return mesh


def refuse_zero_normals(normals: np.ndarray, faces: np.ndarray, path: str, line_of: LineOf | None = None) -> None:
    """:class:`FileError` if a vertex that some face uses has a normal of length zero (others do not matter)."""
    zero = ~normals.any(axis=1)
    if not zero.any():
        return
    used = np.zeros(len(normals), dtype=bool)
    used[faces.ravel()] = True
    if (zero & used).any():
        vertex = int(np.argmax(zero & used))
        line = line_of("vertex", vertex) if line_of else None
        remedy = "set face_normals to true, or re-export without normals so that they are computed"
        raise FileError(f"the normal of vertex {vertex} has length zero", path, line, remedy)


def _require_finite(array: np.ndarray, kind: str, what: str, path: str, line: Callable[[str, int], int | None]) -> None:
    finite = np.isfinite(array)
    if finite.all():
        return
    index = int(np.argmin(finite.all(axis=1)))
    values = " ".join(str(x) for x in array[index].tolist())
    message = f"the {what} of {kind} {index} is not finite: {values}"
    raise FileError(message, path, line(kind, index), "NaN and infinity have no place in a mesh; re-export it")
