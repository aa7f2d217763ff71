"""Bounds on the turns of traversal loops, and a watch over them.

A symbolic loop that does not end cannot be interrupted. Each traversal's module derives the most turns that a ray can
take: every turn uses up a node, a cell or a primitive that it never comes back to. A counter that watches over this
costs 2 to 4 % of rays/s in hierarchies and 5 to 13 % in grids, so loops carry one only where the cost of rays is
counted (``count``) and where Dr.Jit itself is asked to check (``dr.JitFlag.Debug``).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import drjit as dr

from ..errors import RayTraceError
from ..types import Types


@dataclass(eq=False)
class Turns:
    """The ``most`` turns that a ray can take through a structure of a ``kind``; whether a ray took them all without
    coming to its end is noted on the device, by those loops that are watched."""

    types: Types
    kind: str
    most: int
    _limit: Any = field(init=False)
    _overrun: Any = field(init=False)
    _watched: bool = field(init=False, default=False)

    def __post_init__(self) -> None:
        # Another number than the bound itself would do, but turns are counted in 32 bits.
        self._limit = dr.opaque(self.types.UInt, min(self.most, 0xFFFFFFFF))
        self._overrun = dr.zeros(self.types.UInt, 1)
        dr.eval(self._overrun)

    def left(self, width: int, counting: bool) -> Any:
        """State of a loop of so many rays: the turns that each has left, or None where nobody watches."""
        if not (counting or dr.flag(dr.JitFlag.Debug)):
            return None
        self._watched = True
        return self._limit + dr.zeros(self.types.UInt, width)

    def note(self, unfinished: Any, left: Any) -> None:
        """To be told at the end of the loop which rays have not come to theirs."""
        if left is not None:
            dr.scatter(self._overrun, self.types.UInt(1), self.types.UInt(0), unfinished)

    def check(self) -> None:
        """:class:`RayTraceError` if a ray has used up its turns since the last check; evaluates watched loops."""
        if not self._watched or dr.flag(dr.JitFlag.SymbolicScope):
            return
        self._watched = False
        overrun = int(self._overrun.numpy()[0])
        if overrun:
            self._overrun = dr.zeros(self.types.UInt, 1)
            dr.eval(self._overrun)
            raise RayTraceError(
                f"{self.kind}: a ray took more than {self.most} turns, all that there can be: "
                "build the structure anew, or another kind, and report the scene"
            )


def goes_on(unfinished: Any, left: Any) -> Any:
    """Whether each ray takes another turn."""
    return unfinished if left is None else unfinished & (left != 0)


def after_turn(left: Any) -> Any:
    """``left`` after a turn."""
    return None if left is None else left - 1
