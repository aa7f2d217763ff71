"""The boxes of structures, level by level, on the host: what pictures draw, and where tests aim their rays."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np

from . import record

if TYPE_CHECKING:
    from .geometry import Geometry


@dataclass(frozen=True, eq=False)
class Level:
    """Boxes ``lo``, ``hi`` (n, 3) float64 of one level; ``parent`` (n,), the box of the level before that each is part
    of, or -1 for one that begins a structure; ``leaf`` (n,), whether primitives are listed in it, or none at all."""

    lo: np.ndarray
    hi: np.ndarray
    parent: np.ndarray
    leaf: np.ndarray

    def __len__(self) -> int:
        return len(self.lo)


def root_level(bounds: tuple[np.ndarray, np.ndarray], leaf: bool) -> Level:
    """The level of the box around everything."""
    lo, hi = (np.array(corner, np.float64)[None] for corner in bounds)
    return Level(lo, hi, np.full(1, -1), np.full(1, leaf))


def is_box(bounds: tuple[np.ndarray, np.ndarray]) -> bool:
    """Whether there is a box at all: that around nothing is none."""
    lo, hi = bounds
    return bool(np.isfinite(lo).all() and np.isfinite(hi).all() and (lo <= hi).all())


def levels_inside(geometry: Geometry) -> Iterator[Level]:
    """The levels of the structures that ``geometry`` leads into, the roots of all of them on the first.

    What instances place is in boxes around their transformed boxes.
    """
    parts = geometry.primitives()
    if parts is None or not parts.nested:
        return
    words = parts.records[:, [record.KIND, record.INSTANCE_NUMBER]]
    code, number = (words.view(np.uint32) if words.dtype == np.float32 else words.astype(np.uint32)).astype(np.int64).T
    kind = code & 7
    entrances = np.flatnonzero((kind == record.INSTANCE) | (kind == record.NESTED))
    ways: list[tuple[Iterator[Level], np.ndarray]] = []
    for place, structure in enumerate(parts.nested):
        some = entrances[code[entrances] >> 3 == place]
        placed = [geometry.instances[number[k]].to_world if kind[k] == record.INSTANCE else np.eye(4) for k in some]
        if hasattr(structure, "levels"):
            ways.append((structure.levels(), np.array(placed)))
    before = np.zeros(len(ways), np.int64)
    while True:
        found, begin = [], 0
        for k, (levels, maps) in enumerate(ways):
            level = next(levels, None)
            if level is not None:
                found.append(_placed(level, maps, begin, int(before[k])))
            begin += len(maps) * int(before[k])
            before[k] = 0 if level is None else len(level)
        if not found:
            return
        yield Level(*(np.concatenate([getattr(level, f.name) for level in found]) for f in fields(Level)))


def _placed(level: Level, maps: np.ndarray, begin: int, before: int) -> Level:
    """A level once under each of ``maps`` (m, 4, 4), whose parents are ``before`` each, from ``begin`` on.

    Sums of products grow with their terms, rounding included: a box within another stays within it.
    """
    m, n = len(maps), len(level)
    lo, hi = (np.repeat(maps[:, None, :3, 3], n, axis=1) for _ in range(2))
    for k in range(3):
        slope = maps[:, None, :3, k]
        a, b = slope * level.lo[None, :, k, None], slope * level.hi[None, :, k, None]
        lo, hi = lo + np.minimum(a, b), hi + np.maximum(a, b)
    first = begin + before * np.arange(m)[:, None]
    parent = np.where(level.parent < 0, -1, first + level.parent)
    return Level(lo.reshape(-1, 3), hi.reshape(-1, 3), parent.ravel(), np.tile(level.leaf, m))
