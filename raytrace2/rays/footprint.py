"""The footprint of a pixel on a surface, in the surface's uv."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass
class Footprint:
    """How uv changes over the spacing of samples: ``dx`` and ``dy`` (Array2f) towards the next sample to the right and
    down.

    ``dxx``, ``dxy``, ``dyy`` (Array2f): how ``dx`` and ``dy`` change themselves, or None where only the first order is
    known. ``random`` (Array2f) in [0, 1)^2 is there for filters that sample.
    """

    dx: Any
    dy: Any
    dxx: Any = None
    dxy: Any = None
    dyy: Any = None
    random: Any = None

    def mapped(self, linear: Any) -> Footprint:
        """The same under a linear map of uv: ``linear(v)`` is the image of a vector ``v``."""
        dxx, dxy, dyy = (None if v is None else linear(v) for v in (self.dxx, self.dxy, self.dyy))
        return Footprint(linear(self.dx), linear(self.dy), dxx, dxy, dyy, self.random)
