"""What a procedural scene is: surfaces, and a view from which they can be seen."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, overload

import numpy as np

from ...surfaces.surface import Surface
from ..description import Film, PerspectiveCamera

Point = tuple[float, float, float]


@dataclass(frozen=True)
class View:
    """A pinhole at ``eye`` that looks at ``target``, ``x_fov`` degrees wide; z is up unless ``up`` says otherwise."""

    eye: Point
    target: Point
    x_fov: float = 45.0
    up: Point = (0.0, 0.0, 1.0)

    @property
    def to_world(self) -> np.ndarray:
        """The 4x4 matrix from camera space (x left, y up, z forward) to the world."""
        eye = np.array(self.eye)
        forward = np.array(self.target) - eye
        forward /= np.linalg.norm(forward)
        left = np.cross(self.up, forward)
        left /= np.linalg.norm(left)
        matrix = np.eye(4)
        matrix[:3, :] = np.stack([left, np.cross(forward, left), forward, eye], axis=1)
        return matrix

    def camera(self, width: int = 768, height: int = 576) -> PerspectiveCamera:
        """The camera of a scene description, for an image of that size."""
        film = Film(width=width, height=height, crop_width=width, crop_height=height)
        return PerspectiveCamera(to_world=self.to_world, x_fov=self.x_fov, film=film)

    def rays(self, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
        """Origins and directions (width * height, 3) through the middles of pixels, row by row from the top left."""
        half = np.tan(np.radians(self.x_fov) / 2)
        x = (1 - 2 * (np.arange(width) + 0.5) / width) * half
        y = (1 - 2 * (np.arange(height) + 0.5) / height) * half * height / width
        local = np.stack([*np.meshgrid(x, y), np.ones((height, width))], axis=-1).reshape(-1, 3)
        matrix = self.to_world
        return np.broadcast_to(matrix[:3, 3], local.shape).copy(), local @ matrix[:3, :3].T


@dataclass(frozen=True, eq=False)
class ProceduralScene(Sequence[Surface]):
    """A sequence of ``surfaces``, to be given to ``rt.accel.build`` as it is, with a ``view`` of them."""

    name: str
    surfaces: tuple[Surface, ...]
    view: View

    @property
    def primitive_count(self) -> int:
        """How many primitives the surfaces have in all."""
        return sum(surface.primitive_count for surface in self.surfaces)

    def __len__(self) -> int:
        return len(self.surfaces)

    @overload
    def __getitem__(self, index: int) -> Surface: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Surface]: ...
    def __getitem__(self, index: Any) -> Any:
        return self.surfaces[index]

    def __iter__(self) -> Iterator[Surface]:
        return iter(self.surfaces)
