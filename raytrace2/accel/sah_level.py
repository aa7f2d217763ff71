"""What one level of a build reads and writes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from ..surfaces.record import decode_integer
from ..types import Types
from .sah_bins import BINS, BY_COUNT
from .sah_boxes import COUNT, FIRST, Group, group_of, load


@dataclass(frozen=True, eq=False)
class Level:
    """Buffers of packets: the primitives as the level finds them, its nodes and the boxes around their primitives'
    middles; and where those of the next level go. With ``by_count`` nodes are halved by number, whatever their
    shape."""

    types: Types
    primitives: Any
    nodes: Any
    middles: Any
    next_primitives: Any
    next_nodes: Any
    next_middles: Any
    by_count: bool

    def group(self, node: Any) -> Group:
        """All primitives of ``node``."""
        bounds = load(self.types, self.nodes, node)
        begin = decode_integer(bounds[FIRST], self.types)
        end = begin + decode_integer(bounds[COUNT], self.types)
        return group_of(self.types, bounds, load(self.types, self.middles, node), begin, end, BINS)

    def chosen(self, axis: Any) -> Any:
        """``axis``, or BY_COUNT if the level is halved."""
        return dr.select(dr.opaque(self.types.Bool, self.by_count), BY_COUNT, axis)


def right_of_plane(types: Types, axis: Any, plane: Any, least: list[Any], scale: list[Any], half: Any) -> Any:
    """A test of (index, middle) for being right of ``plane`` on ``axis``, in the bins that ``least`` and ``scale``
    make; or from index ``half`` on where the axis is BY_COUNT."""

    def pick(values: list[Any]) -> Any:
        return dr.select(axis == 0, values[0], dr.select(axis == 1, values[1], values[2]))

    offset, factor = pick(least), pick(scale)

    def is_right(i: Any, middle: list[Any]) -> Any:
        return dr.select(axis == BY_COUNT, i >= half, (pick(middle) - offset) * factor >= plane)

    return is_right
