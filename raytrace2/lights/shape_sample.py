"""A point on a light's surface as seen from a reference point: what sampling each kind of shape gives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from .sample import towards


@dataclass
class ShapeSample:
    """``p`` Array3f on the surface; ``d`` and ``dist`` lead to it; ``pdf`` Float per steradian and its ``inverse``
    (each may be 0 or infinite); ``front`` Bool: the emitting side is seen; ``uv`` Array2f surface coordinates, zeros
    where no light needs them."""

    p: Any
    d: Any
    dist: Any
    pdf: Any
    inverse: Any
    front: Any
    uv: Any


def from_area(reference: Any, p: Any, n: Any, side: Any, area: Any, uv: Any) -> ShapeSample:
    """The sample at ``p``, chosen with density ``1 / area``, where the unit geometric normal is ``n`` and light leaves
    towards ``side`` (a normal of any length)."""
    d, dist = towards(reference, p)
    inverse = solid_angle(area, d, dist, n)
    return ShapeSample(p, d, dist, dr.rcp(inverse), inverse, dr.dot(d, side) < 0, uv)


def solid_angle(area: Any, d: Any, dist: Any, n: Any) -> Any:
    """The solid angle of ``area`` with unit normal ``n`` seen along ``d`` from ``dist`` away, to first order."""
    inverse = dr.rcp(dist)
    return (area * inverse) * (dr.abs(dr.dot(d, n)) * inverse)
