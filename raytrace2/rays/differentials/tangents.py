"""Derivatives of a map along a few directions, by Dr.Jit's forward mode, inside a symbolic loop if need be."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr


class Tangents:
    """Inputs with one or more directions in which they may move.

    ``inputs`` are what the map has to be computed from; :meth:`of` gives, for values so computed, their derivative
    along each direction. Copies are differentiated, so nothing outside the map is: it works on the state of a symbolic
    loop, whose iterations it leaves unaware of each other. Further values may be computed from earlier ones after a
    call of :meth:`of`.
    """

    def __init__(self, inputs: Sequence[Any], directions: Sequence[Sequence[Any]]) -> None:
        self.inputs = [type(x)(dr.detach(x)) for x in inputs]
        dr.enable_grad(self.inputs)
        self._directions = directions

    def of(self, values: Sequence[Any]) -> list[tuple[Any, ...]]:
        """The derivatives of ``values`` along each direction; zero for what does not depend on the inputs."""
        # Values may be computed from each other, and forward mode empties what it passes on its way: ask at ends that
        # nothing is computed from.
        ends = [-v if dr.grad_enabled(v) else None for v in values]
        moving = [end for end in ends if end is not None]
        found = []
        for direction in self._directions:
            if moving:
                dr.clear_grad(moving)
                for x, tangent in zip(self.inputs, direction, strict=True):
                    dr.set_grad(x, tangent)
                # The edges stay, for the next direction and for what is yet to be computed.
                dr.forward_to(moving, flags=dr.ADFlag.ClearInterior)
            pairs = zip(values, ends, strict=True)
            found.append(tuple(type(v)(0) if end is None else -dr.grad(end) for v, end in pairs))
        return found
