"""PLY meshes (ascii, binary of either byte order), read as Mitsuba 3.9.1 reads them: triangles only."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial

import numpy as np

from ...errors import FileError
from ...files import read_bytes
from .mesh_data import LineOf, MeshData, checked_mesh, refuse_zero_normals
from .ply_attributes import attribute_groups, attribute_values
from .ply_header import Element, Header, read_header

Columns = list[np.ndarray]
_TRAILING = "the file is damaged or its faces are not triangles; triangulate or export it again"
_UV_NAMES = (("u", "v"), ("texture_u", "texture_v"), ("s", "t"))


def read_ply(path: str | os.PathLike[str], *, flip_tex_coords: bool = False) -> MeshData:
    """The mesh in the PLY file ``path``; arrays are float64 where the file has doubles, else float32.

    ``flip_tex_coords`` makes v -> 1 - v. :class:`FileError` names the line, in the header or (ascii) of the record.
    """
    name = os.fspath(path)
    data = read_bytes(name)
    header = read_header(data, name)
    elements = {e.name: e for e in header.elements}
    for kind in ("vertex", "face"):
        if kind not in elements:
            remedy = "a mesh needs vertices and faces; point clouds cannot be rendered"
            raise FileError(f"there is no element '{kind}'", name, header.body_line - 1, remedy)
    records = _ascii(data, header, name) if header.encoding == "ascii" else _binary(data, header, name)
    vertex, face = elements["vertex"], elements["face"]

    def line_of(kind: str, index: int) -> int | None:
        return _ascii_line(data, header, kind, index) if header.encoding == "ascii" else None

    positions = _vectors(vertex, ("x", "y", "z"), records["vertex"], name)
    if positions is None:
        raise FileError("vertices lack x, y or z", name, vertex.line, "the header is damaged; export the mesh again")
    normals = _vectors(vertex, ("nx", "ny", "nz"), records["vertex"], name)
    uv_names = next((n for n in _UV_NAMES if None not in map(vertex.index, n)), None)
    uv = _vectors(vertex, uv_names, records["vertex"], name) if uv_names else None
    if uv is not None and flip_tex_coords:
        uv[:, 1] = 1 - uv[:, 1]
    faces, face_fields = _faces(face, records["face"], len(positions), name, line_of)

    attributes = {}
    uv_fields = {vertex.index(n) for n in uv_names or ()}
    for element, taken in ((vertex, {i for i in uv_fields if i is not None}), (face, face_fields)):
        columns = records[element.name]
        for attribute, fields in attribute_groups(element, taken, name).items():
            attributes[attribute] = attribute_values(element, fields, columns.__getitem__)

    mesh = checked_mesh(MeshData(positions, faces, normals, uv, attributes), name, line_of)
    if mesh.normals is not None:
        refuse_zero_normals(mesh.normals, mesh.faces, name, line_of)
    return mesh


def _vectors(element: Element, names: tuple[str, ...], columns: Columns, name: str) -> np.ndarray | None:
    fields = [i for i in map(element.index, names) if i is not None]
    if len(fields) < len(names):
        return None
    for i in fields:
        field = element.fields[i]
        # Mitsuba would take these for sRGB-encoded values between 0 and 1.
        if field.code[0] != "f" and field.code != "u1":
            message = f"the property '{field.name}' of the vertices is an integer"
            raise FileError(message, name, element.line, "store it as float")
    code = "f8" if any(element.fields[i].code == "f8" for i in fields) else "f4"
    return np.stack([columns[i].astype(code) for i in fields], axis=1)


def _faces(element: Element, columns: Columns, n: int, name: str, line_of: LineOf) -> tuple[np.ndarray, set[int]]:
    lists = [i for i, f in enumerate(element.fields) if f.role == "count"]
    if len(lists) != 1 or element.fields[lists[0]].name not in ("vertex_index", "vertex_indices"):
        found = ", ".join(element.fields[i].name for i in lists) or "none"
        message = f"faces need one list, 'vertex_index' or 'vertex_indices' (lists found: {found})"
        raise FileError(message, name, element.line, "triangulate and re-export the mesh without other face lists")
    start = lists[0]
    if element.fields[start + 1].code[0] == "f":
        raise FileError("the indices of faces are not integers", name, element.line, "re-export the mesh")
    wrong = columns[start] != 3
    if wrong.any():
        index = int(np.argmax(wrong))
        message = f"face {index} has {int(columns[start][index])} corners"
        raise FileError(message, name, line_of("face", index), "only triangles can be read; triangulate the mesh")
    corners = np.stack(columns[start + 1 : start + 4], axis=1)
    outside = (corners < 0) | (corners >= n)
    if outside.any():
        index = int(np.argmax(outside.any(axis=1)))
        vertex = int(corners[index][outside[index]][0])
        message = f"face {index} refers to vertex {vertex}, but there are only {n} vertices"
        raise FileError(message, name, line_of("face", index), "fix the face or re-export the mesh")
    return corners.astype(np.uint32), set(range(start, start + 4))


def _binary(data: bytes, header: Header, name: str) -> dict[str, Columns]:
    order = "<" if header.encoding == "binary_little_endian" else ">"
    at, result = header.body, {}
    for element in header.elements:
        dtype = element.dtype(order)
        if element.count * dtype.itemsize > len(data) - at:
            left = len(data) - at
            message = f"{element.count} records of '{element.name}' are announced, but only {left} bytes follow"
            remedy = "the file is cut short or its faces are not triangles; triangulate or export it again"
            raise FileError(message, name, element.line, remedy)
        if element.fields:
            records = np.frombuffer(data, dtype, element.count, at)
            result[element.name] = [records[str(i)].astype("=" + f.code) for i, f in enumerate(element.fields)]
            _require_triples(element, result[element.name], name)
        else:
            result[element.name] = []
        at += element.count * dtype.itemsize
    if at != len(data):
        message = f"{len(data) - at} bytes follow the last record"
        raise FileError(message, name, remedy=_TRAILING)
    return result


def _ascii(data: bytes, header: Header, name: str) -> dict[str, Columns]:
    words = data[header.body :].split()
    at, result = 0, {}
    for element in header.elements:
        width = len(element.fields)
        size = element.count * width
        if size > len(words) - at:
            message = f"{element.count} records of '{element.name}' are announced, but the file ends before them"
            remedy = "the file is cut short or its faces are not triangles; triangulate or export it again"
            raise FileError(message, name, element.line, remedy)
        columns = []
        for i, field in enumerate(element.fields):
            column = words[at + i : at + size : width]
            try:
                values = np.array(list(map(float, column)))
            except ValueError:
                values = None
            if values is None or b"_" in b"".join(column) or not _fits(values, field.code):
                index = next(k for k, word in enumerate(column) if not _is_number(word, field.code))
                line = _ascii_line(data, header, element.name, index)
                text = column[index][:40].decode("ascii", "backslashreplace")
                message = f"cannot read '{text}' as the property '{field.name}' of {element.name} {index}"
                raise FileError(message, name, line, "only triangles can be read; else the file is damaged")
            with np.errstate(over="ignore"):  # a number too large for float becomes infinity, which is refused below
                columns.append(values.astype(field.code))
        result[element.name] = columns
        _require_triples(element, columns, name, partial(_ascii_line, data, header, element.name))
        at += size
    if at != len(words):
        message = f"{len(words) - at} numbers follow the last record"
        raise FileError(message, name, remedy=_TRAILING)
    return result


def _fits(values: np.ndarray, code: str) -> bool:
    if code[0] == "f":
        return True
    limits = np.iinfo(code)
    # 2^63 and 2^64 themselves are floats that the integer type cannot hold.
    return bool(np.all((values >= limits.min) & (values < float(limits.max) + 1) & (values == np.floor(values))))


def _is_number(word: bytes, code: str) -> bool:
    try:
        return b"_" not in word and _fits(np.array([float(word)]), code)
    except ValueError:
        return False


def _require_triples(
    element: Element, columns: Columns, name: str, line_of: Callable[[int], int | None] | None = None
) -> None:
    """Every list must hold three items, else all that follows in the file would be misread."""
    for field, column in zip(element.fields, columns, strict=True):
        if field.role == "count" and (column != 3).any():
            index = int(np.argmax(column != 3))
            message = f"the list '{field.name}' of {element.name} {index} has {int(column[index])} items"
            line = line_of(index) if line_of else element.line
            raise FileError(message, name, line, "only lists of three can be read; triangulate the mesh")


def _ascii_line(data: bytes, header: Header, kind: str, index: int) -> int | None:
    """The line on which record ``index`` of element ``kind`` starts, found by counting words."""
    target = 0
    for element in header.elements:
        if element.name == kind:
            target += index * len(element.fields)
            break
        target += element.count * len(element.fields)
    for number, line in enumerate(data[header.body :].split(b"\n"), header.body_line):
        target -= len(line.split())
        if target < 0:
            return number
    return None
