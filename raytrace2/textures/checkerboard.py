"""Checkerboards: two other textures in alternating fields of half a unit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import drjit as dr
import numpy as np

from ..buffers import owned
from ..live import Place, Slot
from ..rays.footprint import Footprint
from ..scene.description import ReconstructionFilter
from ..types import Types
from .checker_coverage import odd_fraction
from .uv_transform import UvTransforms


def checker_scale(pixel: ReconstructionFilter) -> float:
    """How much larger a box has the variance of the pixel filter ``pixel`` (of a box, where it is of another kind than
    tent and gaussian): coverage is that of boxes."""
    if pixel.name == "gaussian":
        return pixel.stddev * math.sqrt(12)
    if pixel.name == "tent":
        return (1.0 if pixel.radius is None else pixel.radius) * math.sqrt(2)
    return 1.0


class Checkerboards:
    """Which of two textures shows at a uv, by place. ``handles``: (n, 2), those of the even and the odd fields."""

    def __init__(
        self,
        handles: np.ndarray,
        to_uv: Sequence[np.ndarray],
        types: Types,
        live: Sequence[Place | None] | None = None,
    ) -> None:
        handles = np.ascontiguousarray(handles, dtype=np.uint32)
        self._types = types
        self._to_uv = UvTransforms(to_uv, types, live)
        self._single = [owned(handles[0, i], types.UInt) for i in range(2)] if len(handles) == 1 else None
        self._handles = None if self._single else owned(handles, types.UInt)

    def slots(self, *, moves: bool) -> list[Slot]:
        """Those of live maps of uv."""
        return self._to_uv.slots(moves=moves)

    def choose(self, place: Any, uv: Any, swapped: bool, active: Any) -> Any:
        """The handle (UInt) of the texture that shows at ``uv``; ``swapped`` exchanges the two."""
        uv = self._to_uv.apply(place, uv, active)
        fraction = uv - dr.floor(uv)
        odd = (fraction.x > 0.5) != (fraction.y > 0.5)
        if swapped:
            odd = ~odd
        if self._single:
            return dr.select(odd, self._single[1], self._single[0])
        return dr.gather(self._types.UInt, self._handles, 2 * place + dr.select(odd, self._types.UInt(1), 0), active)

    def both(self, place: Any, swapped: bool, active: Any) -> tuple[Any, Any]:
        """The handles (UInt) of the textures of the even and the odd fields; ``swapped`` exchanges the two."""
        if self._single:
            first, second = self._single
        else:
            first, second = (dr.gather(self._types.UInt, self._handles, 2 * place + k, active) for k in range(2))
        return (second, first) if swapped else (first, second)

    def covered(self, place: Any, uv: Any, footprint: Footprint, scale: float, active: Any) -> Any:
        """How much (Float) of the ``footprint`` about ``uv``, ``scale`` times as large, lies in odd fields."""

        def look_up() -> Any:
            linear = self._to_uv.apply_linear(place, active)
            a, b = (linear(v) * (2 * scale) for v in (footprint.dx, footprint.dy))
            return odd_fraction(2 * self._to_uv.apply(place, uv, active), a, b, active)

        return footprint.once((id(self), place, self._types.Bool(active)), look_up)
