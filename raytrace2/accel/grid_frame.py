"""A ray in the coordinates of a grid: when it crosses which wall, and the cell that it is in.

Along a ray, time is counted as s = t |d| scale, with |d| the largest component of its direction and ``scale`` from the
grids' coordinates, so that no wall is crossed at a time out of range however long or short d is. Positions and times
are computed from a cell's place, never summed up from step to step: no error grows on the way.

With round-off e and a ray whose origin is at most R (the sum over the axes) from a grid's farthest corner, a position
or a wall at a given time is off by less than 8 e R, a hit's position by less than 20 e R, and the least component to
which a direction is clamped adds at most e R: together less than :data:`ERROR` e R. Cells are filled as though they
were larger by as much for R up to :data:`NEAR` times the sum of the sides of the box around all; rays from beyond that
walk all cells of a beam (:mod:`.grid_beam`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from ..surfaces import record
from ..surfaces.ordered import greater, lesser
from ..types import Types
from .grid_lattice import CELLS, CORNER, FIRST, PARENT, PER_STEP, PLACE, STEP, WORDS

ERROR = 32
NEAR = 16


@dataclass
class WalkRay:
    """A ray in the coordinates that all grids share: origin, direction with a largest component of 1 in size, its
    reciprocal, and what turns t into s: ``length`` and then ``scale``."""

    o: Any
    d: Any
    inverse: Any
    negative: Any
    length: Any
    scale: Any
    start: Any

    def time(self, t: Any) -> Any:
        """s at ``t``."""
        return t * self.length * self.scale


@dataclass
class Frame:
    """A grid as one ray sees it, in units of cells: the wall at w along axis k is crossed at s = w ``slope[k]`` +
    ``base[k]``, and at s the ray is at s ``speed[k]`` + ``origin[k]``; ``per_step[k]`` cells make a unit of length."""

    slope: list[Any]
    base: list[Any]
    speed: list[Any]
    origin: list[Any]
    per_step: list[Any]
    cells: list[Any]
    first: Any
    parent: Any
    place: Any

    def position(self, axis: int, s: Any) -> Any:
        """Where the ray is along ``axis`` at ``s``."""
        return dr.fma(s, self.speed[axis], self.origin[axis])

    def crossing(self, axis: int, wall: Any) -> Any:
        """When it crosses ``wall`` of ``axis``."""
        return dr.fma(wall, self.slope[axis], self.base[axis])

    def cell_at(self, s: Any) -> list[Any]:
        """The cell where the ray is at ``s``, or the nearest to there; also for NaN."""
        return [clamp(dr.floor(self.position(k, s)), self.cells[k]) for k in range(3)]


def clamp(place: Any, cells: Any) -> Any:
    """``place`` within a grid of ``cells``."""
    return lesser(greater(place, type(place)(0)), cells - 1)


def walk_ray(ray: Any, origin: Any, scale: Any, types: Types) -> WalkRay:
    """``ray`` in the coordinates x -> (x - ``origin``) ``scale``."""
    size = abs(ray.d)
    length = dr.fmax(dr.fmax(size.x, size.y), size.z)
    d = ray.d / length
    # Smaller components move the ray by less than the error bound; so no reciprocal is infinite.
    least = types.epsilon
    d = type(d)(*(dr.select(abs(c) < least, dr.copysign(types.Float(least), c), c) for c in d))
    start = ray.tmin * length * scale
    return WalkRay((ray.o - origin) * scale, d, dr.rcp(d), [c < 0 for c in d], length, scale, start)


def frame_of(ray: WalkRay, lattices: Any, grid: Any, types: Types) -> Frame:
    """Grid number ``grid`` as ``ray`` sees it."""
    packet = dr.gather(types.ArrayXf, lattices, grid, shape=(WORDS, dr.width(grid)))
    corner, step, per_step = ([packet[w + k] for k in range(3)] for w in (CORNER, STEP, PER_STEP))
    offset = [ray.o[k] - corner[k] for k in range(3)]
    return Frame(
        [step[k] * ray.inverse[k] for k in range(3)],
        [-offset[k] * ray.inverse[k] for k in range(3)],
        [ray.d[k] * per_step[k] for k in range(3)],
        [offset[k] * per_step[k] for k in range(3)],
        per_step,
        [packet[CELLS + k] for k in range(3)],
        *(record.decode_integer(packet[w], types) for w in (FIRST, PARENT, PLACE)),
    )


def unpack_place(place: Any, types: Types) -> list[Any]:
    """The three cell indices in a word of ten bits each."""
    return [types.Float((place >> (10 * k)) & 1023) for k in range(3)]
