"""What every shape of bounding volume has in common, and what all their tests need of a ray."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from ...types import Types, types_of
from .hulls import Hulls

#: In units of the round-off, what the rounding of a volume test (fewer than 16), of a primitive test (fewer than 10)
#: and the clamping of a direction (1) add up to, relative to the *reach*: the sum over the world's axes of the
#: distances from the ray's origin to the far side of the volume. Every volume is widened by as much before it is
#: tested.
ERROR = 32


@dataclass
class VolumeRay:
    """Per ray: origin, direction as the tests take it, and what they derive from it once.

    ``least`` is the size below which a component of the direction counts as zero; ``scale`` the unit of t.
    """

    o: Any
    d: Any
    inverse: Any
    size: Any
    least: Any
    scale: Any
    tmin: Any


@dataclass(frozen=True)
class Volume:
    """One shape of bounding volume.

    ``fit(hulls, types)`` gives the ``words`` (groups, width), in the working precision, of a volume around each
    group, whatever the rounding; ``meets(words, ray, tmax)`` tells, inside a symbolic loop, whether each ray may meet
    anything in the volume of those words between its tmin and ``tmax``; ``areas(words)`` gives surface areas
    (groups,). ``prepare(ray, types)`` makes the :class:`VolumeRay`.
    """

    width: int
    fit: Callable[[Hulls, Types], np.ndarray]
    prepare: Callable[[Any, Types], VolumeRay]
    meets: Callable[[list[Any], VolumeRay, Any], Any]
    areas: Callable[[np.ndarray], np.ndarray]


def volume_ray(ray: Any, types: Types) -> VolumeRay:
    """The direction with no component so small that its reciprocal overflows, and those reciprocals.

    A component this much smaller than the largest moves the ray by less than volumes are widened.
    """
    d = ray.d
    size = abs(d)
    largest = dr.fmax(dr.fmax(size.x, size.y), size.z)
    least = largest * types.epsilon
    clamped = type(d)(*(dr.select(s < least, dr.copysign(least, c), c) for s, c in zip(size, d, strict=True)))
    inverse = dr.rcp(clamped)
    return VolumeRay(ray.o, d, inverse, abs(inverse), least, largest, ray.tmin)


def relative_error(ray: VolumeRay) -> float:
    """By how much volumes are widened, relative to the reach."""
    return ERROR * types_of(ray.o).epsilon


def round_up(values: np.ndarray, types: Types) -> np.ndarray:
    """``values`` (not negative) in the working precision, with room for what their own computation in float64
    rounded."""
    widened = np.asarray(values * (1 + 64 * 2.0**-53)).astype(types.numpy)
    infinity = np.asarray(np.inf, dtype=types.numpy)
    return np.nextafter(widened, infinity)
