"""Surface: anything that a ray can meet."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..types import Types, types, types_of

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
        return self._scan(ray).intersect(ray, active)

    def occluded(self, ray: Any, active: Any = True) -> Any:
        """Bool: whether anything lies between tmin and tmax on each active ray."""
        return self._scan(ray).occluded(ray, active)

    def interact(self, ray: Any, hit: Hit) -> SurfaceInteraction:
        """Position, normals, uv and their partial derivatives where ``ray`` met the surface at ``hit``."""
        return self._scan(ray).interact(ray, hit)

    def _scan(self, ray: Any) -> Scan:
        """Every primitive of this surface against every ray, in the precision of ``ray``; kept with the surface."""
        # Below this module: a scan is a structure, and a structure a Surface.
        from .door import origin_of
        from .geometry import Geometry
        from .scan import Scan

        precision = types_of(origin_of(ray)).precision
        scans: dict[str, Scan] = self.__dict__.setdefault("_scans", {})
        if precision not in scans:
            scans[precision] = Scan(Geometry([self], types(precision)))
        return scans[precision]
