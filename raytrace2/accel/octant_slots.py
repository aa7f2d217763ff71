"""Which child of a wide node stands where, so that rays can ask the near ones first without sorting.

After Ylitie, Karras and Laine 2017, section 4.1: slot s should hold the child farthest in the direction of octant s,
whose sign on axis k is bit k; a ray towards octant r then asks the slots s in the order of s xor r.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .binary_tree import BinaryTree
from .collapse import WideTree


def by_octant(wide: WideTree, tree: BinaryTree) -> WideTree:
    """``wide``, eight children a node, with the children of each node in slots by octant: each in turn takes, of all
    pairs of a free slot and a child without one, the pair that fits best."""
    n, width = wide.children.shape
    if n == 0:
        return wide
    child = np.maximum(wide.children, 0)
    doubled = tree.lo.astype(np.float64) + tree.hi
    middle = doubled[child] - doubled[wide.binary][:, None]
    signs = np.where(np.arange(width)[:, None] >> np.arange(3) & 1, 1.0, -1.0)
    fit = np.einsum("ncj,sj->ncs", middle, signs)
    fit[wide.children < 0] = -np.inf
    rows = np.arange(n)
    slots = np.full((n, width), -1)
    for _ in range(width):
        best = fit.reshape(n, -1).argmax(axis=1)
        left = fit.reshape(n, -1)[rows, best] > -np.inf
        at, c, s = rows[left], best[left] // width, best[left] % width
        slots[at, s] = c
        fit[at, c, :] = -np.inf
        fit[at, :, s] = -np.inf
    source = np.maximum(slots, 0)

    def moved(table: np.ndarray) -> np.ndarray:
        return np.where(slots >= 0, np.take_along_axis(table, source, axis=1), -1)

    return replace(wide, children=moved(wide.children), inner=moved(wide.inner))
