"""Sierpinski's tetrahedron: triangles that touch at corners, and much empty space in between."""

from __future__ import annotations

import numpy as np

from ...surfaces.mesh import TriangleMesh
from .mesh_parts import repeated
from .scene import ProceduralScene, View

_CORNERS = np.array([(1.0, 1.0, 1.0), (-1.0, -1.0, 1.0), (-1.0, 1.0, -1.0), (1.0, -1.0, -1.0)])
_FACES = np.array([(0, 1, 3), (0, 3, 2), (0, 2, 1), (1, 2, 3)])


def tetra(size: int, seed: int = 0) -> ProceduralScene:
    """Each tetrahedron gives way to four of half its size, until there are ``size`` triangles. ``seed`` has no
    effect."""
    corners = _CORNERS[None]
    while len(corners) * 16 <= size:
        corners = _split(corners)
    extra = max(0, (size - 4 * len(corners)) // 12)
    corners = np.concatenate([_split(corners[:extra]), corners[extra:]])
    mesh = TriangleMesh(*repeated(corners, _FACES), name="tetra")
    return ProceduralScene("tetra", (mesh,), View(eye=(1.3, -4.2, 1.5), target=(0.0, 0.0, -0.1), x_fov=44.0))


def _split(corners: np.ndarray) -> np.ndarray:
    """Four tetrahedra (4 n, 4, 3), each halfway to a corner of the ``corners`` (n, 4, 3)."""
    return ((corners[:, :, None] + corners[:, None]) / 2).reshape(-1, 4, 3)
