"""Handles: 32-bit numbers that name one texture (or one material) of a table by kind and place within the kind.

The kind sits in the top bits, so that a kernel tells kinds apart without a look-up.
"""

from __future__ import annotations

from typing import Any

KIND_SHIFT = 26
PLACE_MASK = (1 << KIND_SHIFT) - 1


def make(kind: int, place: int) -> int:
    """The handle of the ``place``-th thing of ``kind``; ``ValueError`` when there are more than 2^26 of a kind."""
    if place > PLACE_MASK:
        raise ValueError(f"a table holds at most {PLACE_MASK + 1} things of one kind")
    return kind << KIND_SHIFT | place


def kind_of(handle: Any) -> Any:
    """The kind in a handle (Python int or UInt)."""
    return handle >> KIND_SHIFT


def place_of(handle: Any) -> Any:
    """The place in a handle (Python int or UInt)."""
    return handle & PLACE_MASK
