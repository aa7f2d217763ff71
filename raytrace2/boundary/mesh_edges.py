"""The edges of triangle meshes with the faces on either side."""

from __future__ import annotations

import numpy as np

#: In place of a vertex: there is no face.
NO_VERTEX = 0xFFFFFFFF


def welded(positions: np.ndarray) -> np.ndarray:
    """(n,) uint64: the same number for each of ``positions`` (n, 3) that is the same in single precision."""
    single = np.ascontiguousarray(positions, np.float32) + np.float32(0)  # no -0
    return np.unique(single, axis=0, return_inverse=True)[1].ravel().astype(np.uint64)


def mesh_edges(faces: np.ndarray, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n, 4) uint32: the two vertices of each edge, and the third one of each of the two faces that meet there; and
    (n,) how many of them lie on one another.

    ``places`` tells of each vertex where it is: meshes whose vertices are split along a seam, for normals of their own,
    are whole there, with an edge on either side. The fourth vertex is ``NO_VERTEX`` for an edge that has one face, or
    more than two. ``faces`` is (m, 3). Edges between two vertices of one place are none.
    """
    corners = faces.astype(np.uint64)
    ends = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    third = np.concatenate([corners[:, 2], corners[:, 0], corners[:, 1]])
    backwards = places[ends[:, 0]] > places[ends[:, 1]]
    ends[backwards] = ends[backwards, ::-1]
    proper = places[ends[:, 0]] != places[ends[:, 1]]
    ends, third = ends[proper], third[proper]
    if not len(ends):
        return np.zeros((0, 4), np.uint32), np.zeros(0, np.int64)
    keys = _pairs(places[ends])
    order = np.lexsort((_pairs(ends), keys))
    ends, third, keys = ends[order], third[order], keys[order]
    _, group, faces_at = np.unique(keys, return_inverse=True, return_counts=True)
    first = np.r_[0, np.cumsum(faces_at)[:-1]][group]
    other = np.where(np.arange(len(keys)) == first, first + 1, first)
    two = faces_at[group] == 2
    fourth = np.where(two, third[np.minimum(other, len(keys) - 1)], NO_VERTEX)
    own = np.r_[True, _pairs(ends)[1:] != _pairs(ends)[:-1]]
    copies = np.bincount(group[own], minlength=len(faces_at))
    return np.column_stack([ends, third, fourth])[own].astype(np.uint32), copies[group[own]]


def _pairs(ends: np.ndarray) -> np.ndarray:
    return (ends[:, 0] << np.uint64(32)) | ends[:, 1]
