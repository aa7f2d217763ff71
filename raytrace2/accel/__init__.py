"""Acceleration structures: Surfaces over Surfaces. ``build`` makes one by name, ``names`` lists them."""

from __future__ import annotations

from .build import build, names
from .bvh import Bvh
from .bvh_config import BvhConfig

__all__ = ["Bvh", "BvhConfig", "build", "names"]
