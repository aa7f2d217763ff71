"""Spheres, rectangles, disks and cylinders: a canonical shape under an affine map."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from ..arguments import positive_number, real_array
from ..errors import GeometryError
from ..types import Types
from . import record
from .primitives import Primitives
from .surface import Surface
from .transforms import checked_transform, transform_box


@dataclass(frozen=True, eq=False)
class Quadric(Surface):
    """A canonical shape under ``to_world`` (4, 4), which may mirror. ``flip_normals`` turns the normal round."""

    to_world: Any = field(default_factory=lambda: np.eye(4))
    flip_normals: bool = False
    name: str = field(default="", kw_only=True)

    KIND: ClassVar[int]
    LOCAL_BOUNDS: ClassVar[tuple[tuple[float, float, float], tuple[float, float, float]]]

    def __post_init__(self) -> None:
        if not self.name:
            object.__setattr__(self, "name", record.KIND_NAMES[self.KIND])
        object.__setattr__(self, "to_world", checked_transform(self.to_world, self.name))

    @property
    def primitive_count(self) -> int:
        return 1

    def primitives(self, types: Types, first_id: int = 0) -> Primitives:
        lo, hi = self._world_bounds()
        # The ray test works on a rounded inverse of to_world: widen by what that rounding can move the surface.
        margin = 32 * types.epsilon * (np.abs(self.to_world[:3]).sum() + np.abs(hi - lo).max())
        records = record.make_records(self._geometry()[None], np.array([first_id]), self.KIND, types)
        bounds = (lo - margin).astype(types.numpy), (hi + margin).astype(types.numpy)
        return Primitives(types, records, bounds[0][None], bounds[1][None], (self.KIND,))

    def _world_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        return transform_box(self.to_world, np.array(self.LOCAL_BOUNDS[0]), np.array(self.LOCAL_BOUNDS[1]))

    def _geometry(self) -> np.ndarray:
        """The record's geometry words: rows of the linear part of the world-to-local map, each with a component of the
        centre. (The inverse's own translation is rounded to the digits of the distance from the world's origin.)"""
        return np.column_stack([np.linalg.inv(self.to_world[:3, :3]), self.to_world[:3, 3]]).ravel()


@dataclass(frozen=True, eq=False)
class Sphere(Quadric):
    """The unit sphere under ``to_world``, which may rotate, scale evenly and translate; or :meth:`at` a centre.

    Its normals point outwards, mirrored or not. (Mitsuba turns them round where ``to_world`` mirrors.)
    """

    KIND = record.SPHERE
    LOCAL_BOUNDS = ((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0))

    def __post_init__(self) -> None:
        super().__post_init__()
        linear = self.to_world[:3, :3]
        gram = linear.T @ linear
        if not np.allclose(gram, np.eye(3) * gram[0, 0], rtol=1e-4, atol=1e-4 * gram[0, 0]):
            raise GeometryError(f"{self.name}: to_world must scale a sphere evenly in all directions")

    @staticmethod
    def at(center: Any = (0.0, 0.0, 0.0), radius: float = 1.0, *, flip_normals: bool = False) -> Sphere:
        """The sphere of ``radius`` about ``center``."""
        radius = positive_number(radius, "sphere: the radius")
        place = real_array(center, "sphere: the centre").astype(np.float64)
        if place.size != 3 or place.ndim > 2:
            raise GeometryError(f"sphere: the centre must be three numbers, not of shape {place.shape}")
        matrix = np.diag([radius, radius, radius, 1.0])
        matrix[:3, 3] = place.ravel()
        return Sphere(matrix, flip_normals)

    @property
    def center(self) -> np.ndarray:
        """The centre (3,)."""
        return self.to_world[:3, 3]

    @property
    def radius(self) -> float:
        """The radius."""
        return float(np.sqrt(np.square(self.to_world[:3, :3]).sum() / 3))

    def _world_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        return self.center - self.radius, self.center + self.radius

    def _geometry(self) -> np.ndarray:
        return np.array([*self.center, self.radius])


@dataclass(frozen=True, eq=False)
class Rectangle(Quadric):
    """[-1, 1]^2 in the local plane z = 0; the normal is local +z."""

    KIND = record.RECTANGLE
    LOCAL_BOUNDS = ((-1.0, -1.0, 0.0), (1.0, 1.0, 0.0))


@dataclass(frozen=True, eq=False)
class Disk(Quadric):
    """The unit disk in the local plane z = 0; the normal is local +z."""

    KIND = record.DISK
    LOCAL_BOUNDS = ((-1.0, -1.0, 0.0), (1.0, 1.0, 0.0))

    def _world_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        reach = np.sqrt(np.square(self.to_world[:3, :2]).sum(axis=1))
        return self.to_world[:3, 3] - reach, self.to_world[:3, 3] + reach


@dataclass(frozen=True, eq=False)
class Cylinder(Quadric):
    """The open cylinder of unit radius about local z, from z = 0 to z = 1; its normals point outwards."""

    KIND = record.CYLINDER
    LOCAL_BOUNDS = ((-1.0, -1.0, 0.0), (1.0, 1.0, 1.0))

    def _world_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        reach = np.sqrt(np.square(self.to_world[:3, :2]).sum(axis=1))
        ends = np.stack([self.to_world[:3, 3], self.to_world[:3, 3] + self.to_world[:3, 2]])
        return ends.min(axis=0) - reach, ends.max(axis=0) + reach
