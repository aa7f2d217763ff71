"""Relative indices of refraction, by place."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import drjit as dr
import numpy as np

from ..buffers import owned
from ..live import STILL, Live, Slot, Values, put
from ..scene.description import DielectricBsdf, ThinDielectricBsdf
from ..types import Types


class RelativeIndices:
    """``int_ior / ext_ior`` of each dielectric. ``ValueError`` unless both are positive, finite numbers."""

    def __init__(self, bsdfs: Sequence[DielectricBsdf | ThinDielectricBsdf], types: Types, live: Live = STILL) -> None:
        for b in bsdfs:
            if not (0 < b.int_ior < math.inf and 0 < b.ext_ior < math.inf):
                raise ValueError(
                    f"indices of refraction must be positive numbers, not int_ior={b.int_ior}, ext_ior={b.ext_ior}"
                )
        values = np.array([b.int_ior / b.ext_ior for b in bsdfs], dtype=types.numpy)
        self._live = {k: p for k, b in enumerate(bsdfs) if (p := live.place(b, "eta")) is not None}
        self._single = not self._live and bool((values == values[0]).all())
        self._values = owned(values[:1] if self._single else values, types.Float)

    def slots(self, *, moves: bool) -> list[Slot]:
        """That of live indices; ``moves``: whether rays are bent."""

        def make(base: Any, values: Values) -> Any:
            buffer = type(base)(base)
            for k, place in self._live.items():
                put(buffer, k, [values(place)])
            return buffer

        return [Slot.of(self, "_values", self._live.values(), make, moves=moves)] if self._live else []

    def eval(self, place: Any, active: Any) -> Any:
        """The relative index (Float) at ``place``; 1 in inactive lanes."""
        if self._single:
            return self._values
        return dr.select(active, dr.gather(type(self._values), self._values, place, active), 1)
