"""Binned surface-area-heuristic build, a whole level at a time (Wald 2007, "On fast construction of SAH-based BVHs")."""

from __future__ import annotations

import numpy as np

from .binary_tree import BinaryTree, surface_area

#: Bins per axis. Sixteen come within a few per cent of a full sweep's cost.
BINS = 16


def build_binned_sah(lo: np.ndarray, hi: np.ndarray) -> BinaryTree:
    """A binary tree over boxes ``lo``, ``hi`` (n, 3) with one primitive a leaf.

    Each level's nodes are split together by array operations, so that the cost in Python is one pass per level. Nodes whose
    centroids coincide are split by count, which bounds the depth for any input.
    """
    n = len(lo)
    centroid = lo * 0.5 + hi * 0.5
    order = np.arange(n)
    starts, counts = np.zeros(1, np.int64), np.full(1, n, np.int64)
    node_lo, node_hi = [lo.min(axis=0)[None]], [hi.max(axis=0)[None]]
    lefts: list[np.ndarray] = []
    firsts: list[np.ndarray] = []
    totals: list[np.ndarray] = []
    made = 1
    while len(starts):
        inner = counts > 1
        left = np.full(len(starts), -1, np.int64)
        left[inner] = made + 2 * np.arange(np.count_nonzero(inner))
        lefts.append(left)
        firsts.append(starts)
        totals.append(counts)
        starts, counts = starts[inner], counts[inner]
        if len(starts) == 0:
            break
        made += 2 * len(starts)
        left_count, bounds = _split_level(lo, hi, centroid, order, starts, counts)
        node_lo.append(bounds[0].reshape(-1, 3))
        node_hi.append(bounds[1].reshape(-1, 3))
        starts = np.stack([starts, starts + left_count], axis=1).ravel()
        counts = np.stack([left_count, counts - left_count], axis=1).ravel()
    join = np.concatenate
    return BinaryTree(join(node_lo), join(node_hi), join(lefts), join(firsts), join(totals), order)


def _split_level(
    lo: np.ndarray, hi: np.ndarray, centroid: np.ndarray, order: np.ndarray, starts: np.ndarray, counts: np.ndarray
) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Splits nodes ``order[starts : starts + counts]``, each of two or more primitives: reorders ``order`` in place and gives
    the size of each left child and the bounds of both, (m, 2, 3) each."""
    m = len(starts)
    node = np.repeat(np.arange(m), counts)
    offsets = np.cumsum(counts) - counts
    position = np.arange(len(node)) + np.repeat(starts - offsets, counts)
    index = order[position]
    centers = centroid[index]
    least = np.minimum.reduceat(centers, offsets)
    extent = np.maximum.reduceat(centers, offsets) - least
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        scale = np.where(extent > 0, BINS / extent, 0)
        relative = (centers - least[node]) * scale[node]
    bins = np.clip(np.nan_to_num(relative, nan=0, posinf=BINS - 1), 0, BINS - 1).astype(np.int64)

    cost = np.full(m, np.inf)
    axis = np.zeros(m, np.int64)
    last_left = np.zeros(m, np.int64)
    for k in range(3):
        axis_cost, axis_last = _cheapest_plane(lo[index], hi[index], node * BINS + bins[:, k], m)
        better = axis_cost < cost
        cost[better], axis[better], last_left[better] = axis_cost[better], k, axis_last[better]

    right = bins[np.arange(len(node)), axis[node]] > last_left[node]
    together = ~np.isfinite(cost)
    if together.any():
        local = np.arange(len(node)) - np.repeat(offsets, counts)
        right = np.where(together[node], local >= (counts // 2)[node], right)
    left_count = np.add.reduceat((~right).astype(np.int64), offsets)
    rank = np.argsort(node * 2 + right, kind="stable")
    sorted_index = index[rank]
    order[position] = sorted_index
    children = np.stack([offsets, offsets + left_count], axis=1).ravel()
    child_lo = np.minimum.reduceat(lo[sorted_index], children).reshape(m, 2, 3)
    child_hi = np.maximum.reduceat(hi[sorted_index], children).reshape(m, 2, 3)
    return left_count, (child_lo, child_hi)


def _cheapest_plane(lo: np.ndarray, hi: np.ndarray, key: np.ndarray, m: int) -> tuple[np.ndarray, np.ndarray]:
    """For each of ``m`` nodes the least SAH cost of a plane between bins, and the last bin on its left. ``key`` (node times
    BINS plus bin) tells each box's bin. The cost is infinite where all boxes share a bin."""
    rank = np.argsort(key, kind="stable")
    sorted_key = key[rank]
    begins = np.flatnonzero(np.concatenate([[True], sorted_key[1:] != sorted_key[:-1]]))
    filled = sorted_key[begins]
    bin_lo = np.full((m * BINS, 3), np.inf, lo.dtype)
    bin_hi = np.full((m * BINS, 3), -np.inf, lo.dtype)
    bin_count = np.zeros(m * BINS, np.int64)
    bin_lo[filled] = np.minimum.reduceat(lo[rank], begins)
    bin_hi[filled] = np.maximum.reduceat(hi[rank], begins)
    bin_count[filled] = np.diff(np.append(begins, len(key)))
    bin_lo, bin_hi, bin_count = bin_lo.reshape(m, BINS, 3), bin_hi.reshape(m, BINS, 3), bin_count.reshape(m, BINS)
    left_area = surface_area(np.minimum.accumulate(bin_lo, 1), np.maximum.accumulate(bin_hi, 1))[:, :-1]
    right_area = surface_area(
        np.minimum.accumulate(bin_lo[:, ::-1], 1), np.maximum.accumulate(bin_hi[:, ::-1], 1)
    )[:, ::-1][:, 1:]
    left_count = np.cumsum(bin_count, axis=1)[:, :-1]
    right_count = bin_count.sum(axis=1, keepdims=True) - left_count
    cost = left_area * left_count + right_area * right_count
    cost = np.where((left_count > 0) & (right_count > 0), cost, np.inf)
    best = np.argmin(cost, axis=1)
    return cost[np.arange(m), best], best
