"""Which primitives meet which cells: counted and then listed by one kernel each, a lane a primitive.

A primitive is met by the cells that its box meets, a triangle only by those that its plane meets too (by separating
axes: Akenine-Moeller, "Fast 3D triangle-box overlap testing", 2001). The nine axes across the edges are left out on
purpose. To a ray in or near its plane a triangle is edge-on, and the weights of its corners, from which t is
interpolated, are rounding errors: the hit that every structure must find may lie in the plane beside the triangle.

How far from the plane may it lie? With round-off e, a triangle of longest side L and area A, and an origin at most R
away, corners as the ray test sees them are within 4 e R of where they are, which tilts the plane and at a distance of L
from the triangle moves it by at most 4 e R (1 + 2 L^2 / A); edge functions are within 2 e L^2 of the truth each, which
moves the hit off the plane by at most 4 e L L^2 / A, and the normal below is as exact as that. :data:`PLANE_ERROR` e
(R + L) (1 + 2 L^2 / A) is more than their sum.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from ..buffers import owned
from ..surfaces import record
from ..surfaces.primitives import DevicePrimitives, Primitives
from ..types import Types
from .grid_lattice import CELLS, CORNER, FIRST, PER_STEP, STEP, WORDS

#: In units of the round-off; see above.
PLANE_ERROR = 8


@dataclass(frozen=True, eq=False)
class Subjects:
    """Primitives to be put into cells, on the device: records, boxes (None if all are triangles), and the map to the
    grids' coordinates, x -> (x - ``origin``) ``scale``. ``reach`` and ``margin`` are in those."""

    types: Types
    primitives: DevicePrimitives
    boxes: Any
    origin: Any
    scale: Any
    reach: Any
    margin: Any

    @staticmethod
    def make(
        parts: Primitives, device: DevicePrimitives, origin: np.ndarray, scale: float, reach: float, margin: float
    ) -> Subjects:
        """``reach``: the farthest origin (R above); ``margin``: by how much a cell is widened, for all other errors."""
        types = parts.types
        boxes = None
        if parts.kinds != (record.TRIANGLE,):
            words = np.zeros((len(parts), 8), types.numpy)
            words[:, :3], words[:, 3:6] = parts.lo, parts.hi
            boxes = owned(words, types.Float)
        opaque = [dr.opaque(types.Float, float(x)) for x in (*origin, scale, reach, margin)]
        return Subjects(types, device, boxes, types.Array3f(*opaque[:3]), *opaque[3:])

    def corners(self, prim: Any) -> tuple[tuple[Any, Any, Any], Any, Any, Any]:
        """Of primitives by number: the three corners, if they are triangles; opposite corners of their boxes; and
        whether they are triangles. In the grids' coordinates."""
        types = self.types
        Vector = types.Array3f
        words = record.load_words(self.primitives.buffer, prim, types)
        a, b, c = ((Vector(words[k : k + 3]) - self.origin) * self.scale for k in (0, 3, 6))
        if self.boxes is None:
            return (a, b, c), dr.fmin(dr.fmin(a, b), c), dr.fmax(dr.fmax(a, b), c), types.Bool(True)
        box = dr.gather(types.ArrayXf, self.boxes, prim, shape=(8, dr.width(prim)))
        lo, hi = ((Vector(box[k], box[k + 1], box[k + 2]) - self.origin) * self.scale for k in (0, 3))
        return (a, b, c), lo, hi, record.decode_integer(words[record.KIND], types) == record.TRIANGLE


@dataclass
class _Span:
    """The cells that a primitive's box meets, as floats, and its plane in units of cells: cell (i, j, k) meets it where
    |normal . (i, j, k) + offset| <= radius."""

    low: list[Any]
    high: list[Any]
    normal: list[Any]
    offset: Any
    radius: Any
    tilt: Any
    cells: list[Any]
    first: Any


def overlaps(subjects: Subjects, lattices: Any, prim: Any, grid: Any, most: int) -> tuple[np.ndarray, float] | None:
    """Every pair of a cell and a primitive that meet, as uint64 numbers with the cell in the upper half, and the
    largest 2 L^2 / A of triangles that their plane may have kept out of a cell. None if there are more than ``most``.

    ``prim`` and ``grid`` (n,) UInt are the primitives and the grids that each is put into; ``lattices`` their words.
    """
    types = subjects.types
    UInt, Float = types.UInt, types.Float
    span = _span(subjects, lattices, prim, grid)
    zero = dr.zeros(UInt, dr.width(prim))

    def count_row(i: Any, j: Any, found: Any) -> tuple[Any, ...]:
        begin, end = _row(span, i, j)
        wraps = j >= span.high[1]
        i, j = dr.select(wraps, i + 1, i), dr.select(wraps, span.low[1], j + 1)
        return i, j, found + UInt(dr.fmax(end - begin + 1, 0))

    start = (Float(span.low[0]), Float(span.low[1]), zero)
    *_, found = dr.while_loop(start, lambda i, *_: i <= span.high[0], count_row, labels=("i", "j", "found"))
    # At once, for each reduction evaluates what it is asked for in a kernel of its own.
    dr.eval(found, span.tilt)
    tilt, count = dr.max(span.tilt), dr.sum(types.UInt64(found))
    dr.eval(tilt, count)
    total = int(count[0])
    if total > most:
        return None
    if total == 0:
        return np.zeros(0, np.uint64), 0.0
    pairs = dr.empty(types.UInt64, total)
    low = types.UInt64(prim)
    place = dr.cumsum(found) - found
    dr.eval(place)

    def write(i: Any, j: Any, k: Any, end: Any, at: Any) -> tuple[Any, ...]:
        here = k <= end
        cell = span.first + UInt(dr.fma(dr.fma(i, span.cells[1], j), span.cells[2], k))
        dr.scatter(pairs, (types.UInt64(cell) << 32) | low, at, here)
        at, k = dr.select(here, at + 1, at), k + 1
        over = k > end
        wraps = j >= span.high[1]
        i = dr.select(over & wraps, i + 1, i)
        j = dr.select(over, dr.select(wraps, span.low[1], j + 1), j)
        begin, next_end = _row(span, i, j)
        return i, j, dr.select(over, begin, k), dr.select(over, next_end, end), at

    begin, end = _row(span, span.low[0], span.low[1])
    labels = ("i", "j", "k", "end", "at")
    dr.while_loop((*start[:2], begin, end, place), lambda i, *_: i <= span.high[0], write, labels=labels)
    return pairs.numpy(), float(tilt[0])


def _span(subjects: Subjects, lattices: Any, prim: Any, grid: Any) -> _Span:
    types = subjects.types
    Float, Vector = types.Float, types.Array3f
    packet = dr.gather(types.ArrayXf, lattices, grid, shape=(WORDS, dr.width(grid)))
    lattice = [Vector(packet[w], packet[w + 1], packet[w + 2]) for w in (CORNER, STEP, PER_STEP, CELLS)]
    corner, step, per_step, cells = lattice
    (a, b, c), lo, hi, flat = subjects.corners(prim)
    low = dr.fmin(dr.fmax(dr.floor((lo - subjects.margin - corner) * per_step), 0), cells - 1)
    high = dr.fmin(dr.fmax(dr.floor((hi + subjects.margin - corner) * per_step), 0), cells - 1)

    p, q = b - a, c - a
    normal = dr.cross(p, q)
    twice_area = dr.norm(normal)
    longest = dr.fmax(dr.fmax(dr.squared_norm(p), dr.squared_norm(q)), dr.squared_norm(c - b))
    side = dr.sqrt(longest)
    error = (PLANE_ERROR * types.epsilon) * (subjects.reach + side) * (twice_area + 4 * longest)
    size = abs(normal)
    widest = dr.fmax(dr.fmax(step.x, step.y), step.z)
    # A triangle that is nearly a line has no plane to speak of, and one in few cells little to gain.
    flat &= (error < widest * twice_area) & dr.any(high > low)
    radius = dr.dot(size, dr.fma(step, 0.5, subjects.margin)) + error
    offset = dr.dot(normal, (corner - a) + step * 0.5)
    normal *= step
    return _Span(
        [low[k] for k in range(3)],
        [high[k] for k in range(3)],
        [dr.select(flat, normal[k], 0) for k in range(3)],
        dr.select(flat, offset, 0),
        dr.select(flat, radius, 1),
        dr.select(flat, 4 * longest / twice_area, 0) + Float(0),
        [cells[k] for k in range(3)],
        record.decode_integer(packet[FIRST], types),
    )


def _row(span: _Span, i: Any, j: Any) -> tuple[Any, Any]:
    """The first and the last cell of row (i, j) that are met; the first is the larger if none are."""
    middle = dr.fma(i, span.normal[0], dr.fma(j, span.normal[1], span.offset))
    slope = span.normal[2]
    # Where the slope is zero these are infinite, of one sign or of both; NaN only on the rim of the error bound.
    one, other = (-span.radius - middle) / slope, (span.radius - middle) / slope
    begin = dr.fmax(dr.ceil(dr.fmin(one, other)), span.low[2])
    end = dr.fmin(dr.floor(dr.fmax(one, other)), span.high[2])
    return begin, end
