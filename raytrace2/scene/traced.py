"""The form of a scene that kernels read: a structure and tables of materials, textures and lights, met by index."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any

import drjit as dr
import numpy as np

from ..buffers import owned
from ..lights import LightTable
from ..materials.relief import reliefs
from ..materials.table import MaterialTable
from ..surfaces.interaction import SurfaceInteraction
from ..surfaces.record import NONE
from ..surfaces.structure import Structure
from ..textures.filter_settings import FilterSettings
from ..textures.table import TextureTable
from . import description


class TracedScene:
    """A structure over a scene's surfaces and the tables that shade them, in one precision.

    Tables are made on first use: a depth image builds no material.
    """

    def __init__(
        self,
        source: description.SceneDescription,
        structure: Structure,
        shapes: Mapping[int, description.Shape],
        filter: FilterSettings | None = None,
    ) -> None:
        self.description = source
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

    @property
    def draws_texels(self) -> bool:
        """Whether texture look-ups need random numbers."""
        return self.filter is not None and self.filter.name == "stochastic"

    def prepare_shading(self) -> None:
        """Makes the tables of materials and lights, which cannot be made inside a symbolic loop."""
        _ = self._material_of

    @functools.cached_property
    def _tables(self) -> tuple[MaterialTable, LightTable]:
        meshes = {k: s for k, s in enumerate(self._shapes) if isinstance(s, description.MeshShape) and s.attributes}
        textures = TextureTable(self.types, meshes, self.filter)
        emitting = [(k, s) for k, s in enumerate(self._shapes) if s.emitter is not None]
        lights = LightTable.build(
            self.description.lights, emitting, textures, self.structure.geometry.bounds(), self.types
        )
        unique = {id(s.bsdf): s.bsdf for s in self._shapes} or {0: description.DiffuseBsdf()}
        materials = MaterialTable.build(list(unique.values()), self.types, textures)
        textures.finish()
        return materials, lights

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
