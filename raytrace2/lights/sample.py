"""What sampling a light gives, and the arithmetic that every kind of light shares."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from ..types import types_of


@dataclass
class LightSample:
    """A direction from a reference point towards a light, one a lane.

    Every number is finite; where ``pdf`` is 0 so is ``weight``. ``d`` Array3f unit direction in world coordinates;
    ``dist`` Float distance to ``p`` Array3f, which lies outside the scene for infinite lights; ``weight`` Array3f
    radiance over density (irradiance for delta lights); ``pdf`` Float density per steradian (for delta lights 1), both
    with the choice of the light; ``delta`` Bool: no other technique can find this direction.
    """

    d: Any
    dist: Any
    weight: Any
    pdf: Any
    delta: Any
    p: Any


def towards(origin: Any, target: Any) -> tuple[Any, Any]:
    """The unit vector from ``origin`` to ``target`` and their distance; zeros where the two coincide.

    The offset is scaled by its largest component before it is squared, so that no distance overflows or underflows.
    """
    offset = target - origin
    largest = dr.fmax(dr.fmax(dr.abs(offset.x), dr.abs(offset.y)), dr.abs(offset.z))
    apart = largest > _smallest_normal(largest)
    scaled = offset * dr.select(apart, dr.rcp(dr.select(apart, largest, 1)), 0)
    length2 = dr.squared_norm(scaled)
    inverse = dr.rsqrt(dr.select(apart, length2, 1))
    return scaled * inverse, largest * length2 * inverse


def finite_or_zero(weight: Any, pdf: Any, active: Any) -> tuple[Any, Any]:
    """``(weight, pdf)`` where ``active`` and both are representable and ``pdf > 0``, else zeros.

    What is lost are directions in which the light is met at a distance, or at an angle, too small for a density.
    """
    types = types_of(pdf)
    ok = active & (pdf > 0) & (pdf <= types.largest)
    for component in weight:
        ok &= dr.abs(component) <= types.largest
    return dr.select(ok, weight, 0), dr.select(ok, pdf, 0)


def pack(rows: Any, types: Any) -> Any:
    """A NumPy array of records, each a multiple of 4 numbers long, as one evaluated Float buffer for packet gathers."""
    import numpy as np

    buffer = types.Float(np.ascontiguousarray(rows, dtype=types.numpy).ravel())
    # Adding an opaque zero copies the data into memory that Dr.Jit allocated and aligned itself.
    buffer = buffer + dr.opaque(types.Float, 0)
    dr.eval(buffer)
    return buffer


def _smallest_normal(value: Any) -> float:
    # Reciprocals of anything larger stay finite.
    return 4.0 / types_of(value).largest
