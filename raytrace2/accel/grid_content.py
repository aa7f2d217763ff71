"""What the lists of cells hold, each within a box of its own: bounds and sums of sides, read by one kernel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from ..buffers import owned
from .grid_lattice import Extents
from .grid_overlap import Subjects

#: Long lists are read by several lanes each, so that there are about so many at least: blocks for every core.
LANES = 1 << 16


@dataclass(frozen=True, eq=False)
class Content:
    """Of each of m lists: bounds ``lo``, ``hi`` (m, 3) of the parts within its box, and sums over their sides: singly
    (m, 3), in pairs xy, yz, zx (m, 3) and, over all but triangles, of all three (m,)."""

    lo: np.ndarray
    hi: np.ndarray
    lengths: np.ndarray
    areas: np.ndarray
    volumes: np.ndarray

    def extents(self, count: np.ndarray, size: np.ndarray) -> Extents:
        """The sums for grids of ``size`` (m, 3) over lists of ``count`` (m,) primitives."""
        areas = self.areas / (size * np.roll(size, -1, axis=1))
        return Extents(count.astype(np.float64), self.lengths / size, areas, self.volumes / size.prod(axis=1))


def content_of(
    subjects: Subjects, prim: Any, begin: np.ndarray, count: np.ndarray, low: np.ndarray, high: np.ndarray
) -> Content:
    """The content of lists ``prim[begin : begin + count]`` (UInt; none is empty) within boxes ``low``, ``high`` (m, 3),
    in the grids' coordinates and the working precision. The same on every run."""
    types, m = subjects.types, len(begin)
    Float, UInt, Vector = types.Float, types.UInt, types.Array3f
    boxes = np.zeros((m, 8), types.numpy)
    boxes[:, :3], boxes[:, 3:6] = low, high
    # A power of two, so that there are few kernels' worth of widths, none of them a literal.
    lanes = max(1, 1 << (LANES // m).bit_length() - 1) if m < LANES else 1
    lane = dr.arange(UInt, m * lanes)
    bits = dr.opaque(UInt, lanes.bit_length() - 1)
    row = lane >> bits
    each = dr.opaque(UInt, lanes)
    first = dr.gather(UInt, owned(begin.astype(np.uint32), UInt), row)
    end = first + dr.gather(UInt, owned(count.astype(np.uint32), UInt), row)
    box = dr.gather(types.ArrayXf, owned(boxes, Float), row, shape=(8, m * lanes))
    inside = Vector(box[0], box[1], box[2]), Vector(box[3], box[4], box[5])

    def include(at: Any, lo: Any, hi: Any, lengths: Any, areas: Any, volume: Any) -> tuple[Any, ...]:
        _, below, above, flat = subjects.corners(dr.gather(UInt, prim, at))
        below = dr.fmax(below, inside[0])
        above = dr.fmax(dr.fmin(above, inside[1]), below)
        side = above - below
        area = Vector(side.x * side.y, side.y * side.z, side.z * side.x)
        if subjects.boxes is not None:
            volume = volume + dr.select(flat, 0, area.x * side.z)
        return at + each, dr.fmin(lo, below), dr.fmax(hi, above), lengths + side, areas + area, volume

    nothing = dr.zeros(Float, m * lanes)
    most = Vector(nothing + dr.inf)
    start = (first + (lane & (each - 1)), most, -most, Vector(nothing), Vector(nothing), nothing)
    _, *found = dr.while_loop(start, lambda at, *_: at < end, include, label="grid content")
    dr.eval(found)
    lo, hi, lengths, areas = (np.array(v).reshape(3, m, lanes) for v in found[:4])
    return Content(
        lo.min(axis=2).T,
        hi.max(axis=2).T,
        lengths.sum(axis=2, dtype=np.float64).T,
        areas.sum(axis=2, dtype=np.float64).T,
        found[4].numpy().reshape(m, lanes).sum(axis=1, dtype=np.float64),
    )
