"""Texture filters: from an image, a point and a footprint to a value. One a file."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ..filter_settings import FilterSettings
from .bicubic import bicubic
from .ewa import ewa
from .exact import exact
from .exact2 import exact2
from .point import bilinear, nearest
from .probes import probes
from .stochastic import stochastic
from .trilinear import trilinear, trilinear_shorter

#: Look-ups by name: ``(bitmaps, image, uv, footprint, settings, active)`` to the value. ``uv`` (Array2f) is in the
#: texture's coordinates, the :class:`~raytrace2.rays.footprint.Footprint` (or None) in texels of the full image.
FILTERS: dict[str, Callable[[Any, Any, Any, Any, FilterSettings, Any], Any]] = {
    "nearest": nearest,
    "bilinear": bilinear,
    "exact": exact,
    "exact2": exact2,
    "bicubic": bicubic,
    "mip_distance": trilinear,
    "trilinear": trilinear,
    "trilinear_shorter": trilinear_shorter,
    "ewa": ewa,
    "probes": probes,
    "stochastic": stochastic,
}

__all__ = ["FILTERS"]
