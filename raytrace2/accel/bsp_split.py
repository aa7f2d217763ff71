"""The cheapest of several planes at any tilt for each node of a BSP tree, by the surface area heuristic.

After Ize, Wald and Parker 2008, "Ray tracing with the BSP tree". Where they measure the cells, which are polytopes, a
cell is here the box around it, cut by the one plane in question: each face's part on a side is exact, the section is
the mean one across the plane's normal. As the box forgets cuts at a tilt, the same corner could be cut off again and
again for a gain that is not there: so a plane at a tilt must have a share of the primitives on either side.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np

from ..buffers import owned
from ..types import types
from .kdtree_split import Nodes

#: Planes tried along each normal: between BINS bins of equal width, at both ends of what the node holds, and one given.
BINS = 16
#: Normals tried: those of faces in the node, the axes, and the first and last principal axis of the faces' middles.
FACES = 2
NORMALS = FACES + 5
#: Planes count as along a thing's own if it reaches no farther beyond than this, in units of the round-off and of the
#: node's size (sum over the axes). Rounding a plane to the working precision moves it by less.
SLACK = 4
#: The least part of a node's primitives on either side of a plane at a tilt.
SHARE = 0.25

_F64 = types("float64")


def cheapest_planes(
    nodes: Nodes, corner: np.ndarray, on_device: Any, epsilon: float, empty_bonus: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of each node the cost of the best plane in primitive tests (inf: none), its normal (n, 3) and a point on it.

    ``corner`` (references, slots, 4) are the corners of what lies of primitives in the nodes, one node after the other,
    as :class:`~.bsp_polygons.Polygons` has them, and ``on_device`` the same in a buffer.
    """
    n = len(nodes)
    normal, given = _normals(nodes, corner)
    about = np.zeros((n, NORMALS, 16))
    about[:, :, :3], about[:, :, 3] = normal, (normal * given).sum(axis=2)
    about[:, :, 4:7], about[:, :, 7:10] = nodes.lo[:, None], nodes.hi[:, None]
    size = (nodes.hi.astype(np.float64) - nodes.lo).sum(axis=1)
    about[:, :, 10] = (SLACK * epsilon * size)[:, None]
    first, count = (np.repeat(v, NORMALS).astype(np.uint32) for v in (nodes.first, nodes.count))
    cost, place = _search(
        on_device,
        corner.shape[1],
        owned(about, _F64.Float),
        owned(first, _F64.UInt),
        owned(count, _F64.UInt),
        dr.opaque(_F64.Float, 1 - empty_bonus),
    )
    cost, place = cost.reshape(n, NORMALS), place.reshape(n, NORMALS)
    best = cost.argmin(axis=1)
    rows = np.arange(n)
    normal, given, place = normal[rows, best], given[rows, best], place[rows, best]
    # The given point itself where its plane is the best: then it is exactly a corner of the face.
    return cost[rows, best], normal, given + (place - (normal * given).sum(axis=1))[:, None] * normal


def _normals(nodes: Nodes, corner: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit normals (n, NORMALS, 3) to try, and on each a point (n, NORMALS, 3) whose plane to try."""
    n = len(nodes)
    tiny = np.finfo(np.float64).tiny
    normal, point = np.zeros((n, NORMALS, 3)), np.zeros((n, NORMALS, 3))
    for k in range(FACES):
        chosen = nodes.first + (nodes.count * (2 * k + 1)) // (2 * FACES)
        a, b, c = (corner[chosen, j, :3] for j in range(3))
        scale = np.maximum(np.maximum(np.abs(b - a), np.abs(c - a)).max(axis=1), tiny)[:, None]
        normal[:, k] = np.cross((b - a) / scale, (c - a) / scale)
        point[:, k] = a
    normal[:, FACES : FACES + 3] = np.eye(3)
    owner = np.repeat(np.arange(n), nodes.count)
    size = (nodes.hi - nodes.lo).max(axis=1)
    unit = np.where(size > 0, size, 1)
    # Column by column: NumPy is slow at reducing long thin tables.
    columns = [corner[:, 0, k] + corner[:, 1, k] + corner[:, 2, k] for k in range(3)]
    columns = [(c / 3 - nodes.lo[owner, k]) / unit[owner] for k, c in enumerate(columns)]
    center = np.stack([np.add.reduceat(c, nodes.first) / nodes.count for c in columns], axis=1)
    point[:, FACES:] = (nodes.lo + center * unit[:, None])[:, None]
    columns = [c - center[owner, k] for k, c in enumerate(columns)]
    symmetric = np.empty((n, 3, 3))
    for k, i in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
        symmetric[:, k, i] = symmetric[:, i, k] = np.add.reduceat(columns[k] * columns[i], nodes.first)
    axes = np.linalg.eigh(np.where(np.isfinite(symmetric), symmetric, 0))[1]
    normal[:, FACES + 3], normal[:, FACES + 4] = axes[:, :, 0], axes[:, :, 2]
    length = np.sqrt(np.square(normal).sum(axis=2, keepdims=True))
    usable = np.isfinite(length) & (length > 1e-6)
    return np.where(usable, normal / np.where(usable, length, 1), np.eye(3)[0]), point


def extents(on_device: Any, slots: int, normal: np.ndarray, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How far each reference reaches below and above the plane through its ``point`` across its ``normal`` (n, 3)."""
    n = len(normal)
    plane = np.zeros((n, 8))
    plane[:, :3], plane[:, 3:6] = normal, point
    lane = dr.arange(_F64.UInt, n)
    packet = dr.gather(_F64.ArrayXf, owned(plane, _F64.Float), lane, shape=(8, n))
    least, most = _interval(on_device, slots, lane, *([packet[k + i] for i in range(3)] for k in (0, 3)))
    dr.eval(least, most)
    return least.numpy(), most.numpy()


def boxes(on_device: Any, slots: int, n: int) -> tuple[np.ndarray, np.ndarray]:
    """The box around each of ``n`` references' corners: lo, hi (3, n)."""
    lane = dr.arange(_F64.UInt, n)
    least, most = ([_F64.Float(sign * dr.inf) for _ in range(3)] for sign in (1, -1))
    for k in range(slots):
        packet = dr.gather(_F64.Array4f, on_device, lane * slots + k)
        least = [dr.fmin(a, x) for a, x in zip(least, packet, strict=False)]
        most = [dr.fmax(b, x) for b, x in zip(most, packet, strict=False)]
    dr.eval(least, most)
    return np.stack([v.numpy() for v in least]), np.stack([v.numpy() for v in most])


def _interval(corners: Any, slots: int, j: Any, normal: list[Any], point: list[Any]) -> tuple[Any, Any]:
    """The least and the greatest height of a reference's corners above a plane."""
    least, most = _F64.Float(dr.inf), _F64.Float(-dr.inf)
    for k in range(slots):
        x, y, z, _ = dr.gather(_F64.Array4f, corners, j * slots + k)
        at = (x - point[0]) * normal[0] + (y - point[1]) * normal[1] + (z - point[2]) * normal[2]
        least, most = dr.fmin(least, at), dr.fmax(most, at)
    return least, most


def _search(corners: Any, slots: int, about: Any, first: Any, count: Any, bonus: Any) -> tuple[np.ndarray, np.ndarray]:
    """For each lane, a normal of a node: the least cost and how far along the normal its plane lies."""
    Float, UInt = _F64.Float, _F64.UInt
    lanes = dr.width(first)
    packet = dr.gather(_F64.ArrayXf, about, dr.arange(UInt, lanes), shape=(16, lanes))
    normal = [packet[k] for k in range(3)]
    given, slack = packet[3], packet[10]
    lo, hi = [packet[4 + k] for k in range(3)], [packet[7 + k] for k in range(3)]
    end = first + count

    def interval(j: Any) -> tuple[Any, Any]:
        return _interval(corners, slots, j, normal, [0, 0, 0])

    def widen(j: Any, least: Any, most: Any) -> tuple[Any, ...]:
        a, b = interval(j)
        return j + 1, dr.fmin(least, a), dr.fmax(most, b)

    state: tuple[Any, ...] = (first, dr.full(Float, dr.inf, lanes), dr.full(Float, -dr.inf, lanes))
    _, least, most = dr.while_loop(state, lambda j, *_: j < end, widen, label="bsp extent")
    scale = dr.select(most - least > 4 * slack, BINS / (most - least), 0)

    def fill(j: Any, starts: Any, ends: Any, tops: Any) -> tuple[Any, ...]:
        a, b = interval(j)
        below = UInt(dr.clip((a + slack - least) * scale, 0, BINS - 1))
        above = UInt(dr.ceil(dr.clip((b - slack - least) * scale, 0, BINS)))
        starts.write(starts.read(below) + 1, below)
        ends.write(ends.read(above) + 1, above)
        tops.write(dr.fmax(tops.read(above), b), above)
        return j + 1, starts, ends, tops

    def counts() -> Any:
        return dr.alloc_local(UInt, BINS + 1, value=UInt(0))

    zero = dr.zeros(UInt, lanes)
    state = (first, counts(), counts(), dr.alloc_local(Float, BINS + 1, value=Float(-dr.inf)))
    _, starts, ends, tops = dr.while_loop(state, lambda j, *_: j < end, fill, label="bsp bins")

    box = _Box(lo, hi, normal)

    def cost_of(place: Any, n_left: Any, n_right: Any) -> Any:
        a_left, a_right = box.areas(place)
        cost = Float(n_left) * a_left + Float(n_right) * a_right
        cost = dr.select((n_left == 0) | (n_right == 0), cost * bonus, cost)
        return dr.select(box.is_inside(place, slack), cost, dr.inf)

    def try_plane(
        k: Any, cost: Any, at: Any, n_left: Any, done: Any, top: Any, starts: Any, ends: Any, tops: Any
    ) -> tuple[Any, ...]:
        done += ends.read(k)
        # As low as it may be without cutting what ends below it; so it runs along sides that are shared. Before the
        # first end there is only space to cut off.
        top = dr.fmax(top, tops.read(k))
        place = dr.select(done > 0, top, least)
        here = cost_of(place, n_left, count - done)
        better = here < cost
        n_left = n_left + starts.read(k)
        at = dr.select(better, place, at)
        return k + 1, dr.select(better, here, cost), at, n_left, done, top, starts, ends, tops

    infinite = dr.full(Float, dr.inf, lanes)
    state = (zero + 0, infinite, least + 0, zero + 0, zero + 0, -infinite, starts, ends, tops)
    at = dr.while_loop(state, lambda k, *_: k <= BINS, try_plane, label="bsp planes")[2]

    def recount(j: Any, counts: list[Any]) -> tuple[Any, ...]:
        a, b = interval(j)
        here = []
        for k, place in enumerate((at, given)):
            right = b > place + slack
            left = (a < place - slack) | ~right
            here += [counts[2 * k] + dr.select(left, 1, 0), counts[2 * k + 1] + dr.select(right, 1, 0)]
        return j + 1, here

    state = (first, [zero + 0 for _ in range(4)])
    number = dr.while_loop(state, lambda j, *_: j < end, recount, label="bsp counts")[1]
    is_axis = dr.fmax(dr.fmax(abs(normal[0]), abs(normal[1])), abs(normal[2])) == 1
    costs = []
    for k, place in enumerate((at, given)):
        n_left, n_right = number[2 * k], number[2 * k + 1]
        fair = is_axis | (Float(dr.minimum(n_left, n_right)) >= SHARE * Float(count))
        costs.append(dr.select(fair, cost_of(place, n_left, n_right), dr.inf))
    at = dr.select(costs[1] < costs[0], given, at)
    cost = dr.fmin(costs[0], costs[1])
    dr.eval(cost, at)
    return cost.numpy(), at.numpy()


class _Box:
    """The box around a cell, and its area on each side of a plane across ``normal``, as a part of the whole."""

    def __init__(self, lo: list[Any], hi: list[Any], normal: list[Any]) -> None:
        tiny = 1e-12
        size = [h - a for a, h in zip(lo, hi, strict=True)]
        unit = dr.fmax(dr.fmax(dr.fmax(size[0], size[1]), size[2]), 1e-300)
        self.size = [s / unit for s in size]
        self.unit = unit
        self.rise = [dr.fmax(abs(n) * s, tiny) for n, s in zip(normal, self.size, strict=True)]
        self.least = sum(dr.select(n < 0, h, a) * n for n, a, h in zip(normal, lo, hi, strict=True))
        x, y, z = self.size
        self.faces = [y * z, z * x, x * y]
        self.whole = 2 * dr.fmax(x * y + y * z + z * x, 1e-30)
        self.extent = self.rise[0] + self.rise[1] + self.rise[2]
        self.section = x * y * z / self.extent

    def is_inside(self, place: Any, slack: Any) -> Any:
        """Bool: whether the plane cuts the box."""
        distance = place - self.least
        return (distance > slack) & (distance < self.extent * self.unit - slack)

    def areas(self, place: Any) -> tuple[Any, Any]:
        """The parts of the area below and above a plane, the section included in both."""
        x = (place - self.least) / self.unit
        below = 0
        for axis, area in enumerate(self.faces):
            p, q = (self.rise[k] for k in range(3) if k != axis)
            for begin in (0, self.rise[axis]):
                y = x - begin
                squares = [dr.square(dr.fmax(y - c, 0)) for c in (0, p, q, p + q)]
                part = (squares[0] - squares[1] - squares[2] + squares[3]) / (2 * p * q)
                below += area * dr.clip(part, 0, 1)
        return (below + self.section) / self.whole, (self.whole - below + self.section) / self.whole
