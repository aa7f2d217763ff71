"""Bounding volumes of three shapes: how to fit each to groups of primitives, and how to ask whether a ray meets it."""

from __future__ import annotations

from .box import BOX
from .oriented_box import ORIENTED_BOX
from .sphere import SPHERE
from .volume import Volume, VolumeRay, volume_ray

#: Every shape by name.
VOLUMES: dict[str, Volume] = {"sphere": SPHERE, "box": BOX, "oriented_box": ORIENTED_BOX}

__all__ = ["VOLUMES", "Volume", "VolumeRay", "volume_ray"]
