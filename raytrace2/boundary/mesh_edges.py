"""The edges of triangle meshes with the faces on either side."""

from __future__ import annotations

import numpy as np

#: In place of a vertex: there is no face.
NO_VERTEX = 0xFFFFFFFF


def mesh_edges(faces: np.ndarray) -> np.ndarray:
    """(n, 4) uint32: the two vertices of each edge, and the third one of each of its two faces.

    The fourth is ``NO_VERTEX`` for an edge that has one face, or more than two. ``faces`` is (m, 3). An edge that comes
    twice in a face of two equal vertices is none.
    """
    corners = faces.astype(np.uint64)
    ends = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    opposite = np.concatenate([corners[:, 2], corners[:, 0], corners[:, 1]])
    low, high = ends.min(axis=1), ends.max(axis=1)
    proper = low != high
    keys, opposite = (low[proper] << np.uint64(32)) | high[proper], opposite[proper]
    order = np.argsort(keys, kind="stable")
    keys, opposite = keys[order], opposite[order]
    first = np.flatnonzero(np.r_[True, keys[1:] != keys[:-1]]) if len(keys) else np.zeros(0, np.int64)
    count = np.diff(np.r_[first, len(keys)])
    edges = np.empty((len(first), 4), np.uint32)
    edges[:, 0], edges[:, 1] = keys[first] >> np.uint64(32), keys[first] & np.uint64(0xFFFFFFFF)
    edges[:, 2] = opposite[first]
    edges[:, 3] = np.where(count == 2, opposite[np.minimum(first + 1, len(keys) - 1)], NO_VERTEX)
    return edges
