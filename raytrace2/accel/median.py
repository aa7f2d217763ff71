"""Halves of equal number, the axes in turn (Kay and Kajiya 1986): blind to sizes, and as shallow as a tree can be."""

from __future__ import annotations

import numpy as np

from .binary_layout import middles
from .binary_tree import BinaryTree
from .top_down import Segments, build_top_down


def build_median(lo: np.ndarray, hi: np.ndarray) -> BinaryTree:
    """A binary tree over boxes (n, 3), one primitive a leaf, split at the median of the middles along x, y, z, x ...
    Ties go by the primitives' numbers."""
    middle = middles(lo, hi)
    n = len(lo)
    by_axis = [np.argsort(middle[:, axis], kind="stable") for axis in range(3)]
    rank = np.empty((3, n), np.uint64)
    for axis in range(3):
        rank[axis, by_axis[axis]] = np.arange(n, dtype=np.uint64)

    def split(segments: Segments) -> tuple[np.ndarray, np.ndarray]:
        axis = segments.depth % 3
        keys = np.sort((segments.owner.astype(np.uint64) << np.uint64(32)) | rank[axis, segments.items])
        items = by_axis[axis][(keys & np.uint64(0xFFFFFFFF)).astype(np.int64)]
        return items, (segments.counts + 1) // 2

    return build_top_down(lo, hi, split)
