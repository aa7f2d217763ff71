"""Independent uniform random numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ..types import Precision, types
from .random import opaque_sum, sample_tea, sequence_streams, uniform
from .wavefront import Wavefront


@dataclass
class Independent:
    """A PCG32 generator a lane (O'Neill 2014), seeded as Mitsuba's ``independent`` sampler: equal seeds, equal numbers.

    A PyTree: it can be part of the state of a Dr.Jit loop.
    """

    precision: Precision
    sample_count: int
    base_seed: int
    rng: Any = None

    def seed(self, seed: Any, wavefront: Wavefront) -> None:
        """Begin the sequences of the lanes of ``wavefront``, other ones for every ``seed`` modulo 2^32."""
        t = types(self.precision)
        lane, _, _ = sequence_streams(wavefront, self.sample_count)
        state, stream = sample_tea(opaque_sum(self.base_seed, seed), lane)
        self.rng = t.PCG32()
        self.rng.seed(t.UInt64(state), t.UInt64(stream))

    def next_1d(self, active: Any = True) -> Any:
        """One number in [0, 1) a lane; lanes that are not ``active`` keep their place in the sequence."""
        return uniform(self.rng, self.precision, active)

    def next_2d(self, active: Any = True) -> Any:
        """A point of [0, 1)^2 a lane."""
        x = self.next_1d(active)
        return types(self.precision).Array2f(x, self.next_1d(active))
