"""What every structure over surfaces has in common: it is entered by a traversal and answers as a Surface."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import drjit as dr
import numpy as np

from ..rays.ray import Ray
from ..types import Types
from .door import checked_hit, checked_mask, origin_of
from .hit import Candidate, Counts, Hit
from .levels import Level, is_box, levels_inside, root_level
from .primitives import LocalRay, Primitives
from .record import NONE
from .surface import Surface
from .turns import Turns
from .units import Units

if TYPE_CHECKING:
    from .geometry import Geometry
    from .interaction import SurfaceInteraction


class Structure(Surface):
    """A Surface over the surfaces of a :class:`Geometry`. Subclasses give ``traverse`` and ``traverse_any``, and the
    ``turns`` that rays can take in them."""

    kind: str = ""

    def __init__(self, geometry: Geometry) -> None:
        self.geometry = geometry
        self.types: Types = geometry.types
        self.exponent = geometry.exponent
        self.units = Units.of(*geometry.bounds(), geometry.exponent, geometry.types)
        self.name = self.kind
        self.turns = Turns(self.types, self.kind, 0)

    def prepare(self) -> None:
        """Makes every buffer that queries read, so that the first query may stand inside a symbolic loop."""
        self.geometry.prepare()

    @property
    def has_instances(self) -> bool:
        """Whether a hit may have been met through an instance."""
        return bool(self.geometry.instances)

    @property
    def primitive_count(self) -> int:
        return self.geometry.primitive_count

    def primitives(self, types: Types, first_id: int = 0) -> Primitives:
        raise TypeError("a structure is entered, not taken apart; its surfaces are in geometry.surfaces")

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        return self.geometry.bounds()

    def own_levels(self, bounds: tuple[np.ndarray, np.ndarray]) -> Iterator[Level]:
        """The structure's own boxes, level by level from that around everything, ``bounds``, on: made when asked for,
        not kept. ``bounds`` are, and the boxes shall be, in the unit in which the structure holds lengths."""
        yield root_level(bounds, leaf=True)

    def levels(self) -> Iterator[Level]:
        """The structure's own boxes and then those of the structures inside it, a level at a time."""
        bounds = self.bounds()
        if is_box(bounds):
            unit = 2.0**self.exponent
            lo, hi = (np.asarray(corner, np.float64) / unit for corner in bounds)
            for level in self.own_levels((lo, hi)):
                yield replace(level, lo=level.lo * unit, hi=level.hi * unit)
        yield from levels_inside(self.geometry)

    def level_bounds(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Opposite corners (n, 3), (n, 3), float64, of the boxes of each level, the box around everything first.

        Boxes are parts of those of the level before; cells of grids and of trees of planes end in the very planes that
        rays are met with. After a structure's own levels come those of the structures in it. Structures of a million
        primitives have as many boxes: :meth:`levels` gives a level at a time, and tells how they hang together.
        """
        return [(level.lo, level.hi) for level in self.levels()]

    def traverse(self, ray: LocalRay, best: Candidate, root: Any, active: Any) -> Candidate:
        """The closest hit of each active ray no farther than ``best.t``; ``best`` where there is none."""
        raise NotImplementedError

    def traverse_any(self, ray: LocalRay, root: Any, active: Any) -> Any:
        """Bool: whether an active ray meets anything between its tmin and tmax."""
        raise NotImplementedError

    def intersect(self, ray: Any, active: Any = True) -> Hit:
        return self._closest(ray, active, counting=False)[0]

    def count(self, ray: Any, active: Any = True) -> tuple[Hit, Counts]:
        """The closest hits together with what finding them cost each ray.

        Loops are watched: :meth:`check_turns` tells of any that a ray did not come to the end of.
        """
        hit, counts = self._closest(ray, active, counting=True)
        assert counts is not None
        return hit, counts

    def _closest(self, ray: Any, active: Any, *, counting: bool) -> tuple[Hit, Counts | None]:
        self.check_turns()
        ray = self._checked(ray)
        active = checked_mask(active, self.types, _width(ray, True))
        types, width = self.types, _width(ray, active)
        zero = dr.zeros(types.Float, width)
        none = dr.full(types.UInt, NONE, width)
        instance = dr.full(types.UInt, NONE, width) if self.has_instances else None
        counts = Counts(*(dr.zeros(types.UInt, width) for _ in range(3))) if counting else None
        with dr.suspend_grad():
            local, back = self.units.enter(ray, self._farthest(ray))
            start = Candidate(local.tmax + zero, zero, zero + 0, none, instance, counts)
            found = self.traverse(local, start, dr.zeros(types.UInt, width), _can_hit(ray, local) & active)
        valid = found.id != NONE
        surface, prim = self.geometry.surface_and_prim(found.id, valid)
        instance = dr.full(types.UInt, NONE, width) if found.instance is None else found.instance
        t = dr.select(valid, back(found.t), dr.inf)
        return Hit(t, prim, types.Array2f(found.u, found.v), surface, instance), found.counts

    def occluded(self, ray: Any, active: Any = True) -> Any:
        self.check_turns()
        ray = self._checked(ray)
        active = checked_mask(active, self.types, _width(ray, True))
        with dr.suspend_grad():
            local, _ = self.units.enter(ray, self._farthest(ray))
            root = dr.zeros(self.types.UInt, _width(ray, active))
            return self.traverse_any(local, root, _can_hit(ray, local) & active)

    def check_turns(self) -> None:
        """:class:`~raytrace2.RayTraceError` if a ray of an earlier query used up the turns that its traversal can take.

        Queries are watched that count, or are made while ``dr.JitFlag.Debug`` is set, and the next query checks by
        itself; inside symbolic loops no query can.
        """
        self.turns.check()
        for inner in self.geometry.nested:
            inner.check_turns()

    def interact(self, ray: Any, hit: Hit) -> SurfaceInteraction:
        ray = self._checked(ray)
        return self.geometry.interact(ray, checked_hit(hit, _width(ray, True)))

    def _farthest(self, ray: Ray) -> Any:
        """tmax, but finite: a hit at infinity is no hit, it comes from overflow. NaN stays, and admits nothing."""
        largest = self.types.largest
        return dr.select(ray.tmax > largest, largest, ray.tmax)

    def _checked(self, ray: Any) -> Ray:
        origin_of(ray)
        if not isinstance(ray, Ray):
            ray = Ray(ray, precision=self.types.precision)
        given = dr.type_v(ray.o) == dr.VarType.Float64
        if given != (self.types.precision == "float64"):
            wanted = self.types.precision
            raise TypeError(f"this structure takes {wanted} rays; make them with Ray(o, d, precision={wanted!r})")
        return ray


def _width(ray: Ray, active: Any) -> int:
    return dr.width((ray.o, ray.d, ray.tmin, ray.tmax, active))


def _can_hit(ray: Ray, local: LocalRay) -> Any:
    """Bool: rays that are rays. NaN would meet every box on its way to no primitive."""
    return dr.all(dr.isfinite(local.o)) & dr.all(dr.isfinite(ray.d)) & dr.any(local.d != 0)
