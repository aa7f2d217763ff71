"""How much a texture changes from texel to texel."""

from __future__ import annotations

from typing import Any

import drjit as dr


def total_variation(texture: Any) -> Any:
    """The mean absolute difference of texels beside each other plus that of texels below each other (Float of width 1),
    for a loss that shall prefer smooth textures to noisy ones without blurring edges (Rudin, Osher and Fatemi 1992,
    "Nonlinear Total Variation Based Noise Removal Algorithms").

    ``texture`` is a TensorXf of the shape (height, width) or (height, width, channels). Equal texels have the
    derivative 0. ``ValueError`` for other shapes.
    """
    if len(texture.shape) not in (2, 3) or 0 in texture.shape:
        raise ValueError(f"a texture has the shape (height, width, channels), not {tuple(texture.shape)}")
    total = type(texture.array)(0)
    for before, after in ((texture[:, :-1], texture[:, 1:]), (texture[:-1], texture[1:])):
        difference = after.array - before.array
        if len(difference) > 0:
            total = total + dr.mean(dr.abs(difference))
    return total


__all__ = ["total_variation"]
