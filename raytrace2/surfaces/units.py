"""Powers of two taken out of lengths and directions: exact, and then nothing overflows or vanishes on the way.

Squares and products of lengths leave the range of float32 beyond 2^60 and below 2^-60 or so. A structure whose
geometry is so large or so small holds it divided by a power of two, and meets each ray in the same unit; results have
the same bits as at a benign scale. Rays from far away are met as if from near.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import numpy as np

from ..types import Types, types_of
from . import record
from .compensated import point_on_ray
from .magnitude import powers_of_two
from .primitives import LocalRay, Primitives

#: Geometry that reaches between 2^-BENIGN and 2^BENIGN stays as it is.
BENIGN = 16

#: Origins so many radii away from what there is to meet are moved near it.
FAR = 32


def exponent_of(lo: np.ndarray, hi: np.ndarray) -> int:
    """The power of two to take out of geometry between the corners ``lo`` and ``hi`` (3,); 0 where none needs to be."""
    reach = float(np.abs([lo, hi]).max())
    if not (np.isfinite(reach) and reach > 0):
        return 0
    exponent = int(np.frexp(reach)[1])
    return 0 if abs(exponent) <= BENIGN else exponent


def scaled(parts: Primitives, exponent: int) -> Primitives:
    """``parts``, given in units of one, in units of 2^``exponent``; the ways into nested structures with them."""
    if exponent == 0 and not parts.nested:
        return parts
    factor = 2.0**-exponent
    records = parts.records.copy()
    codes = np.ascontiguousarray(records[:, record.KIND])
    words = codes.view(np.uint32) if parts.types.precision == "float32" else codes.astype(np.uint32)
    kinds, places = words % 8, words // 8
    lengths = np.isin(kinds, (record.TRIANGLE, record.SPHERE))
    records[lengths, : record.GEOMETRY] *= factor
    # Rows of maps from the world: from lengths in the new unit.
    maps = np.isin(kinds, (record.RECTANGLE, record.DISK, record.CYLINDER, record.INSTANCE))
    for row in range(3):
        records[maps, 4 * row : 4 * row + 3] /= factor
        # Those of an instance end in a translation after the map, the others in a component of their centre.
        records[maps & (kinds != record.INSTANCE), 4 * row + 3] *= factor
    for place, structure in enumerate(parts.nested):
        inside = (kinds == record.INSTANCE) & (places == place)
        records[inside, : record.GEOMETRY] *= 2.0**-structure.exponent
    return replace(parts, records=records, lo=parts.lo * factor, hi=parts.hi * factor, exponent=exponent)


@dataclass(frozen=True, eq=False)
class Units:
    """How a structure holds lengths, in units of 2^``exponent``, and a ball around what it holds: ``ball`` has the
    centre and the radius on the device, and is None where there is nothing."""

    exponent: int
    ball: tuple[Any, Any] | None

    @staticmethod
    def of(lo: np.ndarray, hi: np.ndarray, exponent: int, types: Types) -> Units:
        """Around the box between the corners ``lo`` and ``hi`` (3,), in lengths of one."""
        if not (np.isfinite(lo).all() and np.isfinite(hi).all()):
            return Units(exponent, None)
        factor = 2.0**-exponent
        low, high = lo.astype(np.float64) * factor, hi.astype(np.float64) * factor
        center = types.Array3f(*(dr.opaque(types.Float, float(x)) for x in (low + high) / 2))
        return Units(exponent, (center, dr.opaque(types.Float, max(float(np.linalg.norm(high - low)) / 2, 1e-30))))

    def enter(self, ray: Any, farthest: Any) -> tuple[LocalRay, Callable[[Any], Any]]:
        """``ray`` up to ``farthest`` as the structure meets it, and what makes t of that ray t of ``ray``.

        The direction is 1 to 2 in its largest component. An origin that is :data:`FAR` radii away is moved near along
        the ray, in twice the digits: from afar, all that is met would be as small as the rounding of its distance.
        """
        size, inverse = powers_of_two(ray.d)
        o, d, tmin, tmax = ray.o, ray.d * inverse, ray.tmin, farthest
        if self.exponent:
            factor = 2.0**-self.exponent
            o, tmin, tmax = o * factor, tmin * factor, tmax * factor
        tmin, tmax = tmin * size, tmax * size
        way: Any = 0
        if self.ball is not None:
            center, radius = self.ball
            way = _way_near(o, d, center, radius)
            point, _ = point_on_ray(list(o), [0, 0, 0], list(d), way)
            o, tmin, tmax = type(o)(*point), tmin - way, tmax - way
        largest = types_of(ray.o).largest

        def back(t: Any) -> Any:
            t = t + way
            # In the order in which nothing overflows that does not do so in the end.
            if self.exponent < 0:
                t = t * 2.0**self.exponent
            t = t * inverse
            return t * 2.0**self.exponent if self.exponent > 0 else t

        return LocalRay(o, d, tmin, dr.select(tmax > largest, largest, tmax)), back


def _way_near(o: Any, d: Any, center: Any, radius: Any) -> Any:
    """How far along a ray an origin that is far from the ball is moved: to about two radii before the place nearest to
    its centre; 0 for all others."""
    f = center - o
    per_square = dr.rcp(dr.squared_norm(d))
    way = dr.dot(f, d) * per_square - 2 * radius * dr.sqrt(per_square)
    return dr.select((dr.squared_norm(f) > dr.square(FAR * radius)) & (way > 0) & dr.isfinite(way), way, 0)
