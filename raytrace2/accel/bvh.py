"""Bounding volume hierarchies."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any, Literal

import drjit as dr
import numpy as np

from ..buffers import owned
from ..surfaces.geometry import Geometry
from ..surfaces.hit import Candidate
from ..surfaces.primitives import LocalRay
from ..surfaces.structure import Structure
from . import bvh_traversal, wide_node
from .binned_sah import build_binned_sah
from .collapse import WideTree, collapse


@dataclass(frozen=True)
class BvhConfig:
    """``max_leaf_size``: most primitives in a leaf; ``node_cost`` and ``primitive_cost``: what a visit and a test
    cost, in any unit, for the choice between splitting and stopping."""

    builder: Literal["sah"] = "sah"
    max_leaf_size: int = 4
    node_cost: float = 1.0
    primitive_cost: float = 1.0

    def __post_init__(self) -> None:
        if self.builder != "sah":
            raise ValueError(f"builder must be 'sah', not {self.builder!r}")
        if not 1 <= self.max_leaf_size <= wide_node.MAX_LEAF_SIZE:
            raise ValueError(f"max_leaf_size must lie in 1 to {wide_node.MAX_LEAF_SIZE}, not {self.max_leaf_size}")
        if not (self.node_cost > 0 and self.primitive_cost > 0):
            raise ValueError("node_cost and primitive_cost must be positive")


class Bvh(Structure):
    """A four-wide hierarchy of boxes over the primitives of a geometry."""

    kind = "bvh"

    def __init__(self, geometry: Geometry, config: BvhConfig | None = None) -> None:
        super().__init__(geometry)
        self.config = config or BvhConfig()
        begin = time.perf_counter()
        parts = geometry.primitives()
        self._device: bvh_traversal.DeviceTree | None = None
        empty = dict.fromkeys(("primitives", "references", "nodes", "leaves", "depth", "bytes", "sah_cost"), 0)
        self._statistics: dict[str, Any] = {"kind": self.kind, **empty}
        if parts is not None and (absent := (parts.lo > parts.hi).any(axis=1)).any():
            # A structure over nothing has a box that encloses nothing.
            parts = parts.reordered(np.flatnonzero(~absent))
        if parts is not None and len(parts):
            if len(parts) > wide_node.MAX_PRIMITIVES:
                raise ValueError(f"a bvh holds at most {wide_node.MAX_PRIMITIVES} primitives, not {len(parts)}")
            tree = build_binned_sah(parts.lo, parts.hi)
            config = self.config
            wide = collapse(
                tree,
                wide_node.WIDTH,
                max_leaf_size=config.max_leaf_size,
                node_cost=config.node_cost,
                primitive_cost=config.primitive_cost,
            )
            if len(wide.binary) > wide_node.MAX_NODES:
                most = wide_node.MAX_NODES
                raise ValueError(f"a bvh has at most {most} nodes, not {len(wide.binary)}: raise max_leaf_size")
            words = wide_node.encode_nodes(tree, wide, self.types)
            whole = wide_node.leaf_reference(np.zeros(1, np.int64), np.array([len(parts)]))[0]
            self._root = dr.opaque(self.types.UInt, int(whole) if len(wide.binary) == 0 else 0)
            # A multiple of eight keeps scenes of like depth on one kernel; a level leaves one group pending at most.
            stack_size = max(8, -(-wide.depth // 8) * 8)
            Word = self.types.UInt if words.dtype == np.uint32 else self.types.UInt64
            device = parts.upload(tree.order)
            self._device = bvh_traversal.DeviceTree(self.types, owned(words, Word), device, stack_size)
            self._statistics = _describe(wide, len(parts), words.nbytes + parts.records.nbytes)
        self._statistics["build_seconds"] = time.perf_counter() - begin

    def traverse(self, ray: LocalRay, best: Candidate, root: Any, active: Any) -> Candidate:
        if self._device is None:
            return best
        return bvh_traversal.closest(self._device, ray, best, root + self._root, active)

    def traverse_any(self, ray: LocalRay, root: Any, active: Any) -> Any:
        if self._device is None:
            return dr.full(self.types.Bool, False, dr.width(root))
        return bvh_traversal.anything(self._device, ray, root + self._root, active)

    def statistics(self) -> dict[str, Any]:
        """Counts of nodes, leaves and primitives, depth, bytes on the device, the seconds that the build took and
        ``sah_cost``, the expected cost of a random ray that meets the root's box, in units of the config's costs."""
        return dict(self._statistics)


def _describe(wide: WideTree, primitives: int, size: int) -> dict[str, Any]:
    children = np.count_nonzero(wide.children >= 0)
    inner = np.count_nonzero(wide.inner >= 0)
    return {
        "kind": Bvh.kind,
        "primitives": primitives,
        "references": primitives,
        "nodes": len(wide.binary),
        "leaves": int(children - inner) if len(wide.binary) else 1,
        "depth": wide.depth,
        "children_per_node": float(children / max(1, len(wide.binary))),
        "bytes": int(size),
        "sah_cost": wide.cost,
    }
