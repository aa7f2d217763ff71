"""Which curve to sample: with a probability in proportion to a weight each."""

from __future__ import annotations

from typing import Any

import drjit as dr

from ..types import Types
from ..types import types as make_types


class Choice:
    """Draws numbers below the count of ``weights`` (Float, none negative), detached."""

    def __init__(self, weights: Any, types: Types) -> None:
        self.types, self._wide = types, make_types("float64").Float
        weights = dr.select(dr.isfinite(weights), self._wide(dr.detach(weights)), 0)
        dr.eval(weights)
        self._sums = dr.cumsum(weights)
        self._last = dr.width(weights) - 1
        dr.eval(self._sums)
        #: The sum of all weights, Float of width 1.
        self.total = dr.gather(self._wide, self._sums, types.UInt(self._last))

    def draw(self, u: Any) -> tuple[Any, Any, Any]:
        """A number (UInt) for each ``u`` (float64, in [0, 1)), its probability (Float; 0 where no weight is), and what
        is left of ``u`` (Float in [0, 1))."""
        at, UInt = u * self.total, self.types.UInt
        index = UInt(dr.binary_search(0, self._last, lambda k: dr.gather(self._wide, self._sums, UInt(k)) <= at))
        before = dr.gather(self._wide, self._sums, index - 1, index > 0)
        weight = dr.gather(self._wide, self._sums, index) - before
        chance = dr.select(self.total > 0, weight / dr.select(self.total > 0, self.total, 1), 0)
        rest = dr.select(weight > 0, (at - before) / dr.select(weight > 0, weight, 1), 0)
        return index, self.types.Float(chance), dr.fmin(self.types.Float(rest), 1 - self.types.epsilon)
