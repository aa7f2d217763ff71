"""Materials that wrap others: which leaf material the two sides of a surface have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from ..buffers import owned
from ..scene.description import Bsdf, BumpMapBsdf, MaskBsdf, NormalMapBsdf, TwoSidedBsdf
from ..types import Types

_TWO_SIDED, _SMOOTH = 1 << 31, 1 << 30
_LEAF = _SMOOTH - 1


def sides(bsdf: Bsdf) -> tuple[Bsdf, Bsdf | None]:
    """The leaf materials on the front and on the back; None for the back where the material has but one description.

    Masks, bump and normal maps are looked through. Each side of a two-sided material sees only rays from its own front,
    so that of nested two-sided ones the front remains.
    """
    if isinstance(bsdf, MaskBsdf | BumpMapBsdf | NormalMapBsdf):
        return sides(bsdf.nested)
    if isinstance(bsdf, TwoSidedBsdf):
        return sides(bsdf.front)[0], sides(bsdf.back)[0]
    return bsdf, None


@dataclass
class Side:
    """What a ray meets: ``leaf`` handle (UInt), ``wi`` seen from it, and if that is ``flipped`` (None: nowhere)."""

    leaf: Any
    wi: Any
    flipped: Any

    def turn(self, wo: Any) -> Any:
        """``wo`` taken from the shading frame to the leaf's, or back (the two are each other's mirror image)."""
        if self.flipped is None:
            return wo
        return type(wo)(wo.x, wo.y, dr.select(self.flipped, -wo.z, wo.z))


class Sides:
    """For each material (a position, here) the leaves on its two sides, and whether any lobe is not a delta."""

    def __init__(self, leaves: Sequence[tuple[int, int | None]], smooth: Sequence[bool], types: Types) -> None:
        self._types = types
        two_sided = [back is not None for _, back in leaves]
        self._any = any(two_sided)
        self._all = all(two_sided)
        self._count = len(leaves)
        first = [f | _TWO_SIDED * b | _SMOOTH * s for (f, _), b, s in zip(leaves, two_sided, smooth, strict=True)]
        second = [front if back is None else back for front, back in leaves]
        pairs = np.array([first, second], dtype=np.uint32)
        if not self._any:
            self._records = owned(pairs[0], types.UInt)
        elif self._count == 1:
            self._records = owned(pairs[0], types.UInt), owned(pairs[1], types.UInt)
        else:
            self._records = owned(pairs.T, types.UInt)

    def meet(self, material: Any, wi: Any, active: Any) -> Side:
        """The side of ``material`` that a ray from ``wi`` meets."""
        front, back = self._record(material, active)
        if not self._any:
            return Side(front & _LEAF, wi, None)
        flipped = wi.z < 0
        if not self._all:
            flipped = flipped & (front & _TWO_SIDED != 0)
        return Side(
            dr.select(flipped, back, front & _LEAF),
            type(wi)(wi.x, wi.y, dr.select(flipped, -wi.z, wi.z)),
            flipped,
        )

    def entry(self, material: Any, flipped: Any) -> Any:
        """The number (UInt) of a side of a material: ``2 material + back`` if any material here is two-sided."""
        if not self._any:
            return material
        return 2 * material + dr.select(flipped, self._types.UInt(1), 0)

    @property
    def any_two_sided(self) -> bool:
        """Whether any material is two-sided."""
        return self._any

    def has_smooth(self, material: Any, active: Any) -> Any:
        """Whether either side of ``material`` has a lobe that is not a delta (Bool)."""
        return self._record(material, active)[0] & _SMOOTH != 0

    def _record(self, material: Any, active: Any) -> tuple[Any, Any]:
        t = self._types
        if not self._any:
            front = self._records if self._count == 1 else dr.gather(t.UInt, self._records, material, active)
            return front, front
        if self._count == 1:
            return self._records
        pair = dr.gather(t.Array2u, self._records, material, active)
        return pair.x, pair.y
