"""The form of a scene that kernels read: a structure and tables of materials, textures and lights, met by index."""

from __future__ import annotations

import functools
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from ..buffers import owned
from ..errors import SettingError
from ..lights import LightTable
from ..live import Place, Slot, bound
from ..materials.relief import reliefs
from ..materials.table import MaterialTable
from ..parameters.store import Store
from ..surfaces.interaction import SurfaceInteraction
from ..surfaces.record import NONE
from ..surfaces.structure import Structure
from ..textures.filter_settings import FilterSettings
from ..textures.table import TextureTable
from . import description


def refuse_while_freezing() -> None:
    """``SettingError`` in a function that Dr.Jit is freezing."""
    if dr.flag(dr.JitFlag.FreezingScope):
        raise SettingError(
            "a function that is being frozen can make no tables or structures and move no surfaces: update the "
            "parameters that it changes, and render once with the same arguments, before it is called"
        )


@dataclass(frozen=True, eq=False)
class Moment:
    """Where surfaces were, what their interactions were computed from, and what the slots held."""

    structure: Structure
    shading: dict[str, Any]
    values: list[Any]


class TracedScene:
    """A structure over a scene's surfaces and the tables that shade them, in one precision.

    Tables are made on first use: a depth image builds no material. Values of ``store`` lie in the buffers of ``slots``,
    which :meth:`refresh` writes anew.
    """

    def __init__(
        self,
        source: description.SceneDescription,
        structure: Structure,
        shapes: Mapping[int, description.Shape],
        filter: FilterSettings | None = None,
        store: Store | None = None,
    ) -> None:
        self.description = source
        self.store = store or Store()
        self.live = self.store.live()
        self.structure = structure
        self.types = structure.types
        self.filter = filter
        self._shapes = [shapes[id(surface)] for surface in structure.geometry.surfaces]
        names = {id(shape): k + 1 for k, shape in enumerate(source.shapes)}
        numbers = [names.get(id(shape), 0) for shape in self._shapes]
        UInt = self.types.UInt
        self._shape_numbers = owned(np.array(numbers, dtype=np.uint32), UInt) if numbers else None
        through = [k + 1 for k, s in enumerate(source.shapes) if isinstance(s, description.InstanceShape)]
        self._instance_numbers = owned(np.array(through, dtype=np.uint32), UInt) if through else None
        structure.prepare()
        self._built, self._fresh = self.store.clock, 0
        # Another array whenever a frozen function has written the slots.
        self._written = dr.opaque(self.types.UInt, 0)
        self._seen = self._written.index

    @property
    def draws_texels(self) -> bool:
        """Whether texture look-ups need random numbers."""
        return self.filter is not None and self.filter.name == "stochastic"

    def prepare_shading(self) -> None:
        """Makes the tables of materials and lights, which cannot be made inside a symbolic loop."""
        _ = self._material_of

    @functools.cached_property
    def _tables(self) -> tuple[MaterialTable, LightTable]:
        refuse_while_freezing()
        meshes = {k: s for k, s in enumerate(self._shapes) if isinstance(s, description.MeshShape) and s.attributes}
        textures = TextureTable(self.types, meshes, self.filter, self.live)
        emitting = [(k, s) for k, s in enumerate(self._shapes) if s.emitter is not None]
        lights = LightTable.build(
            self.description.lights, emitting, textures, self.structure.geometry.bounds(), self.types
        )
        unique = {id(s.bsdf): s.bsdf for s in self._shapes} or {0: description.DiffuseBsdf()}
        materials = MaterialTable.build(list(unique.values()), self.types, textures)
        textures.finish()
        return materials, lights

    @functools.cached_property
    def slots(self) -> tuple[Slot, ...]:
        """Every buffer that live values of the scene are held in, those of cameras aside."""
        if not self.live.places:
            return ()
        materials, lights = self._tables
        instances = [s for s in self.description.shapes if isinstance(s, description.InstanceShape)]
        shading = self.structure.geometry.shading
        found = [*shading.slots(self._shapes, instances, self.live), *lights.slots]
        return tuple(found + materials.textures.slots() + materials.slots())

    def live_values(self) -> list[Any]:
        """What the buffers of ``slots`` shall hold now, as differentiable functions of the parameters.

        ``SettingError`` for a parameter with derivatives of which something is not such a function.
        """
        loose = self.loose
        for place in self.store.with_derivatives():
            if place in loose:
                key = self.store.entries[place].key
                raise SettingError(
                    f"{key}: there are no derivatives by it in this scene with these settings; dr.disable_grad it"
                )
        values, some = self.store.values(self.types), set(self.store.with_derivatives())
        return [slot.value if some.isdisjoint(slot.places) else slot.made(values) for slot in self.slots]

    @functools.cached_property
    def loose(self) -> frozenset[Place]:
        """Live places that something follows from which no slot holds: tables are made anew when these change."""
        held = {place for slot in self.slots for place in slot.places}
        everywhere = {p for p in self.live.places if not isinstance(p.owner, description.Camera)}
        return frozenset(everywhere - held)

    def refresh(self, structure: Structure) -> bool:
        """Takes the present values; ``structure`` is that of where surfaces are now. False if that takes new tables."""
        entries = self.store.entries
        if any(entries[p].changed > self._built for p in self.loose):
            return False
        self._move_to(structure)
        if self._fresh != self.store.clock:
            values = self.store.values(self.types)
            stale = [slot for slot in self.slots if any(entries[p].changed > self._fresh for p in slot.places)]
            with dr.suspend_grad():
                made = [slot.made(values) for slot in stale]
                dr.make_opaque(made)
            for slot, value in zip(stale, made, strict=True):
                slot.assign(value)
            self._fresh = self.store.clock
            if dr.flag(dr.JitFlag.FreezingScope):
                self._written = dr.opaque(self.types.UInt, 0)
        return True

    def now(self) -> Moment:
        """What kernels read at present, for :meth:`at`."""
        # Frozen functions write into arrays themselves, and other scenes into shading that they share with this one.
        shading = vars(self.structure.geometry.shading).items()
        held = {name: dr.copy(value) for name, value in shading if isinstance(value, dr.ArrayBase)}
        return Moment(self.structure, held, [dr.copy(dr.detach(slot.value)) for slot in self.slots])

    @contextmanager
    def at(self, moment: Moment) -> Iterator[None]:
        """While it lasts, kernels read what they did at a ``moment`` before."""
        present = self.structure
        self._move_to(moment.structure)
        shading = vars(self.structure.geometry.shading)
        before = dict(shading)
        shading.update(moment.shading)
        try:
            with bound(self.slots, moment.values):
                yield
        finally:
            shading.update(before)
            self._move_to(present)

    def _move_to(self, structure: Structure) -> None:
        if structure is not self.structure:
            self.structure = structure
            structure.prepare()
            if "_tables" in self.__dict__:
                self.lights.enclose(*structure.geometry.bounds())

    def make_what(self, other: TracedScene) -> None:
        """Makes the tables that ``other`` has."""
        if "_material_of" in other.__dict__:
            self.prepare_shading()

    def held(self) -> list[Any]:
        """What has the arrays that kernels read."""
        made = [self.__dict__.get(name) for name in ("_tables", "slots", "_material_of")]
        return [self.structure, self._shape_numbers, self._instance_numbers, self._written, *made]

    def notice(self) -> None:
        """After a frozen function has changed values of the store: takes it that the slots are those of the present
        values if that function wrote them."""
        if self._written.index != self._seen:
            self._seen, self._fresh = self._written.index, self.store.clock

    def surfaces_of(self, places: Collection[Place]) -> list[int]:
        """The numbers of the surfaces that stand by any of ``places``."""
        fields = ("vertices", "to_world")
        own = [{self.live.place(shape, field) for field in fields} for shape in self._shapes]
        return [k for k, mine in enumerate(own) if not mine.isdisjoint(places)]

    @property
    def materials(self) -> MaterialTable:
        """All materials."""
        return self._tables[0]

    @property
    def lights(self) -> LightTable:
        """All lights."""
        return self._tables[1]

    @functools.cached_property
    def _material_of(self) -> Any:
        handles = [self.materials.index_of(s.bsdf) for s in self._shapes]
        if len(set(handles)) <= 1:
            return handles[0] if handles else self.materials.indices[0]
        return owned(np.array(handles, dtype=np.uint32), self.types.UInt)

    @functools.cached_property
    def has_reliefs(self) -> bool:
        """Whether any surface has a bump or normal map."""
        return any(any(reliefs(s.bsdf)) for s in self._shapes)

    def material(self, si: SurfaceInteraction, active: Any) -> Any:
        """UInt: the material of each surface met; a constant where all surfaces share one."""
        if isinstance(self._material_of, int):
            return self.types.UInt(self._material_of)
        return dr.gather(self.types.UInt, self._material_of, si.surface, active)

    def shape_index(self, si: SurfaceInteraction) -> Any:
        """UInt: 1 plus the position in the scene of the shape or instance that was met, 0 on a miss."""
        UInt = self.types.UInt
        index = UInt(0)
        if self._shape_numbers is not None:
            index = dr.gather(UInt, self._shape_numbers, si.surface, si.valid)
        if self._instance_numbers is not None:
            through = si.valid & (si.instance != NONE)
            index = dr.select(through, dr.gather(UInt, self._instance_numbers, si.instance, through), index)
        return index
