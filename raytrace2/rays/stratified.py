"""Stratified sampling: one sample in each cell of a grid, cells in random order."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import drjit as dr

from ..types import Precision, types
from .random import below_one, opaque_sum, permute, sample_tea, sequence_streams, uniform
from .wavefront import Wavefront


@dataclass
class Stratified:
    """The samples of a pixel fill a square grid, each dimension in a random order of its own.

    Equal to Mitsuba's ``stratified`` sampler, number for number, except where that returns 1. ``sample_count`` is
    a square.
    A PyTree: it can be part of the state of a Dr.Jit loop.
    """

    precision: Precision
    sample_count: int
    base_seed: int
    jitter: bool
    rng: Any = None
    permutation: Any = None
    sample: Any = None
    dimension: Any = None
    count: Any = None
    columns: Any = None
    rows: Any = None

    @staticmethod
    def round_sample_count(sample_count: int) -> int:
        """The smallest sample count at or above ``sample_count`` that fills a grid."""
        return (math.isqrt(sample_count - 1) + 1) ** 2

    def resolution(self) -> tuple[int, int]:
        """Columns and rows of the grid of ``sample_count`` cells."""
        side = math.isqrt(self.sample_count)
        return side, side

    def seed(self, seed: Any, wavefront: Wavefront) -> None:
        """Begin the sequences of the lanes of ``wavefront``, other ones for every ``seed`` modulo 2^32."""
        t = types(self.precision)
        lane, first, self.sample = sequence_streams(wavefront, self.sample_count)
        state, stream = sample_tea(opaque_sum(self.base_seed, seed), lane)
        self.rng = t.PCG32()
        self.rng.seed(t.UInt64(state), t.UInt64(stream))
        base = dr.opaque(t.UInt, self.base_seed % 2**32)
        self.permutation, _ = sample_tea(base, first + opaque_sum(seed))
        self.dimension = dr.zeros(t.UInt, wavefront.size)
        # Read from memory, so that kernels do not depend on the sample count.
        columns, rows = self.resolution()
        self.count, self.columns, self.rows = (dr.opaque(t.UInt, n) for n in (self.sample_count, columns, rows))

    def next_1d(self, active: Any = True) -> Any:
        """One number in [0, 1) a lane."""
        cell = self._permute(self.sample, self.count, self.sample_count, self._next_permutation())
        T = types(self.precision)
        return below_one((T.Float(cell) + self._jitter(active)) * dr.rcp(T.Float(self.count)), self.precision)

    def next_2d(self, active: Any = True) -> Any:
        """A point of [0, 1)^2 a lane."""
        T = types(self.precision)
        cell = self._permute(self.sample, self.count, self.sample_count, self._next_permutation())
        row = cell // self.columns
        column = cell - row * self.columns
        x = T.Float(column) + self._jitter(active)
        y = T.Float(row) + self._jitter(active)
        scale = dr.rcp(T.Float(self.columns))
        return T.Array2f(below_one(x * scale, self.precision), below_one(y * scale, self.precision))

    def _next_permutation(self) -> Any:
        seed = self.permutation + self.dimension
        self.dimension = self.dimension + 1
        return seed

    def _permute(self, index: Any, count: Any, size: int, seed: Any) -> Any:
        return permute(index, count, size & (size - 1) == 0, seed)

    def _jitter(self, active: Any) -> Any:
        return uniform(self.rng, self.precision, active) if self.jitter else types(self.precision).Float(0.5)
