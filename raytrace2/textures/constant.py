"""Textures of one colour."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import numpy as np

from ..buffers import owned
from ..live import STILL, Live, Slot, Values, channels, put
from ..scene.description import ConstantTexture
from ..types import Types


class Constants:
    """Colours (linear RGB) by place. A single one takes no gather, unless it is ``live``; none is a literal of the
    kernel."""

    def __init__(self, textures: Sequence[ConstantTexture], types: Types, live: Live = STILL) -> None:
        values = np.asarray([texture.value for texture in textures], dtype=types.numpy)
        self._live = {k: p for k, t in enumerate(textures) if (p := live.place(t, "value")) is not None}
        if not np.isfinite(values).all():
            raise ValueError("a constant texture has a colour that is not a finite number")
        self._types = types
        if len(values) == 1 and not self._live:
            self._single = types.Array3f(*(owned(values[0, c], types.Float) for c in range(3)))
        else:
            self._single = None
            self._values = owned(np.pad(values, ((0, 0), (0, 1))), types.Float)

    def eval(self, place: Any, active: Any) -> Any:
        """The colour (Array3f) at ``place``."""
        if self._single is not None:
            return self._types.Array3f(self._single)
        return dr.gather(self._types.Array4f, self._values, place, active).xyz

    def slots(self, moving: frozenset[int]) -> list[Slot]:
        """Those of live colours; ``moving``: the places of which rays depend on."""

        def make(base: Any, values: Values) -> Any:
            buffer = type(base)(base)
            for k, place in self._live.items():
                put(buffer, 4 * k, channels(values(place)))
            return buffer

        if not self._live:
            return []
        return [Slot.of(self, "_values", self._live.values(), make, moves=not moving.isdisjoint(self._live))]
