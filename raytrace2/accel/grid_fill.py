"""One level of grids, filled: which cells there are and what each holds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..buffers import owned
from .grid_cells import FULL, LAST, MOST, clear_distances, runs, sorted_pairs
from .grid_lattice import Extents, Lattices, choose_cells
from .grid_overlap import Subjects, overlaps

#: Cells are made larger where a grid would hold more than so many references a primitive (or more than the least).
DUPLICATION, LEAST_REFERENCES = 8, 64


@dataclass(frozen=True, eq=False)
class Level:
    """Grids and their cells' ``words`` (c,), whose lists are runs of ``prims`` (n,) and ``entries`` (n,), the same with the
    last of each list marked. Run r begins at ``begin[r]``, has ``count[r]`` and belongs to cell ``cell[r]``. ``tilt``
    is for rays from afar."""

    lattices: Lattices
    words: np.ndarray
    prims: np.ndarray
    entries: np.ndarray
    begin: np.ndarray
    count: np.ndarray
    cell: np.ndarray
    tilt: float


def fill(
    subjects: Subjects,
    prim: np.ndarray,
    grid: np.ndarray,
    make: Callable[[np.ndarray], Lattices],
    size: np.ndarray,
    extents: Extents,
    target: np.ndarray,
    least_step: float,
) -> Level:
    """Grids of ``size`` (m, 3), with about ``target`` (m,) cells each, over the primitives ``prim`` (n,) that go into
    grids ``grid`` (n,); ``make`` turns cells (m, 3) into lattices."""
    UInt = subjects.types.UInt
    most = np.maximum(DUPLICATION * extents.count, LEAST_REFERENCES)
    prims, grids = owned(prim, UInt), owned(grid, UInt)
    while True:
        lattices = make(choose_cells(size, extents, target, most, least_step))
        # What was expected holds on average over where things lie; should it not, cells are made larger.
        limit = MOST if target.max() <= 1 else min(MOST, int(2 * most.sum()))
        found = overlaps(subjects, lattices.upload(subjects.types), prims, grids, limit)
        if found is not None:
            break
        if target.max() <= 1:
            raise ValueError(f"grids hold at most {MOST} references: build several structures instead")
        target = np.maximum(target // 2, 1)
    cells, lanes, tilt = found
    start = int(lattices.first[0])
    cell_of, of = sorted_pairs(cells.numpy(), prim[lanes.numpy()])
    begin, count = runs(cell_of)
    entries = of.copy()
    entries[begin + count - 1] |= np.uint32(LAST)
    cell = cell_of[begin].astype(np.int64)
    full = np.zeros(lattices.end - start, bool)
    full[cell - start] = True
    words = clear_distances(full, lattices.cells, lattices.first - start).astype(np.uint32)
    words[cell - start] = np.uint32(FULL) | begin.astype(np.uint32)
    return Level(lattices, words, of, entries, begin, count, cell, tilt)
