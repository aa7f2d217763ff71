"""A closed body without symmetry, evenly tessellated: the plainest of meshes."""

from __future__ import annotations

import numpy as np

from ...surfaces.mesh import TriangleMesh
from .scene import ProceduralScene, View


def bumpy_sphere(triangles: int, *, bumps: float = 0.25, seed: int = 0) -> TriangleMesh:
    """A closed star-shaped body of about ``triangles`` triangles: a unit sphere whose radius is modulated by waves of
    up to ``bumps`` in all, with smooth normals left out."""
    rows = max(3, round((triangles / 4) ** 0.5))
    columns = 2 * rows
    theta = np.linspace(0, np.pi, rows + 1)[1:-1]
    phi = np.arange(columns) * (2 * np.pi / columns)
    t, p = np.meshgrid(theta, phi, indexing="ij")
    ring = np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], axis=-1).reshape(-1, 3)
    directions = np.concatenate([[[0.0, 0.0, 1.0]], ring, [[0.0, 0.0, -1.0]]])
    rng = np.random.default_rng(seed)
    waves = rng.normal(size=(24, 3)) * np.geomspace(2, 24, 24)[:, None]
    sizes = np.geomspace(1, 0.1, 24)
    heights = np.sin(directions @ waves.T + rng.uniform(0, 2 * np.pi, 24)) @ (sizes / sizes.sum())
    index = 1 + np.arange((rows - 1) * columns).reshape(rows - 1, columns)
    right = np.roll(index, -1, axis=1)
    a, b, c, d = index[:-1].ravel(), index[1:].ravel(), right[1:].ravel(), right[:-1].ravel()
    last = len(directions) - 1
    faces = np.concatenate(
        [
            np.stack([np.zeros(columns, int), index[0], right[0]], axis=1),
            np.stack([a, b, c], axis=1),
            np.stack([a, c, d], axis=1),
            np.stack([index[-1], np.full(columns, last), right[-1]], axis=1),
        ]
    )
    return TriangleMesh(directions * (1 + bumps * heights)[:, None], faces, name="bumpy sphere")


def bumpy_sphere_scene(size: int, seed: int = 0) -> ProceduralScene:
    """The :func:`bumpy_sphere` of about ``size`` triangles."""
    view = View(eye=(2.4, -2.2, 1.4), target=(0.0, 0.0, 0.0), x_fov=50.0)
    return ProceduralScene("bumpy_sphere", (bumpy_sphere(size, seed=seed),), view)
