"""Binary space partitioning: space divided by planes at any tilt."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from ..surfaces.geometry import Geometry
from ..surfaces.hit import Candidate
from ..surfaces.levels import Level
from ..surfaces.primitives import LocalRay
from ..surfaces.record import encode_integers
from ..surfaces.structure import Structure
from . import kdtree_traversal as traversal
from .bsp_build import BspTree, build_bsp
from .kdtree import KdTreeConfig, describe, empty_statistics, plane_turns, present, rules_of, upload
from .level_boxes_planes import plane_levels

#: Words of a node: the plane's normal and a point on it (a leaf has its count in the first), its reach and its link.
WORDS = 8


@dataclass(frozen=True)
class BspConfig(KdTreeConfig):
    """As for the kd-tree, with planes along faces, across the axes, and across the principal axes of what a node
    holds."""

    max_leaf_size: int = 8
    traversal_cost: float = 4.0
    empty_bonus: float = 0.0


class Bsp(Structure):
    """A BSP tree over the primitives of a geometry; a primitive is listed in every leaf that it reaches."""

    kind = "bsp"

    def __init__(self, geometry: Geometry, config: BspConfig | None = None) -> None:
        super().__init__(geometry)
        self.config = config or BspConfig()
        begin = time.perf_counter()
        self._device: traversal.PlaneTree | None = None
        parts = present(geometry)
        self._statistics: dict[str, Any] = {**empty_statistics(self.kind), "tilted_planes": 0}
        if parts is not None:
            rules = rules_of(self.config, len(parts))
            tree = build_bsp(parts, rules)
            is_leaf = tree.child < 0
            words = np.zeros((len(tree.child), WORDS), self.types.numpy)
            words[:, :3], words[:, 3:6] = tree.normal, tree.point
            words[is_leaf, 0] = encode_integers(tree.count, self.types)[is_leaf]
            words[:, 6] = tree.reach
            link = np.where(is_leaf, 4 * tree.first + traversal.LEAF, 4 * tree.child)
            words[:, 7] = encode_integers(link, self.types)
            self._device, size = upload(parts, words, tree.refs, tree.depth, tree.lo, tree.hi)
            self._statistics = describe(self.kind, tree, is_leaf, len(parts), size, rules)
            self._statistics["tilted_planes"] = _tilted(tree)
        self.turns = plane_turns(self._statistics, self.types)
        self._statistics["build_seconds"] = time.perf_counter() - begin

    def traverse(self, ray: LocalRay, best: Candidate, root: Any, active: Any) -> Candidate:
        if self._device is None:
            return best
        return traversal.closest(self._device, _meet_plane, ray, best, root, active, self.turns)

    def traverse_any(self, ray: LocalRay, root: Any, active: Any) -> Any:
        if self._device is None:
            return dr.full(self.types.Bool, False, dr.width(root))
        return traversal.anything(self._device, _meet_plane, ray, root, active, self.turns)

    def own_levels(self, bounds: tuple[np.ndarray, np.ndarray]) -> Iterator[Level]:
        return iter(()) if self._device is None else plane_levels(bounds, self._device)

    def statistics(self) -> dict[str, Any]:
        """What the kd-tree tells, with the boxes around cells for the cells, and how many planes are across no axis."""
        return dict(self._statistics)


def _meet_plane(words: list[Any], link: Any, slopes: traversal.Slopes) -> tuple[Any, Any, Any]:
    """:data:`~.kdtree_traversal.Meet` for the plane through words 3 to 5 across words 0 to 2.

    The distance to the plane is formed from the point, which is near: its rounding is relative to the way there.
    """
    o, d = slopes.o, slopes.d
    distance = dr.fma(words[0], words[3] - o.x, dr.fma(words[1], words[4] - o.y, words[2] * (words[5] - o.z)))
    slope = dr.fma(words[0], d.x, dr.fma(words[1], d.y, words[2] * d.z))
    # As for components of the direction: so little of a slope is less than the margin, and its reciprocal is finite.
    slope = dr.select(abs(slope) < slopes.least, dr.copysign(slopes.least, slope), slope)
    inverse = dr.rcp(slope)
    return distance * inverse, abs(inverse), inverse < 0


def _tilted(tree: BspTree) -> int:
    axis_parallel = np.count_nonzero(tree.normal, axis=1) <= 1
    return int(np.count_nonzero((tree.child >= 0) & ~axis_parallel))
