"""Pieces that meshes are put together from, many at a time."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import ArrayLike

_CUBE = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
_CUBE_FACES = np.array(
    [
        *((0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1)),
        *((2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)),
    ]
)

#: Vertices (n, 3) and faces (m, 3) of a piece of a mesh.
Piece = tuple[np.ndarray, np.ndarray]


def joined(pieces: list[Piece]) -> Piece:
    """All ``pieces`` as one."""
    firsts = np.cumsum([0, *(len(vertices) for vertices, _ in pieces)])
    faces = [part + first for (_, part), first in zip(pieces, firsts[:-1], strict=True)]
    return np.concatenate([vertices for vertices, _ in pieces]), np.concatenate(faces)


def repeated(vertices: np.ndarray, faces: np.ndarray) -> Piece:
    """One piece of copies with ``vertices`` (copies, n, 3) that share their ``faces`` (m, 3)."""
    copies, n = vertices.shape[:2]
    shifted = faces[None] + (np.arange(copies) * n)[:, None, None]
    return vertices.reshape(-1, 3), shifted.reshape(-1, 3)


def boxes(centers: ArrayLike, sizes: ArrayLike, angles: ArrayLike = 0.0) -> Piece:
    """Boxes of full ``sizes`` (n, 3) about ``centers`` (n, 3), turned by ``angles`` (n,) about z: twelve triangles
    each."""
    middles = np.asarray(centers, dtype=np.float64).reshape(-1, 3)
    corners = _CUBE[None] * (np.broadcast_to(sizes, middles.shape) / 2)[:, None]
    c, s = (f(np.broadcast_to(angles, len(middles)))[:, None] for f in (np.cos, np.sin))
    x, y = c * corners[:, :, 0] - s * corners[:, :, 1], s * corners[:, :, 0] + c * corners[:, :, 1]
    return repeated(np.stack([x, y, corners[:, :, 2]], axis=2) + middles[:, None], _CUBE_FACES)


def grid_faces(rows: int, columns: int) -> np.ndarray:
    """Two triangles for each of ``rows`` x ``columns`` squares between (rows + 1) x (columns + 1) vertices, row by
    row."""
    index = np.arange((rows + 1) * (columns + 1)).reshape(rows + 1, columns + 1)
    a, b, c, d = index[:-1, :-1].ravel(), index[:-1, 1:].ravel(), index[1:, 1:].ravel(), index[1:, :-1].ravel()
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def floor(extent: float, height: float = 0.0, center: tuple[float, float] = (0.0, 0.0)) -> Piece:
    """A square on the ground, ``extent`` to either side of ``center``: two triangles."""
    corners = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]) * extent + center
    return np.column_stack([corners, np.full(4, height)]), np.array([(0, 1, 2), (0, 2, 3)])


def without_collapsed(vertices: np.ndarray, faces: np.ndarray) -> Piece:
    """The piece without the triangles of which two corners coincide."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    same = (a == b).all(axis=1) | (b == c).all(axis=1) | (c == a).all(axis=1)
    return vertices, faces[~same]
