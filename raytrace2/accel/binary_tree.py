"""Binary trees over boxes, as every builder makes them: arrays, no node objects."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class BinaryTree:
    """Node k has bounds ``lo[k]``, ``hi[k]``; an inner node's children are ``left[k]`` and ``left[k] + 1``, both later
    than k; ``left[k]`` is -1 for a leaf. Every node holds the primitives ``order[first[k] : first[k] + count[k]]``."""

    lo: np.ndarray
    hi: np.ndarray
    left: np.ndarray
    first: np.ndarray
    count: np.ndarray
    order: np.ndarray

    def levels(self) -> list[np.ndarray]:
        """The nodes of each level, root first."""
        level = np.zeros(1, dtype=np.int64)
        found = []
        while len(level):
            found.append(level)
            children = self.left[level]
            children = children[children >= 0]
            level = np.stack([children, children + 1], axis=1).ravel()
        return found


def surface_area(lo: np.ndarray, hi: np.ndarray) -> np.ndarray:
    """Half the surface area of boxes (..., 3), in float64; zero for an empty box (lo > hi)."""
    x, y, z = (np.maximum(np.subtract(hi[..., k], lo[..., k], dtype=np.float64), 0) for k in range(3))
    return x * y + y * z + z * x
