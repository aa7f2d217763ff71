"""Shapes as raytrace2 and as Mitsuba have them, and rays that meet them."""

from __future__ import annotations

from typing import Any

import numpy as np

from raytrace2 import accel
from raytrace2.surfaces.instance import Instance
from raytrace2.surfaces.mesh import TriangleMesh
from raytrace2.surfaces.quadrics import Cylinder, Disk, Quadric, Rectangle, Sphere

QUADRICS: dict[str, type[Quadric]] = {"sphere": Sphere, "rectangle": Rectangle, "disk": Disk, "cylinder": Cylinder}
SCALES = {"sphere": (0.8, 0.8, 0.8), "rectangle": (1, 0.5, 0.7), "disk": (1, 0.5, 0.7), "cylinder": (0.6, 0.6, 1.1)}


def matrix(seed: int, scale: Any = 1.0, mirrored: bool = False) -> np.ndarray:
    """A random rotation after ``scale`` (a number or three), then a small translation."""
    rng = np.random.default_rng(seed)
    q = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    q *= np.sign(np.linalg.det(q))
    result = np.eye(4)
    result[:3, :3] = q @ np.diag(np.broadcast_to(scale, 3) * ([-1, 1, 1] if mirrored else [1, 1, 1]))
    result[:3, 3] = rng.uniform(-0.3, 0.3, 3)
    return result


def mesh(normals: bool, uv: bool, seed: int = 0) -> TriangleMesh:
    """Triangles here and there; the uv of the first ten do not span them."""
    rng = np.random.default_rng(seed)
    n = 100
    vertices = (rng.uniform(-0.7, 0.7, (n, 1, 3)) + rng.normal(size=(n, 3, 3)) * 0.25).reshape(-1, 3)
    bent = np.repeat(rng.normal(size=(n, 3)), 3, 0) + rng.normal(size=(3 * n, 3)) * 0.2
    bent /= np.linalg.norm(bent, axis=1, keepdims=True)
    texture = rng.uniform(size=(3 * n, 2))
    texture[:30] = texture[0]
    faces = np.arange(3 * n).reshape(-1, 3)
    return TriangleMesh(vertices, faces, texture if uv else None, bent if normals else None)


def mitsuba_mesh(mi: Any, ours: TriangleMesh) -> Any:
    result = mi.Mesh(
        "mesh",
        len(ours.vertices),
        len(ours.faces),
        has_vertex_normals=ours.normals is not None,
        has_vertex_texcoords=ours.uv is not None,
    )
    params = mi.traverse(result)
    params["vertex_positions"] = ours.vertices.ravel()
    params["faces"] = ours.faces.ravel()
    if ours.normals is not None:
        params["vertex_normals"] = ours.normals.ravel()
    if ours.uv is not None:
        params["vertex_texcoords"] = ours.uv.ravel()
    params.update()
    return result


def rays(n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Unit rays from a sphere around everything into it, and some from within."""
    rng = np.random.default_rng(seed)
    o = rng.normal(size=(n, 3))
    o *= rng.choice([3.0, 0.3], (n, 1)) / np.linalg.norm(o, axis=1, keepdims=True)
    d = rng.uniform(-1, 1, (n, 3)) - o
    return o, d / np.linalg.norm(d, axis=1, keepdims=True)


def group(precision: str = "float32") -> tuple[list[Any], Any]:
    """What a group holds, and a structure over it."""
    places = [matrix(seed, 0.5) for seed in range(10, 14)]
    quadrics = [kind(m) for kind, m in zip(QUADRICS.values(), places, strict=True)]
    items = [mesh(True, True), *quadrics]
    return items, accel.build(items, precision=precision)


def everything(precision: str) -> list[Any]:
    """Every kind of surface, far enough apart that random rays meet each."""
    _, structure = group(precision)
    return [
        mesh(True, True),
        mesh(False, False, 1),
        *(QUADRICS[k](matrix(i, np.array(SCALES[k]) * 0.4)) for i, k in enumerate(QUADRICS)),
        Instance(structure, matrix(9, (0.8, 0.5, 1.2), True)),
    ]
