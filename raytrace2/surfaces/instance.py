"""Instances: one structure, met in many places."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..errors import GeometryError
from ..types import Types
from . import record
from .primitives import Primitives
from .structure import Structure
from .surface import Surface
from .transforms import checked_transform, transform_box


@dataclass(frozen=True, eq=False)
class Instance(Surface):
    """A copy of ``structure`` (an acceleration structure over the shapes of a group) under ``to_world`` (4, 4).

    Many instances share one structure in memory. Instances do not nest.
    """

    structure: Structure
    to_world: Any = field(default_factory=lambda: np.eye(4))
    name: str = field(default="instance", kw_only=True)

    def __post_init__(self) -> None:
        if not isinstance(self.structure, Structure):
            raise GeometryError(f"{self.name}: an instance is of a structure; build one over the surfaces first")
        if self.structure.has_instances:
            raise GeometryError(f"{self.name}: instances do not nest; give the shapes of the inner one directly")
        object.__setattr__(self, "to_world", checked_transform(self.to_world, self.name))

    @property
    def primitive_count(self) -> int:
        return 1

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        return transform_box(self.to_world, *self.structure.bounds())

    def placed(self, types: Types, *, id_offset: int, number: int, place: int) -> Primitives:
        """The record that leads into the structure: ``id_offset`` is added to the numbers of its primitives,
        ``number`` is the instance's own, ``place`` the structure's position among the nested ones."""
        lo, hi = self.bounds()
        reach = np.abs(self.structure.bounds()).max()
        margin = 32 * types.epsilon * (np.abs(self.to_world[:3, :3]).sum() * reach + np.abs(self.to_world[:3, 3]).sum())
        geometry = np.linalg.inv(self.to_world)[:3].ravel()[None]
        records = record.make_records(geometry, np.array([id_offset]), record.INSTANCE + 8 * place, types, np.zeros(1))
        records[:, record.INSTANCE_NUMBER] = record.encode_integers(np.array([number]), types)
        bounds = (lo - margin).astype(types.numpy)[None], (hi + margin).astype(types.numpy)[None]
        return Primitives(types, records, *bounds, (record.INSTANCE,), (self.structure,))
