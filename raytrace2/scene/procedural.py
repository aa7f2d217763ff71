"""Meshes made by formula, the same for the same arguments on every machine."""

from __future__ import annotations

import numpy as np

from ..surfaces.mesh import TriangleMesh


def bumpy_sphere(triangles: int, *, bumps: float = 0.25, seed: int = 0) -> TriangleMesh:
    """A closed star-shaped body of about ``triangles`` triangles: a unit sphere whose radius is modulated by waves of up to
    ``bumps`` in all, with smooth normals left out."""
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


def terrain(triangles: int, *, roughness: float = 0.5, seed: int = 0) -> TriangleMesh:
    """A height field over [-1, 1]^2 of about ``triangles`` triangles: a sum of waves and a jitter of every vertex."""
    side = max(1, round((triangles / 2) ** 0.5))
    rng = np.random.default_rng(seed)
    axis = np.linspace(-1, 1, side + 1)
    y, x = np.meshgrid(axis, axis, indexing="ij")
    height = np.zeros_like(x)
    for octave in range(7):
        kx, ky = rng.normal(size=2) * 2.0**octave
        height += np.sin(kx * x + ky * y + rng.uniform(0, 2 * np.pi)) * roughness**octave * 0.2
    jitter = rng.uniform(-0.3, 0.3, size=(*x.shape, 3)) * (2 / side)
    vertices = np.stack([x, y, height], axis=-1) + jitter
    index = np.arange((side + 1) ** 2).reshape(side + 1, side + 1)
    a, b, c, d = index[:-1, :-1].ravel(), index[:-1, 1:].ravel(), index[1:, 1:].ravel(), index[1:, :-1].ravel()
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return TriangleMesh(vertices.reshape(-1, 3), faces, name="terrain")
