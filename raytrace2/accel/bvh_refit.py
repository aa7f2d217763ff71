"""New boxes for a hierarchy whose primitives have moved, from the bottom up, a level at a time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from ..buffers import owned
from ..surfaces.geometry import Geometry
from ..surfaces.primitives import DevicePrimitives, Primitives
from ..surfaces.record import KIND
from ..surfaces.surface import Surface
from ..types import Types
from .binary_tree import surface_area
from .bvh_traversal import Nodes
from .moved_geometry import MovedGeometry, are_meshes
from .moved_triangles import moved_triangles
from .sah_boxes import WORDS, empty, load, store, union
from .topology import Topology
from .volume_nodes import volume_nodes
from .wide_boxes import QuantisedNodes
from .wide_encode import encode
from .wide_node import COUNT_MASK, COUNT_SHIFT, FIRST_MASK, LAYOUTS


@dataclass(frozen=True, eq=False)
class Refit:
    """What a refit finds, and how many nodes and primitives a random ray through the root is expected to meet;
    ``nodes`` and ``primitives`` are None if there is nothing."""

    geometry: Geometry
    nodes: Nodes | None
    primitives: DevicePrimitives | None
    expected: tuple[float, float]


def refit_boxes(
    before: Geometry,
    moved: Geometry | Surface | Sequence[Surface],
    topology: Topology | None,
    primitives: DevicePrimitives | None,
) -> Refit:
    """Quantised nodes of ``topology``, whose leaves hold ``primitives`` of the geometry ``before``, around ``moved``.
    Triangle meshes stay on the device throughout."""
    items = _items(moved)
    if topology is None or primitives is None:
        return Refit(_geometry(moved, before), None, None, (0.0, 0.0))
    types = topology.types
    geometry: Geometry
    if items is not None and are_meshes(before, items):
        geometry = MovedGeometry(before, items)
        device, boxes = moved_triangles(items, topology, primitives)
    else:
        geometry = _geometry(moved, before)
        device, boxes = _moved_primitives(before, geometry, topology)
    rows = _Rows.of(topology)
    table, expected = _boxes_from_below(boxes, topology, rows)
    layout = LAYOUTS[topology.width]
    words = encode(table, rows.of_children, topology.device_references, layout, types)
    return Refit(
        geometry, QuantisedNodes(types, layout, words, geometry.intersection == "watertight"), device, expected
    )


def refit_volumes(
    before: Geometry,
    moved: Geometry | Surface | Sequence[Surface],
    topology: Topology | None,
    volume: str,
) -> Refit:
    """The same for nodes of the shape ``volume``, whose volumes are fitted anew."""
    geometry = _geometry(moved, before)
    if topology is None:
        return Refit(geometry, None, None, (0.0, 0.0))
    device, boxes = _moved_primitives(before, geometry, topology)
    rows = _Rows.of(topology)
    table, expected = _boxes_from_below(boxes, topology, rows)
    parts = geometry.primitives()
    assert parts is not None
    of_children = table.numpy().reshape(-1, WORDS)[rows.of_children.numpy()]
    return Refit(
        geometry, volume_nodes(topology, parts.reordered(topology.order), of_children, volume), device, expected
    )


def _items(moved: Geometry | Surface | Sequence[Surface]) -> list[Surface] | None:
    if isinstance(moved, Geometry):
        return None
    return [moved] if isinstance(moved, Surface) else list(moved)


def _geometry(moved: Geometry | Surface | Sequence[Surface], before: Geometry) -> Geometry:
    items, types = _items(moved), before.types
    if items is not None:
        return Geometry(items, types, intersection=before.intersection)
    assert isinstance(moved, Geometry)
    if moved.types is not types:
        raise ValueError(f"a {types.precision} hierarchy cannot be refitted to a {moved.types.precision} geometry")
    return moved


def matching(before: Geometry, moved: Geometry | Surface | Sequence[Surface]) -> Geometry:
    """The geometry of ``moved``; ``ValueError`` unless it has the primitives of ``before``, kind by kind."""
    geometry = _geometry(moved, before)
    _check_match(before, geometry)
    return geometry


def _check_match(before: Geometry, geometry: Geometry) -> tuple[Primitives, Primitives]:
    old, new = before.primitives(), geometry.primitives()
    if old is None or new is None or len(old) != len(new):
        counts = [0 if p is None else len(p) for p in (old, new)]
        given = f"{counts[0]} primitives, not {counts[1]}"
        raise ValueError(f"refit needs the surfaces that the bvh was built over: {given}")
    if old.kinds != new.kinds or (old.records[:, KIND] != new.records[:, KIND]).any():
        raise ValueError("refit needs the surfaces that the bvh was built over, of the same kinds in the same order")
    return old, new


def _moved_primitives(before: Geometry, geometry: Geometry, topology: Topology) -> tuple[DevicePrimitives, Any]:
    """The primitives of ``geometry`` and packets of their boxes, both in the order of the leaves."""
    _, new = _check_match(before, geometry)
    types, order = topology.types, topology.order
    if not (new.lo[order] <= new.hi[order]).all():
        raise ValueError("refit cannot take away what a nested structure held; build anew")
    packets = np.zeros((len(order), WORDS), types.numpy)
    packets[:, :3] = new.lo[order]
    packets[:, 3:6] = -new.hi[order]
    return new.upload(order), owned(packets, types.Float)


@dataclass(frozen=True, eq=False)
class _Rows:
    """Where boxes stand in the table that a refit makes: those of the leaves, then those of the nodes level by level
    from the root on, then the box around nothing. ``leaf_references`` are the leaves' references in the order of the
    table, ``of_levels`` for each level the rows of its nodes' children, and ``of_children`` those of all nodes in
    their order."""

    leaf_references: Any
    of_levels: list[Any]
    of_children: Any

    @staticmethod
    def of(topology: Topology) -> _Rows:
        """Made once and kept with the topology."""
        kept = topology.__dict__.get("_rows")
        if kept is None:
            kept = topology.__dict__["_rows"] = _Rows._made(topology)
        return kept

    @staticmethod
    def _made(topology: Topology) -> _Rows:
        UInt = topology.types.UInt
        refs, levels = topology.references, topology.levels
        leaf = topology.is_leaf
        number = np.empty(len(refs), np.int64)
        if levels:
            number[np.concatenate(levels)] = np.arange(len(refs))
        leaves = np.count_nonzero(leaf)
        rows = np.full(refs.shape, leaves + len(refs), np.int64)
        rows[leaf] = np.arange(leaves)
        inner = topology.is_inner
        rows[inner] = leaves + number[refs[inner]]
        # Within its level, the children that are nodes are counted from the level's own beginning on.
        return _Rows(owned(refs[leaf], UInt), [owned(rows[level], UInt) for level in levels], owned(rows, UInt))


def _boxes_from_below(primitives: Any, topology: Topology, rows: _Rows) -> tuple[Any, tuple[float, float]]:
    """The table of boxes, and how many nodes and primitives a ray through the root is expected to meet."""
    types = topology.types
    UInt, Float, width = types.UInt, types.Float, topology.width
    if len(topology.references) == 0:
        return dr.full(Float, dr.inf, WORDS), (0.0, float(len(topology.order)))
    leaves = dr.width(rows.leaf_references)
    total = leaves + len(topology.references) + 1
    table = dr.full(Float, dr.inf, total * WORDS)
    of_leaves = _leaf_boxes(primitives, rows.leaf_references, table, types)
    # A level reads the leaves and the level below, which is all that its children can be.
    below, begin = dr.full(Float, dr.inf, WORDS), total - 1
    for index in reversed(rows.of_levels):
        n = dr.width(index) // width
        node = dr.arange(UInt, n)
        box = empty(types, n)
        first, limit, absent = (dr.opaque(UInt, x) for x in (begin, leaves, total - 1))
        for slot in range(width):
            row = dr.gather(UInt, index, node * width + slot)
            is_leaf = row < limit
            mine = load(types, of_leaves, dr.select(is_leaf, row, 0))
            theirs = load(types, below, dr.select(is_leaf | (row < first), 0, row - first))
            exists = row != absent
            chosen = [dr.select(is_leaf, a, b) for a, b in zip(mine[:6], theirs[:6], strict=True)]
            box = union(box, chosen, exists)
        begin -= n
        below = dr.empty(Float, n * WORDS)
        store(types, below, node, box)
        store(types, table, node + dr.opaque(UInt, begin), box)
        dr.eval(below)
    dr.eval(table)
    return table, _expected(table, rows, leaves)


def _leaf_boxes(primitives: Any, references: Any, table: Any, types: Types) -> Any:
    """Packets of the leaves' boxes, which are also written to the beginning of ``table``."""
    n = dr.width(references)
    first, count = references & FIRST_MASK, (references >> COUNT_SHIFT) & COUNT_MASK

    def add(k: Any, box: list[Any]) -> tuple[Any, ...]:
        return k + 1, union(box, load(types, primitives, first + k))

    state = (dr.zeros(types.UInt, n), empty(types, n))
    box = dr.while_loop(state, lambda k, _: k < count, add, label="leaf boxes")[1]
    target = dr.empty(types.Float, n * WORDS)
    for buffer in (target, table):
        store(types, buffer, dr.arange(types.UInt, n), box)
    dr.eval(target)
    return target


def _expected(table: Any, rows: _Rows, leaves: int) -> tuple[float, float]:
    """The sums of the nodes' areas, and of the leaves' times the numbers of their primitives, relative to the root's
    area."""
    boxes = table.numpy().reshape(-1, WORDS)[:-1]
    areas = surface_area(boxes[:, :3], -boxes[:, 3:6])
    count = (rows.leaf_references.numpy() >> COUNT_SHIFT) & COUNT_MASK
    root = areas[leaves]
    if root <= 0:
        return float(len(areas) - leaves), float(count.sum())
    return float(areas[leaves:].sum() / root), float((areas[:leaves] * count).sum() / root)
