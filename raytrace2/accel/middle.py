"""Halves of equal space: cut in the middle of the longest side of the box around the primitives' middles."""

from __future__ import annotations

import numpy as np

from .binary_layout import middles
from .binary_tree import BinaryTree
from .top_down import Segments, build_top_down, parted


def build_middle(lo: np.ndarray, hi: np.ndarray) -> BinaryTree:
    """A binary tree over boxes (n, 3), one primitive a leaf."""
    columns = [np.ascontiguousarray(column) for column in middles(lo, hi).T]

    def split(segments: Segments) -> tuple[np.ndarray, np.ndarray]:
        of_items = [column[segments.items] for column in columns]
        least = [np.minimum.reduceat(c, segments.starts) for c in of_items]
        most = [np.maximum.reduceat(c, segments.starts) for c in of_items]
        axis = np.argmax([m * 0.5 - n * 0.5 for n, m in zip(least, most, strict=True)], axis=0)
        goes_right = np.zeros(len(segments.items), bool)
        for k, column in enumerate(of_items):
            cut = least[k] * 0.5 + most[k] * 0.5
            goes_right |= (column > cut[segments.owner]) & (axis == k)[segments.owner]
        return parted(segments, goes_right)

    return build_top_down(lo, hi, split)
