"""Wide nodes whose children have balls or oriented boxes around them, not quantised."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import drjit as dr
import drjit.llvm.ad as ad
import numpy as np

from ..buffers import owned
from ..surfaces.primitives import LocalRay, Primitives
from ..types import Types
from .binary_layout import ranges
from .topology import Topology
from .volumes import VOLUMES, Volume, VolumeRay
from .volumes.hulls import Hulls
from .wide_node import NEXT

#: Children of more primitives than this get volumes around the boxes of their descendants instead of around the
#: primitives.
EXACT = 64
#: Where a volume keeps its centre.
_CENTER = {"sphere": 0, "oriented_box": 9}
#: Points that hulls are made of at a time, which bounds the memory that fitting takes.
_POINTS = 1 << 20


@dataclass(frozen=True, eq=False)
class VolumeNodes:
    """``words``, a row a child, of the ``volume`` around it; ``references``, a row a node."""

    types: Types
    volume: Volume
    center: int
    width: int
    words: Any
    references: Any

    @property
    def bytes(self) -> int:
        """On the device."""
        return dr.width(self.words) * (4 if self.types.precision == "float32" else 8) + dr.width(self.references) * 4

    def prepare(self, ray: LocalRay) -> VolumeRay:
        """What the tests need, once per ray."""
        return self.volume.prepare(ray, self.types)

    def visit(self, at: Any, ready: VolumeRay, tmax: Any) -> tuple[list[tuple[Any, Any]], list[Any]]:
        """For each child of node ``at`` how far along a ray its centre is and whether the ray meets it; and the
        references."""
        types, width = self.types, self.volume.width
        packet = dr.gather(ad.ArrayXu, self.references, at, shape=(self.width, dr.width(at)))
        refs = [packet[k] for k in range(self.width)]
        met = []
        for child in range(self.width):
            row = dr.gather(types.ArrayXf, self.words, at * self.width + child, shape=(width, dr.width(at)))
            words = [row[k] for k in range(width)]
            hit = self.volume.meets(words, ready, tmax) & (refs[child] != NEXT)
            offset = type(ready.o)(*words[self.center : self.center + 3]) - ready.o
            met.append((dr.fmax(dr.dot(offset, ready.d), 0), hit))
        return met, refs

    def octant(self, ready: VolumeRay) -> Any:
        """UInt: a bit for each negative component of the direction."""
        UInt = self.types.UInt
        bits = [dr.select(c < 0, UInt(1 << k), UInt(0)) for k, c in enumerate(ready.d)]
        return bits[0] | bits[1] | bits[2]

    def child(self, node: Any, slot: Any, active: Any) -> Any:
        """The reference to child ``slot`` of ``node``."""
        return dr.gather(self.types.UInt, self.references, node * self.width + slot, active)


def volume_nodes(topology: Topology, parts: Primitives, boxes: np.ndarray, volume: str) -> VolumeNodes:
    """Nodes with the ``volume`` of that name around every child, over ``parts`` in the order of the leaves; ``boxes``
    are packets (nodes * width, 8) of the children's boxes."""
    shape, types, width = VOLUMES[volume], topology.types, topology.width
    words = np.zeros((topology.references.size, shape.width), types.numpy)
    first, count = (x.ravel() for x in topology.spans)
    small = np.flatnonzero((count > 0) & (count <= EXACT))
    for some in _chunks(small, count[small] * 3):
        number = count[some]
        inside = parts.reordered(ranges(first[some], number))
        words[some] = shape.fit(Hulls.of(inside, np.concatenate([[0], np.cumsum(number)])), types)
    large = np.flatnonzero(count > EXACT)
    for some in _chunks(large, np.full(len(large), 8 * EXACT)):
        words[some] = shape.fit(_hulls_of_descendants(topology, boxes, some), types)
    references = owned(topology.references, types.UInt)
    return VolumeNodes(types, shape, _CENTER[volume], width, owned(words, types.Float), references)


def _chunks(rows: np.ndarray, points: np.ndarray) -> list[np.ndarray]:
    """``rows`` in pieces of about as many points."""
    chunk = np.cumsum(points) // _POINTS
    return np.split(rows, np.flatnonzero(np.diff(chunk)) + 1) if len(rows) else []


def _hulls_of_descendants(topology: Topology, boxes: np.ndarray, rows: np.ndarray) -> Hulls:
    """The corners of the boxes of each row's descendants, up to EXACT of them."""
    refs, width = topology.references, topology.width
    row, group = rows, np.arange(len(rows))
    for _ in range(EXACT.bit_length() // width.bit_length()):
        inner = refs.ravel()[row] < NEXT
        below = refs.ravel()[row[inner]].astype(np.int64)[:, None] * width + np.arange(width)
        owner = np.repeat(group[inner], width)
        below = below.ravel()
        exists = refs.ravel()[below] != NEXT
        row = np.concatenate([row[~inner], below[exists]])
        group = np.concatenate([group[~inner], owner[exists]])
    order = np.argsort(group, kind="stable")
    box, counts = boxes[row[order]].astype(np.float64), np.bincount(group)
    points = np.empty((len(box), 8, 3))
    for k, corner in enumerate(itertools.product((False, True), repeat=3)):
        points[:, k] = np.where(corner, -box[:, 3:6], box[:, :3])
    return Hulls(points.reshape(-1, 3), None, 8 * (np.cumsum(counts) - counts))
