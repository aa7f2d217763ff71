"""The surface-area heuristic with every plane between primitives tried (MacDonald and Booth 1990, Wald 2007)."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np

from ..buffers import owned
from ..types import Types, types
from .binary_layout import middles, ranges
from .binary_tree import BinaryTree
from .sah_bins import better_split, no_split
from .sah_boxes import WORDS, area, empty, lanes, load, union
from .top_down import Segments, build_top_down


def build_sweep(lo: np.ndarray, hi: np.ndarray) -> BinaryTree:
    """A binary tree over boxes (n, 3), one primitive a leaf.

    The primitives are sorted along each axis once; the three orders are divided with the nodes and so stay sorted. Of
    equal costs the more even split wins.
    """
    kinds = types(str(lo.dtype))
    n = len(lo)
    middle = middles(lo, hi)
    sorted_items = [np.argsort(middle[:, axis], kind="stable") for axis in range(3)]
    packets = np.zeros((n, WORDS), lo.dtype)
    packets[:, :3] = lo
    np.negative(hi, out=packets[:, 3:6])
    boxes = owned(packets, kinds.Float)
    position = np.empty(n, np.int64)
    goes_right = np.empty(n, bool)
    before = Segments(np.arange(n), np.zeros(1, np.int64), np.array([n]), np.zeros(n, np.int64), 0)

    def split(segments: Segments) -> tuple[np.ndarray, np.ndarray]:
        nonlocal before, sorted_items
        # What became a leaf on the level before leaves the sorted orders.
        if len(segments.items) < len(before.items):
            position[:] = -1
            position[segments.items] = 0
            sorted_items = [items[position[items] >= 0] for items in sorted_items]
        axis, lefts = _cheapest(kinds, boxes, sorted_items, segments)
        chosen = np.choose(axis[segments.owner], sorted_items)
        rank = np.arange(len(chosen)) - segments.starts[segments.owner]
        goes_right[chosen] = rank >= lefts[segments.owner]
        sorted_items = [_parted(items, goes_right[items], segments, lefts) for items in sorted_items]
        before = segments
        return _parted(chosen, goes_right[chosen], segments, lefts), lefts

    return build_top_down(lo, hi, split)


def _parted(items: np.ndarray, right: np.ndarray, segments: Segments, lefts: np.ndarray) -> np.ndarray:
    """``items`` with those that go right after the others of their segment, each side in the order it had."""
    moved = np.empty_like(items)
    moved[ranges(segments.starts, lefts)] = items[~right]
    moved[ranges(segments.starts + lefts, segments.counts - lefts)] = items[right]
    return moved


def _cheapest(
    kinds: Types, boxes: Any, sorted_items: list[np.ndarray], segments: Segments
) -> tuple[np.ndarray, np.ndarray]:
    """The axis of the cheapest split of each segment, and how many go left."""
    UInt, Float = kinds.UInt, kinds.Float
    m, size = len(segments.starts), len(segments.items)
    order = UInt(np.concatenate(sorted_items).astype(np.uint32))
    begin = np.concatenate([segments.starts + axis * size for axis in range(3)])
    first, number = lanes(kinds, begin, np.tile(segments.counts, 3))
    width = 3 * m
    costs = dr.empty(Float, 3 * size)

    def box_of(i: Any) -> list[Any]:
        return load(kinds, boxes, dr.gather(UInt, order, i))

    def around(k: Any, side: list[Any]) -> tuple[Any, ...]:
        return k + 1, union(side, box_of(first + k))

    whole = dr.while_loop(
        (dr.zeros(UInt, width), empty(kinds, width)), lambda k, _: k < number, around, label="sweep whole"
    )[1]
    largest = dr.fmax(dr.fmax(-whole[3] - whole[0], -whole[4] - whole[1]), -whole[5] - whole[2])
    unit = dr.select(largest > 0, dr.fmin(1 / largest, kinds.largest), 0)

    def from_right(k: Any, side: list[Any]) -> tuple[Any, ...]:
        side = union(side, box_of(first + k))
        dr.scatter(costs, area(side, unit) * Float(number - k), first + k)
        return k - 1, side

    dr.eval(unit)
    dr.while_loop((number - 1, empty(kinds, width)), lambda k, _: k > 0, from_right, label="sweep from right")
    dr.eval(costs)

    def from_left(k: Any, side: list[Any], best: tuple[Any, ...]) -> tuple[Any, ...]:
        side = union(side, box_of(first + k))
        cost = area(side, unit) * Float(k + 1) + dr.gather(Float, costs, first + k + 1)
        best = better_split(best, cost, k + 1, number, (UInt(0), k + 1))
        return k + 1, side, best

    start = (dr.zeros(UInt, width), empty(kinds, width), no_split(kinds, width, dr.zeros(UInt, width)))
    best = dr.while_loop(start, lambda k, *_: k + 1 < number, from_left, label="sweep from left")[2]
    cost, uneven, lefts = (x.numpy().reshape(3, m) for x in (best[0], best[1], best[3]))
    # Of equal costs the more even one; of those the first axis.
    axis = np.lexsort((np.broadcast_to(np.arange(3)[:, None], (3, m)), uneven, cost), axis=0)[0]
    return axis, lefts.astype(np.int64)[axis, np.arange(m)]
