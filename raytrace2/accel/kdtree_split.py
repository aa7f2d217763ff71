"""The cheapest plane of each node by the surface area heuristic (Wald and Havran 2006).

A candidate plane costs ``bonus * (N_left * A_left + N_right * A_right) / A`` tests per ray of the node. Planes across
an axis cut off areas linear in their place x (0 to 1 through the cell): ``A_left / A = base + slope * x``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from ..buffers import owned
from ..types import Types

#: Nodes of up to EXACT references try every side of every box; larger ones BINS planes an axis, and the sides of all.
EXACT = 128
BINS = 64
#: Words of a box in a packet: lower corner, upper corner, two unused.
_BOX = 8


@dataclass(frozen=True, eq=False)
class Nodes:
    """Nodes of a level: the references ``first`` to ``first + count`` of each, and its cell ``lo``, ``hi`` (n, 3)."""

    first: np.ndarray
    count: np.ndarray
    lo: np.ndarray
    hi: np.ndarray

    def __len__(self) -> int:
        return len(self.first)

    def take(self, which: np.ndarray) -> Nodes:
        """Some of the nodes."""
        return Nodes(self.first[which], self.count[which], self.lo[which], self.hi[which])

    def references(self) -> tuple[np.ndarray, np.ndarray]:
        """The references of all nodes, one node after the other, and for each the place of its node."""
        owner = np.repeat(np.arange(len(self)), self.count)
        start = np.cumsum(self.count) - self.count
        return np.arange(len(owner)) + (self.first - start)[owner], owner


@dataclass(frozen=True, eq=False)
class Splits:
    """``cost`` in primitive tests (inf: no plane), ``axis``, ``plane`` and whether boxes in the plane go left."""

    cost: np.ndarray
    axis: np.ndarray
    plane: np.ndarray
    flat_left: np.ndarray


def cheapest_splits(types: Types, nodes: Nodes, lo: np.ndarray, hi: np.ndarray, empty_bonus: float) -> Splits:
    """The cheapest plane of each node over references with boxes ``lo``, ``hi``."""
    n = len(nodes)
    found = Splits(np.full(n, np.inf), np.zeros(n, np.int64), np.zeros(n, lo.dtype), np.zeros(n, bool))
    for method, chosen in ((_exact, nodes.count <= EXACT), (_binned, nodes.count > EXACT)):
        where = np.flatnonzero(chosen)
        if len(where):
            part = method(types, nodes.take(where), lo, hi, empty_bonus)
            found.cost[where], found.axis[where] = part.cost, part.axis
            found.plane[where], found.flat_left[where] = part.plane, part.flat_left
    return found


def _area_model(nodes: Nodes) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """``base``, ``slope`` (n, 3), and the scale and offset that take a plane p to its place: (p - offset) * scale."""
    size = nodes.hi.astype(np.float64) - nodes.lo
    unit = size / np.maximum(size.max(axis=1, keepdims=True), np.finfo(np.float64).tiny)
    y, z = np.roll(unit, -1, axis=1), np.roll(unit, -2, axis=1)
    base, slope = y * z, unit * (y + z)
    whole = base[:, :1] + slope[:, :1]
    # A cell without area is met by what meets its length.
    line = whole[:, 0] <= 0
    base, slope = base / np.where(whole > 0, whole, 1), slope / np.where(whole > 0, whole, 1)
    slope[line] = 1
    scale = 1 / np.maximum(size, np.finfo(lo_dtype := nodes.lo.dtype).tiny)
    return base, slope, np.minimum(scale, np.finfo(lo_dtype).max), nodes.lo


def _exact(types: Types, nodes: Nodes, lo: np.ndarray, hi: np.ndarray, empty_bonus: float) -> Splits:
    """Every side of every box, against every box of the node: one lane a reference."""
    base, slope, scale, offset = _area_model(nodes)
    ref, owner = nodes.references()
    boxes = np.zeros((len(ref), _BOX), lo.dtype)
    boxes[:, :3], boxes[:, 3:6] = lo[ref], hi[ref]
    model = np.zeros((len(nodes), 16), lo.dtype)
    for k, values in enumerate((base, slope, scale, offset, nodes.hi)):
        model[:, 3 * k : 3 * k + 3] = values
    start = np.cumsum(nodes.count) - nodes.count
    UInt = types.UInt
    cost, code = _exact_kernel(
        types,
        owned(boxes, types.Float),
        owned(model, types.Float),
        owned(owner.astype(np.uint32), UInt),
        owned(start.astype(np.uint32), UInt),
        owned(nodes.count.astype(np.uint32), UInt),
        dr.opaque(types.Float, 1 - empty_bonus),
    )
    # The bits of a positive float32 sort as it does; below them the reference and its side decide ties.
    key = (cost.view(np.uint32).astype(np.uint64) << np.uint64(32)) | np.arange(len(ref), dtype=np.uint64)
    best = (np.minimum.reduceat(key, start) & np.uint64(0xFFFFFFFF)).astype(np.int64)
    side = code[best].astype(np.int64)
    axis = (side >> 1) % 3
    plane = boxes[best, axis + 3 * (side >= 6)]
    return Splits(cost[best].astype(np.float64), axis, plane, (side & 1).astype(bool))


def _exact_kernel(
    types: Types, boxes: Any, model: Any, owner: Any, start: Any, count: Any, bonus: Any
) -> tuple[np.ndarray, np.ndarray]:
    """The least cost over the six sides of each reference's box, in float32, and a code: flat_left + 2 axis + 6 if
    upper."""
    UInt, Float = types.UInt, types.Float
    n = dr.width(owner)
    lane = dr.arange(UInt, n)
    own = dr.gather(types.ArrayXf, boxes, lane, shape=(_BOX, n))
    planes = [own[k] for k in range(6)]
    about = dr.gather(types.ArrayXf, model, owner, shape=(16, n))
    begin = dr.gather(UInt, start, owner)
    end = begin + dr.gather(UInt, count, owner)
    zero = dr.zeros(UInt, n)

    def compare(j: Any, left: list[Any], right: list[Any], flat: list[Any]) -> tuple[Any, ...]:
        box = dr.gather(types.ArrayXf, boxes, j, shape=(_BOX, n))
        for k in range(6):
            below, above = box[k % 3] < planes[k], box[3 + k % 3] > planes[k]
            left[k] = dr.select(below, left[k] + 1, left[k])
            right[k] = dr.select(above, right[k] + 1, right[k])
            flat[k] = dr.select(below | above, flat[k], flat[k] + 1)
        return j + 1, left, right, flat

    zeros = lambda: [zero + 0 for _ in range(6)]  # noqa: E731
    state = (begin, zeros(), zeros(), zeros())
    _, left, right, flat = dr.while_loop(state, lambda j, *_: j < end, compare, label="kdtree exact")
    best, code = dr.full(Float, dr.inf, n), dr.zeros(UInt, n)
    for k in range(6):
        axis = k % 3
        plane = planes[k]
        base, slope, scale, offset = (about[axis + 3 * i] for i in range(4))
        x = dr.clip((plane - offset) * scale, 0, 1)
        a_left, a_right = dr.fma(slope, x, base), dr.fma(slope, 1 - x, base)
        inside = (plane > offset) & (plane < about[axis + 12])
        for flat_left in (1, 0):
            n_left = left[k] + (flat[k] if flat_left else 0)
            n_right = right[k] + (0 if flat_left else flat[k])
            cost = Float(n_left) * a_left + Float(n_right) * a_right
            cost = dr.select((n_left == 0) | (n_right == 0), cost * bonus, cost)
            better = inside & (cost < best)
            best = dr.select(better, cost, best)
            code = dr.select(better, UInt(flat_left + 2 * axis + 6 * (k // 3)), code)
    import drjit.llvm.ad as ad

    cost32 = ad.Float32(best)
    dr.eval(cost32, code)
    return cost32.numpy(), code.numpy()


def _binned(types: Types, nodes: Nodes, lo: np.ndarray, hi: np.ndarray, empty_bonus: float) -> Splits:
    """Planes between bins of equal width through the box around each node's references, and the sides of that box."""
    base, slope, scale, offset = _area_model(nodes)
    n = len(nodes)
    ref, owner = nodes.references()
    start = np.cumsum(nodes.count) - nodes.count
    result = Splits(np.full(n, np.inf), np.zeros(n, np.int64), np.zeros(n, lo.dtype), np.zeros(n, bool))
    for axis in range(3):
        a, b = lo[ref, axis], hi[ref, axis]
        least, most = np.minimum.reduceat(a, start), np.maximum.reduceat(b, start)
        planes = np.empty((n, BINS + 1), lo.dtype)
        steps = np.linspace(0, 1, BINS + 1)
        planes[:] = least[:, None] * (1 - steps) + most[:, None] * steps
        planes[:, 0], planes[:, -1] = least, most
        with np.errstate(divide="ignore", over="ignore"):
            per_bin = BINS / (most.astype(np.float64) - least)
        first_bin, last_bin = _bins(a, owner, least, per_bin), _bins(b, owner, least, per_bin)
        # What starts inside bin k starts before plane k + 1; what ends on plane k or before it ends at k rounded up.
        # Rounding may miscount a little: the cost is an estimate, what goes where is decided by the plane itself.
        n_left = _running(owner, np.minimum(np.floor(first_bin), BINS - 1) + 1, n)
        n_right = nodes.count[:, None] - _running(owner, np.ceil(last_bin), n)
        in_plane = (a == b) & (first_bin == np.floor(first_bin)) & (first_bin > 0) & (first_bin < BINS)
        flat = _count(owner[in_plane], first_bin[in_plane], n)
        place = np.clip((planes.astype(np.float64) - offset[:, axis, None]) * scale[:, axis, None], 0, 1)
        left = base[:, axis, None] + slope[:, axis, None] * place
        right = base[:, axis, None] + slope[:, axis, None] * (1 - place)
        cost = n_left * left + n_right * right
        cost *= np.where((n_left == 0) | (n_right == 0), 1 - empty_bonus, 1.0)
        cost += flat * np.minimum(left, right)
        inside = (planes > nodes.lo[:, axis, None]) & (planes < nodes.hi[:, axis, None])
        cost[~inside] = np.inf
        best = cost.argmin(axis=1)
        rows = np.arange(n)
        better = cost[rows, best] < result.cost
        result.cost[better] = cost[rows, best][better]
        result.axis[better] = axis
        result.plane[better] = planes[rows, best][better]
        result.flat_left[better] = (left <= right)[rows, best][better]
    return result


def _bins(values: np.ndarray, owner: np.ndarray, least: np.ndarray, per_bin: np.ndarray) -> np.ndarray:
    """Where ``values`` lie in the bins of their nodes, 0 to BINS."""
    with np.errstate(invalid="ignore", over="ignore"):
        place = (values - least.astype(np.float64)[owner]) * per_bin[owner]
    return np.clip(np.nan_to_num(place, nan=0.0, posinf=BINS), 0, BINS)


def _count(owner: np.ndarray, place: np.ndarray, n: int) -> np.ndarray:
    """How many references of each of ``n`` nodes are at each of BINS + 1 places (n, BINS + 1)."""
    wide = BINS + 1
    return np.bincount(owner * wide + place.astype(np.int64), minlength=n * wide).reshape(n, wide)


def _running(owner: np.ndarray, place: np.ndarray, n: int) -> np.ndarray:
    """How many are at each place or before it."""
    return np.cumsum(_count(owner, place, n), axis=1)
