"""Parts of a hierarchy that rays would test like a list: large triangles about one point, say, whose boxes overlap
however they are grouped. There, and only there, triangles are cut."""

from __future__ import annotations

import numpy as np

from ..surfaces.primitives import Primitives
from . import wide_node
from .binary_layout import ranges
from .binary_tree import BinaryTree, surface_area
from .collapse import WideTree
from .spatial import build_spatial_forest
from .triangle_parts import triangle_corners

#: A node is a tangle if a ray through its box is expected to test more primitives than it visits nodes, and more than
#: this many. Where triangles do not overlap it tests 5 to 20, however many there are.
MOST_TESTS = 40.0
#: At most this many parts of the primitives in tangles beyond the first, per primitive.
BUDGET = 1.0
#: Cuts are tried where children overlap by more than this share of a tangle's area: what overlaps by less is as quick
#: with a third fewer parts.
OVERLAP = 1e-3


def find_tangles(tree: BinaryTree, wide: WideTree) -> np.ndarray:
    """The topmost tangles: nodes of ``tree``, none below another."""
    if wide.dearest <= MOST_TESTS:
        return np.zeros(0, np.int64)
    area = surface_area(tree.lo, tree.hi)
    child = np.maximum(wide.children, 0)
    is_leaf = (wide.children >= 0) & (wide.inner < 0)
    visits = area[wide.binary]
    tests = np.where(is_leaf, area[child] * tree.count[child], 0).sum(axis=1)
    levels = [np.zeros(1, np.int64)]
    while len(levels[-1]):
        below = wide.inner[levels[-1]]
        levels.append(below[below >= 0])
    for level in reversed(levels):
        for slot in wide.inner[level].T:
            inner = slot >= 0
            visits[level[inner]] += visits[slot[inner]]
            tests[level[inner]] += tests[slot[inner]]
    tangled = (tests > visits) & (tests > MOST_TESTS * area[wide.binary])
    found = []
    level = levels[0]
    while len(level):
        found.append(wide.binary[level[tangled[level]]])
        below = wide.inner[level[~tangled[level]]]
        level = below[below >= 0]
    return np.concatenate(found)


def untangled(parts: Primitives, tree: BinaryTree, wide: WideTree) -> BinaryTree | None:
    """``tree`` over ``parts`` with its tangles built anew, their triangles cut; None if there is nothing to gain.

    ``wide`` is what ``tree`` collapses to. A tangle of other primitives stays, as nothing else can be cut.
    """
    nodes = find_tangles(tree, wide)
    if len(nodes):
        is_triangle = triangle_corners(parts)[1]
        triangles = np.concatenate([[0], np.cumsum(is_triangle[tree.order])])
        first, count = tree.first[nodes].astype(np.int64), tree.count[nodes].astype(np.int64)
        nodes = nodes[2 * (triangles[first + count] - triangles[first]) > count]
    if len(nodes) == 0:
        return None
    nodes = nodes[np.argsort(tree.first[nodes])]
    first, count = tree.first[nodes].astype(np.int64), tree.count[nodes].astype(np.int64)
    held = tree.order[ranges(first, count)]
    room = wide_node.MAX_PRIMITIVES - len(tree.order)
    depth = next(k for k, level in reversed(list(enumerate(tree.levels()))) if np.isin(nodes, level).any())
    forest = build_spatial_forest(
        parts, held, count, most=min(int(BUDGET * len(held)), room), depth=depth, overlap=OVERLAP
    )
    return _grafted(tree, nodes, forest)


def _grafted(tree: BinaryTree, nodes: np.ndarray, forest: BinaryTree) -> BinaryTree:
    """``tree`` with ``nodes``, in the order of what they hold, replaced by the first nodes of ``forest``."""
    roots = len(nodes)
    stays = np.ones(len(tree.left), bool)
    level = nodes
    while len(level):
        left = tree.left[level]
        left = left[left >= 0]
        level = np.concatenate([left, left + 1])
        stays[level] = False
    place = np.cumsum(stays) - 1
    kept = np.flatnonzero(stays)
    old_first, old_count = tree.first[nodes].astype(np.int64), tree.count[nodes].astype(np.int64)
    grown = np.concatenate([[0], np.cumsum(forest.count[:roots] - old_count)])

    def moved(position: np.ndarray) -> np.ndarray:
        """Where what stood at a position outside of the tangles stands now."""
        return position + grown[np.searchsorted(old_first + old_count, position, side="right")]

    first, count = tree.first[kept].astype(np.int64), tree.count[kept].astype(np.int64)
    # A tangle's own beginning lies behind all tangles before it.
    new_first, end = moved(first), moved(first + count)
    left = tree.left[kept]
    left = np.where(left >= 0, place[left], -1)
    at = place[nodes]
    begins, ends = new_first[at], end[at]
    # Roots take the places of the tangles, the others follow all that stays.
    shift = len(kept) - roots
    forest_left = np.where(forest.left >= 0, forest.left + shift, -1)
    left[at] = forest_left[:roots]
    assert (ends - begins == forest.count[:roots]).all()
    owner = np.searchsorted(forest.first[:roots], forest.first[roots:], side="right") - 1
    order = np.empty(len(tree.order) + int(grown[-1]), np.int64)
    outside = np.ones(len(tree.order), bool)
    outside[ranges(old_first, old_count)] = False
    where = np.flatnonzero(outside)
    order[moved(where)] = tree.order[where]
    order[ranges(begins, forest.count[:roots])] = forest.order
    lo, hi = tree.lo[kept].copy(), tree.hi[kept].copy()
    lo[at], hi[at] = forest.lo[:roots], forest.hi[:roots]
    return BinaryTree(
        np.concatenate([lo, forest.lo[roots:]]),
        np.concatenate([hi, forest.hi[roots:]]),
        np.concatenate([left, forest_left[roots:]]),
        np.concatenate([new_first, forest.first[roots:] + (begins - forest.first[:roots])[owner]]),
        np.concatenate([end - new_first, forest.count[roots:]]),
        order,
    )
