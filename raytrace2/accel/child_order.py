"""In which order a ray visits the children that it meets: the nearest at once, the others as a *group* to come back to.

A group packs a node's index above eight bits. With four children in order of distance those bits are a list, two bits a
child and from bit 6 on how many; else a bit a child. Eight children stand in their node by octants of it
(:mod:`.octant_slots`), and a ray asks them by octants too: the bits are moved so that the lowest is asked first.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from ..types import Types
from .wide_node import NEXT


@dataclass(frozen=True)
class ChildOrder:
    """For nodes of ``width`` children; by distance if ``ordered``, else as they come."""

    types: Types
    width: int
    ordered: bool

    @property
    def _is_list(self) -> bool:
        return self.ordered and self.width == 4

    @property
    def by_octant(self) -> bool:
        """Whether :meth:`split` and :meth:`next` need the octant that the ray points to."""
        return self.ordered and self.width == 8

    def split(self, met: list[tuple[Any, Any]], refs: list[Any], octant: Any) -> tuple[Any, Any]:
        """The child to go on to (NEXT if none), and the group bits of the others. The order need not be exact: it only
        decides who is asked first."""
        UInt = self.types.UInt
        if self._is_list:
            first, code = self._by_distance(met)
            return dr.select(first < self.width, _pick4(refs, first), NEXT), code
        mask = UInt(0)
        for child, (_, hit) in enumerate(met):
            mask |= dr.select(hit, UInt(1 << child), UInt(0))
        if not self.ordered:
            first, code = dr.select(mask != 0, dr.tzcnt(mask), self.width), mask & (mask - 1)
            return dr.select(first < self.width, _pick(refs, first), NEXT), code
        if self.width == 2:
            both = mask == 3
            second_first = (mask == 2) | (both & (met[1][0] < met[0][0]))
            code = dr.select(both, dr.select(second_first, UInt(1), UInt(2)), 0)
            return dr.select(mask != 0, dr.select(second_first, refs[1], refs[0]), NEXT), code
        keys, none = self._keys(met)
        while len(keys) > 1:
            keys = [dr.select(a < b, a, b) for a, b in zip(keys[::2], keys[1::2], strict=True)]
        first = UInt(keys[0] & type(keys[0])(self.width - 1))
        rest = mask & ~(UInt(1) << first)
        # Moves bit s to bit s xor octant: every bit of the octant swaps halves of some size.
        for bit, low in ((1, 0x55), (2, 0x33), (4, 0x0F)):
            swapped = ((rest & low) << bit) | ((rest >> bit) & low)
            rest = dr.select((octant & bit) != 0, swapped, rest)
        return dr.select(keys[0] != none, _pick(refs, first), NEXT), rest

    def next(self, group: Any, octant: Any) -> tuple[Any, Any]:
        """The slot of the group's next child, and the group without it (zero after the last)."""
        if self._is_list:
            count = (group >> 6) & 3
            rest = dr.select(count > 1, (group & 0xFFFFFF00) | ((group >> 2) & 0xF) | ((count - 1) << 6), 0)
            return group & 3, rest
        bits = (1 << self.width) - 1
        slot = dr.tzcnt(group & bits)
        rest = group & (group - 1)
        rest = dr.select((rest & bits) != 0, rest, 0)
        return (slot ^ octant if self.by_octant else slot), rest

    def _keys(self, met: list[tuple[Any, Any]]) -> tuple[list[Any], Any]:
        """Numbers that sort like the distances and carry the child in their lowest bits, and the one of a child not
        met."""
        double = self.types.precision == "float64"
        Word = self.types.UInt64 if double else self.types.UInt
        none = Word(0xFFFFFFFFFFFFFFFF if double else 0xFFFFFFFF)
        low_bits = Word(self.width - 1)
        # Distances are not negative (or nearly so), and such floats compare like their bits.
        keys = [
            dr.select(hit, (dr.reinterpret_array(Word, enter) & ~low_bits) | Word(child), none)
            for child, (enter, hit) in enumerate(met)
        ]
        return keys, none

    def _by_distance(self, met: list[tuple[Any, Any]]) -> tuple[Any, Any]:
        """The nearest of four children met (4 if none), and the others as a list in distance order."""
        keys, none = self._keys(met)
        for i, j in ((0, 1), (2, 3), (0, 2), (1, 3), (1, 2)):
            keys[i], keys[j] = (
                dr.select(keys[i] < keys[j], keys[i], keys[j]),
                dr.select(keys[i] < keys[j], keys[j], keys[i]),
            )
        UInt = self.types.UInt
        low_two = type(none)(3)
        slots = [UInt(key & low_two) for key in keys]
        count = dr.select(keys[3] != none, UInt(3 << 6), dr.select(keys[2] != none, UInt(2 << 6), UInt(1 << 6)))
        code = dr.select(keys[1] != none, slots[1] | (slots[2] << 2) | (slots[3] << 4) | count, 0)
        return dr.select(keys[0] != none, slots[0], 4), code


def _pick(refs: list[Any], index: Any) -> Any:
    """``refs[index]`` of a power of two of them; any where the index is past them."""
    if len(refs) == 4:
        return _pick4(refs, index)
    bit = 1
    while len(refs) > 1:
        refs = [dr.select((index & bit) != 0, b, a) for a, b in zip(refs[::2], refs[1::2], strict=True)]
        bit *= 2
    return refs[0]


def _pick4(refs: list[Any], index: Any) -> Any:
    return dr.select(index < 2, dr.select(index == 0, refs[0], refs[1]), dr.select(index == 2, refs[2], refs[3]))
