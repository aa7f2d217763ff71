"""Low-discrepancy sampling: the first two dimensions of Sobol's sequence under Owen scrambling."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from ..types import Precision, types
from .random import fraction, mix, opaque_sum, sample_tea
from .wavefront import Wavefront


@dataclass
class LowDiscrepancy:
    """Every dimension, and every pair drawn at once, is a shuffled (0, 2)-sequence over the samples of a pixel.

    Hash-based Owen scrambling and shuffling (Burley 2020, JCGT 9(4)), different for each pixel and dimension. Any
    sample count will do, and powers of two do best: each aligned block of 2^m samples is a (0, m, 2)-net. The numbers
    are not those of Mitsuba's ``ldsampler``, whose dimensions all share one exclusive-or scramble.
    A PyTree: it can be part of the state of a Dr.Jit loop.
    """

    precision: Precision
    sample_count: int
    base_seed: int
    sequence: Any = None
    sample: Any = None
    dimension: Any = None

    def seed(self, seed: Any, wavefront: Wavefront) -> None:
        """Begin the sequences of the lanes of ``wavefront``, other ones for every ``seed`` modulo 2^32."""
        UInt = types(self.precision).UInt
        # Keyed by the pixel alone, so that more samples continue the sequence that fewer began.
        pixel, self.sample = wavefront.pixel_and_sample()
        self.sequence, _ = sample_tea(opaque_sum(self.base_seed, seed), pixel)
        self.dimension = dr.zeros(UInt, wavefront.size)

    def next_1d(self, active: Any = True) -> Any:
        """One number in [0, 1) a lane."""
        seed, index = self._next_index()
        return fraction(dr.brev(_owen_hash(index, mix(seed ^ 0x68BC21EB))), self.precision)

    def next_2d(self, active: Any = True) -> Any:
        """A point of [0, 1)^2 a lane."""
        seed, index = self._next_index()
        x = fraction(dr.brev(_owen_hash(index, mix(seed ^ 0x68BC21EB))), self.precision)
        y = fraction(dr.brev(_owen_hash(_pascal(index), mix(seed ^ 0x02E5BE93))), self.precision)
        return types(self.precision).Array2f(x, y)

    def _next_index(self) -> tuple[Any, Any]:
        """A seed of this dimension's own, and the sample's place in its shuffled sequence."""
        seed = mix(self.sequence + self.dimension * 0x9E3779B9)
        self.dimension = self.dimension + 1
        return seed, dr.brev(_owen_hash(dr.brev(self.sample), seed))


def _owen_hash(x: Any, seed: Any) -> Any:
    """Flips each bit of ``x`` by a hash of the bits below it and ``seed``.

    Laine and Karras 2011 (CGF 30(4)), with the constants of Vegdahl 2021 ("Building a better LK hash").
    """
    x = x ^ (x * 0x3D20ADEA)
    x = (x + seed) * ((seed >> 16) | 1)
    x = x ^ (x * 0x05526C56)
    return x ^ (x * 0x53A22864)


def _pascal(x: Any) -> Any:
    """Sobol's second dimension before the bit reversal: ``x`` times Pascal's triangle modulo 2.

    Bit j of the result is the sum of the bits of ``x`` at all k whose binary digits include those of j (Lucas'
    theorem), which five steps of a butterfly add up.
    """
    for shift, mask in ((1, 0x55555555), (2, 0x33333333), (4, 0x0F0F0F0F), (8, 0x00FF00FF), (16, 0x0000FFFF)):
        x = x ^ ((x >> shift) & mask)
    return x
