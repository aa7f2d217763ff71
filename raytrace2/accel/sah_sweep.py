"""The cheapest of all planes between the middles of a few boxes: exact, and for few boxes faster than bins."""

from __future__ import annotations

from typing import Any

import drjit as dr

from ..types import Types
from .sah_bins import better_split, no_split
from .sah_boxes import Group, area, centre, empty, load, union


def sweep(types: Types, primitives: Any, group: Group) -> tuple[Any, Any]:
    """The axis and the least middle on the right of the cheapest split of each group, in time quadratic in its size."""
    UInt, Float, width = types.UInt, types.Float, dr.width(group.begin)
    total = group.end - group.begin

    def try_plane(i: Any, best: tuple[Any, ...]) -> tuple[Any, ...]:
        planes = centre(load(types, primitives, i))

        def sort(j: Any, left: list[Any], right: list[Any], numbers: list[Any]) -> tuple[Any, ...]:
            box = load(types, primitives, j)
            for axis, middle in enumerate(centre(box)):
                is_left = middle < planes[axis]
                left[axis] = union(left[axis], box, is_left)
                right[axis] = union(right[axis], box, ~is_left)
                numbers[axis] = dr.select(is_left, numbers[axis] + 1, numbers[axis])
            return j + 1, left, right, numbers

        nothing = [empty(types, width) for _ in range(6)]
        start = (group.begin + 0, nothing[:3], nothing[3:], [dr.zeros(UInt, width) for _ in range(3)])
        _, left, right, numbers = dr.while_loop(start, lambda j, *_: j < group.end, sort, label="sides")
        for axis in range(3):
            number = numbers[axis]
            cost = area(left[axis], group.unit) * Float(number) + area(right[axis], group.unit) * Float(total - number)
            best = better_split(best, cost, number, total, (UInt(axis), planes[axis]))
        return i + 1, best

    state = (group.begin, no_split(types, width, dr.zeros(Float, width)))
    best = dr.while_loop(state, lambda i, *_: i < group.end, try_plane, label="sweep")[1]
    return best[2], best[3]
