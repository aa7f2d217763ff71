"""Texture filters: from an image, a point and a footprint to a value. One a file."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ..filter_settings import FilterSettings
from .point import bilinear, nearest

#: Look-ups by name: ``(bitmaps, image, uv, footprint, settings, active)`` to the value. ``uv`` (Array2f) is in the
#: texture's coordinates, the :class:`~raytrace2.rays.footprint.Footprint` (or None) in texels of the full image.
FILTERS: dict[str, Callable[[Any, Any, Any, Any, FilterSettings, Any], Any]] = {
    "nearest": nearest,
    "bilinear": bilinear,
}

__all__ = ["FILTERS"]
