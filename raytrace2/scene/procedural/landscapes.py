"""Height fields: a fractal mountain with spheres of glass above it, and rolling terrain."""

from __future__ import annotations

import numpy as np

from ...surfaces.mesh import TriangleMesh
from .mesh_parts import grid_faces
from .round_parts import spheres
from .scene import ProceduralScene, View


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
    return TriangleMesh(vertices.reshape(-1, 3), grid_faces(side, side), name="terrain")


def terrain_scene(size: int, seed: int = 0) -> ProceduralScene:
    """The :func:`terrain` of about ``size`` triangles."""
    view = View(eye=(1.9, -1.7, 1.3), target=(0.0, 0.0, -0.1), x_fov=45.0)
    return ProceduralScene("terrain", (terrain(size, seed=seed),), view)


def mountain(size: int, seed: int = 0) -> ProceduralScene:
    """A mountain of random heights at ever finer lattices, and four spheres above it."""
    rng = np.random.default_rng(seed)
    side = max(2, round(((size - 4) / 2) ** 0.5))
    axis = np.linspace(0, 1, side + 1)
    y, x = np.meshgrid(axis, axis, indexing="ij")
    height = np.zeros_like(x)
    cells, amplitude = 3, 0.5
    while cells <= 2 * side:
        height += amplitude * (_lattice_noise(x, y, rng.uniform(-1, 1, (cells + 1, cells + 1))))
        cells, amplitude = 2 * cells, amplitude * 0.52
    distance = np.hypot(x - 0.5, y - 0.5)
    height = 0.45 * height + 1.1 * np.exp(-9 * distance**2) - 0.2
    vertices = np.stack([2 * x - 1, 2 * y - 1, height], axis=-1).reshape(-1, 3)
    mesh = TriangleMesh(vertices, grid_faces(side, side), name="mountain")
    angle = np.arange(4) * np.pi / 2 + 0.4
    centers = np.column_stack([0.62 * np.cos(angle), 0.62 * np.sin(angle), 0.95 + 0.08 * np.sin(3 * angle)])
    view = View(eye=(2.1, -1.9, 1.7), target=(0.0, 0.0, 0.3), x_fov=47.0)
    return ProceduralScene("mountain", (mesh, *spheres(centers, 0.16)), view)


def _lattice_noise(x: np.ndarray, y: np.ndarray, values: np.ndarray) -> np.ndarray:
    """``values`` on a square lattice over [0, 1]^2, in between by a smooth step along either axis."""
    cells = len(values) - 1
    i, j = (np.minimum((c * cells).astype(int), cells - 1) for c in (y, x))
    fy, fx = y * cells - i, x * cells - j
    fy, fx = (f * f * (3 - 2 * f) for f in (fy, fx))
    low = values[i, j] * (1 - fx) + values[i, j + 1] * fx
    return low * (1 - fy) + (values[i + 1, j] * (1 - fx) + values[i + 1, j + 1] * fx) * fy
