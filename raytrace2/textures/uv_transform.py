"""Affine maps from a surface's uv to a texture's, one for each texture of a kind."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import drjit as dr
import numpy as np

from ..buffers import owned
from ..live import Place, Slot, Values, put
from ..types import Types


class UvTransforms:
    """``to_uv`` matrices (3x3, or 4x4 as Mitsuba takes them; the upper 2x2 and the last column count), by place.

    Identities cost nothing, equal maps are kept once and cost no gather, unless some are ``live`` (by place).
    ``ValueError`` for other shapes and for entries that are not finite.
    """

    def __init__(
        self, matrices: Sequence[np.ndarray], types: Types, live: Sequence[Place | None] | None = None
    ) -> None:
        rows = np.array([_affine(m) for m in matrices], dtype=types.numpy)
        self._types = types
        self._live = {k: place for k, place in enumerate(live or ()) if place is not None}
        self.identity = not self._live and bool((rows == np.eye(2, 3)).all())
        self.uniform = not self._live and bool((rows == rows[:1]).all())
        self._rows: Any = None
        if self.identity:
            return
        if self.uniform:
            self._rows = [owned(entry, types.Float) for entry in rows[0].ravel()]
        else:
            self._rows = owned(np.pad(rows, ((0, 0), (0, 0), (0, 1))), types.Float)

    def apply(self, place: Any, uv: Any, active: Any) -> Any:
        """The texture's coordinates (Array2f) of ``uv`` for the texture at ``place``."""
        if self.identity:
            return uv
        a, b, c, d, e, f = self._entries(place, active)
        return type(uv)(dr.fma(a, uv.x, dr.fma(b, uv.y, c)), dr.fma(d, uv.x, dr.fma(e, uv.y, f)))

    def apply_linear(self, place: Any, active: Any) -> Callable[[Any], Any]:
        """The map of vectors of uv, which translations leave alone."""
        if self.identity:
            return lambda v: v
        a, b, _, d, e, _ = self._entries(place, active)
        return lambda v: type(v)(dr.fma(a, v.x, b * v.y), dr.fma(d, v.x, e * v.y))

    def slots(self, *, moves: bool) -> list[Slot]:
        """Those of live maps, whose values are 3x3 matrices; ``moves``: whether rays depend on what is looked up."""

        def make(base: Any, values: Values) -> Any:
            buffer = type(base)(base)
            for k, place in self._live.items():
                matrix = values(place)
                for row in range(2):
                    put(buffer, 8 * k + 4 * row, [matrix[row, column] for column in range(3)])
            return buffer

        return [Slot.of(self, "_rows", self._live.values(), make, moves=moves)] if self._live else []

    def _entries(self, place: Any, active: Any) -> Any:
        if self.uniform:
            return self._rows
        array4 = self._types.Array4f
        rows = (dr.gather(array4, self._rows, 2 * place + k, active) for k in range(2))
        return [row[k] for row in rows for k in range(3)]


def _affine(matrix: np.ndarray) -> np.ndarray:
    matrix = np.asarray(matrix, dtype=np.float64)
    if matrix.shape not in ((3, 3), (4, 4)):
        raise ValueError(f"to_uv must be a 3x3 or 4x4 matrix, not {matrix.shape}")
    rows = matrix[:2][:, [0, 1, -1]]
    if not np.isfinite(rows).all():
        raise ValueError("to_uv has entries that are not finite numbers")
    return rows
