"""What travels with a ray, and what is known where it meets a surface."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import drjit as dr

from ...surfaces.interaction import SurfaceInteraction


@dataclass
class RayDifferential:
    """The derivatives (Array3f) of a ray's origin and direction towards the next sample to the right and down, and the
    ``flags`` (UInt) of :mod:`.trust` that were met on the way."""

    o_dx: Any
    d_dx: Any
    o_dy: Any
    d_dy: Any
    flags: Any

    @staticmethod
    def full(o: Any, o_dx: Any, d_dx: Any, o_dy: Any, d_dy: Any) -> RayDifferential:
        """A camera's, as wide as its rays' origins ``o``: a loop's state needs that."""
        none = dr.zeros(dr.uint32_array_t(type(o.x)), dr.width(o))
        zero = dr.zeros(type(o), dr.width(o))
        return RayDifferential(o_dx + zero, d_dx + zero, o_dy + zero, d_dy + zero, none)

    def directions(self) -> list[tuple[Any, Any]]:
        """(origin, direction) moved to the right, and down."""
        return [(self.o_dx, self.d_dx), (self.o_dy, self.d_dy)]


@dataclass
class Meeting:
    """A ray with differentials at a surface.

    ``si`` is what shading reads, with its footprint; ``scatter`` the same for choosing where the ray goes on: what
    moves with the ray there may carry derivatives, which end in ``leave``. ``memory`` is the way's own.
    """

    si: SurfaceInteraction
    scatter: SurfaceInteraction
    memory: Any = None

    def drawing(self, random: Any) -> Meeting:
        """The same with random numbers (Array2f) for filters that read texels at random."""
        for x in (self.si, self.scatter):
            if x.footprint is not None:
                x.footprint.random = random
        return self

    def inside(self, loop: bool) -> Meeting:
        """The same for use in the body of a symbolic ``loop``, where look-ups cannot be shared with the outside."""
        if not loop or self.si.footprint is None:
            return self
        footprint = self.si.footprint.copy()
        si, scatter = (replace(x, footprint=footprint) for x in (self.si, self.scatter))
        return Meeting(si, scatter, self.memory)
