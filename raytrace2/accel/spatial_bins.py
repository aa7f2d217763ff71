"""The cheapest plane that cuts through references, between bins of equal width of a node's box (Stich et al. 2009)."""

from __future__ import annotations

from typing import Any

import drjit as dr

from ..surfaces.record import decode_integer, load_words
from ..types import Types
from .sah_bins import ALL_BINS, BINS, better_split, no_split
from .sah_boxes import FIRST, area, empty, load, union

#: The boxes of each lane's bins, and how many references begin and end in each.
CutBins = tuple[Any, Any, Any]


def no_cut_bins(types: Types) -> CutBins:
    """Memory of each lane for bins on three axes, empty."""
    return (
        dr.alloc_local(types.Float, 6 * ALL_BINS, value=types.Float(dr.inf)),
        dr.alloc_local(types.UInt, ALL_BINS, value=types.UInt(0)),
        dr.alloc_local(types.UInt, ALL_BINS, value=types.UInt(0)),
    )


def fill_cut_bins(types: Types, references: Any, corners: Any, bounds: list[Any], begin: Any, end: Any) -> CutBins:
    """Each lane's bins, over its node's ``bounds``, with the references from ``begin`` to ``end`` (excluded).

    ``references`` are packets of boxes with the number of a primitive; ``corners`` rows of sixteen words: the
    vertices, and a tenth word that is not zero for what may be cut. The parts of a reference in the bins that it spans
    are found by clipping.
    """
    UInt, Float = types.UInt, types.Float
    size = [-bounds[k + 3] - bounds[k] for k in range(3)]
    scale = [dr.select(s > 0, dr.fmin(BINS / s, types.largest), 0) for s in size]

    def add(i: Any, boxes: Any, entries: Any, exits: Any) -> tuple[Any, ...]:
        box = load(types, references, i)
        words = load_words(corners, decode_integer(box[FIRST], types), types)
        vertices = [words[3 * k : 3 * k + 3] for k in range(3)]
        cuttable = words[9] != 0
        for axis in range(3):
            ends = [box[axis], dr.select(cuttable, -box[axis + 3], box[axis])]
            first, last = (
                UInt(dr.fmax(dr.fmin((x - bounds[axis]) * scale[axis], BINS - 1), 0)) + axis * BINS for x in ends
            )
            entries.write(entries.read(first) + 1, first)
            exits.write(exits.read(last) + 1, last)

            def part(b: Any, boxes: Any, axis: int = axis, first: Any = first, last: Any = last) -> tuple[Any, ...]:
                step = size[axis] / BINS
                least = bounds[axis] + step * Float(b - axis * BINS)
                piece = _clipped(vertices, box, axis, least, least + step)
                piece = [dr.select(first == last, whole, cut) for whole, cut in zip(box[:6], piece, strict=True)]
                for k in range(6):
                    boxes.write(dr.fmin(boxes.read(b * 6 + k), piece[k]), b * 6 + k)
                return b + 1, boxes

            _, boxes = dr.while_loop((first, boxes), lambda b, _, last=last: b <= last, part, label="parts")
        return i + 1, boxes, entries, exits

    state = (begin + 0, *no_cut_bins(types))
    _, boxes, entries, exits = dr.while_loop(state, lambda i, *_: i < end, add, label="spatial bins")
    return boxes, entries, exits


def cheapest_cut(types: Types, bins: CutBins, unit: Any, width: int) -> tuple[Any, ...]:
    """Cost, in units of ``1 / unit**2``, axis and plane (the first bin right of it) of each of ``width`` nodes'
    cheapest cut; infinite cost where there is none."""
    UInt, Float = types.UInt, types.Float
    costs, numbers = dr.alloc_local(Float, BINS, value=Float(0)), dr.alloc_local(UInt, BINS, value=UInt(0))
    best = no_split(types, width, dr.zeros(UInt, width))
    boxes, entries, exits = bins
    for axis in range(3):

        def from_right(
            k: Any, side: list[Any], n: Any, costs: Any, numbers: Any, boxes: Any, exits: Any, axis: int = axis
        ) -> tuple[Any, ...]:
            b = k + axis * BINS
            side, n = union(side, [boxes.read(b * 6 + j) for j in range(6)]), n + exits.read(b)
            costs.write(area(side, unit) * Float(n), k)
            numbers.write(n, k)
            return k - 1, side, n, costs, numbers, boxes, exits

        def from_left(
            k: Any,
            side: list[Any],
            n: Any,
            best: Any,
            costs: Any,
            numbers: Any,
            boxes: Any,
            entries: Any,
            axis: int = axis,
        ) -> tuple[Any, ...]:
            b = k + axis * BINS
            side, n = union(side, [boxes.read(b * 6 + j) for j in range(6)]), n + entries.read(b)
            cost = area(side, unit) * Float(n) + costs.read(k + 1)
            right = numbers.read(k + 1)
            best = better_split(best, cost, n, n + right, (UInt(axis), k + 1))
            return k + 1, side, n, best, costs, numbers, boxes, entries

        start = (dr.full(UInt, BINS - 1, width), empty(types, width), dr.zeros(UInt, width))
        _, _, _, costs, numbers, boxes, exits = dr.while_loop(
            (*start, costs, numbers, boxes, exits), lambda k, *_: k > 0, from_right, label="cut from right"
        )
        start = (dr.zeros(UInt, width), empty(types, width), dr.zeros(UInt, width))
        _, _, _, best, costs, numbers, boxes, entries = dr.while_loop(
            (*start, best, costs, numbers, boxes, entries), lambda k, *_: k < BINS - 1, from_left, label="cut from left"
        )
    return best[0], best[2], best[3]


def _clipped(vertices: list[list[Any]], box: list[Any], axis: int, begin: Any, end: Any) -> list[Any]:
    """The box (negated upper corner) around the part of a triangle between two planes, within ``box``; not widened."""
    least = [dr.full(type(begin), dr.inf, dr.width(begin)) for _ in range(6)]

    def include(point: list[Any], which: Any) -> None:
        for k in range(3):
            least[k] = dr.select(which, dr.fmin(least[k], point[k]), least[k])
            least[k + 3] = dr.select(which, dr.fmin(least[k + 3], -point[k]), least[k + 3])

    for p, q in zip(vertices, vertices[1:] + vertices[:1], strict=True):
        include(p, (p[axis] >= begin) & (p[axis] <= end))
        for plane in (begin, end):
            share = (plane - p[axis]) / (q[axis] - p[axis])
            cut = [dr.fma(share, q[k] - p[k], p[k]) for k in range(3)]
            include(cut, (p[axis] < plane) != (q[axis] < plane))
    return [dr.fmax(a, b) for a, b in zip(least, box[:6], strict=True)]
