"""What builders share to lay a :class:`BinaryTree` out: level by level, siblings side by side."""

from __future__ import annotations

import numpy as np

from .binary_tree import BinaryTree

#: Levels that a builder may split as it likes. Below, nodes are halved by number: no input makes a tree deeper than
#: this and its logarithm.
FREE_LEVELS = 128


def middles(lo: np.ndarray, hi: np.ndarray) -> np.ndarray:
    """The middles of boxes (n, 3), halved before they are added so that they cannot overflow."""
    return lo * lo.dtype.type(0.5) + hi * hi.dtype.type(0.5)


def ranges(first: np.ndarray, count: np.ndarray) -> np.ndarray:
    """``first[k]``, ``first[k] + 1`` ... (``count[k]`` of them, at least one) for each k in turn."""
    ends = np.cumsum(count)
    steps = np.ones(int(ends[-1]) if len(ends) else 0, np.int64)
    if len(ends):
        steps[0] = first[0]
        steps[ends[:-1]] = first[1:] - (first[:-1] + count[:-1] - 1)
    return np.cumsum(steps)


def with_bounds(
    left: np.ndarray,
    first: np.ndarray,
    count: np.ndarray,
    order: np.ndarray,
    level_ends: list[int],
    lo: np.ndarray,
    hi: np.ndarray,
) -> BinaryTree:
    """The tree of nodes laid out in levels (level k ends before node ``level_ends[k]``), with bounds from the bottom
    up; ``lo``, ``hi`` are those of what ``order`` refers to, in its order."""
    n = len(left)
    box = np.empty((n, 6), lo.dtype)
    leaf = np.flatnonzero(left < 0)
    if (count[leaf] == 1).all():
        at = first[leaf]
        box[leaf, :3], box[leaf, 3:] = lo[at], -hi[at]
    else:
        by_place = leaf[np.argsort(first[leaf])]
        for k in range(3):
            box[by_place, k] = np.minimum.reduceat(np.ascontiguousarray(lo[:, k]), first[by_place])
            box[by_place, k + 3] = np.minimum.reduceat(np.ascontiguousarray(-hi[:, k]), first[by_place])
    begins = [0, *level_ends[:-1]]
    for begin, end in zip(reversed(begins), reversed(level_ends), strict=True):
        inner = begin + np.flatnonzero(left[begin:end] >= 0)
        child = left[inner]
        box[inner] = np.minimum(box.take(child, axis=0), box.take(child + 1, axis=0))
    return BinaryTree(box[:, :3], -box[:, 3:], left, first, count, order)


def lay_out(
    children: np.ndarray, count: np.ndarray, lo: np.ndarray, hi: np.ndarray, root: int, leaf_order: np.ndarray
) -> BinaryTree:
    """The tree whose node k has ``children[k]`` (2,), or is the leaf of primitive ``leaf_order[k]`` where k is less
    than their number; ``count``, ``lo``, ``hi`` are given for every node."""
    leaves = len(leaf_order)
    level, place = np.array([root]), np.zeros(1, np.int64)
    nodes, firsts, lefts = [], [], []
    order = np.empty(leaves, np.int64)
    made = 1
    while len(level):
        is_leaf = level < leaves
        order[place[is_leaf]] = leaf_order[level[is_leaf]]
        inner = level[~is_leaf]
        left = np.full(len(level), -1, np.int64)
        left[~is_leaf] = made + 2 * np.arange(len(inner))
        made += 2 * len(inner)
        nodes.append(level)
        firsts.append(place)
        lefts.append(left)
        pair = children[inner - leaves]
        start = place[~is_leaf]
        place = np.stack([start, start + count[pair[:, 0]]], axis=1).ravel()
        level = pair.ravel()
    node = np.concatenate(nodes)
    return BinaryTree(lo[node], hi[node], np.concatenate(lefts), np.concatenate(firsts), count[node], order)
