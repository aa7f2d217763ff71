"""Smallest enclosing balls of many groups of points at once.

A basis of at most four points spans each ball. The point farthest from its centre enters, the smallest ball of those
five is found among the balls that subsets span, and the subset is the next basis: the radius only grows, so that no
basis comes back, and it ends with every point inside. (Welzl 1991 in the pivoting form of Gaertner, "Fast and robust
smallest enclosing balls", ESA 1999, a step for all groups at a time.)
"""

from __future__ import annotations

import itertools

import numpy as np

from .hulls import Hulls

# A ball that grows by less than this, relatively, is as good as found.
_TOLERANCE = 1e-9
# Far more than any group has been seen to take; beyond them the centre is still a good one.
_STEPS = 100

# The subsets of the basis that may go on beside the point that enters (position 4), small ones first.
_SUBSETS = [(*rest, 4) for size in range(4) for rest in itertools.combinations(range(4), size)]


def enclosing_balls(hulls: Hulls) -> np.ndarray:
    """Centres (groups, 3) of the smallest balls around points without radii; exact but for rounding."""
    lo, hi = hulls.box()
    # Coordinates relative to the box keep their digits from afar; the size keeps their squares in range.
    origin, size = (lo + hi) / 2, np.maximum((hi - lo).max(axis=1), 1e-300)
    scaled = (hulls.points - np.repeat(origin, hulls.counts, axis=0)) / np.repeat(size, hulls.counts)[:, None]
    current = Hulls(scaled, None, hulls.starts)
    groups = np.arange(len(hulls))
    center = np.zeros((len(hulls), 3))
    squared = np.full(len(hulls), -1.0)
    basis = np.full((len(hulls), 4, 3), np.nan)
    for _ in range(_STEPS):
        distances = current.squared_distances(center[groups])
        farthest = np.maximum.reduceat(distances, current.starts)
        growing = farthest > squared[groups] * (1 + _TOLERANCE)
        if not growing.any():
            break
        entering = current.first_with(distances, farthest)[growing]
        points = current.points[entering]
        if not growing.all():
            groups = groups[growing]
            current = current.some(np.flatnonzero(growing))
        center[groups], squared[groups], basis[groups] = _next_ball(basis[groups], points, center[groups])
    return origin + center * size[:, None]


def _next_ball(
    basis: np.ndarray, entering: np.ndarray, before: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The smallest balls around ``basis`` (g, 4, 3; NaN where empty) and ``entering`` (g, 3), which lies on them:
    centres, squared radii and the points that span them. Where rounding leaves no such ball, the centre ``before``
    and an infinite radius: that group is done."""
    g = len(basis)
    points = np.concatenate([basis, entering[:, None]], axis=1)
    present = ~np.isnan(points[:, :, 0])
    best = np.full(g, np.inf)
    center = before.copy()
    subset = np.zeros((g, 5), dtype=bool)
    subset[:, 4] = True
    known = np.where(present[:, :, None], points, entering[:, None])
    for members in _SUBSETS:
        candidate = _circumcenters(known[:, members])
        squared = np.square(candidate - entering).sum(axis=1)
        reach = np.square(known - candidate[:, None]).sum(axis=2).max(axis=1)
        valid = present[:, members].all(axis=1) & (squared < best) & (reach <= squared * (1 + 1e-10) + 1e-30)
        best = np.where(valid, squared, best)
        center = np.where(valid[:, None], candidate, center)
        subset = np.where(valid[:, None], np.isin(np.arange(5), members), subset)
    order = np.argsort(~subset, axis=1, kind="stable")[:, :4]
    chosen = np.take_along_axis(points, order[:, :, None], axis=1)
    kept = np.take_along_axis(subset, order, axis=1)
    return center, best, np.where(kept[:, :, None], chosen, np.nan)


def _circumcenters(points: np.ndarray) -> np.ndarray:
    """Centres (g, 3) of the smallest spheres through ``points`` (g, k, 3); NaN or far off where those are dependent."""
    last = points[:, -1]
    edges = points[:, :-1] - last[:, None]
    k = edges.shape[1]
    if k == 0:
        return last.copy()
    gram = edges @ edges.transpose(0, 2, 1)
    right = np.einsum("gii->gi", gram) / 2
    with np.errstate(all="ignore"):
        if k == 1:
            weights = right / gram[:, 0]
        elif k == 2:
            a, b, d = gram[:, 0, 0], gram[:, 0, 1], gram[:, 1, 1]
            determinant = a * d - b * b
            weights = np.stack([d * right[:, 0] - b * right[:, 1], a * right[:, 1] - b * right[:, 0]], 1)
            weights /= determinant[:, None]
        else:
            e0, e1, e2 = edges[:, 0], edges[:, 1], edges[:, 2]
            c12, c20, c01 = np.cross(e1, e2), np.cross(e2, e0), np.cross(e0, e1)
            determinant = np.einsum("gi,gi->g", e0, c12)
            offset = right[:, :1] * c12 + right[:, 1:2] * c20 + right[:, 2:] * c01
            return last + offset / determinant[:, None]
        return last + np.einsum("gk,gki->gi", weights, edges)
