"""Interpolation between the two levels whose texels are about as large as the footprint (Williams 1983, SIGGRAPH)."""

from __future__ import annotations

from typing import Any

import drjit as dr

from ..filter_settings import FilterSettings
from .axes import principal_axes, width
from .point import bilinear


def trilinear(bitmaps: Any, image: Any, uv: Any, footprint: Any, settings: FilterSettings, active: Any) -> Any:
    """The level by the footprint's longer axis: never too sharp. A footprint that knows only distance is a circle."""
    return between_levels(bitmaps, image, uv, width(settings.pixel, principal_axes(footprint).major), active)


def trilinear_shorter(bitmaps: Any, image: Any, uv: Any, footprint: Any, settings: FilterSettings, active: Any) -> Any:
    """The level by the footprint's shorter axis: never too blurred."""
    return between_levels(bitmaps, image, uv, width(settings.pixel, principal_axes(footprint).minor), active)


def between_levels(bitmaps: Any, image: Any, uv: Any, texels: Any, active: Any) -> Any:
    """The image at ``uv`` at a resolution of ``texels`` (Float) texels of the full image: bilinear in two levels and
    linear in the level's number between them. Up to one texel it is the bilinear look-up to the last bit."""
    level, fraction = split_level(bitmaps, texels)
    this, after, another = bitmaps.two_levels(image, level, active)
    fine = bilinear(bitmaps, this, uv, active=active)
    between = active & another & (fraction > 0)
    coarse = bilinear(bitmaps, after, uv, active=between)
    return dr.select(between, dr.fma(fraction, coarse - fine, fine), fine)


def split_level(bitmaps: Any, texels: Any) -> tuple[Any, Any]:
    """The finer level (UInt) and how far (Float in [0, 1)) it is to the next, for a resolution of ``texels``."""
    last = float(bitmaps.pyramid.levels - 1)
    number = dr.fmin(dr.log2(dr.fmax(texels, 1)), last)
    level = dr.floor(number)
    return dr.uint32_array_t(level)(level), number - level
