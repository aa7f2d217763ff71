"""Binary trees from the top down, all nodes of a level at once, by any rule that says who goes right."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .binary_layout import FREE_LEVELS, ranges, with_bounds
from .binary_tree import BinaryTree


@dataclass(frozen=True, eq=False)
class Segments:
    """The nodes of a level that are to be split, each of two primitives or more: node k has ``items[starts[k] :
    starts[k] + counts[k]]``, and ``owner`` is the k of each item. ``depth`` is the level's number."""

    items: np.ndarray
    starts: np.ndarray
    counts: np.ndarray
    owner: np.ndarray
    depth: int


#: Takes the segments and gives the items in a new order within each segment, and how many of each go left.
Splitter = Callable[[Segments], tuple[np.ndarray, np.ndarray]]


def build_top_down(lo: np.ndarray, hi: np.ndarray, split: Splitter) -> BinaryTree:
    """A tree with one primitive a leaf. A node of which ``split`` sends all one way, or past the level where it may
    choose, is halved by number."""
    order = np.arange(len(lo))
    first, count = np.zeros(1, np.int64), np.array([len(lo)])
    firsts, counts, lefts, level_ends = [], [], [], []
    made, depth = 1, 0
    while len(first):
        inner = np.flatnonzero(count > 1)
        left = np.full(len(first), -1, np.int64)
        left[inner] = made + 2 * np.arange(len(inner))
        level_ends.append(made)
        made += 2 * len(inner)
        firsts.append(first)
        counts.append(count)
        lefts.append(left)
        begin, number = first[inner], count[inner]
        if len(inner) == 0:
            break
        place = ranges(begin, number)
        starts = np.cumsum(number) - number
        segments = Segments(order[place], starts, number, np.repeat(np.arange(len(inner)), number), depth)
        lefts_of = number // 2
        if depth < FREE_LEVELS:
            order[place], chosen = split(segments)
            lefts_of = np.where((chosen > 0) & (chosen < number), chosen, lefts_of)
        first = np.stack([begin, begin + lefts_of], axis=1).ravel()
        count = np.stack([lefts_of, number - lefts_of], axis=1).ravel()
        depth += 1
    left, first, count = (np.concatenate(parts) for parts in (lefts, firsts, counts))
    return with_bounds(left, first, count, order, level_ends, lo[order], hi[order])


def parted(segments: Segments, goes_right: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The items with those that go right after the others, each side in the order it had, and how many stay left."""
    stays = ~goes_right
    before = np.cumsum(stays) - stays
    before -= before[segments.starts][segments.owner]
    lefts = np.add.reduceat(stays, segments.starts, dtype=np.int64)
    start = segments.starts[segments.owner]
    place = np.where(stays, start + before, lefts[segments.owner] + np.arange(len(stays)) - before)
    moved = np.empty_like(segments.items)
    moved[place] = segments.items
    return moved, lefts
