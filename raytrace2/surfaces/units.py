"""Powers of two taken out of lengths and directions: exact, and then nothing overflows or vanishes on the way.

Squares and products of lengths leave the range of float32 beyond 2^60 and below 2^-60 or so. A structure whose
geometry is so large or so small holds it divided by a power of two, and meets each ray in the same unit; results have
the same bits as at a benign scale.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import drjit as dr
import numpy as np

from ..types import types_of
from . import record
from .magnitude import powers_of_two
from .primitives import LocalRay, Primitives

#: Geometry that reaches between 2^-BENIGN and 2^BENIGN stays as it is.
BENIGN = 16


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


def into_units(ray: Any, farthest: Any, exponent: int) -> tuple[LocalRay, Any]:
    """``ray`` up to ``farthest`` in units of 2^``exponent`` and with a direction from 1 to 2 in its largest component,
    and what to multiply its t by to have that of ``ray``."""
    size, inverse = powers_of_two(ray.d)
    o, tmin, tmax, back = ray.o, ray.tmin, farthest, inverse
    if exponent:
        factor = 2.0**-exponent
        o, tmin, tmax, back = o * factor, tmin * factor, tmax * factor, back * 2.0**exponent
    largest = types_of(ray.o).largest
    tmax = tmax * size
    return LocalRay(o, ray.d * inverse, tmin * size, dr.select(tmax > largest, largest, tmax)), back
