"""The cells of kd-trees and boxes around those of BSP trees, cut by the planes on the device."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..surfaces.levels import Level, root_level
from .kdtree_traversal import LEAF, PlaneTree

Boxes = tuple[np.ndarray, np.ndarray]


def plane_levels(bounds: Boxes, tree: PlaneTree) -> Iterator[Level]:
    """The ``bounds`` of everything, cut level by level; empty cells are leaves, too.

    A cell of a kd-tree ends in its planes exactly. So does the box of a BSP tree's cell where planes are across an
    axis; elsewhere it is the box around what the plane leaves of its parent's box.
    """
    words = tree.nodes.numpy().reshape(-1, tree.words)
    link = np.ascontiguousarray(words[:, -1])
    link = (link.view(np.uint32) if link.dtype == np.float32 else link).astype(np.int64)
    node = np.zeros(1, np.int64)
    level = root_level(bounds, leaf=bool(link[0] & 3 == LEAF))
    yield level
    while len(inner := np.flatnonzero(~level.leaf)):
        node = node[inner]
        some = words[node].astype(np.float64)
        if tree.words == 4:
            normal = np.eye(3)[link[node] & 3]
            point = np.where(normal == 1, some[:, :1], 0)
        else:
            normal, point = some[:, :3], some[:, 3:6]
        lo, hi = np.repeat(level.lo[inner], 2, axis=0), np.repeat(level.hi[inner], 2, axis=0)
        lo[0::2], hi[0::2] = below(lo[0::2], hi[0::2], normal, point)
        lo[1::2], hi[1::2] = below(lo[1::2], hi[1::2], -normal, point)
        node = ((link[node] >> 2)[:, None] + np.arange(2)).ravel()
        level = Level(lo, hi, np.repeat(inner, 2), link[node] & 3 == LEAF)
        yield level


def below(lo: np.ndarray, hi: np.ndarray, normal: np.ndarray, point: np.ndarray) -> Boxes:
    """Boxes (n, 3), (n, 3) around what of others lies below planes through ``point`` across ``normal`` (n, 3).

    Where nothing does, the part nearest to the plane. On each axis the end is where the plane is for the corner of the
    box that is lowest on the others; rounded outwards, but for planes across that axis.
    """
    new_lo, new_hi = lo.copy(), hi.copy()
    low, high = normal * (lo - point), normal * (hi - point)
    least, size = np.minimum(low, high), np.maximum(np.abs(low), np.abs(high))
    for k in range(3):
        others = [j for j in range(3) if j != k]
        rest = least[:, others].sum(axis=1)
        error = 8 * 2.0**-53 * size.sum(axis=1)
        slope = normal[:, k]
        some = slope != 0
        with np.errstate(all="ignore"):
            exact = (normal[:, others] == 0).all(axis=1)
            way = np.where(exact, 0, -rest + error) / slope
            end = point[:, k] + way
            end = np.where(exact, end, np.nextafter(end, np.copysign(np.inf, slope)))
        upper, lower = some & (slope > 0), some & (slope < 0)
        new_hi[upper, k] = np.clip(end, lo[:, k], hi[:, k])[upper]
        new_lo[lower, k] = np.clip(end, lo[:, k], hi[:, k])[lower]
    return new_lo, new_hi
