"""Triangle meshes of all origins (files, Mitsuba's cube, live ``mi.Mesh`` objects) as :class:`MeshShape`."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from .description import ConstantTexture, DiffuseBsdf, MeshShape
from .mesh_files import MeshData, finish_normals, load_mesh_file
from .nodes import Node
from .read_lights import frozen
from .reading import Reading
from .transforms import transform_normals, transform_points


def load_mesh(reading: Reading, path: str, kind: str, **options: Any) -> MeshData:
    """The mesh file ``path``, read once per scene and set of options."""
    key = (os.path.abspath(path), kind, *sorted(options.items()))
    if key not in reading.files:
        reading.files[key] = load_mesh_file(path, kind, **options)  # type: ignore[arg-type]
    found: MeshData = reading.files[key]
    return found


def mesh_shape(
    mesh: MeshData,
    matrix: np.ndarray,
    face_normals: bool,
    flip_normals: bool,
    reading: Reading,
    node: Node,
    common: dict[str, Any],
) -> MeshShape | None:
    """``mesh`` under ``matrix``, in float64; missing vertex normals are computed in world coordinates."""
    with np.errstate(over="ignore", invalid="ignore"):
        vertices = transform_points(matrix, mesh.vertices.astype(np.float64))
    if not np.isfinite(vertices).all() or np.abs(vertices).max() > np.finfo(np.float32).max:
        reading.refuse(node, "'to_world' takes vertices out of the range of float32", "use a smaller scale")
        return None
    normals = None
    if mesh.normals is not None and not face_normals:
        normals = transform_normals(matrix, mesh.normals.astype(np.float64))
    normals = finish_normals(vertices, mesh.faces, normals, face_normals=face_normals)
    faces = np.asarray(mesh.faces, dtype=np.uint32)
    if flip_normals:
        faces = faces[:, [0, 2, 1]]
        normals = None if normals is None else -normals
    return MeshShape(
        vertices=frozen(vertices),
        faces=frozen(faces),
        normals=None if normals is None else frozen(normals),
        uv=None if mesh.uv is None else frozen(mesh.uv.astype(np.float64)),
        attributes={name: frozen(values) for name, values in mesh.attributes.items()},
        flipped=flip_normals,
        **common,
    )


def cube_mesh() -> MeshData:
    """Mitsuba's cube [-1, 1]^3: four vertices and two triangles a side, uv over [0, 1]^2 on each."""
    sides = {
        (0, -1, 0): [(1, -1, -1), (1, -1, 1), (-1, -1, 1), (-1, -1, -1)],
        (0, 1, 0): [(1, 1, -1), (-1, 1, -1), (-1, 1, 1), (1, 1, 1)],
        (1, 0, 0): [(1, -1, -1), (1, 1, -1), (1, 1, 1), (1, -1, 1)],
        (0, 0, 1): [(1, -1, 1), (1, 1, 1), (-1, 1, 1), (-1, -1, 1)],
        (-1, 0, 0): [(-1, -1, 1), (-1, 1, 1), (-1, 1, -1), (-1, -1, -1)],
        (0, 0, -1): [(1, 1, -1), (1, -1, -1), (-1, -1, -1), (-1, 1, -1)],
    }
    first = 4 * np.arange(6)[:, None, None]
    return MeshData(
        vertices=np.array([p for side in sides.values() for p in side], dtype=np.float64),
        faces=(first + np.array([[0, 1, 2], [3, 0, 2]])).reshape(-1, 3).astype(np.uint32),
        normals=np.repeat(np.array(list(sides), dtype=np.float64), 4, axis=0),
        uv=np.tile(np.array([(0.0, 1.0), (1.0, 1.0), (1.0, 0.0), (0.0, 0.0)]), (6, 1)),
    )


def live_mesh_shape(mesh: Any, reading: Reading, node: Node, name: str) -> MeshShape | None:
    """A ``mi.Mesh`` that a scene dict holds, from its buffers (the names are those of Mitsuba 3.9)."""
    faces = np.array(mesh.faces_buffer(), dtype=np.uint32).reshape(-1, 3)
    vertices = np.array(mesh.vertex_positions_buffer(), dtype=np.float64).reshape(-1, 3)
    if not len(faces) or not len(vertices):
        reading.refuse(node, f"the mesh '{name}' is empty", "remove it")
        return None
    if int(faces.max()) >= len(vertices):
        reading.refuse(node, f"the mesh '{name}' has face indices beyond its {len(vertices)} vertices")
        return None
    if mesh.is_emitter() or mesh.is_sensor() or mesh.interior_medium() or mesh.exterior_medium():
        remedy = "write the mesh as a file, and the shape with its emitter as a dict"
        reading.refuse(node, f"the live mesh '{name}' has an emitter, a sensor or a medium", remedy)
        return None
    normals = uv = None
    if mesh.has_vertex_normals() and not mesh.has_face_normals():
        normals = np.array(mesh.vertex_normals_buffer(), dtype=np.float64).reshape(-1, 3)
    if mesh.has_vertex_texcoords():
        uv = np.array(mesh.vertex_texcoords_buffer(), dtype=np.float64).reshape(-1, 2)
    for array in (vertices, normals, uv):
        if array is not None and not np.isfinite(array).all():
            reading.refuse(node, f"the mesh '{name}' has values that are not finite", "repair it")
            return None
    bsdf = _live_bsdf(mesh, reading, node, name)
    if mesh.has_flipped_normals():
        faces = faces[:, [0, 2, 1]]
        normals = None if normals is None else -normals
    return MeshShape(
        id=name,
        location=node.location,
        bsdf=bsdf,
        vertices=frozen(vertices),
        faces=frozen(faces),
        normals=None if normals is None else frozen(normals),
        uv=None if uv is None else frozen(uv),
        flipped=bool(mesh.has_flipped_normals()),
    )


def _live_bsdf(mesh: Any, reading: Reading, node: Node, name: str) -> DiffuseBsdf:
    """Only what a mesh has by default, or a diffuse of one colour, can be told from outside."""
    text = "".join(str(mesh.bsdf()).split())
    start, end = "SmoothDiffuse[reflectance=UniformSpectrum[value=", "]]"
    if text.startswith(start) and text.endswith(end):
        value = float(np.float32(float(text[len(start) : -len(end)].strip("[]"))))
        return DiffuseBsdf(ConstantTexture((value, value, value), grey=True))
    remedy = "write the mesh to a file, and the shape with its BSDF as a dict"
    reading.refuse(node, f"the live mesh '{name}' has a BSDF that cannot be read from a live object", remedy)
    return DiffuseBsdf()
