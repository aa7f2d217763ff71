"""Checkerboards: two other textures in alternating fields of half a unit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import numpy as np

from ..buffers import owned
from ..types import Types
from .uv_transform import UvTransforms


class Checkerboards:
    """Which of two textures shows at a uv, by place. ``handles``: (n, 2), those of the even and the odd fields."""

    def __init__(self, handles: np.ndarray, to_uv: Sequence[np.ndarray], types: Types) -> None:
        handles = np.ascontiguousarray(handles, dtype=np.uint32)
        self._types = types
        self._to_uv = UvTransforms(to_uv, types)
        self._single = [owned(handles[0, i], types.UInt) for i in range(2)] if len(handles) == 1 else None
        self._handles = None if self._single else owned(handles, types.UInt)

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
