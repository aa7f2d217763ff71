"""What cells hold, a word each, and the lists of primitives that the words point to.

A word with the bit :data:`FULL` holds the position of its list; one with :data:`INNER` the number of the grid that fills
the cell; any other cell is empty, and so are all cells of its grid up to that many away along every axis, which a ray
crosses in one step (proximity clouds: Cohen and Sheffer, "Proximity clouds", The Visual Computer 11, 1994). An
entry of a list is a primitive's index, with :data:`LAST` on the last.
"""

from __future__ import annotations

import numpy as np

FULL, INNER, LAST = 0x80000000, 0x40000000, 0x80000000
NUMBER = 0x3FFFFFFF
#: Most entries of lists, and most grids: what a word has room for.
MOST = 1 << 30


def sorted_pairs(cells: np.ndarray, prims: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pairs (n,), (n,) of 32-bit numbers, by cell and then by primitive."""
    keys = np.sort(cells.astype(np.uint64) << np.uint64(32) | prims.astype(np.uint64))
    return (keys >> np.uint64(32)).astype(np.uint32), keys.astype(np.uint32)


def runs(cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where each run of equal numbers begins in the sorted ``cells`` (n,), and its length."""
    begin = np.flatnonzero(np.concatenate([[True], cells[1:] != cells[:-1]])) if len(cells) else np.zeros(0, np.int64)
    return begin, np.diff(begin, append=len(cells))


def clear_distances(full: np.ndarray, shapes: np.ndarray, first: np.ndarray) -> np.ndarray:
    """For every cell how many cells away, along every axis and within its grid, all are empty: uint8, 0 where the next
    may be full. ``full`` (n,) bool; ``shapes`` (m, 3) cells of the grids; ``first`` (m,) the number of their first."""
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
    """The distances in grids (m, x, y, z); what is outside counts as full. Each round moves the full cells' frontier on
    by one along every axis."""
    blocked = np.ones(tuple(n + 2 * (k > 0) for k, n in enumerate(full.shape)), bool)
    inside = (slice(None), *[slice(1, -1)] * 3)
    blocked[inside] = full
    found = np.zeros(full.shape, np.uint8)
    for _ in range(255):
        for axis in (1, 2, 3):
            low = tuple(slice(None, -1) if k == axis else slice(None) for k in range(4))
            high = tuple(slice(1, None) if k == axis else slice(None) for k in range(4))
            spread = blocked.copy()
            spread[low] |= blocked[high]
            spread[high] |= blocked[low]
            blocked = spread
        clear = ~blocked[inside]
        if not clear.any():
            break
        found += clear
    return found
