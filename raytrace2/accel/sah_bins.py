"""The cheapest plane between bins of equal width, and the rule by which splits are compared."""

from __future__ import annotations

from typing import Any

import drjit as dr

from ..types import Types
from .sah_boxes import Group, area, centre, empty, load, union

#: Bins per axis. Sixteen come within a few per cent of a full sweep's cost.
BINS = 16
ALL_BINS = 3 * BINS
#: What stands for the axis of a node that no plane divides: its primitives are halved by number.
BY_COUNT = 3


def no_bins(types: Types) -> tuple[Any, Any]:
    """Memory of each lane for the boxes and the counts of the bins on three axes, empty."""
    boxes = dr.alloc_local(types.Float, 6 * ALL_BINS, value=types.Float(dr.inf))
    return boxes, dr.alloc_local(types.UInt, ALL_BINS, value=types.UInt(0))


def add_to_bin(bins: tuple[Any, Any], bin: Any, box: list[Any], count: Any) -> None:
    """Puts ``count`` primitives inside ``box`` into ``bin``."""
    boxes, counts = bins
    for k in range(6):
        boxes.write(dr.fmin(boxes.read(bin * 6 + k), box[k]), bin * 6 + k)
    counts.write(counts.read(bin) + count, bin)


def fill_bins(types: Types, primitives: Any, group: Group) -> tuple[Any, Any]:
    """Each lane's bins with the primitives of its group."""

    def turn(i: Any, boxes: Any, counts: Any) -> tuple[Any, ...]:
        box = load(types, primitives, i)
        for axis, middle in enumerate(centre(box)):
            place = (middle - group.least[axis]) * group.scale[axis]
            bin = types.UInt(dr.fmax(dr.fmin(place, BINS - 1), 0)) + axis * BINS
            add_to_bin((boxes, counts), bin, box, 1)
        return i + 1, boxes, counts

    state = (group.begin, *no_bins(types))
    _, boxes, counts = dr.while_loop(state, lambda i, *_: i < group.end, turn, label="fill bins")
    return boxes, counts


def cheapest_plane(types: Types, bins: tuple[Any, Any], total: Any, unit: Any) -> tuple[Any, Any, Any]:
    """The axis and the first bin right of the plane of least area times count, and that cost; :data:`BY_COUNT` and
    infinity where all share a bin.

    Of equal costs the more even split wins, which bounds the depth over boxes without any area.
    """
    UInt, Float, width = types.UInt, types.Float, dr.width(total)
    right_costs = dr.alloc_local(Float, ALL_BINS, value=Float(0))

    def from_right(
        k: Any, sides: list[Any], numbers: list[Any], costs: Any, boxes: Any, counts: Any
    ) -> tuple[Any, ...]:
        for axis in range(3):
            sides[axis], numbers[axis] = _add_bin(boxes, counts, k + axis * BINS, sides[axis], numbers[axis])
            costs.write(area(sides[axis], unit) * Float(numbers[axis]), k + axis * BINS)
        return k - 1, sides, numbers, costs, boxes, counts

    def nothing() -> tuple[list[Any], list[Any]]:
        return [empty(types, width) for _ in range(3)], [dr.zeros(UInt, width) for _ in range(3)]

    state = (dr.full(UInt, BINS - 1, width), *nothing(), right_costs, *bins)
    _, _, _, right_costs, boxes, counts = dr.while_loop(state, lambda k, *_: k > 0, from_right, label="right costs")

    def from_left(
        k: Any, sides: list[Any], numbers: list[Any], best: tuple[Any, ...], costs: Any, boxes: Any, counts: Any
    ) -> tuple[Any, ...]:
        for axis in range(3):
            sides[axis], numbers[axis] = _add_bin(boxes, counts, k + axis * BINS, sides[axis], numbers[axis])
            cost = area(sides[axis], unit) * Float(numbers[axis]) + costs.read(k + 1 + axis * BINS)
            best = better_split(best, cost, numbers[axis], total, (UInt(axis), k + 1))
        return k + 1, sides, numbers, best, costs, boxes, counts

    best = no_split(types, width, dr.zeros(UInt, width))
    start = (dr.zeros(UInt, width), *nothing(), best, right_costs, boxes, counts)
    best = dr.while_loop(start, lambda k, *_: k < BINS - 1, from_left, label="cheapest plane")[3]
    return best[2], best[3], best[0]


def no_split(types: Types, width: int, plane: Any) -> tuple[Any, Any, Any, Any]:
    """Cost, unevenness, axis and plane before any has been found."""
    return dr.full(types.Float, dr.inf, width), dr.zeros(types.UInt, width), dr.full(types.UInt, BY_COUNT, width), plane


def better_split(best: tuple[Any, ...], cost: Any, left: Any, total: Any, split: tuple[Any, Any]) -> tuple[Any, ...]:
    """The better of ``best`` and a ``split`` (axis, plane) of ``cost`` with ``left`` of ``total`` primitives on its
    left."""
    uneven = dr.select(2 * left > total, 2 * left - total, total - 2 * left)
    better = (left > 0) & (left < total) & ((cost < best[0]) | ((cost == best[0]) & (uneven < best[1])))
    return tuple(dr.select(better, new, old) for new, old in zip((cost, uneven, *split), best, strict=True))


def _add_bin(boxes: Any, counts: Any, bin: Any, side: list[Any], number: Any) -> tuple[list[Any], Any]:
    return union(side, [boxes.read(bin * 6 + k) for k in range(6)]), number + counts.read(bin)
