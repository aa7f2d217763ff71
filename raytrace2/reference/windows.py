"""Overlapping square windows over an image and their means, by a summed-area table."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Windows:
    """Rows ``y0`` to ``y1`` and columns ``x0`` to ``x1`` (exclusive) of n windows: four (n,) int arrays."""

    y0: np.ndarray
    x0: np.ndarray
    y1: np.ndarray
    x1: np.ndarray


def windows(shape: tuple[int, ...], sizes: tuple[int, ...]) -> Windows:
    """Windows of every size that fits, half overlapping and flush with the borders of an image of ``shape`` (H, W).

    Where no size fits, the windows span the image's shorter side.
    """
    height, width = shape[0], shape[1]
    corners: set[tuple[int, int, int, int]] = set()
    for size in sizes:
        rows, columns = min(size, height), min(size, width)
        for y in _starts(height, rows):
            for x in _starts(width, columns):
                corners.add((y, x, y + rows, x + columns))
    y0, x0, y1, x1 = np.array(sorted(corners)).T
    return Windows(y0, x0, y1, x1)


def window_means(image: np.ndarray, grid: Windows) -> np.ndarray:
    """Means of (H, W, C) over each window: (n, C) float64."""
    table = np.zeros((image.shape[0] + 1, image.shape[1] + 1, image.shape[2]))
    table[1:, 1:] = image.cumsum(axis=0, dtype=np.float64).cumsum(axis=1)
    total = table[grid.y1, grid.x1] - table[grid.y0, grid.x1] - table[grid.y1, grid.x0] + table[grid.y0, grid.x0]
    return total / ((grid.y1 - grid.y0) * (grid.x1 - grid.x0))[:, None]


def _starts(length: int, size: int) -> list[int]:
    return sorted({*range(0, length - size + 1, max(1, size // 2)), length - size})
