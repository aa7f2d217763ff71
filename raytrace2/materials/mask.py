"""Opacity masks: with probability 1 - opacity a ray passes a surface as if it were not there."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr

from ..chances import by_choice
from ..scene.description import Bsdf, MaskBsdf, Texture, TwoSidedBsdf
from ..textures import TextureParameter, TextureTable
from .sample import BsdfSample


def opacities(bsdf: Bsdf) -> list[Texture]:
    """The opacities of the masks around a leaf, outermost first; ``ValueError`` if one is inside a two-sided one."""
    if isinstance(bsdf, MaskBsdf):
        return [bsdf.opacity, *opacities(bsdf.nested)]
    if isinstance(bsdf, TwoSidedBsdf) and (opacities(bsdf.front) or opacities(bsdf.back)):
        raise ValueError("a twosided material cannot hold a mask; put the mask around the twosided material")
    return []


class Masks:
    """The opacity of each material (a position, here); nested masks multiply."""

    def __init__(self, chains: Sequence[list[Texture]], textures: TextureTable) -> None:
        self._types = textures.types
        self._levels = [
            TextureParameter([chain[level] if level < len(chain) else None for chain in chains], textures)
            for level in range(max(map(len, chains)))
        ]

    def opacity(self, material: Any, si: Any, active: Any) -> Any:
        """Opacity in [0, 1] (Float) at ``si``."""
        result: Any = None
        for level in self._levels:
            value = dr.fmin(dr.fmax(level.eval_1(material, si, active), 0), 1)
            result = value if result is None else result * value
        return self._types.Float(result)

    def through(self, wi: Any, opacity: Any, solid: Any, sample: BsdfSample) -> BsdfSample:
        """``sample`` of the leaf where ``solid``, else straight on."""
        t = self._types
        return BsdfSample(
            dr.select(solid, sample.wo, -wi),
            by_choice(dr.select(solid, sample.weight, 1), dr.select(solid, opacity, 1 - opacity)),
            dr.select(solid, sample.pdf * opacity, 1 - opacity),
            dr.select(solid, sample.eta, 1),
            sample.delta | ~solid,
            t.Bool(sample.null) | ~solid,
        )
