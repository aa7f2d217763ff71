"""Moving a node's primitives to its two children."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr

from ..types import Types
from .sah_boxes import centre, empty, encode_integer, load, store, union


@dataclass(frozen=True, eq=False)
class Side:
    """What went to one side: the box around it and the box around the primitives' middles."""

    bounds: list[Any]
    middles: list[Any]


def partition(
    types: Types,
    source: Any,
    target: Any,
    begin: Any,
    end: Any,
    left_at: Any,
    right_at: Any,
    goes_right: Callable[[Any, list[Any]], Any],
) -> tuple[tuple[Side, Side], Any]:
    """Copies primitives ``begin`` to ``end`` of ``source`` into ``target``, those on the left from ``left_at`` upwards,
    the others from ``right_at`` downwards; gives both sides and where the left one ends.

    ``goes_right`` takes a primitive's index and middle. Filling from both ends, a lane writes within its own
    range whatever ``goes_right`` says.
    """
    width = dr.width(begin)

    def turn(i: Any, left_at: Any, right_at: Any, left: list[Any], right: list[Any]) -> tuple[Any, ...]:
        words = load(types, source, i)
        middle = centre(words)
        is_right = goes_right(i, middle)
        store(types, target, dr.select(is_right, right_at, left_at), words)
        point = [*middle, *(-c for c in middle)]
        left = union(left[:6], words, ~is_right) + union(left[6:], point, ~is_right)
        right = union(right[:6], words, is_right) + union(right[6:], point, is_right)
        left_at = dr.select(is_right, left_at, left_at + 1)
        right_at = dr.select(is_right, right_at - 1, right_at)
        return i + 1, left_at, right_at, left, right

    nothing = [empty(types, width) for _ in range(4)]
    state = (begin + 0, left_at, right_at, nothing[0] + nothing[1], nothing[2] + nothing[3])
    _, left_end, _, left, right = dr.while_loop(state, lambda i, *_: i < end, turn, label="partition")
    return (Side(left[:6], left[6:]), Side(right[:6], right[6:])), left_end


def store_children(
    types: Types, nodes: Any, middles: Any, place: Any, sides: tuple[Side, Side], begin: Any, middle: Any, end: Any
) -> None:
    """Writes two nodes at ``place`` and after it: packets of bounds, first primitive and count, and of middles."""
    (left, right), width = sides, dr.width(begin)

    def write(k: Any) -> tuple[Any]:
        # In a loop, because a second scatter into one buffer would be a second kernel.
        is_left = k == 0
        first, last = dr.select(is_left, begin, middle), dr.select(is_left, middle, end)
        range_ = [encode_integer(types, first), encode_integer(types, last - first)]
        store(types, nodes, place + k, [*_pick(is_left, left.bounds, right.bounds), *range_])
        store(types, middles, place + k, _pick(is_left, left.middles, right.middles))
        return (k + 1,)

    dr.while_loop((dr.zeros(types.UInt, width),), lambda k: k < 2, write, label="store children")


def _pick(is_left: Any, left: list[Any], right: list[Any]) -> list[Any]:
    return [dr.select(is_left, a, b) for a, b in zip(left, right, strict=True)]
