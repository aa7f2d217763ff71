"""Axes of small oriented boxes around many groups of points at once.

Larsson and Kallberg, "Fast Computation of Tight-Fitting Oriented Bounding Boxes" (Game Engine Gems 2, 2011), with
fourteen extremal points: a large triangle among them, a point on either side of it, and the edges of the seven
triangles so made as candidate axes. The best on the extremal points then competes, on all points, with the principal
axes and the world's.
"""

from __future__ import annotations

import numpy as np

from .hulls import Hulls

_DIRECTIONS = np.array(
    [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1), (1, 1, -1), (1, -1, 1), (1, -1, -1)], dtype=np.float64
)
#: Groups worked on at a time, which bounds the memory for candidates.
_CHUNK = 8192


def box_axes(hulls: Hulls) -> np.ndarray:
    """Orthonormal axes (groups, 3, 3), as rows, of a box around points without radii."""
    lo, hi = hulls.box()
    size = np.maximum((hi - lo).max(axis=1), 1e-300)
    counts = hulls.counts
    points = (hulls.points - np.repeat((lo + hi) / 2, counts, axis=0)) / np.repeat(size, counts)[:, None]
    local = Hulls(points, None, hulls.starts)
    extremes = _extremal_points(local)
    from_triangles = np.concatenate(
        [_axes_of_triangles(extremes[k : k + _CHUNK]) for k in range(0, len(extremes), _CHUNK)]
    )
    candidates = np.stack([np.broadcast_to(np.eye(3), from_triangles.shape), _principal_axes(local), from_triangles], 1)
    areas = np.stack([_areas(local, candidates[:, k]) for k in range(candidates.shape[1])], axis=1)
    return candidates[np.arange(len(hulls)), areas.argmin(axis=1)]


def _extremal_points(hulls: Hulls) -> np.ndarray:
    """The least and the greatest point of each group along each direction: (groups, 14, 3), least ones first."""
    least, most = [], []
    for direction in _DIRECTIONS:
        along = hulls.points @ direction
        least.append(hulls.points[hulls.first_with(along, np.minimum.reduceat(along, hulls.starts))])
        most.append(hulls.points[hulls.first_with(along, np.maximum.reduceat(along, hulls.starts))])
    return np.stack(least + most, axis=1)


def _principal_axes(hulls: Hulls) -> np.ndarray:
    """Eigenvectors of each group's covariance."""
    counts = hulls.counts
    mean = np.add.reduceat(hulls.points, hulls.starts, axis=0) / counts[:, None]
    offset = hulls.points - np.repeat(mean, counts, axis=0)
    covariance = np.empty((len(hulls), 3, 3))
    for i in range(3):
        for j in range(i, 3):
            product = np.add.reduceat(offset[:, i] * offset[:, j], hulls.starts)
            covariance[:, i, j] = covariance[:, j, i] = product / counts
    return np.linalg.eigh(covariance)[1].transpose(0, 2, 1)


def _areas(hulls: Hulls, axes: np.ndarray) -> np.ndarray:
    counts = hulls.counts
    extents = []
    for k in range(3):
        along = np.einsum("ij,ij->i", hulls.points, np.repeat(axes[:, k], counts, axis=0))
        extents.append(np.maximum.reduceat(along, hulls.starts) - np.minimum.reduceat(along, hulls.starts))
    x, y, z = extents
    return x * y + y * z + z * x


def _axes_of_triangles(extremes: np.ndarray) -> np.ndarray:
    """Of the axes that the edges of seven triangles and their normals give, those of the least box around
    ``extremes``."""
    g = np.arange(len(extremes))
    pairs = extremes[:, 7:] - extremes[:, :7]
    longest = np.square(pairs).sum(axis=2).argmax(axis=1)
    a, b = extremes[g, longest], extremes[g, longest + 7]
    along = _unit(b - a)
    from_a = extremes - a[:, None]
    away = np.square(from_a - (from_a @ along[:, :, None]) * along[:, None]).sum(axis=2)
    c = extremes[g, away.argmax(axis=1)]
    height = (extremes @ _unit(np.cross(b - a, c - a))[:, :, None])[:, :, 0]
    triangles = [(a, b, c)]
    for top in (extremes[g, height.argmin(axis=1)], extremes[g, height.argmax(axis=1)]):
        triangles += [(a, b, top), (b, c, top), (c, a, top)]
    candidates = np.stack([_frame(p, q, r) for t in triangles for p, q, r in (t, (*t[1:], t[0]), (t[2], *t[:2]))], 1)
    projected = np.einsum("gcki,gpi->gckp", candidates, extremes)
    extents = projected.max(axis=3) - projected.min(axis=3)
    x, y, z = extents.transpose(2, 0, 1)
    areas = x * y + y * z + z * x
    areas[~np.isfinite(areas)] = np.inf
    best = candidates[g, areas.argmin(axis=1)]
    usable = np.isfinite(areas.min(axis=1))
    return np.where(usable[:, None, None], best, np.eye(3))


def _frame(p: np.ndarray, q: np.ndarray, r: np.ndarray) -> np.ndarray:
    """Rows: the edge from p to q, the triangle's normal, and what is across both; NaN where the triangle is
    degenerate."""
    normal = np.cross(q - p, r - p)
    flat = np.square(normal).sum(axis=1) < 1e-20
    edge, normal = _unit(q - p), _unit(normal)
    # The edge and the normal are at right angles but for rounding, which the third axis and one more turn settle.
    across = _unit(np.cross(normal, edge))
    frame = np.stack([np.cross(across, normal), normal, across], axis=1)
    frame[flat] = np.nan
    return frame


def _unit(v: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(v, axis=-1, keepdims=True)
    return np.divide(v, length, out=np.zeros_like(v), where=length > 0)
