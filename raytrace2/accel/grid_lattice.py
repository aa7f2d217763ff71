"""Where the cells of uniform grids lie: a batch of grids, one row each, and how many cells each is given."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from ..buffers import owned
from ..surfaces.record import encode_integers
from ..types import Types

#: Words of a grid on the device: lower corner, size of a cell, its reciprocal, cells along each axis, the number of the
#: first cell, the grid that this one fills a cell of, and that cell's place in it, ten bits an axis.
WORDS = 16
CORNER, STEP, PER_STEP, CELLS, FIRST, PARENT, PLACE = 0, 3, 6, 9, 12, 13, 14

#: Most cells along an axis: their places fit ten bits.
MOST_ALONG = 1 << 10

#: Halvings of the logarithm of a cell's size: to a millionth, within which whole numbers of cells are rounded.
BISECTIONS = 24


@dataclass(frozen=True, eq=False)
class Lattices:
    """Grids whose cells are numbered on: ``corner`` (m, 3) and ``step`` (m, 3), in the working precision; ``cells``
    (m, 3) along each axis; ``first`` (m,); ``parent`` (m,) and ``place`` (m, 3), the cell of another that each fills.
    Cells of a grid are numbered with the last axis fastest."""

    corner: np.ndarray
    step: np.ndarray
    cells: np.ndarray
    first: np.ndarray
    parent: np.ndarray
    place: np.ndarray

    def __len__(self) -> int:
        return len(self.first)

    @property
    def end(self) -> int:
        """The number after that of the last cell."""
        return int(self.first[-1] + self.cells[-1].prod())

    @staticmethod
    def make(
        corner: np.ndarray, size: np.ndarray, cells: np.ndarray, first: int, parent: np.ndarray, place: np.ndarray
    ) -> Lattices:
        """Grids of ``cells`` (m, 3) in boxes of ``size`` (m, 3), numbered from ``first`` on."""
        counts = cells.prod(axis=1)
        step = (size / cells).astype(corner.dtype)
        return Lattices(corner, step, cells, first + np.cumsum(counts) - counts, parent, place)

    def followed_by(self, more: Lattices) -> Lattices:
        """These grids and then ``more``."""
        pairs = ((getattr(self, f.name), getattr(more, f.name)) for f in fields(self))
        return Lattices(*(np.concatenate(pair) for pair in pairs))

    def where(self, cell: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The grid (k,) and the place (k, 3) of cells by number (k,)."""
        grid = np.searchsorted(self.first, cell, side="right") - 1
        rest = cell - self.first[grid]
        ny, nz = self.cells[grid, 1], self.cells[grid, 2]
        return grid, np.stack([rest // (ny * nz), rest // nz % ny, rest % nz], axis=1)

    def upload(self, types: Types) -> Any:
        """The grids as device words, :data:`WORDS` each."""
        words = np.zeros((len(self), WORDS), types.numpy)
        words[:, CORNER : CORNER + 3] = self.corner
        words[:, STEP : STEP + 3] = self.step
        words[:, PER_STEP : PER_STEP + 3] = 1 / self.step
        words[:, CELLS : CELLS + 3] = self.cells
        words[:, FIRST] = encode_integers(self.first, types)
        words[:, PARENT] = encode_integers(self.parent, types)
        words[:, PLACE] = encode_integers(self.place[:, 0] | self.place[:, 1] << 10 | self.place[:, 2] << 20, types)
        return owned(words, types.Float)


@dataclass(frozen=True)
class Extents:
    """Sums over the primitives of each of m grids: how many there are (m,), and of products of the sides of their
    boxes, in units of the grid's own: singly (m, 3), in pairs xy, yz, zx (m, 3) and, for those met by their box alone,
    of all three (m,)."""

    count: np.ndarray
    lengths: np.ndarray
    areas: np.ndarray
    volumes: np.ndarray

    def take(self, chosen: np.ndarray) -> Extents:
        """Those of the grids ``chosen``."""
        return Extents(self.count[chosen], self.lengths[chosen], self.areas[chosen], self.volumes[chosen])

    def references(self, cells: np.ndarray) -> np.ndarray:
        """How many references grids of ``cells`` (m, 3) should hold.

        A box of side w meets 1 + w (cells - 1) cells along an axis, on average over where it lies. The product of that
        over the axes is for boxes that are filled; a flat thing, tilted in any way, is met by no more than the terms
        below the third order.
        """
        walls = cells - 1.0
        pairs = walls * np.roll(walls, -1, axis=1)
        flat = self.count + (self.lengths * walls).sum(axis=1) + (self.areas * pairs).sum(axis=1)
        return flat + self.volumes * walls.prod(axis=1)


def choose_cells(
    size: np.ndarray, extents: Extents, target: np.ndarray, most_references: np.ndarray, least_step: float
) -> np.ndarray:
    """Cells (m, 3) along the axes of grids of ``size`` (m, 3): as near to cubes as whole numbers allow, at most
    ``target`` (m,) in all, holding at most ``most_references`` (m,), none smaller than ``least_step``.

    By bisection on the size of a cell, which takes care of flat boxes: an axis shorter than two cells has one.
    """
    longest = size.max(axis=1)
    high = np.maximum(longest, least_step)
    low = np.minimum(np.maximum(longest / MOST_ALONG, least_step), high)

    def cells_of(step: np.ndarray) -> np.ndarray:
        return np.clip(np.floor(size / step[:, None] * (1 + 1e-6)), 1, MOST_ALONG - 1)

    for _ in range(BISECTIONS):
        middle = np.sqrt(low * high)
        cells = cells_of(middle)
        fits = (cells.prod(axis=1) <= target) & (extents.references(cells) <= most_references)
        low, high = np.where(fits, low, middle), np.where(fits, middle, high)
    return cells_of(high).astype(np.int64)
