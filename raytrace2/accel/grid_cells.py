"""What cells hold, a word each, and the lists of primitives that the words point to.

A word with the bit :data:`FULL` holds the position of its list; one with :data:`INNER` the number of the grid that
fills the cell; any other cell is empty, and so are all cells of its grid up to that many away along every axis, which a
ray crosses in one step (Cohen and Sheffer, "Proximity clouds", The Visual Computer 11, 1994). An entry of a list is a
primitive's index, with :data:`LAST` on the last.
"""

from __future__ import annotations

import itertools

import numpy as np

FULL, INNER, LAST = 0x80000000, 0x40000000, 0x80000000
NUMBER = 0x3FFFFFFF
#: Most entries of lists, and most grids: what a word has room for.
MOST = 1 << 30
#: About so many pairs are sorted at once, and a grid's at least.
SORTED_AT_ONCE = 1 << 13


def sorted_pairs(pairs: np.ndarray, first: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The upper and the lower halves of numbers ``pairs`` (n,) uint64, by size. Pairs of a grid, whose cells are
    numbered from ``first`` (m,) on, stand before those of the next."""
    pairs = pairs.astype("<u8")
    # What fits the cache is sorted in half the time.
    grid = np.searchsorted(pairs, first.astype(np.uint64) << np.uint64(32))
    cuts = grid[np.minimum(np.searchsorted(grid, np.arange(0, len(pairs), SORTED_AT_ONCE)), len(grid) - 1)]
    cuts = np.unique(np.concatenate([[0], cuts, [len(pairs)]]))
    for begin, end in itertools.pairwise(cuts.tolist()):
        pairs[begin:end].sort()
    halves = pairs.view("<u4").reshape(-1, 2)
    return halves[:, 1], np.ascontiguousarray(halves[:, 0])


def runs(cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where each run of equal numbers begins in the sorted ``cells`` (n,), and its length."""
    begin = np.flatnonzero(np.concatenate([[True], cells[1:] != cells[:-1]])) if len(cells) else np.zeros(0, np.int64)
    return begin, np.diff(begin, append=len(cells))


def clear_distances(full: np.ndarray, shapes: np.ndarray, first: np.ndarray) -> np.ndarray:
    """For every cell how many cells away, along every axis and within its grid, all are surely empty: uint8, 0 where
    the next may be full. ``full`` (n,) bool; ``shapes`` (m, 3) cells of the grids; ``first`` (m,) their first cell."""
    result = np.zeros(len(full), np.uint8)
    kinds, which = np.unique(shapes, axis=0, return_inverse=True)
    for kind, (nx, ny, nz) in enumerate(kinds):
        if min(nx, ny, nz) < 3:
            continue
        begin = first[which.ravel() == kind]
        if len(begin) == 1:
            inside = slice(begin[0], begin[0] + nx * ny * nz)
            result[inside] = _clear(full[inside].reshape(1, nx, ny, nz)).ravel()
        else:
            index = begin[:, None] + np.arange(nx * ny * nz)
            result[index] = _clear(full[index].reshape(-1, nx, ny, nz)).reshape(index.shape)
    return result


def _clear(full: np.ndarray) -> np.ndarray:
    """The distances in grids (m, x, y, z), rounded down to 0, 1, 3, 7, ... 127; what is outside counts as full.

    Where nothing within r is full the cell is clear; a cell is clear up to 2 r + 1 if those r + 1 away on either side
    along every axis are clear up to r.
    """
    found = np.zeros(full.shape, np.uint8)
    radius = 0
    while 4 * radius + 3 <= min(full.shape[1:]) and radius < 127:
        step = radius + 1
        for axis in (1, 2, 3):
            full = _spread(full, axis, step)
        radius += step
        clear = ~full
        if not clear.any():
            break
        np.maximum(found, clear * np.uint8(radius), out=found)
    return found


def _spread(full: np.ndarray, axis: int, step: int) -> np.ndarray:
    """``full`` or so ``step`` cells before or after along ``axis``."""

    def part(cut: slice) -> tuple[slice, ...]:
        return tuple(cut if k == axis else slice(None) for k in range(4))

    spread = full.copy()
    spread[part(slice(None, -step))] |= full[part(slice(step, None))]
    spread[part(slice(step, None))] |= full[part(slice(None, -step))]
    spread[part(slice(None, step))] = True
    spread[part(slice(-step, None))] = True
    return spread
