"""Triangles without order: a soup, and slivers that boxes cannot hold tightly."""

from __future__ import annotations

import numpy as np

from ...surfaces.mesh import TriangleMesh
from .scene import ProceduralScene, View

_VIEW = View(eye=(2.6, -2.3, 1.7), target=(0.0, 0.0, 0.0), x_fov=45.0)


def soup(size: int, seed: int = 0) -> ProceduralScene:
    """Triangles at random places in a cube, of random shape; smaller where there are more, so that rays get as deep."""
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-1, 1, (size, 1, 3)) + rng.normal(size=(size, 3, 3)) * (3 * size**-0.5)
    return ProceduralScene("soup", (_separate(corners, "soup"),), _VIEW)


def slivers(size: int, seed: int = 0) -> ProceduralScene:
    """Long thin triangles along one diagonal of a cube: their boxes are almost empty and overlap."""
    rng = np.random.default_rng(seed)
    along = np.ones(3) / 3**0.5 + rng.normal(size=(size, 1, 3)) * 0.04
    middle = rng.uniform(-0.7, 0.7, (size, 1, 3))
    length = rng.uniform(0.2, 0.6, (size, 1, 1))
    ends = middle + along * length * np.array([[-1.0], [1.0], [0.97]])
    ends[:, 2] += rng.normal(size=(size, 3)) * (0.5 / size**0.5)
    return ProceduralScene("slivers", (_separate(ends, "slivers"),), _VIEW)


def _separate(corners: np.ndarray, name: str) -> TriangleMesh:
    """Triangles (n, 3, 3) that share no vertices."""
    return TriangleMesh(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3), name=name)
