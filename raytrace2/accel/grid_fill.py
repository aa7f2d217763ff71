"""One level of grids, filled: which cells there are and what each holds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .grid_cells import LAST, MOST, clear_distances, runs, sorted_pairs
from .grid_lattice import Extents, Lattices, choose_cells
from .grid_overlap import Subjects, overlaps

#: Cells are made larger where a grid would hold more than so many references a primitive (or more than the least).
DUPLICATION, LEAST_REFERENCES = 8, 64


@dataclass(frozen=True, eq=False)
class Level:
    """Grids and what is in their cells. Run r of ``prims`` (n,) begins at ``begin[r]``, has ``count[r]`` of them and is
    the list of cell ``cell[r]``. ``clear`` (c,) uint8 tells how far around each cell all is empty. ``tilt`` is for rays
    from afar."""

    lattices: Lattices
    prims: np.ndarray
    begin: np.ndarray
    count: np.ndarray
    cell: np.ndarray
    clear: np.ndarray
    tilt: float

    @property
    def start(self) -> int:
        """The number of the first cell."""
        return int(self.lattices.first[0])

    def list_of(self, run: np.ndarray) -> np.ndarray:
        """The primitives of runs ``run``, one after the other."""
        count = self.count[run]
        rank = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
        return self.prims[np.repeat(self.begin[run], count) + rank]

    def without(self, run: np.ndarray) -> Level:
        """The level without the lists ``run`` (bool)."""
        kept = np.flatnonzero(~run)
        count = self.count[kept]
        return replace(
            self, prims=self.list_of(kept), begin=np.cumsum(count) - count, count=count, cell=self.cell[kept]
        )

    def entries(self) -> np.ndarray:
        """The lists as rays read them: the last of each is marked."""
        entries = self.prims.copy()
        entries[self.begin + self.count - 1] |= np.uint32(LAST)
        return entries


def most_references(extents: Extents, share: float = 1.0) -> np.ndarray:
    """What each grid may hold (m,), where what goes into it is ``share`` of a primitive."""
    return np.maximum(DUPLICATION * share * extents.count, LEAST_REFERENCES)


def fill(
    subjects: Subjects,
    prim: Any,
    grid: Any,
    make: Callable[[np.ndarray], Lattices],
    size: np.ndarray,
    extents: Extents,
    most: np.ndarray,
    target: np.ndarray,
    least_step: float,
) -> Level:
    """Grids of ``size`` (m, 3), with about ``target`` (m,) cells and ``most`` (m,) references each, over the primitives
    ``prim`` (n,) that go into grids ``grid`` (n,), both UInt and in the grids' order; ``make`` turns cells (m, 3) into
    lattices."""
    while True:
        lattices = make(choose_cells(size, extents, target, most, least_step))
        # What was expected holds on average over where things lie; should it not, cells are made larger.
        limit = MOST if target.max() <= 1 else min(MOST, int(2 * most.sum()))
        found = overlaps(subjects, lattices.upload(subjects.types), prim, grid, limit)
        if found is not None:
            break
        if target.max() <= 1:
            raise ValueError(f"grids hold at most {MOST} references: build several structures instead")
        target = np.maximum(target // 2, 1)
    pairs, tilt = found
    start = int(lattices.first[0])
    cell_of, of = sorted_pairs(pairs, lattices.first)
    begin, count = runs(cell_of)
    cell = cell_of[begin].astype(np.int64)
    full = np.zeros(lattices.end - start, bool)
    full[cell - start] = True
    clear = clear_distances(full, lattices.cells, lattices.first - start)
    return Level(lattices, of, begin, count, cell, clear, tilt)
