"""A texture-valued parameter of n like things, such as the reflectances of all diffuse materials."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import numpy as np

from ..buffers import owned
from ..rays.footprint import shared
from ..scene.description import ConstantTexture, Texture
from .table import TextureTable

_ABSENT = 0xFFFFFFFF


class TextureParameter:
    """``textures[i]`` is the value for thing ``i``, or None where thing ``i`` has the value one without any look-up.

    Its kernels hold the kinds of texture that occur among ``textures``. ``always_one`` is a Python flag: the value is
    one everywhere. ``moves``: where rays go depends on the values.
    """

    def __init__(self, textures: Sequence[Texture | None], table: TextureTable, *, moves: bool = False) -> None:
        self._table = table
        needed = [None if t is None or (_is_one(t) and not table.live.has(t, "value")) else t for t in textures]
        indices = [_ABSENT if t is None else table.add(t, moves=moves) for t in needed]
        present = [i for i in indices if i != _ABSENT]
        self._reach = table.reach(present)
        self.always_one = not present
        self._some_absent = len(present) < len(indices)
        self._single = len(set(indices)) == 1
        self._indices = owned(np.array(indices[:1] if self._single else indices, dtype=np.uint32), table.types.UInt)

    def eval(self, place: Any, si: Any, active: Any = True) -> Any:
        """The colour (Array3f) for thing ``place`` (UInt) at ``si``."""
        if self.always_one:
            return self._table.types.Array3f(1)
        return self._shared(self._table.eval, place, si, active)

    def eval_1(self, place: Any, si: Any, active: Any = True) -> Any:
        """One channel, as :meth:`TextureTable.eval_1` gives it, for thing ``place`` at ``si`` (Float)."""
        if self.always_one:
            return self._table.types.Float(1)
        return self._shared(self._table.eval_1, place, si, active)

    def _shared(self, look_up: Any, place: Any, si: Any, active: Any) -> Any:
        def value() -> Any:
            index, present = self._index(place, active)
            value = look_up(index, si, present, reach=self._reach)
            return dr.select(present, value, 1) if self._some_absent else value

        return shared(si, (id(self), look_up.__name__, place, active), value)

    def _index(self, place: Any, active: Any) -> tuple[Any, Any]:
        active = self._table.types.Bool(active)
        index = self._indices if self._single else dr.gather(self._table.types.UInt, self._indices, place, active)
        return index, active & (index != _ABSENT) if self._some_absent else active


def _is_one(texture: Texture) -> bool:
    return isinstance(texture, ConstantTexture) and tuple(texture.value) == (1.0, 1.0, 1.0)
