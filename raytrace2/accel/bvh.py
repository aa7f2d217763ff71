"""Bounding volume hierarchies."""

from __future__ import annotations

import copy
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import drjit as dr
import numpy as np

from ..surfaces.geometry import Geometry
from ..surfaces.hit import Candidate
from ..surfaces.levels import Level
from ..surfaces.primitives import DevicePrimitives, LocalRay
from ..surfaces.structure import Structure
from ..surfaces.surface import Surface
from ..surfaces.turns import Turns
from . import bvh_traversal, wide_encode, wide_node
from .binary_tree import BinaryTree, surface_area
from .builders import BUILDERS
from .bvh_config import BvhConfig
from .bvh_refit import Refit, matching, refit_boxes, refit_volumes
from .collapse import WideTree, collapse
from .held import indices_held
from .level_boxes_bvh import bvh_levels
from .octant_slots import by_octant
from .tangles import untangled
from .topology import Topology
from .volume_nodes import volume_nodes
from .wide_boxes import QuantisedNodes


class Bvh(Structure):
    """A wide hierarchy of volumes over the primitives of a geometry."""

    kind = "bvh"

    def __init__(self, geometry: Geometry, config: BvhConfig | None = None) -> None:
        super().__init__(geometry)
        self.config = config or BvhConfig()
        begin = time.perf_counter()
        self._device: bvh_traversal.DeviceTree | None = None
        self._without_copies = False
        self._topology: Topology | None = None
        counts = dict.fromkeys(("primitives", "references", "nodes", "leaves", "depth", "bytes"), 0)
        costs = dict.fromkeys(("expected_nodes", "expected_volumes", "expected_primitives", "sah_cost"), 0.0)
        self._statistics: dict[str, Any] = {"kind": self.kind, **_settings(self.config), **counts, **costs}
        self._build()
        self._statistics["build_seconds"] = time.perf_counter() - begin

    def _build(self) -> None:
        parts, config = self.geometry.primitives(), self.config
        if parts is None:
            return
        present = indices_held(parts)
        self._without_copies = present is not None and len(present) < (parts.lo <= parts.hi).all(axis=1).sum()
        some = parts if present is None else parts.reordered(present)
        if len(some) == 0:
            return
        if len(some) > wide_node.MAX_PRIMITIVES:
            raise ValueError(f"a bvh holds at most {wide_node.MAX_PRIMITIVES} primitives, not {len(some)}")
        tree = BUILDERS[config.builder](some, config)
        if len(tree.order) > wide_node.MAX_PRIMITIVES:
            most = wide_node.MAX_PRIMITIVES
            raise ValueError(f"a bvh holds at most {most} parts, not {len(tree.order)}: lower reference_budget")
        wide = _collapsed(tree, config)
        if config.builder == "sah" and config.volume == "box":
            cut = untangled(some, tree, wide)
            if cut is not None:
                tree, wide = cut, _collapsed(cut, config)
        if len(wide.binary) > wide_node.MAX_NODES:
            most = wide_node.MAX_NODES
            raise ValueError(f"a bvh has at most {most} nodes, not {len(wide.binary)}: raise max_leaf_size")
        if config.width == 8:
            wide = by_octant(wide, tree)
        topology = Topology.of(tree, wide, tree.order if present is None else present[tree.order], self.types)
        boxes = wide_encode.child_boxes(tree, wide)
        nodes: bvh_traversal.Nodes
        if config.volume == "box":
            layout = wide_node.LAYOUTS[config.width]
            refs = topology.device_references
            words = wide_encode.encode(self.types.Float(boxes.ravel()), None, refs, layout, self.types)
            nodes = QuantisedNodes(self.types, layout, words, self.geometry.intersection == "watertight")
        else:
            nodes = volume_nodes(topology, parts.reordered(topology.order), boxes, config.volume)
        visits = _expected_nodes(tree, wide)
        expected = visits, (wide.cost - config.node_cost * visits) / config.primitive_cost
        self._adopt(topology, nodes, parts.upload(topology.order), expected, len(some))

    def _adopt(
        self,
        topology: Topology,
        nodes: bvh_traversal.Nodes,
        primitives: DevicePrimitives,
        expected: tuple[float, float],
        present: int,
    ) -> None:
        self._topology = topology
        self._root = dr.opaque(self.types.UInt, topology.root)
        # A multiple of eight keeps scenes of like depth on one kernel; a level leaves one group pending at most.
        stack_size = max(8, -(-topology.depth // 8) * 8)
        self._device = bvh_traversal.DeviceTree(self.types, nodes, primitives, stack_size)
        node_count, references = len(topology.references), len(topology.order)
        children = int(np.count_nonzero(topology.references != wide_node.NEXT))
        empty = topology.references.size - children
        self.turns = Turns(self.types, self.kind, node_count + references + empty)
        self._statistics |= {
            "primitives": present,
            "references": references,
            "duplication": references / present,
            "nodes": node_count,
            "leaves": topology.leaves,
            "depth": topology.depth,
            "children_per_node": children / max(1, node_count),
            "bytes": nodes.bytes + dr.width(primitives.buffer) * primitives.buffer.numpy().itemsize,
            "expected_nodes": expected[0],
            "expected_volumes": expected[0] * topology.width,
            "expected_primitives": expected[1],
            "sah_cost": self.config.node_cost * expected[0] + self.config.primitive_cost * expected[1],
        }

    def with_margins(self, padded: bool) -> Bvh:
        """The same hierarchy of boxes with or without the margins for rounding by which they are met: to measure what
        margins cost, and what is missed without. ``ValueError`` for other volumes."""
        if self.config.volume != "box":
            raise ValueError(f"only boxes have margins that can be left out, not {self.config.volume} volumes")
        result = copy.copy(self)
        if self._device is not None:
            assert isinstance(self._device.nodes, QuantisedNodes)
            result._device = replace(self._device, nodes=replace(self._device.nodes, padded=padded))
        return result

    def refit(self, moved: Geometry | Surface | Sequence[Surface]) -> Bvh:
        """A hierarchy of the same nodes over surfaces that have moved: new boxes, not a new tree.

        ``moved`` are the surfaces that this one was built over, with the same kinds and numbers of primitives in the
        same order. This hierarchy stays as it is, and so do structures that it is part of. ``statistics()["refit"]``
        of the result tells what was lost: ``sah_cost_built`` of the tree when it was built, ``sah_cost`` now,
        ``sah_cost_ratio`` of the two, ``refits`` since the build and the ``seconds`` it took. A geometry that held
        copies of primitives is built anew. ``ValueError`` if the surfaces do not match.
        """
        begin = time.perf_counter()
        before = self._statistics.get("refit", {"sah_cost_built": self._statistics["sah_cost"], "refits": 0})
        result = self._built_anew(moved) if self._without_copies else self._with_new_boxes(moved)
        cost = result._statistics["sah_cost"]
        built = before["sah_cost_built"]
        result._statistics["refit"] = {
            "sah_cost_built": built,
            "sah_cost": cost,
            "sah_cost_ratio": cost / built if built else 1.0,
            "refits": before["refits"] + 1,
            "seconds": time.perf_counter() - begin,
        }
        return result

    def _built_anew(self, moved: Geometry | Surface | Sequence[Surface]) -> Bvh:
        """What stood for its copies need not once it has moved."""
        return Bvh(matching(self.geometry, moved), self.config)

    def _with_new_boxes(self, moved: Geometry | Surface | Sequence[Surface]) -> Bvh:
        found = self._refitted(moved)
        result = Bvh.__new__(Bvh)
        Structure.__init__(result, found.geometry)
        result.config = self.config
        result._device, result._topology, result._without_copies = None, None, False
        result._statistics = dict(self._statistics)
        if found.nodes is not None:
            assert self._topology is not None and found.primitives is not None
            result._adopt(self._topology, found.nodes, found.primitives, found.expected, self._statistics["primitives"])
        return result

    def _refitted(self, moved: Geometry | Surface | Sequence[Surface]) -> Refit:
        if self.config.volume == "box":
            primitives = None if self._device is None else self._device.primitives
            return refit_boxes(self.geometry, moved, self._topology, primitives)
        return refit_volumes(self.geometry, moved, self._topology, self.config.volume)

    def traverse(self, ray: LocalRay, best: Candidate, root: Any, active: Any) -> Candidate:
        if self._device is None:
            return best
        return bvh_traversal.closest(self._device, ray, best, root + self._root, active, self.turns)

    def traverse_any(self, ray: LocalRay, root: Any, active: Any) -> Any:
        if self._device is None:
            return dr.full(self.types.Bool, False, dr.width(root))
        return bvh_traversal.anything(self._device, ray, root + self._root, active, self.turns)

    def own_levels(self, bounds: tuple[np.ndarray, np.ndarray]) -> Iterator[Level]:
        if self._device is None or self._topology is None:
            return iter(())
        return bvh_levels(bounds, self._device.nodes, self._topology, self.config.volume)

    def statistics(self) -> dict[str, Any]:
        """Counts of nodes, leaves, primitives and references to them, depth, bytes on the device and the seconds that
        the build took. ``expected_nodes``, ``expected_volumes`` and ``expected_primitives``: what a random ray that
        meets the root's box is expected to visit and test, by the areas of the children's boxes; ``sah_cost``, what
        that costs in units of the config's costs. ``refit``: what :meth:`refit` says, where there was one."""
        return dict(self._statistics)


def _collapsed(tree: BinaryTree, config: BvhConfig) -> WideTree:
    return collapse(
        tree,
        config.width,
        max_leaf_size=config.max_leaf_size,
        node_cost=config.node_cost,
        primitive_cost=config.primitive_cost,
    )


def _expected_nodes(tree: BinaryTree, wide: WideTree) -> float:
    """How many nodes a random ray that meets the root's box visits (Goldsmith and Salmon 1987)."""
    if len(wide.binary) == 0:
        return 0.0
    areas = surface_area(tree.lo.take(wide.binary, axis=0), tree.hi.take(wide.binary, axis=0))
    return float(areas.sum() / areas[0]) if areas[0] > 0 else float(len(areas))


def _settings(config: BvhConfig) -> dict[str, Any]:
    return {"builder": config.builder, "width": config.width, "volume": config.volume}
