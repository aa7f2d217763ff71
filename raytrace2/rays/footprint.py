"""The footprint of a pixel on a surface, in the surface's uv."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr

#: The flag of footprints of which no more than the size is known, and that roughly.
WIDENED = 16


@dataclass
class Footprint:
    """How uv changes over the spacing of samples: ``dx`` and ``dy`` (Array2f) towards the next sample to the right and
    down.

    ``dxx``, ``dxy``, ``dyy`` (Array2f): how ``dx`` and ``dy`` change themselves, or None where only the first order is
    known. ``random`` (Array2f) in [0, 1)^2 is there for filters that sample. ``flags`` (UInt) tell where and why the
    footprint is not what derivatives say, as :mod:`~raytrace2.rays.differentials.trust` has it.
    """

    dx: Any
    dy: Any
    dxx: Any = None
    dxy: Any = None
    dyy: Any = None
    random: Any = None
    flags: Any = 0

    def __post_init__(self) -> None:
        self._looked_up: dict[Any, Any] = {}

    def once(self, what: tuple[Any, ...], look_up: Callable[[], Any]) -> Any:
        """``look_up()``, or what it gave before for the same ``what``.

        Look-ups over footprints have loops and branches, which Dr.Jit does not recognise as the same, nor anything that
        is computed on either side of one: a material that is sampled and evaluated would do them twice. Dr.Jit arrays
        in ``what`` count as the variables that they are.
        """
        key = tuple(x.index if dr.is_jit_v(x) else x for x in what)
        if key not in self._looked_up:
            # With what it is of, so that no variable of another value comes to bear the same index.
            self._looked_up[key] = look_up(), what
        return self._looked_up[key][0]

    def copy(self) -> Footprint:
        """The same with nothing looked up: for the body of a symbolic loop, whose values are of no use outside."""
        return replace(self)

    def is_guess(self) -> Any:
        """Whether no more than the size is known, and that roughly (Bool); None where nothing tells."""
        return None if isinstance(self.flags, int) else (self.flags & WIDENED) != 0

    def mapped(self, linear: Any) -> Footprint:
        """The same under a linear map of uv: ``linear(v)`` is the image of a vector ``v``."""
        dxx, dxy, dyy = (None if v is None else linear(v) for v in (self.dxx, self.dxy, self.dyy))
        return Footprint(linear(self.dx), linear(self.dy), dxx, dxy, dyy, self.random, self.flags)


def shared(si: Any, what: tuple[Any, ...], compute: Callable[[], Any]) -> Any:
    """:meth:`Footprint.once` for what is computed at ``si``; where it has no footprint, look-ups are such that Dr.Jit
    shares them by itself."""
    return compute() if si.footprint is None else si.footprint.once(what, compute)
