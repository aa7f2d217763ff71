"""Steps from a curve, on the film or elsewhere, to either side of it, so large that rounding takes neither across."""

from __future__ import annotations

from typing import Any

import drjit as dr

from ..film import Film
from ..rays.film_map import FilmMap

#: Steps are so many times the rounding of the coordinates involved: across silhouettes, where what is round shows that
#: they are steps by the root of their size; and across shadows, to which rays go by a surface.
CLEARANCE = 32
SHADOW_CLEARANCE = 256
#: Of the way to a curve, how much of its end is not searched for what hides it, and how far from it what is met there
#: may be. What lies there and hides both sides is found when the light of both is the same.
NEAR = 0.01


def across(film: Film, tangent: tuple[Any, Any]) -> tuple[Any, Any]:
    """The vector in pixels across a curve whose film position changes by ``tangent`` (two Floats), as long as it."""
    Float = type(tangent[0])
    return tangent[1] * dr.opaque(Float, film.height), -tangent[0] * dr.opaque(Float, film.width)


def steps(film: Film, across: tuple[Any, Any]) -> tuple[Any, Any]:
    """The film positions by which one pixel along ``across`` goes on."""
    Float = type(across[0])
    length = dr.sqrt(across[0] * across[0] + across[1] * across[1])
    inverse = dr.rcp(dr.select(length > 0, length, 1))
    return across[0] * inverse * dr.opaque(Float, 1 / film.width), across[1] * inverse * dr.opaque(
        Float, 1 / film.height
    )


def pixels(film: Film, position: tuple[Any, Any]) -> tuple[Any, Any]:
    """A film position (two Floats) in pixels."""
    Float = type(position[0])
    return position[0] * dr.opaque(Float, film.width), position[1] * dr.opaque(Float, film.height)


def lateral(view: FilmMap, step: tuple[Any, Any], depth: Any) -> Any:
    """How a point seen at ``depth`` moves beside the rays where its film position moves by ``step``."""
    return (view.du * step[0] + view.dv * step[1]) * depth


def reach(*points: Any) -> Any:
    """The largest coordinate of ``points``."""
    largest = [dr.fmax(dr.fmax(dr.abs(p.x), dr.abs(p.y)), dr.abs(p.z)) for p in points]
    found = largest[0]
    for other in largest[1:]:
        found = dr.fmax(found, other)
    return found


def clear_of_rounding(moved: Any, plane: Any, reach: Any, rounding: float) -> Any:
    """How many steps, each of which moves a ray by ``moved`` where it passes a curve, take it so far from the plane of
    normal ``plane`` (of any length) through eye and curve that a ``rounding`` of coordinates up to ``reach`` is nothing
    to it."""
    size = dr.norm(plane)
    per_step = dr.abs(dr.dot(moved, plane)) / dr.select(size > 0, size, 1)
    return reach * rounding / per_step
