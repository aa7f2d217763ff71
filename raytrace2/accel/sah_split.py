"""Splitting many small nodes, a lane each."""

from __future__ import annotations

from typing import Any

from .sah_bins import cheapest_plane, fill_bins
from .sah_level import Level, right_of_plane
from .sah_partition import partition, store_children
from .sah_sweep import sweep


def split_small(level: Level, node: Any, place: Any, *, exact: bool) -> None:
    """Splits nodes ``node``; their children become nodes ``place`` and ``place + 1`` of the next level.

    ``exact`` tries every plane instead of those between bins, in time quadratic in a node's size.
    """
    types = level.types
    group = level.group(node)
    count = group.end - group.begin
    if exact:
        axis, plane = sweep(types, level.primitives, group)
        least, scale = [types.Float(0)] * 3, [types.Float(1)] * 3
    else:
        axis, bin, _ = cheapest_plane(types, fill_bins(types, level.primitives, group), count, group.unit)
        plane, least, scale = types.Float(bin), group.least, group.scale
    is_right = right_of_plane(types, level.chosen(axis), plane, least, scale, group.begin + (count >> 1))
    sides, left_end = partition(
        types, level.primitives, level.next_primitives, group.begin, group.end, group.begin, group.end - 1, is_right
    )
    store_children(types, level.next_nodes, level.next_middles, place, sides, group.begin, left_end, group.end)
