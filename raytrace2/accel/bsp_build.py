"""Building BSP trees a level at a time: the planes of :mod:`.bsp_split`, and what lies of primitives on their sides."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from ..buffers import owned
from ..surfaces.primitives import Primitives
from ..types import types
from .bsp_polygons import Polygons
from .bsp_split import SLACK, boxes, cheapest_planes, extents
from .kdtree_build import UNPAID_PLANES, BuildRules
from .kdtree_split import Nodes

#: References per primitive, above which no more are made. (Their polygons take more memory than boxes.)
MAX_DUPLICATION = 4
#: Polygons cut at a time, so that temporaries stay small.
_BLOCK = 1 << 16


@dataclass(frozen=True, eq=False)
class BspTree:
    """Nodes level by level: the plane through ``point`` across ``normal`` of inner node k, its children ``child[k]``
    (below the plane; -1: leaf) and ``child[k] + 1``; a leaf's references ``refs[first[k] : first[k] + count[k]]``.

    ``reach`` bounds, in sums over the axes, the box of a whole primitive below the node, plus how far the cell lies
    from the point, plus what rounding during the build amounts to in units of the round-off. ``share`` is the area of a
    box around the cell by that of the root.
    """

    normal: np.ndarray
    point: np.ndarray
    child: np.ndarray
    first: np.ndarray
    count: np.ndarray
    reach: np.ndarray
    share: np.ndarray
    refs: np.ndarray
    depth: int
    lo: np.ndarray
    hi: np.ndarray


@dataclass(frozen=True, eq=False)
class _References:
    """Primitives and the rows of what lies of them in their node among the polygons."""

    prim: np.ndarray
    row: np.ndarray


class _Pool:
    """The polygons of all references: one of the two that a cut makes takes the place of what was cut."""

    def __init__(self, first: Polygons, most: int) -> None:
        n = len(first.count)
        columns = first.corner, first.count, first.is_flat
        # Memory that nothing is written to costs nothing.
        room = (np.empty((most, *column.shape[1:]), column.dtype) for column in columns)
        self._all = Polygons(*room)
        self._used = 0
        self.put(self.more(n), first)

    @property
    def slots(self) -> int:
        return self._all.corner.shape[1]

    def take(self, row: np.ndarray) -> Polygons:
        return self._all.take(row)

    def corners(self, row: np.ndarray) -> np.ndarray:
        return self._all.corner[row]

    def more(self, n: int) -> np.ndarray:
        """``n`` rows not used so far."""
        self._used += n
        return np.arange(self._used - n, self._used)

    def put(self, row: np.ndarray, new: Polygons) -> None:
        self._all.corner[row], self._all.count[row], self._all.is_flat[row] = new.corner, new.count, new.is_flat


def build_bsp(parts: Primitives, rules: BuildRules) -> BspTree:
    """A BSP tree over one or more primitives with boxes that enclose something. Deterministic."""
    epsilon, dtype = parts.types.epsilon, parts.types.numpy
    most = MAX_DUPLICATION * len(parts)
    pool = _Pool(Polygons.of(parts), most)
    whole = (parts.hi.astype(np.float64) - parts.lo).sum(axis=1)
    lo, hi = parts.lo.min(axis=0), parts.hi.max(axis=0)
    # Cuts are made in float64; a few dozen of them, one after the other, err by this much in units of the round-off.
    cut_error = 2 * np.maximum(np.abs(lo), np.abs(hi)).astype(np.float64).sum() * (2.0**-53 / epsilon)
    refs = _References(np.arange(len(whole), dtype=np.int32), np.arange(len(whole)))
    nodes = Nodes(np.zeros(1, np.int64), np.array([len(whole)]), lo[None].astype(float), hi[None].astype(float))
    unpaid, tilted = np.zeros(1, np.int64), np.zeros(1, bool)
    made, listed = 1, 0
    levels: list[tuple[np.ndarray, ...]] = []
    leaf_refs: list[np.ndarray] = []
    while len(nodes):
        n = len(nodes)
        asked = np.flatnonzero((nodes.count > rules.max_leaf_size) & (len(levels) < rules.max_depth))
        ref, _ = nodes.take(asked).references()
        count = nodes.count[asked]
        live = _References(refs.prim[ref], refs.row[ref])
        part = Nodes(np.cumsum(count) - count, count, nodes.lo[asked], nodes.hi[asked])
        slots = pool.slots
        on_device = owned(pool.corners(live.row), types("float64").Float)
        # The same memory seen from the host.
        corner = on_device.numpy()[: 4 * slots * len(live.row)].reshape(-1, slots, 4)
        part = _tightened(part, tilted[asked], on_device, slots)
        nodes.lo[asked], nodes.hi[asked] = part.lo, part.hi
        planes = _choose(part, corner, on_device, unpaid[asked], rules, epsilon)
        planes = _Planes(planes.cost, *(v.astype(dtype).astype(np.float64) for v in (planes.normal, planes.point)))
        below, above = _sides(part, planes, on_device, slots, epsilon)
        del corner, on_device
        # The next level wants a buffer of another size: what is kept for reuse would add up.
        dr.flush_malloc_cache()
        added = np.bincount(_owners(part)[below & above], minlength=len(part))
        splits = np.isfinite(planes.cost) & (listed + nodes.count.sum() + np.cumsum(added) <= most)

        inner = np.zeros(n, bool)
        inner[asked[splits]] = True
        normal, point, child = np.zeros((n, 3)), np.zeros((n, 3)), np.full(n, -1)
        normal[inner], point[inner] = planes.normal[splits], planes.point[splits]
        child[inner] = made + 2 * np.arange(np.count_nonzero(inner))
        made += 2 * int(np.count_nonzero(inner))
        leaf = np.flatnonzero(~inner)
        kept, _ = nodes.take(leaf).references()
        first, held = np.zeros(n, np.int64), np.where(inner, 0, nodes.count)
        first[leaf] = listed + np.cumsum(held[leaf]) - held[leaf]
        listed += len(kept)
        leaf_refs.append(refs.prim[kept])
        reach = _greatest(whole[refs.prim], nodes) + 3 * (nodes.hi - nodes.lo).sum(axis=1) + cut_error
        levels.append((normal, point, child, first, held, reach, _areas(nodes)))
        price = rules.traversal_cost + rules.intersection_cost * planes.cost[splits]
        unpaid = np.repeat(unpaid[asked[splits]] + (price >= rules.intersection_cost * count[splits]), 2)
        tilted = np.repeat(np.count_nonzero(planes.normal[splits], axis=1) > 1, 2)
        nodes, refs = _next_level(part, np.flatnonzero(splits), planes, below, above, live, pool)
    columns: list[Any] = [np.concatenate(column) for column in zip(*levels, strict=True)]
    share = columns[-1]
    columns[-1] = share / share[0] if share[0] > 0 else np.ones(len(share))
    columns += [np.concatenate(leaf_refs), len(levels) - 1, lo, hi]
    return BspTree(*columns)


@dataclass(frozen=True, eq=False)
class _Planes:
    """The plane of each node, with its cost in tests (inf: better not split)."""

    cost: np.ndarray
    normal: np.ndarray
    point: np.ndarray


def _choose(
    nodes: Nodes, corner: np.ndarray, on_device: Any, unpaid: np.ndarray, rules: BuildRules, epsilon: float
) -> _Planes:
    if len(nodes) == 0:
        return _Planes(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)))
    cost, normal, point = cheapest_planes(nodes, corner, on_device, epsilon, rules.empty_bonus)
    price = rules.traversal_cost + rules.intersection_cost * cost
    whole = rules.intersection_cost * nodes.count
    hopeless = unpaid + (price >= whole) >= UNPAID_PLANES
    hopeless |= (price > 4 * whole) & (nodes.count < 16)
    return _Planes(np.where(hopeless, np.inf, cost), normal, point)


def _owners(nodes: Nodes) -> np.ndarray:
    return np.repeat(np.arange(len(nodes)), nodes.count)


def _sides(nodes: Nodes, planes: _Planes, on_device: Any, slots: int, epsilon: float) -> tuple[np.ndarray, np.ndarray]:
    """Whether each reference goes below and above the plane of its node; neither where the node is not split."""
    owner = _owners(nodes)
    if len(owner) == 0:
        return np.zeros(0, bool), np.zeros(0, bool)
    least, most = extents(on_device, slots, planes.normal[owner], planes.point[owner])
    slack = (SLACK * epsilon * (nodes.hi - nodes.lo).sum(axis=1))[owner]
    splits = np.isfinite(planes.cost)[owner]
    above = most > slack
    below = (least < -slack) | ~above
    return below & splits, above & splits


def _next_level(
    nodes: Nodes,
    split: np.ndarray,
    planes: _Planes,
    below: np.ndarray,
    above: np.ndarray,
    refs: _References,
    pool: _Pool,
) -> tuple[Nodes, _References]:
    """The children of nodes ``split`` and their references: of each node those below the plane, then those above."""
    place = np.full(len(nodes), -1)
    place[split] = np.arange(len(split))
    owner = _owners(nodes)
    rank = place[owner]
    both = np.flatnonzero(below & above & (rank >= 0))
    row_above = refs.row.copy()
    row_above[both] = pool.more(len(both))
    for begin in range(0, len(both), _BLOCK):
        some = both[begin : begin + _BLOCK]
        whole = pool.take(refs.row[some])
        height = whole.heights(planes.normal[owner[some]], planes.point[owner[some]])
        pool.put(row_above[some], whole.above(height))
        pool.put(refs.row[some], whole.above(-height))
    sides = [(below & (rank >= 0), refs.row, 0), (above & (rank >= 0), row_above, 1)]
    child = np.concatenate([2 * rank[goes] + side for goes, _, side in sides])
    order = np.argsort(child, kind="stable")
    number = np.bincount(child, minlength=2 * len(split))
    lo, hi = _cut_boxes(nodes.take(split), planes.normal[split], planes.point[split])
    prim = np.concatenate([refs.prim[goes] for goes, _, _ in sides])[order]
    row = np.concatenate([rows[goes] for goes, rows, _ in sides])[order]
    return Nodes(np.cumsum(number) - number, number, lo, hi), _References(prim, row)


def _tightened(nodes: Nodes, tilted: np.ndarray, on_device: Any, slots: int) -> Nodes:
    """The nodes, those below a plane at a tilt (``tilted``) in boxes no larger than around what they hold.

    The box around the cell would be far larger than the cell, and planes would be spent on cutting off what the cell
    does not have.
    """
    chosen = np.flatnonzero(tilted)
    if len(chosen) == 0:
        return nodes
    least, most = boxes(on_device, slots, int(nodes.count.sum()))
    lo, hi = nodes.lo.copy(), nodes.hi.copy()
    for axis in range(3):
        below = np.minimum.reduceat(least[axis], nodes.first)[chosen]
        above = np.maximum.reduceat(most[axis], nodes.first)[chosen]
        lo[chosen, axis] = np.clip(below, nodes.lo[chosen, axis], nodes.hi[chosen, axis])
        hi[chosen, axis] = np.clip(above, lo[chosen, axis], nodes.hi[chosen, axis])
    return Nodes(nodes.first, nodes.count, lo, hi)


def _cut_boxes(nodes: Nodes, normal: np.ndarray, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Boxes around the parts of the nodes' boxes below and above their planes, alternating."""
    n = len(nodes)
    upper = (np.arange(8)[:, None] >> np.arange(3)) & 1 == 1
    corner = np.where(upper, nodes.hi[:, None], nodes.lo[:, None])
    height = ((corner - point[:, None]) * normal[:, None]).sum(axis=2)
    edges = [(a, a | 1 << k) for k in range(3) for a in range(8) if not a >> k & 1]
    a, b = np.array(edges).T
    crosses = (height[:, a] < 0) != (height[:, b] < 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        part = height[:, a] / (height[:, a] - height[:, b])
    cut = corner[:, a] + np.where(crosses, part, 0)[:, :, None] * (corner[:, b] - corner[:, a])
    lo, hi = np.empty((n, 2, 3)), np.empty((n, 2, 3))
    for side in range(2):
        inside = (height <= 0) if side == 0 else (height >= 0)
        points = np.concatenate([corner, cut], axis=1)
        known = np.concatenate([inside, crosses], axis=1)[:, :, None]
        lo[:, side] = np.where(known, points, np.inf).min(axis=1)
        hi[:, side] = np.where(known, points, -np.inf).max(axis=1)
    nothing = (lo > hi).any(axis=2)
    lo[nothing] = hi[nothing] = np.repeat(point[:, None], 2, axis=1)[nothing]
    return lo.reshape(-1, 3), hi.reshape(-1, 3)


def _greatest(values: np.ndarray, nodes: Nodes) -> np.ndarray:
    """The greatest value of each node's references; 0 for a node without any."""
    result = np.zeros(len(nodes))
    some = np.flatnonzero(nodes.count > 0)
    if len(some):
        result[some] = np.maximum.reduceat(values, nodes.first[some])
    return result


def _areas(nodes: Nodes) -> np.ndarray:
    x, y, z = (nodes.hi - nodes.lo).T
    return x * y + y * z + z * x
