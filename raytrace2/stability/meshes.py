"""Closed meshes by formula, with the tables of who touches whom that rays are aimed by."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..surfaces.mesh import TriangleMesh

_PHI = (1 + 5**0.5) / 2
_CORNERS: list[tuple[float, float, float]] = [
    (-1, _PHI, 0),
    (1, _PHI, 0),
    (-1, -_PHI, 0),
    (1, -_PHI, 0),
    (0, -1, _PHI),
    (0, 1, _PHI),
]
_CORNERS += [(0, -1, -_PHI), (0, 1, -_PHI), (_PHI, 0, -1), (_PHI, 0, 1), (-_PHI, 0, -1), (-_PHI, 0, 1)]
_FACES = "0 11 5 0 5 1 0 1 7 0 7 10 0 10 11 1 5 9 5 11 4 11 10 2 10 7 6 7 1 8 3 9 4 3 4 2 3 2 6 3 6 8 3 8 9 4 9 5"
_FACES += " 2 4 11 6 2 10 8 6 7 9 8 1"


@dataclass(frozen=True, eq=False)
class Closed:
    """A closed mesh about ``center`` with outward faces; ``vertices`` (n, 3) float64 hold numbers of ``dtype``.

    ``radius`` is that of the sphere it was made from, before spikes.
    """

    name: str
    vertices: np.ndarray
    faces: np.ndarray
    dtype: str
    radius: float = 1.0
    center: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def mesh(self) -> TriangleMesh:
        """The same as a surface."""
        return TriangleMesh(self.vertices, self.faces, name=self.name)

    @cached_property
    def edges(self) -> np.ndarray:
        """(m, 4) the two vertices of each edge and the two faces beside it."""
        f = self.faces
        pairs = np.sort(np.concatenate([f[:, [0, 1]], f[:, [1, 2]], f[:, [2, 0]]]), axis=1)
        order = np.lexsort(pairs.T)
        owner = np.tile(np.arange(len(f)), 3)[order].reshape(-1, 2)
        return np.concatenate([pairs[order][::2], owner], axis=1)

    @cached_property
    def fans(self) -> np.ndarray:
        """(n, k) the faces around each vertex, the last repeated up to the largest number."""
        corner = self.faces.ravel()
        order = np.argsort(corner, kind="stable")
        count = np.bincount(corner, minlength=len(self.vertices))
        first = np.cumsum(count) - count
        column = np.minimum(np.arange(count.max()), count[:, None] - 1)
        return order[first[:, None] + column] // 3

    @cached_property
    def planes(self) -> tuple[np.ndarray, np.ndarray]:
        """Outward normals (m, 3), not of unit length, and their products with a point of each face."""
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        normal = np.cross(b - a, c - a)
        return normal, (normal * a).sum(axis=1)

    def placed(self, scale: float, shift: float = 0.0) -> Closed:
        """The same times ``scale``, then moved by ``shift`` along every axis, rounded to ``dtype``."""
        at = (self.vertices * scale + shift).astype(self.dtype).astype(np.float64)
        middle = tuple(float(np.dtype(self.dtype).type(c * scale + shift)) for c in self.center)
        name = f"{self.name} x {scale:g}" + (f" + {shift:g}" if shift else "")
        return Closed(name, at, self.faces, self.dtype, self.radius * scale, (middle[0], middle[1], middle[2]))


def icosphere(levels: int, dtype: str) -> Closed:
    """An icosahedron of radius 1, its 20 faces split in four ``levels`` times: 20,480 faces for 5."""
    f = np.array(_FACES.split(), dtype=int).reshape(-1, 3)
    v = np.array(_CORNERS, dtype=float)
    for _ in range(levels):
        edges = np.sort(np.concatenate([f[:, [0, 1]], f[:, [1, 2]], f[:, [2, 0]]]), axis=1)
        unique, inverse = np.unique(edges, axis=0, return_inverse=True)
        a, b, c = inverse.reshape(3, -1) + len(v)
        v = np.concatenate([v, v[unique].mean(axis=1)])
        x, y, z = f.T
        f = np.concatenate([np.stack(t, 1) for t in ((x, a, c), (a, y, b), (c, b, z), (a, b, c))])
        v = v / np.linalg.norm(v, axis=1, keepdims=True)
    v = v / np.linalg.norm(v, axis=1, keepdims=True)
    return Closed("ico", v.astype(dtype).astype(np.float64), f, dtype)


def spiky(levels: int, dtype: str, seed: int = 0) -> Closed:
    """The icosphere, each vertex farther out by up to a half of its radius at random."""
    base = icosphere(levels, dtype)
    grown = 1 + 0.5 * np.random.default_rng(seed).random((len(base.vertices), 1))
    return Closed("spiky", (base.vertices * grown).astype(dtype).astype(np.float64), base.faces, dtype)
