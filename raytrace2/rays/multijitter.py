"""Correlated multi-jittered sampling (Kensler 2013, Pixar memo 13-01)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import drjit as dr

from ..types import types
from .random import below_one
from .stratified import Stratified


@dataclass
class MultiJitter(Stratified):
    """Stratified in two dimensions at once and, finely, in each alone (equal to Mitsuba's ``multijitter``).

    ``sample_count`` is a product of two nearly equal integers. A PyTree: it can be part of the state of a Dr.Jit loop.
    """

    @staticmethod
    def round_sample_count(sample_count: int) -> int:
        """The sample count at or above ``sample_count`` that fills the grid chosen for it."""
        rows = math.isqrt(sample_count)
        return rows * -(-sample_count // rows)

    def resolution(self) -> tuple[int, int]:
        """Columns and rows of the grid of ``sample_count`` cells."""
        rows = math.isqrt(self.sample_count)
        return -(-self.sample_count // rows), rows

    def next_1d(self, active: Any = True) -> Any:
        """One number in [0, 1) a lane."""
        seed = self._next_permutation() * 0x45FBE943
        cell = self._permute(self.sample, self.count, self.sample_count, seed)
        T = types(self.precision)
        return below_one((T.Float(cell) + self._jitter(active)) * dr.rcp(T.Float(self.count)), self.precision)

    def next_2d(self, active: Any = True) -> Any:
        """A point of [0, 1)^2 a lane."""
        T = types(self.precision)
        seed = self._next_permutation()
        columns, rows = self.resolution()
        cell = self._permute(self.sample, self.count, self.sample_count, seed * 0x51633E2D)
        row = cell // self.columns
        column = cell - row * self.columns
        # Where in its cell the sample lies depends on the other axis' cell: no two samples share a fine row or column.
        fine_x = T.Float(self._permute(column, self.columns, columns, seed * 0x68BC21EB))
        fine_y = T.Float(self._permute(row, self.rows, rows, seed * 0x02E5BE93))
        step_x, step_y = dr.rcp(T.Float(self.columns)), dr.rcp(T.Float(self.rows))
        x = (T.Float(column) + (fine_y + self._jitter(active)) * step_y) * step_x
        y = (T.Float(row) + (fine_x + self._jitter(active)) * step_x) * step_y
        return T.Array2f(below_one(x, self.precision), below_one(y, self.precision))
