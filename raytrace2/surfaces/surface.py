"""Surface: anything that a ray can meet."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Any

import numpy as np

from ..types import Types, types

if TYPE_CHECKING:
    from .hit import Hit
    from .interaction import SurfaceInteraction
    from .primitives import Primitives
    from .scan import Scan


class Surface:
    """Anything that a ray can meet: a mesh, a sphere, an acceleration structure over any of them.

    Subclasses say what they are made of (:meth:`primitives`); by itself a surface tests each of them against every ray.
    ``rt.accel.build`` makes faster Surfaces of it.
    """

    name: str

    @property
    def primitive_count(self) -> int:
        """How many primitives there are."""
        raise NotImplementedError

    def primitives(self, types: Types, first_id: int = 0) -> Primitives:
        """The primitives as records in the precision of ``types``, numbered from ``first_id``."""
        raise NotImplementedError

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Opposite corners (3,), (3,) of an axis-aligned box around everything."""
        parts = self.primitives(types("float64"))
        return parts.lo.min(axis=0), parts.hi.max(axis=0)

    def intersect(self, ray: Any, active: Any = True) -> Hit:
        """The closest hit of each active ray between its tmin and tmax."""
        return self._scan(_precision(ray)).intersect(ray, active)

    def occluded(self, ray: Any, active: Any = True) -> Any:
        """Bool: whether anything lies between tmin and tmax on each active ray."""
        return self._scan(_precision(ray)).occluded(ray, active)

    def interact(self, ray: Any, hit: Hit) -> SurfaceInteraction:
        """Position, normals, uv and their partial derivatives where ``ray`` met the surface at ``hit``."""
        return self._scan(_precision(ray)).interact(ray, hit)

    @functools.cache  # noqa: B019 - surfaces are few and live as long as their scans
    def _scan(self, precision: str) -> Scan:
        from .geometry import Geometry
        from .scan import Scan

        return Scan(Geometry([self], types(precision)))


def _precision(ray: Any) -> str:
    from ..types import types_of

    return types_of(ray.o).precision
