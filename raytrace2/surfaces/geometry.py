"""Geometry: a list of surfaces flattened to numbered primitives, and the way back from a number to a surface."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, get_args

import drjit as dr
import numpy as np

from ..buffers import owned
from ..errors import SettingError
from ..types import Types
from . import record
from .hit import Hit
from .instance import Instance
from .interaction import SurfaceInteraction
from .primitives import Intersection, Primitives
from .shading import Shading
from .structure import Structure
from .surface import Surface
from .units import exponent_of, scaled


class Geometry:
    """Surfaces in one precision, with every primitive numbered.

    ``items`` may be leaf surfaces, structures (which are entered, not copied) and instances. ``surfaces`` lists the
    leaf surfaces in order, those inside structures and groups included; ``Hit.surface`` indexes it. ``instances``
    lists the instances. Primitives are held in units of 2^``exponent``, which follows from their extent if not given.
    ``intersection`` is how they are met; structures among the items keep their own.
    """

    def __init__(
        self,
        items: Sequence[Surface],
        types: Types,
        exponent: int | None = None,
        intersection: Intersection = "watertight",
    ) -> None:
        if intersection not in (known := get_args(Intersection)):
            raise SettingError(f"intersection must be one of {', '.join(known)}, not {intersection!r}")
        self.types = types
        self.intersection = intersection
        self.surfaces: list[Surface] = []
        self.instances: list[Instance] = []
        self.first_ids: list[int] = []
        self.primitive_count = 0
        self.exponent = 0
        self._parts: list[Primitives] = []
        self.nested: list[Structure] = []
        offsets: dict[int, tuple[int, int]] = {}
        pending: list[tuple[Instance | Structure, int]] = []
        for item in items:
            if isinstance(item, Instance):
                self.instances.append(item)
                pending.append((item, len(self.instances) - 1))
            elif isinstance(item, Structure):
                pending.append((item, record.NONE))
            else:
                first = self._add([item])
                self._parts.append(item.primitives(types, first))
        entrances = []
        for item, number in pending:
            structure = item.structure if isinstance(item, Instance) else item
            if structure.types is not types:
                raise TypeError(f"a {structure.types.precision} structure cannot be part of a {types.precision} one")
            if id(structure) not in offsets:
                offsets[id(structure)] = self._add(structure.geometry.surfaces), len(self.instances)
                self.nested.append(structure)
                self.instances.extend(structure.geometry.instances)
            place = self.nested.index(structure)
            offset, first_instance = offsets[id(structure)]
            if isinstance(item, Instance):
                entrances.append(item.placed(types, id_offset=offset, number=number, place=place))
            else:
                entrances.append(_entrance(structure, offset, first_instance, place, types))
        if entrances:
            joined = Primitives.join([Primitives(types, e.records, e.lo, e.hi, e.kinds) for e in entrances])
            self._parts.append(
                Primitives(types, joined.records, joined.lo, joined.hi, joined.kinds, tuple(self.nested))
            )
        self.exponent = exponent_of(*self.bounds()) if exponent is None else exponent
        self._parts = [replace(scaled(part, self.exponent), intersection=intersection) for part in self._parts]

    def _add(self, surfaces: Sequence[Surface]) -> int:
        start = self.primitive_count
        for surface in surfaces:
            self.surfaces.append(surface)
            self.first_ids.append(self.primitive_count)
            self.primitive_count += surface.primitive_count
        if self.primitive_count >= record.NONE or len(self.surfaces) >= 2**24:
            raise ValueError("more primitives than 32-bit numbers can tell apart")
        return start

    def primitives(self) -> Primitives | None:
        """Everything a structure over this geometry has to hold, or None if there is nothing."""
        return Primitives.join(self._parts) if self._parts else None

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Opposite corners (3,), (3,) of a box around everything; (inf, -inf) if there is nothing."""
        if not self._parts:
            return np.full(3, np.inf), np.full(3, -np.inf)
        unit = 2.0**self.exponent
        lo = np.min([p.lo.min(axis=0) for p in self._parts], axis=0)
        return lo * unit, np.max([p.hi.max(axis=0) for p in self._parts], axis=0) * unit

    def surface_and_prim(self, id: Any, valid: Any) -> tuple[Any, Any]:
        """The surface's index and the primitive's index within it, for numbers ``id``; NONE where not ``valid``."""
        if len(self.surfaces) <= 1:
            return dr.select(valid, self.types.UInt(0), record.NONE), dr.select(valid, id, record.NONE)
        surface_of, first_of = self._number_tables
        surface = dr.gather(self.types.UInt, surface_of, id, valid)
        prim = id - dr.gather(self.types.UInt, first_of, surface, valid)
        return dr.select(valid, surface, record.NONE), dr.select(valid, prim, record.NONE)

    def prepare(self) -> None:
        """Makes the buffers that queries read.

        They cannot be made inside a symbolic loop, so a query that is first asked there needs this before.
        """
        if len(self.surfaces) > 1:
            _ = self._number_tables
        _ = self.shading

    @functools.cached_property
    def _number_tables(self) -> tuple[Any, Any]:
        counts = [s.primitive_count for s in self.surfaces]
        surface_of = np.repeat(np.arange(len(counts), dtype=np.uint32), counts)
        UInt = self.types.UInt
        return owned(surface_of, UInt), owned(np.array(self.first_ids, dtype=np.uint32), UInt)

    @functools.cached_property
    def shading(self) -> Shading:
        """The buffers that interactions are computed from, made when first asked for."""
        if dr.flag(dr.JitFlag.SymbolicScope):
            raise RuntimeError("call prepare() on the structure before its first interact() inside a symbolic loop")
        return Shading(self.surfaces, self.instances, self.types)

    def adopt_shading(self, before: Geometry) -> None:
        """Takes the buffers of ``before``, the same surfaces elsewhere, which hold live values in their places."""
        if "shading" in before.__dict__:
            self.__dict__["shading"] = before.shading

    def interact(self, ray: Any, hit: Hit) -> SurfaceInteraction:
        """The local geometry where ``ray`` met a surface at ``hit``."""
        return self.shading.interact(ray, hit)


def _entrance(structure: Structure, offset: int, first_instance: int, place: int, types: Types) -> Primitives:
    lo, hi = structure.bounds()
    kind = record.NESTED
    records = record.make_records(np.zeros((1, 0)), np.array([offset]), kind + 8 * place, types, np.zeros(1))
    records[:, record.INSTANCE_NUMBER] = record.encode_integers(np.array([first_instance]), types)
    return Primitives(types, records, lo.astype(types.numpy)[None], hi.astype(types.numpy)[None], (kind,))
