"""kd-trees: space divided by planes across the axes."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import drjit as dr
import numpy as np

from ..buffers import owned
from ..errors import SettingError
from ..surfaces.geometry import Geometry
from ..surfaces.hit import Candidate
from ..surfaces.levels import Level
from ..surfaces.primitives import LocalRay, Primitives
from ..surfaces.record import encode_integers
from ..surfaces.structure import Structure
from ..surfaces.turns import Turns
from ..types import Types
from . import kdtree_traversal as traversal
from .held import held
from .kdtree_build import BuildRules, KdTree, build_kdtree
from .level_boxes_planes import plane_levels

if TYPE_CHECKING:
    from .bsp_build import BspTree


@dataclass(frozen=True)
class KdTreeConfig:
    """Nodes of at most ``max_leaf_size`` primitives are leaves; larger ones where no plane lowers the expected cost, or
    at ``max_depth`` (None: 8 + 1.3 log2 of the number of primitives). ``traversal_cost`` and ``intersection_cost`` are
    what a visit and a test cost, in any unit; ``empty_bonus`` is the part of the cost forgiven to planes that cut off
    empty space (from 0 to below 1)."""

    max_leaf_size: int = 2
    max_depth: int | None = None
    traversal_cost: float = 2.0
    intersection_cost: float = 1.0
    empty_bonus: float = 0.2

    def __post_init__(self) -> None:
        if self.max_leaf_size < 1:
            raise SettingError(f"max_leaf_size must be at least 1, not {self.max_leaf_size}")
        if self.max_depth is not None and not 0 <= self.max_depth <= 120:
            raise SettingError(f"max_depth must lie in 0 to 120, not {self.max_depth}")
        for name in ("traversal_cost", "intersection_cost"):
            if not 0 < getattr(self, name) < math.inf:
                raise SettingError(f"{name} must be positive, not {getattr(self, name)}")
        if not 0 <= self.empty_bonus < 1:
            raise SettingError(f"empty_bonus must lie in 0 to below 1, not {self.empty_bonus}")


class KdTreeStructure(Structure):
    """A kd-tree over the primitives of a geometry; a primitive is listed in every leaf that it reaches."""

    kind = "kdtree"

    def __init__(self, geometry: Geometry, config: KdTreeConfig | None = None) -> None:
        super().__init__(geometry)
        self.config = config or KdTreeConfig()
        begin = time.perf_counter()
        self._device: traversal.PlaneTree | None = None
        parts = present(geometry)
        self._statistics: dict[str, Any] = empty_statistics(self.kind)
        if parts is not None:
            rules = rules_of(self.config, len(parts))
            tree = build_kdtree(parts, rules)
            words = np.zeros((len(tree.axis), 4), self.types.numpy)
            words[:, 0] = np.where(tree.axis < 3, tree.plane, encode_integers(tree.count, self.types))
            words[:, 2] = tree.reach
            link = np.where(tree.axis < 3, 4 * tree.child + tree.axis, 4 * tree.first + traversal.LEAF)
            words[:, 3] = encode_integers(link, self.types)
            self._device, size = upload(parts, words, tree.refs, tree.depth, tree.lo, tree.hi)
            self._statistics = describe(self.kind, tree, tree.axis == 3, len(parts), size, rules)
        self.turns = plane_turns(self._statistics, self.types)
        self._statistics["build_seconds"] = time.perf_counter() - begin

    def traverse(self, ray: LocalRay, best: Candidate, root: Any, active: Any) -> Candidate:
        if self._device is None:
            return best
        return traversal.closest(self._device, traversal.meet_axis_plane, ray, best, root, active, self.turns)

    def traverse_any(self, ray: LocalRay, root: Any, active: Any) -> Any:
        if self._device is None:
            return dr.full(self.types.Bool, False, dr.width(root))
        return traversal.anything(self._device, traversal.meet_axis_plane, ray, root, active, self.turns)

    def own_levels(self, bounds: tuple[np.ndarray, np.ndarray]) -> Iterator[Level]:
        return iter(()) if self._device is None else plane_levels(bounds, self._device)

    def statistics(self) -> dict[str, Any]:
        """Counts of primitives, of references to them from leaves and their ratio ``duplication``, of nodes and leaves;
        depth, bytes on the device, the seconds that the build took; and what a random ray that meets the box around
        everything is expected to visit and test without stopping at a hit: ``expected_nodes``,
        ``expected_primitives``, and ``sah_cost``, their sum in units of the config's costs."""
        return dict(self._statistics)


def rules_of(config: KdTreeConfig, primitives: int) -> BuildRules:
    """What a config says of a build over so many primitives."""
    depth = int(8 + 1.3 * math.log2(primitives)) if config.max_depth is None else config.max_depth
    costs = config.traversal_cost, config.intersection_cost
    return BuildRules(config.max_leaf_size, depth, *costs, config.empty_bonus)


def empty_statistics(kind: str) -> dict[str, Any]:
    """The statistics of a tree over nothing."""
    counts = ("primitives", "references", "duplication", "nodes", "leaves", "empty_leaves", "depth", "bytes")
    return {"kind": kind, **dict.fromkeys((*counts, "expected_nodes", "expected_primitives", "sah_cost"), 0)}


def present(geometry: Geometry) -> Primitives | None:
    """The primitives of a geometry that are anywhere, or None. (A structure over nothing is a box that encloses
    nothing.)"""
    parts = geometry.primitives()
    if parts is None:
        return None
    parts = held(parts)
    return parts if len(parts) else None


def upload(
    parts: Primitives, words: np.ndarray, refs: np.ndarray, depth: int, lo: np.ndarray, hi: np.ndarray
) -> tuple[traversal.PlaneTree, int]:
    """The tree on the device, and its bytes. Records stand in the order in which leaves first name them."""
    types = parts.types
    if len(words) > traversal.MAX_NODES or len(refs) > traversal.MAX_NODES:
        most = traversal.MAX_NODES
        raise SettingError(f"a tree of planes has at most {most} nodes and references: raise max_leaf_size")
    named, place = np.unique(refs, return_index=True)
    order = named[np.argsort(place, kind="stable")]
    rank = np.zeros(len(parts), np.uint32)
    rank[order] = np.arange(len(order))
    device = traversal.PlaneTree(
        types,
        owned(words, types.Float),
        words.shape[1],
        owned(rank[refs], types.UInt),
        parts.upload(order),
        # A multiple of eight keeps scenes of like depth on one kernel; a level leaves one cell pending at most.
        max(8, -(-depth // 8) * 8),
        [dr.opaque(types.Float, float(x)) for x in lo],
        [dr.opaque(types.Float, float(x)) for x in hi],
    )
    return device, words.nbytes + 4 * len(refs) + len(order) * parts.records[:1].nbytes


def plane_turns(statistics: dict[str, Any], types: Types) -> Turns:
    """The bound of :mod:`.kdtree_traversal` for a tree with these ``statistics``."""
    return Turns(types, statistics["kind"], statistics["nodes"] + statistics["references"])


def describe(
    kind: str, tree: KdTree | BspTree, leaf: np.ndarray, primitives: int, size: int, rules: BuildRules
) -> dict[str, Any]:
    """The statistics of a tree of planes with leaves where ``leaf`` is true."""
    nodes, tests = float(tree.share.sum()), float((tree.share * tree.count)[leaf].sum())
    return {
        "kind": kind,
        "primitives": primitives,
        "references": len(tree.refs),
        "duplication": len(tree.refs) / primitives,
        "nodes": len(leaf),
        "leaves": int(np.count_nonzero(leaf)),
        "empty_leaves": int(np.count_nonzero(leaf & (tree.count == 0))),
        "depth": tree.depth,
        "bytes": int(size),
        "expected_nodes": nodes,
        "expected_primitives": tests,
        "sah_cost": rules.traversal_cost * nodes + rules.intersection_cost * tests,
    }
