"""The walk of rays from so far away that rounding moves them by more than cells are widened: all cells of a beam.

The beam is cut in slices, one for every layer of cells across the ray's largest component, nearest first; of each
slice the cells of a rectangle are visited. State is the cell alone, its second index -1 before the first of a slice; so
there are no more turns than cells and layers.
"""

from __future__ import annotations

from typing import Any

import drjit as dr

from ..surfaces.ordered import greater, lesser
from .grid_frame import Frame, WalkRay


def first_slice(ray: WalkRay, frame: Frame) -> list[Any]:
    """The place before the first slice."""
    x, y = _largest(ray)
    ends = [dr.select(ray.negative[k], frame.cells[k] - 1, 0) for k in range(3)]
    end = _pick(x, y, ends)
    return _placed(x, y, end, type(end)(-1), type(end)(0))


def next_cell(ray: WalkRay, frame: Frame, radius: Any, place: list[Any], limit: Any) -> tuple[list[Any], Any, Any]:
    """The place after ``place``, whether it is a cell (or still before one), and whether the beam has left the grid or
    come past ``limit`` (an s). ``radius`` is the beam's."""
    x, y = _largest(ray)
    negative = _pick(x, y, ray.negative)
    layer, row, cell = _pick(x, y, place), dr.select(x, place[1], place[0]), dr.select(x | y, place[2], place[1])
    slope, base, layers = (_pick(x, y, v) for v in (frame.slope, frame.base, frame.cells))
    wide = _pick(x, y, frame.per_step) * radius
    one = dr.fma(layer - wide, slope, base)
    other = dr.fma(layer + 1 + wide, slope, base)
    begin, end = lesser(one, other), greater(one, other)
    row_0, row_1, empty = _range(radius, begin, end, *(dr.select(x, b, a) for a, b in _axes(frame, 0, 1)))
    cell_0, cell_1, nothing = _range(radius, begin, end, *(dr.select(x | y, b, a) for a, b in _axes(frame, 1, 2)))
    fresh = row < 0
    row, cell = dr.select(fresh, row_0, row), dr.select(fresh, cell_0, cell + 1)
    wraps = cell > cell_1
    row, cell = dr.select(wraps, row + 1, row), dr.select(wraps, cell_0, cell)
    over = empty | nothing | (row > row_1) | (end < ray.start)
    layer = dr.select(over, dr.select(negative, layer - 1, layer + 1), layer)
    row = dr.select(over, -1, row)
    left = (begin > limit) | (layer < 0) | (layer >= layers)
    return _placed(x, y, layer, row, cell), ~over & ~left, left


def _largest(ray: WalkRay) -> tuple[Any, Any]:
    """Whether the direction's largest component is x, and whether it is y."""
    size = abs(ray.d)
    x = (size.x >= size.y) & (size.x >= size.z)
    return x, ~x & (size.y >= size.z)


def _pick(x: Any, y: Any, values: Any) -> Any:
    return dr.select(x, values[0], dr.select(y, values[1], values[2]))


def _placed(x: Any, y: Any, layer: Any, row: Any, cell: Any) -> list[Any]:
    return [
        dr.select(x, layer, row),
        dr.select(x, row, dr.select(y, layer, cell)),
        dr.select(x | y, cell, layer),
    ]


def _axes(frame: Frame, a: int, b: int) -> list[tuple[Any, Any]]:
    """Speed, origin, cells and cells per unit on two axes."""
    return [(v[a], v[b]) for v in (frame.speed, frame.origin, frame.cells, frame.per_step)]


def _range(
    radius: Any, begin: Any, end: Any, speed: Any, origin: Any, cells: Any, per_step: Any
) -> tuple[Any, Any, Any]:
    """The first and last cell along an axis that the beam covers from ``begin`` to ``end``; whether there is none."""
    one, other = dr.fma(begin, speed, origin), dr.fma(end, speed, origin)
    wide = radius * per_step
    low, high = dr.floor(lesser(one, other) - wide), dr.floor(greater(one, other) + wide)
    none = (high < 0) | (low >= cells)
    # In this order NaN, which only rays from infinity bring, stands for everything.
    return lesser(greater(low, 0 * cells), cells - 1), greater(lesser(high, cells - 1), 0 * cells), none
