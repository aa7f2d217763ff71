"""A geometry whose vertices have moved, without anything made anew until it is asked for."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np

from ..surfaces.geometry import Geometry
from ..surfaces.mesh import TriangleMesh
from ..surfaces.primitives import Primitives
from ..surfaces.surface import Surface


class MovedGeometry(Geometry):
    """``items`` in the place of those of ``before``, numbered alike: meshes of as many triangles as there."""

    def __init__(self, before: Geometry, items: Sequence[Surface]) -> None:
        self.types = before.types
        self.intersection = before.intersection
        self.exponent = before.exponent
        self.surfaces = list(items)
        self.instances = []
        self.nested = []
        self.first_ids = before.first_ids
        self.primitive_count = before.primitive_count

    @functools.cached_property
    def _whole(self) -> Geometry:
        return Geometry(self.surfaces, self.types, self.exponent, self.intersection)

    def primitives(self) -> Primitives | None:
        return self._whole.primitives()

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        return self._whole.bounds()


def are_meshes(before: Geometry, items: Sequence[Surface]) -> bool:
    """Whether ``before`` and ``items`` are triangle meshes and nothing else, of as many triangles one by one."""
    return (
        len(items) == len(before.surfaces)
        and not before.instances
        and all(isinstance(s, TriangleMesh) for s in (*items, *before.surfaces))
        and all(a.primitive_count == b.primitive_count for a, b in zip(items, before.surfaces, strict=True))
    )
