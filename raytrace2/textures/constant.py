"""Textures of one colour."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import numpy as np

from ..buffers import owned
from ..types import Types


class Constants:
    """Colours (linear RGB) by place. A single one takes no gather; none is a literal of the kernel."""

    def __init__(self, colors: Sequence[tuple[float, float, float]], types: Types) -> None:
        values = np.asarray(colors, dtype=types.numpy)
        if not np.isfinite(values).all():
            raise ValueError("a constant texture has a colour that is not a finite number")
        self._types = types
        if len(values) == 1:
            self._single = types.Array3f(*(owned(values[0, c], types.Float) for c in range(3)))
        else:
            self._single = None
            self._values = owned(np.pad(values, ((0, 0), (0, 1))), types.Float)

    def eval(self, place: Any, active: Any) -> Any:
        """The colour (Array3f) at ``place``."""
        if self._single is not None:
            return self._types.Array3f(self._single)
        return dr.gather(self._types.Array4f, self._values, place, active).xyz
