"""Wavefront OBJ meshes, read as Mitsuba 3.9.1 reads them.

Vertices are numbered in the order in which faces first name a combination of position, texture coordinate and normal;
polygons become fans around their first corner. Keywords other than v, vt, vn and f are ignored. Negative (relative)
indices, which Mitsuba refuses, are refused.
"""

from __future__ import annotations

import itertools
import os

import numpy as np

from ...errors import FileError
from ...files import read_bytes
from .mesh_data import MeshData, checked_mesh, refuse_zero_normals

_LARGEST_INDEX = 2**31


def read_obj(path: str | os.PathLike[str], *, flip_tex_coords: bool = True) -> MeshData:
    """The mesh in the OBJ file ``path``: float64 vertices and normals, float32 uv.

    ``flip_tex_coords`` makes v -> 1 - v. A corner without a texture coordinate in a file that has some gets
    uv (0, 0); one without a normal gets a row of zeros. :class:`FileError` names the line.
    """
    name = os.fspath(path)
    lines = read_bytes(name).split(b"\n")
    positions: list[tuple[float, ...]] = []
    normals: list[tuple[float, ...]] = []
    uvs: list[tuple[float, ...]] = []
    triangles: list[tuple[int, int, int]] = []
    triangle_lines: list[int] = []
    corner_of_word: dict[bytes, int] = {}
    corner_of_key: dict[tuple[int, int, int], int] = {}
    corner_lines: list[int] = []

    for number, line in enumerate(lines, 1):
        words = line.split()
        if not words or words[0] not in (b"v", b"vt", b"vn", b"f"):
            continue
        if b"#" in line:
            words = line.partition(b"#")[0].split()
        keyword = words[0]
        if keyword == b"v":
            positions.append(_numbers(words, 3, name, number))
        elif keyword == b"vn":
            normals.append(_numbers(words, 3, name, number))
        elif keyword == b"vt":
            uvs.append(_numbers(words, 2, name, number))
        else:
            corners = []
            for word in words[1:]:
                corner = corner_of_word.get(word)
                if corner is None:
                    key = _corner_key(word, len(positions), name, number)
                    corner = corner_of_key.setdefault(key, len(corner_of_key))
                    corner_of_word[word] = corner
                    if corner == len(corner_lines):
                        corner_lines.append(number)
                corners.append(corner)
            if len(corners) < 3:
                remedy = "remove the face or give it three corners"
                raise FileError(f"a face of {len(corners)} corners has no area", name, number, remedy)
            for k in range(1, len(corners) - 1):
                triangles.append((corners[0], corners[k], corners[k + 1]))
                triangle_lines.append(number)

    keys = np.array(list(corner_of_key), dtype=np.int64).reshape(-1, 3)
    faces = np.array(triangles, dtype=np.uint32).reshape(-1, 3)
    for column, (what, given_rows) in enumerate((("texture coordinate", uvs), ("normal", normals)), 1):
        available = len(given_rows)
        if len(keys) and keys[:, column].max() > available:
            corner = int(np.argmax(keys[:, column] > available))
            message = f"a face refers to {what} {keys[corner, column]}, but the file has only {available}"
            raise FileError(message, name, corner_lines[corner], "fix the face or re-export the mesh")
    _require_like_corners(keys, faces, triangle_lines, name)

    pool = np.array(positions).reshape(-1, 3)
    if not np.isfinite(pool).all():
        bad = int(np.argmin(np.isfinite(pool).all(axis=1)))
        line_number = _line_of_record(lines, b"v", bad)
        remedy = "NaN and infinity have no place in a mesh; re-export it"
        raise FileError(f"vertex {bad + 1} is not finite", name, line_number, remedy)
    uv = None
    if keys[:, 1].any():
        with np.errstate(over="ignore"):  # a number too large for float32 becomes infinity, which is refused below
            texels = np.array(uvs).astype(np.float32).reshape(-1, 2)
        if flip_tex_coords:
            texels[:, 1] = np.float32(1) - texels[:, 1]
        uv = _gather(texels, keys[:, 1])

    def line_of(kind: str, index: int) -> int | None:
        return triangle_lines[index] if kind == "face" else corner_lines[index]

    given_normals = None
    if keys[:, 2].any():
        vectors = np.array(normals).reshape(-1, 3)
        given_normals = _gather(vectors, keys[:, 2])
        given = keys[:, 2] > 0
        refuse_zero_normals(np.where(given[:, None], given_normals, 1.0), faces, name, line_of)
    vertices = _gather(pool, keys[:, 0])
    return checked_mesh(MeshData(vertices, faces, given_normals, uv), name, line_of)


def _numbers(words: list[bytes], count: int, name: str, line: int) -> tuple[float, ...]:
    try:
        # float() takes digit separators, which no OBJ reader does.
        values = tuple(map(float, words[1 : count + 1]))
        if len(values) == count and b"_" not in b"".join(words[1 : count + 1]):
            return values
    except ValueError:
        pass
    text = b" ".join(words)[:60].decode("ascii", "backslashreplace")
    raise FileError(f"{count} numbers expected in '{text}'", name, line, "fix the line or re-export the mesh") from None


def _corner_key(word: bytes, positions: int, name: str, line: int) -> tuple[int, int, int]:
    """(v, vt, vn) of ``v``, ``v/vt``, ``v//vn`` or ``v/vt/vn``; 0 stands for an index that is not there."""
    parts = word.split(b"/")
    if len(parts) <= 3 and parts[0] and all(not p or (p.isdigit() and len(p) <= 12) for p in parts):
        v, vt, vn = (int(p) if p else 0 for p, _ in itertools.zip_longest(parts, range(3), fillvalue=b""))
        if max(vt, vn) > _LARGEST_INDEX:
            v = _LARGEST_INDEX
        if 1 <= v <= positions:
            return v, vt, vn
        message = f"a face refers to vertex {v}, but only {positions} are defined before it"
        raise FileError(message, name, line, "indices start at 1; fix the face or re-export the mesh")
    text = word[:40].decode("ascii", "backslashreplace")
    negative = all(p.removeprefix(b"-").isdigit() for p in parts if p)
    remedy = "write absolute indices, counted from 1" if negative else "write corners as v, v/vt, v//vn or v/vt/vn"
    message = f"relative index '{text}' in a face" if negative else f"cannot read the corner '{text}' of a face"
    raise FileError(message, name, line, remedy)


def _require_like_corners(keys: np.ndarray, faces: np.ndarray, lines: list[int], name: str) -> None:
    """All corners of a face must give the same kinds of index, else readers disagree on what is meant."""
    for column, what in ((1, "texture coordinate"), (2, "normal")):
        given = (keys[:, column] > 0)[faces]
        mixed = given.any(axis=1) & ~given.all(axis=1)
        if mixed.any():
            line = lines[int(np.argmax(mixed))]
            raise FileError(f"only some corners of the face have a {what}", name, line, "give all or none of them one")


def _gather(pool: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Rows ``index - 1`` of ``pool``, zeros where the index is 0."""
    padded = np.concatenate([np.zeros_like(pool[:1]), pool]) if len(pool) else np.zeros((1, pool.shape[1]))
    return np.ascontiguousarray(padded[index])


def _line_of_record(lines: list[bytes], keyword: bytes, index: int) -> int | None:
    numbers = (i for i, line in enumerate(lines, 1) if line.split()[:1] == [keyword])
    return next(itertools.islice(numbers, index, None), None)
