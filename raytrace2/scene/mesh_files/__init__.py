"""Mesh files: Wavefront OBJ, PLY and Mitsuba's serialized format, read in Python and checked before use."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import Literal

from ...errors import FileError
from .mesh_data import MeshData
from .normals import finish_normals, vertex_normals
from .obj import read_obj
from .ply import read_ply
from .serialized import read_serialized

__all__ = ["MeshData", "finish_normals", "load_mesh_file", "vertex_normals"]


def load_mesh_file(
    path: str | os.PathLike[str],
    kind: Literal["obj", "ply", "serialized"],
    *,
    shape_index: int = 0,
    flip_tex_coords: bool | None = None,
    face_normals: bool = False,
) -> MeshData:
    """The mesh in ``path``, with the meaning that Mitsuba 3.9.1's shape plugin ``kind`` gives it.

    ``flip_tex_coords`` makes v -> 1 - v; None is the plugin's default (obj: true, ply: false; serialized cannot).
    ``shape_index`` chooses among the meshes of a serialized file. With ``face_normals`` normals are left out; without,
    pass the result through :func:`finish_normals` once it is in world coordinates. :class:`FileError` for files that
    cannot be read or are no mesh; ``ValueError`` for an unknown ``kind``.
    """
    name = os.fspath(path)
    if shape_index and kind != "serialized":
        raise FileError(f"{kind} files hold one mesh, not number {shape_index}", name, remedy="remove shape_index")
    if kind == "obj":
        mesh = read_obj(name, flip_tex_coords=True if flip_tex_coords is None else flip_tex_coords)
    elif kind == "ply":
        mesh = read_ply(name, flip_tex_coords=bool(flip_tex_coords))
    elif kind == "serialized":
        if flip_tex_coords:
            remedy = "remove it, or scale the texture's to_uv by (1, -1)"
            raise FileError("serialized meshes do not take flip_tex_coords", name, remedy=remedy)
        mesh = read_serialized(name, shape_index=shape_index)
    else:
        raise ValueError(f"kind must be 'obj', 'ply' or 'serialized', not {kind!r}")
    return replace(mesh, normals=None) if face_normals else mesh
