"""Mitsuba's ``serialized`` meshes, versions 3 and 4, read as Mitsuba 3.9.1 reads them.

Per shape: uint16 0x041C, uint16 version, then a zlib stream of uint32 flags, a null-terminated name (version 4), uint64
vertex and face counts, positions, normals, texture coordinates, colours (each if flagged), uint32 faces; little
endian. At the end of the file: the offset of every shape (uint64; uint32 in version 3) and a uint32 count. Colours
and the face-normals flag of the file have no effect, as in Mitsuba.
"""

from __future__ import annotations

import os
import struct
import zlib

import numpy as np

from ...errors import FileError
from ...files import read_bytes
from .mesh_data import MeshData, checked_mesh, refuse_zero_normals

_MAGIC = 0x041C
_HAS_NORMALS, _HAS_UV, _HAS_COLORS, _DOUBLE = 0x0001, 0x0002, 0x0008, 0x2000
# DEFLATE cannot do better than 1032 to 1. Meshes reach about 20 to 1, so a large content at a far higher ratio is
# a file made to exhaust memory.
_LARGEST_RATIO = 1040
_LARGE_CONTENT, _LARGEST_RATIO_WHEN_LARGE = 1 << 28, 100
_LONGEST_NAME = 1 << 16
_REMEDY = "the file is damaged; export it again"


def read_serialized(path: str | os.PathLike[str], *, shape_index: int = 0) -> MeshData:
    """Mesh number ``shape_index`` of the serialized file ``path``; float64 if the file holds doubles, else float32.

    :class:`FileError` if there is no such mesh or the file is damaged.
    """
    name = os.fspath(path)
    data = read_bytes(name)
    if len(data) < 4:
        raise FileError(f"only {len(data)} bytes long: not a serialized mesh", name, remedy=_REMEDY)
    magic, version = struct.unpack_from("<HH", data, 0)
    if magic != _MAGIC:
        raise FileError("not a serialized mesh (its first two bytes differ)", name, remedy="check the shape's type")
    if version not in (3, 4):
        message = f"serialized version {version} cannot be read"
        raise FileError(message, name, remedy="write version 3 or 4, or convert the mesh to ply")
    start = _offset(data, version, shape_index, name)
    if start + 4 > len(data) or struct.unpack_from("<HH", data, start) != (_MAGIC, version):
        raise FileError(f"shape {shape_index} does not start where the file says", name, remedy=_REMEDY)
    stream = _Inflater(memoryview(data)[start + 4 :], name)

    (flags,) = struct.unpack("<I", stream.read(4))
    if version == 4:
        for _ in range(_LONGEST_NAME):
            if stream.read(1) == b"\0":
                break
        else:
            raise FileError(f"the name of shape {shape_index} does not end", name, remedy=_REMEDY)
    n, m = struct.unpack("<QQ", stream.read(16))
    real = "<f8" if flags & _DOUBLE else "<f4"
    per_vertex = 3 + 3 * bool(flags & _HAS_NORMALS) + 2 * bool(flags & _HAS_UV) + 3 * bool(flags & _HAS_COLORS)
    stream.require_plausible(n * per_vertex * np.dtype(real).itemsize + m * 12)

    def array(rows: int, columns: int, dtype: str) -> np.ndarray:
        raw = stream.read(rows * columns * np.dtype(dtype).itemsize)
        return np.frombuffer(raw, dtype).reshape(rows, columns).astype(np.dtype(dtype).newbyteorder("="))

    vertices = array(n, 3, real)
    normals = array(n, 3, real) if flags & _HAS_NORMALS else None
    uv = array(n, 2, real) if flags & _HAS_UV else None
    if flags & _HAS_COLORS:
        array(n, 3, real)
    faces = array(m, 3, "<u4")
    stream.finish()
    mesh = checked_mesh(MeshData(vertices, faces, normals, uv), name)
    if mesh.normals is not None:
        refuse_zero_normals(mesh.normals, mesh.faces, name)
    return mesh


def _offset(data: bytes, version: int, shape_index: int, name: str) -> int:
    if shape_index == 0:
        return 0
    (count,) = struct.unpack_from("<I", data, len(data) - 4)
    word = 8 if version == 4 else 4
    if count * word + 8 > len(data):
        raise FileError(f"the table at the end speaks of {count} shapes, more than fit", name, remedy=_REMEDY)
    if not 0 <= shape_index < count:
        remedy = f"shape_index goes from 0 to {count - 1}"
        raise FileError(f"there is no shape {shape_index}: the file has {count}", name, remedy=remedy)
    (offset,) = struct.unpack_from("<Q" if word == 8 else "<I", data, len(data) - 4 - word * (count - shape_index))
    if offset >= len(data):
        raise FileError(f"shape {shape_index} lies beyond the end of the file", name, remedy=_REMEDY)
    return int(offset)


class _Inflater:
    """Reads exact numbers of bytes from a zlib stream, never inflating more than was asked for."""

    def __init__(self, compressed: memoryview, name: str) -> None:
        self._engine = zlib.decompressobj()
        self._rest: bytes | memoryview = compressed
        self._size = len(compressed)
        self._ready = b""
        self._at = 0
        self._name = name

    def read(self, count: int) -> bytes:
        available = len(self._ready) - self._at
        if available < count:
            parts = [self._ready[self._at :]]
            # At least a page at a time: byte-wise reads of the name would copy the whole rest every time.
            wanted = max(count - available, 4096)
            while wanted > 0:
                part = self._inflate(wanted)
                if not part:
                    break
                parts.append(part)
                wanted -= len(part)
            self._ready, self._at = b"".join(parts), 0
            if len(self._ready) < count:
                raise FileError("the compressed content ends too early", self._name, remedy=_REMEDY)
        self._at += count
        return self._ready[self._at - count : self._at]

    def finish(self) -> None:
        """Let zlib compare its checksum where the stream ends here."""
        self._inflate(1)

    def require_plausible(self, count: int) -> None:
        ratio = _LARGEST_RATIO if count <= _LARGE_CONTENT else _LARGEST_RATIO_WHEN_LARGE
        if count > self._size * ratio:
            message = f"the header speaks of {count} bytes of content in {self._size} compressed bytes"
            raise FileError(message, self._name, remedy=_REMEDY)

    def _inflate(self, count: int) -> bytes:
        if self._engine.eof:
            return b""
        try:
            part = self._engine.decompress(self._rest, count)
        except zlib.error as error:
            raise FileError(f"the compressed content is damaged: {error}", self._name, remedy=_REMEDY) from None
        self._rest = self._engine.unconsumed_tail
        return part
