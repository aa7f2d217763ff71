"""From a binary tree to wide nodes of least expected cost (Ylitie, Karras and Laine 2017, section 4.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .binary_tree import BinaryTree, surface_area


@dataclass(frozen=True, eq=False)
class WideTree:
    """Wide node k is binary node ``binary[k]``; its children are binary nodes ``children[k]`` (-1: none). ``inner[k,
    j]`` is the child's own wide index, or -1 where the child is a leaf. Nodes stand in depth-first order. ``cost`` is
    the expected cost of a ray through the root (node visits plus primitive tests), ``dearest`` the largest of a ray
    through any binary node, of a size that can be told from none, in primitive tests."""

    binary: np.ndarray
    children: np.ndarray
    inner: np.ndarray
    depth: int
    cost: float
    dearest: float


def collapse(tree: BinaryTree, width: int, *, max_leaf_size: int, node_cost: float, primitive_cost: float) -> WideTree:
    """Chooses which binary nodes become wide nodes, which become leaves, and which dissolve, by dynamic programming.

    ``cost[i][n]`` is the least cost of standing for binary node n by at most i roots, fewer than ``width``; a node is a
    leaf if testing all its primitives is cheaper than any wide node over it.
    """
    cost, split, is_leaf, dearest = _least_costs(tree, width, max_leaf_size, node_cost, primitive_cost)
    frontier = np.zeros(1, np.int64)
    if is_leaf[0]:
        no_children = np.full((0, width), -1, np.int64)
        return WideTree(np.zeros(0, np.int64), no_children, no_children, 0, float(cost[1][0]), dearest)
    levels = []
    while len(frontier):
        children = _children_of(tree, split, frontier, width)
        levels.append((frontier, children))
        inner = (children >= 0) & ~is_leaf[np.maximum(children, 0)]
        frontier = children[inner]
    binary, children, inner = _depth_first(levels, is_leaf, width)
    return WideTree(binary, children, inner, len(levels), float(cost[1][0]), dearest)


def _least_costs(
    tree: BinaryTree, width: int, max_leaf_size: int, node_cost: float, primitive_cost: float
) -> tuple[list[np.ndarray], np.ndarray, np.ndarray, float]:
    area = surface_area(tree.lo, tree.hi)
    area = (area / area[0] if area[0] > 0 else np.ones(len(area))).astype(np.float32)
    # split[n, i]: how many of i roots go to the left child, 0 where one root fewer is as good; split[n, 0]: for a wide
    # node.
    split = np.zeros((len(area), width), np.int8)
    is_leaf = tree.left < 0
    tests = area * tree.count.astype(np.float32) * np.float32(primitive_cost)
    as_leaf = np.where(tree.count <= max_leaf_size, tests, np.float32(np.inf))
    # Arrays of one number each are gathered faster than rows; what is set here is right for the leaves.
    cost = [tests] + [tests.copy() for _ in range(1, width)]
    for level in reversed(tree.levels()):
        left = tree.left[level]
        inner = left >= 0
        nodes, left = level[inner], left[inner]
        if len(nodes) == 0:
            continue
        of_left = [cost[k][left] for k in range(1, width)]
        of_right = [cost[k][left + 1] for k in range(1, width)]
        shared: list[np.ndarray] = []
        chosen: list[np.ndarray] = []
        for i in range(2, width + 1):
            least, best = of_left[0] + of_right[i - 2], np.ones(len(nodes), np.int8)
            for k in range(2, i):
                other = of_left[k - 1] + of_right[i - k - 1]
                best[other < least] = k
                least = np.minimum(least, other)
            shared.append(least)
            chosen.append(best)
        as_wide = shared[-1] + area[nodes] * np.float32(node_cost)
        is_leaf[nodes] = as_leaf[nodes] <= as_wide
        split[nodes, 0] = chosen[-1]
        least = cost[1][nodes] = np.minimum(as_leaf[nodes], as_wide)
        for i in range(2, width):
            split[nodes, i] = np.where(shared[i - 2] < least, chosen[i - 2], 0)
            least = cost[i][nodes] = np.minimum(shared[i - 2], least)
    dearest = np.divide(cost[1], area, out=np.zeros_like(area), where=area > 0).max()
    return cost, split, is_leaf, float(dearest) / primitive_cost


def _children_of(tree: BinaryTree, split: np.ndarray, nodes: np.ndarray, width: int) -> np.ndarray:
    """The up to ``width`` children of each of ``nodes`` as wide nodes, packed to the front and padded with -1."""
    m = len(nodes)
    at = np.full((m, width), -1, np.int64)
    budget = np.zeros((m, width), np.int64)
    k = split[nodes, 0].astype(np.int64)
    rows = np.arange(m)
    at[:, 0], budget[:, 0] = tree.left[nodes], k
    at[rows, k], budget[rows, k] = tree.left[nodes] + 1, width - k
    for _ in range(width):
        # A root fewer where that is as good.
        for _ in range(width):
            idle = (budget > 1) & (split[np.maximum(at, 0), budget] == 0)
            if not idle.any():
                break
            budget[idle] -= 1
        row, column = np.nonzero(budget > 1)
        if len(row) == 0:
            break
        node, i = at[row, column], budget[row, column]
        k = split[node, i].astype(np.int64)
        at[row, column], budget[row, column] = tree.left[node], k
        at[row, column + k], budget[row, column + k] = tree.left[node] + 1, i - k
    front = np.argsort(at < 0, axis=1, kind="stable")
    return np.take_along_axis(at, front, axis=1)


def _depth_first(
    levels: list[tuple[np.ndarray, np.ndarray]], is_leaf: np.ndarray, width: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lays the levels' nodes out depth first; gives binary nodes, children and the children's wide indices."""
    sizes: list[np.ndarray] = [np.zeros(0)] * len(levels)
    inner_masks = [(c >= 0) & ~is_leaf[np.maximum(c, 0)] for _, c in levels]
    below = np.zeros(0, np.int64)
    child_sizes = []
    for k in range(len(levels) - 1, -1, -1):
        table = np.zeros(levels[k][1].shape, np.int64)
        table[inner_masks[k]] = below
        child_sizes.append(table)
        below = sizes[k] = 1 + table.sum(axis=1)
    child_sizes.reverse()
    total = int(sizes[0][0])
    binary = np.empty(total, np.int64)
    children = np.empty((total, width), np.int64)
    inner = np.full((total, width), -1, np.int64)
    place = np.zeros(1, np.int64)
    for (nodes, level_children), mask, table in zip(levels, inner_masks, child_sizes, strict=True):
        binary[place] = nodes
        children[place] = level_children
        before = np.cumsum(table, axis=1) - table
        own = np.where(mask, place[:, None] + 1 + before, -1)
        inner[place] = own
        place = own[mask]
    return binary, children, inner
