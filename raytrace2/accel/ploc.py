"""Locally-ordered clustering: trees from the bottom up, near to the quality of a sweep.

Meister and Bittner 2018, "Parallel locally-ordered clustering for bounding volume hierarchy construction": clusters in
the order of a space-filling curve look for the partner that makes the smallest box among a few to either side; those
that choose each other merge.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np

from ..buffers import owned
from ..types import Types, types
from .binary_layout import lay_out
from .binary_tree import BinaryTree
from .morton_codes import sorted_codes
from .sah_boxes import WORDS, area, load, union

#: How far to either side a cluster looks. More costs time in proportion and gains little.
RADIUS = 14
#: A round in which fewer than one cluster in this many merges is made up for by merging neighbours: no input needs more
#: rounds than the logarithm of its size to the base 1 + 1 / (2 * SLOW).
SLOW = 8


def build_ploc(lo: np.ndarray, hi: np.ndarray) -> BinaryTree:
    """A binary tree over boxes (n, 3), one primitive a leaf."""
    kinds = types(str(lo.dtype))
    n = len(lo)
    order = sorted_codes(lo, hi)[1]
    boxes = np.zeros((2 * n - 1, WORDS), lo.dtype)
    boxes[:n, :3] = lo.take(order, axis=0)
    boxes[:n, 3:6] = -hi.take(order, axis=0)
    count = np.ones(2 * n - 1, np.int64)
    children = np.empty((n - 1, 2), np.int64)
    size = -boxes[:n, 3:6].min(axis=0) - boxes[:n, :3].min(axis=0)
    unit = dr.opaque(kinds.Float, _unit(float(size.max()), kinds))
    cluster, made = np.arange(n), n
    while len(cluster) > 1:
        partner = _partners(kinds, boxes[cluster], unit)
        here = np.arange(len(cluster))
        first = np.flatnonzero((partner[partner] == here) & (here < partner))
        second = partner[first]
        if 2 * len(first) * SLOW < len(cluster):
            merged = np.zeros(len(cluster), bool)
            merged[first] = merged[second] = True
            alone = np.flatnonzero(~merged)
            alone = alone[: len(alone) // 2 * 2]
            first, second = np.append(first, alone[::2]), np.append(second, alone[1::2])
            by_place = np.argsort(first)
            first, second = first[by_place], second[by_place]
        new = made + np.arange(len(first))
        pair = np.stack([cluster[first], cluster[second]], axis=1)
        children[new - n] = pair
        boxes[new] = np.minimum(boxes[pair[:, 0]], boxes[pair[:, 1]])
        count[new] = count[pair].sum(axis=1)
        made += len(first)
        cluster[first] = new
        keep = np.ones(len(cluster), bool)
        keep[second] = False
        cluster = cluster[keep]
    return lay_out(children, count, boxes[:, :3], -boxes[:, 3:6], 2 * n - 2, order)


def _unit(size: float, kinds: Types) -> float:
    return min(1 / size, kinds.largest) if size > 0 else 0.0


def _partners(kinds: Types, packets: np.ndarray, unit: Any) -> np.ndarray:
    """The place of the partner that each cluster would like: of the least area, then the nearest place, then such that
    the places 2k and 2k + 1 choose each other. That is an order of *pairs*, so the first of them is always mutual."""
    UInt, Int, Float = kinds.UInt, kinds.Int, kinds.Float
    n = len(packets)
    source, count = owned(packets, Float), dr.opaque(Int, n)
    here = Int(dr.arange(UInt, n))
    own = load(kinds, source, UInt(here))
    sibling = here ^ 1

    def look(distance: Any, best: Any, partner: Any) -> tuple[Any, ...]:
        for place in (here - distance, here + distance):
            inside = (place >= 0) & (place < count)
            other = load(kinds, source, UInt(dr.select(inside, place, here)))
            cost = area(union(own, other), unit)
            better = inside & ((cost < best) | ((cost == best) & (distance == 1) & (place == sibling)))
            best, partner = dr.select(better, cost, best), dr.select(better, place, partner)
        return distance + 1, best, partner

    state = (dr.full(Int, 1, n), dr.full(Float, dr.inf, n), here ^ 1)
    partner = dr.while_loop(state, lambda d, *_: d <= RADIUS, look, label="ploc partners")[2]
    # The last of an odd number has nobody beside it, but then it has found somebody before it.
    return dr.select(partner < count, partner, count - 1).numpy().astype(np.int64)
