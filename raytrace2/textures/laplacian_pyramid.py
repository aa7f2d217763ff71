"""A texture as the sum of levels of detail, for optimisers: what many texels have in common is one number to them.

Steps of an optimiser on raw texels leave alone what no pixel saw, and noise where few did; steps on levels move
neighbourhoods first (Burt and Adelson, "The Laplacian Pyramid as a Compact Image Code", 1983; as a parametrisation of
textures, Weier et al., "Practical Inverse Rendering of Textured and Translucent Appearance", 2025).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import drjit as dr
import numpy as np

from ..buffers import owned
from ..types import Types, types_of
from .halving import half, taps
from .pyramid import level_count
from .wrap import MODES, REPEAT


class LaplacianPyramid:
    """``texture`` (TensorXf of the shape (height, width, channels)) as a coarse image and what finer ones add to it.

    :attr:`levels` are tensors by name, ``level_0`` being as large as the texture, each further one half as wide and
    high, rounded up, for ``count`` levels or down to a single texel. Put them in an optimiser, and what :meth:`texture`
    makes of the optimiser's values in the scene's parameters::

        pyramid = rt.LaplacianPyramid(params[key])
        optimizer = Adam(lr=0.02, params=pyramid.levels)  # of drjit.opt
        for step in range(100):
            params[key] = pyramid.texture(optimizer)
            params.update()
            ...

    ``wrap_mode`` is the texture's own: ``"repeat"``, ``"mirror"`` or ``"clamp"``. ``ValueError`` for textures of
    another shape and for counts that are no number of levels.
    """

    def __init__(self, texture: Any, count: int | None = None, wrap_mode: str = "repeat") -> None:
        if len(texture.shape) != 3 or 0 in texture.shape:
            raise ValueError(f"a texture has the shape (height, width, channels), not {tuple(texture.shape)}")
        if wrap_mode not in MODES:
            raise ValueError(f"wrap_mode is one of {', '.join(MODES)}, not {wrap_mode!r}")
        height, width, channels = texture.shape
        most = level_count(width, height)
        if count is not None and not 1 <= count <= most:
            raise ValueError(f"a texture of {width} x {height} texels has 1 to {most} levels, not {count}")
        self._mode = MODES[wrap_mode]
        self._shapes = [(height, width, channels)]
        for _ in range((count or most) - 1):
            height, width = half(height), half(width)
            self._shapes.append((height, width, channels))
        finer = dr.detach(texture)
        #: What an optimiser changes.
        self.levels: dict[str, Any] = {}
        for k, shape in enumerate(self._shapes[1:]):
            coarser = _resampled(finer, self._shapes[k], shape, self._mode)
            self.levels[f"level_{k}"] = finer - _resampled(coarser, shape, self._shapes[k], self._mode)
            finer = coarser
        self.levels[f"level_{len(self._shapes) - 1}"] = finer
        dr.eval(self.levels)

    def texture(self, levels: Mapping[str, Any] | None = None) -> Any:
        """The texture (TensorXf) that ``levels`` (of the names and shapes of :attr:`levels`, which they are else) make,
        with their derivatives."""
        given = self.levels if levels is None else levels
        result = given[f"level_{len(self._shapes) - 1}"]
        for k in reversed(range(len(self._shapes) - 1)):
            result = _resampled(result, self._shapes[k + 1], self._shapes[k], self._mode) + given[f"level_{k}"]
        return result

    def clamped(self, levels: Mapping[str, Any], lowest: float = 0.0, highest: float = 1.0) -> dict[str, Any]:
        """``levels`` whose texture is in [``lowest``, ``highest``]: the finest one makes up for what was beyond."""
        texture = dr.detach(self.texture(levels))
        inside = dr.fmin(dr.fmax(texture, lowest), highest)
        result = {name: dr.detach(levels[name]) for name in self.levels}
        result["level_0"] = result["level_0"] + (inside - texture)
        return result


def _resampled(image: Any, shape: tuple[int, int, int], target: tuple[int, int, int], mode: int) -> Any:
    """A tensor of ``shape`` as one of ``target``, half or twice as large: means, or bilinear interpolation."""
    types = types_of(image.array)
    height, width, channels = shape
    values = _along(image.array, height, width, target[1], channels, mode, types)
    values = _along(values, 1, height, target[0], target[1] * channels, mode, types)
    return type(image)(values, target)


def _along(values: Any, before: int, size: int, target: int, after: int, mode: int, types: Types) -> Any:
    """Lines of ``size`` as lines of ``target``; ``before`` and ``after`` are the numbers of entries of the axes before
    and after that one."""
    if size == target:
        return values
    indices, weights, count, apart = _weights(size, target, mode, types)
    u = types.UInt
    entry = dr.arange(u, before * target * after)
    outer = entry // dr.opaque(u, after)
    inner = entry - outer * dr.opaque(u, after)
    line = outer // dr.opaque(u, target)
    place = outer - line * dr.opaque(u, target)
    gathers = dr.ReduceMode.NoConflicts if apart else dr.ReduceMode.Auto
    total = dr.zeros(types.Float, len(entry))
    for k in range(count):
        tap = place * count + k
        source = dr.fma(dr.fma(line, dr.opaque(u, size), dr.gather(u, indices, tap)), dr.opaque(u, after), inner)
        total = dr.fma(
            dr.gather(types.Float, weights, tap), dr.gather(types.Float, values, source, mode=gathers), total
        )
    dr.eval(total)
    return total


@lru_cache(maxsize=256)
def _weights(size: int, target: int, mode: int, types: Types) -> tuple[Any, Any, int, bool]:
    """Which entries of a line those of another one gather, with what weights, how many, and whether all differ."""
    if target < size:
        index, weights = taps(size, "box", mode)
    else:
        place = (np.arange(target) + 0.5) * (size / target) - 0.5
        left = np.floor(place).astype(np.int64)
        index, weights = left[:, None] + np.arange(2), np.stack([left + 1 - place, place - left], 1)
        if mode == REPEAT:
            index = index % size
        else:
            # Mirrored and clamped lines are the same as far as half a texel.
            index = np.clip(index, 0, size - 1)
    apart = len(np.unique(index)) == index.size
    indices, factors = owned(index.astype(np.uint32), types.UInt), owned(weights.astype(types.numpy), types.Float)
    return indices, factors, index.shape[1], apart


__all__ = ["LaplacianPyramid"]
