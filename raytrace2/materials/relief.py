"""Bump and normal maps around a material: which of them the two sides of a surface have."""

from __future__ import annotations

from dataclasses import dataclass

from ..scene.description import Bsdf, BumpMapBsdf, MaskBsdf, NormalMapBsdf, TwoSidedBsdf


@dataclass(frozen=True, eq=False)
class Relief:
    """A map around a leaf. ``behind``: it was put around a two-sided material whose back the leaf is, so that what
    rises on the front is sunk here (a map inside a two-sided material rises on either side, as in Mitsuba)."""

    bsdf: BumpMapBsdf | NormalMapBsdf
    behind: bool = False


def reliefs(bsdf: Bsdf) -> tuple[Relief | None, Relief | None]:
    """The maps on the front and on the back of a material, as :func:`~.twosided.sides` gives its leaves.

    ``ValueError`` for a map around a mask or around another map.
    """
    if isinstance(bsdf, MaskBsdf):
        return reliefs(bsdf.nested)
    if isinstance(bsdf, TwoSidedBsdf):
        return reliefs(bsdf.front)[0], reliefs(bsdf.back)[0]
    if isinstance(bsdf, BumpMapBsdf | NormalMapBsdf):
        if _holds_mask(bsdf.nested):
            raise ValueError("a bump or normal map cannot hold a mask; put the mask around the map")
        if any(reliefs(bsdf.nested)):
            raise ValueError("a bump or normal map cannot hold another one; merge the two maps")
        two = isinstance(bsdf.nested, TwoSidedBsdf)
        return Relief(bsdf), Relief(bsdf, behind=True) if two else None
    return None, None


def _holds_mask(bsdf: Bsdf) -> bool:
    if isinstance(bsdf, TwoSidedBsdf):
        return _holds_mask(bsdf.front) or _holds_mask(bsdf.back)
    return isinstance(bsdf, MaskBsdf)
