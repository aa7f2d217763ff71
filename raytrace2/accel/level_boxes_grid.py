"""The cells of grids that hold something, and those of the grids in them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..surfaces.levels import Level
from .grid_cells import FULL, INNER, NUMBER
from .grid_lattice import CELLS, CORNER, FIRST, STEP, WORDS
from .grid_walk import DeviceGrids


def grid_levels(bounds: tuple[np.ndarray, np.ndarray], grids: DeviceGrids) -> Iterator[Level]:
    """The box around everything and the outermost grid; its cells that hold anything; those of the grids that fill
    them, as far as they lie within them; and so on.

    Walls lie where rays cross them: whole numbers of steps from a grid's corner. Primitives that are in no cell make a
    leaf of the first box.
    """
    table = grids.lattices.numpy().reshape(-1, WORDS)
    first = np.ascontiguousarray(table[:, FIRST])
    first = (first.view(np.uint32) if first.dtype == np.float32 else first).astype(np.int64)
    corner, step, shape = (table[:, w : w + 3].astype(np.float64) for w in (CORNER, STEP, CELLS))
    origin, scale = grids.origin.numpy().ravel().astype(np.float64), float(grids.scale.numpy()[0])

    def wall(grid: np.ndarray, at: np.ndarray) -> np.ndarray:
        return np.asarray(origin + (corner[grid] + at * step[grid]) / scale)

    content = grids.words.numpy()
    cell = np.flatnonzero(content >= INNER)
    owner = np.searchsorted(first, cell, side="right") - 1
    root = np.zeros(1, np.int64)
    lo = np.minimum(np.asarray(bounds[0], np.float64), wall(root, np.zeros(3)))
    hi = np.maximum(np.asarray(bounds[1], np.float64), wall(root, shape[root]))
    yield Level(lo, hi, np.full(1, -1), np.full(1, grids.large is not None))

    # The grids of the level, and the box before that each fills.
    begin, end, filled = 0, 1, np.zeros(1, np.int64)
    while end > begin:
        some = slice(np.searchsorted(owner, begin), np.searchsorted(owner, end))
        number, grid = cell[some], owner[some]
        rest, ny, nz = number - first[grid], shape[grid, 1].astype(np.int64), shape[grid, 2].astype(np.int64)
        at = np.stack([rest // (ny * nz), rest // nz % ny, rest % nz], axis=1)
        parent = filled[grid - begin]
        low, high = (np.clip(wall(grid, at + k), lo[parent], hi[parent]) for k in (0, 1))
        leaf = content[number] >= FULL
        yield Level(low, high, parent, leaf)
        inside = np.flatnonzero(~leaf)
        inner = (content[number[inside]] & NUMBER).astype(np.int64)
        begin, end = end, end + len(inner)
        filled = np.empty(len(inner), np.int64)
        filled[inner - begin] = inside
        lo, hi = low, high
