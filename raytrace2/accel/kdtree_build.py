"""Building kd-trees a level at a time, by the surface area heuristic with perfect splits.

After Havran 2000, "Heuristic ray shooting algorithms", and Wald and Havran 2006, "On building fast kd-trees".

References to primitives carry the box of what lies of them in their node's cell. A plane sends each reference to the
sides that its box reaches; those on both sides are clipped, and the parts boxed anew.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..surfaces.primitives import Primitives
from .kdtree_clip import clip_boxes, triangle_corners
from .kdtree_split import Nodes, Splits, cheapest_splits

#: Planes that do not pay for themselves are still tried this often on the way down from a node (Pharr et al. 2023,
#: section 7.3 of the online edition of "Physically Based Rendering"): a plane of no use may be what the next one needs.
UNPAID_PLANES = 3
#: References per primitive, above which no more are made: for a million primitives they take two gigabytes on the way.
#: With half as many, trees over long diagonal things test more than twice as many primitives a ray.
MAX_DUPLICATION = 16


@dataclass(frozen=True, eq=False)
class KdTree:
    """Nodes level by level: ``axis`` (3: leaf) and ``plane`` of node k, its children ``child[k]`` (below the plane) and
    ``child[k] + 1``; a leaf's references ``refs[first[k] : first[k] + count[k]]``. ``reach`` is the greatest sum of the
    edges of a box of a whole primitive below the node; ``share`` the area of the cell by the root's."""

    axis: np.ndarray
    plane: np.ndarray
    child: np.ndarray
    first: np.ndarray
    count: np.ndarray
    reach: np.ndarray
    share: np.ndarray
    refs: np.ndarray
    depth: int
    lo: np.ndarray
    hi: np.ndarray


@dataclass(frozen=True)
class BuildRules:
    """When to split, in the terms of :class:`.kdtree.KdTreeConfig`; ``max_depth`` is a number here."""

    max_leaf_size: int
    max_depth: int
    traversal_cost: float
    intersection_cost: float
    empty_bonus: float


def build_kdtree(parts: Primitives, rules: BuildRules) -> KdTree:
    """A kd-tree over one or more primitives with boxes that enclose something. Deterministic."""
    corners, is_triangle = triangle_corners(parts)
    size = (parts.hi.astype(np.float64) - parts.lo).sum(axis=1)
    lo, hi = parts.lo, parts.hi
    prim = np.arange(len(lo), dtype=np.int32)
    nodes = Nodes(np.zeros(1, np.int64), np.array([len(lo)]), lo.min(axis=0)[None], hi.max(axis=0)[None])
    root_lo, root_hi = nodes.lo[0], nodes.hi[0]
    unpaid = np.zeros(1, np.int64)
    made, leaf_refs = 1, 0
    levels: list[tuple[np.ndarray, ...]] = []
    refs: list[np.ndarray] = []
    while len(nodes):
        splits = _choose(parts, nodes, unpaid, lo, hi, rules, last=len(levels) >= rules.max_depth)
        inner = np.isfinite(splits.cost)
        _keep_within_budget(splits, inner, nodes, lo, hi, MAX_DUPLICATION * len(parts) - leaf_refs)
        leaf = np.flatnonzero(~inner)
        axis = np.where(inner, splits.axis, 3)
        child = np.full(len(nodes), -1)
        child[inner] = made + 2 * np.arange(np.count_nonzero(inner))
        made += 2 * int(np.count_nonzero(inner))
        kept, _ = nodes.take(leaf).references()
        first = np.zeros(len(nodes), np.int64)
        count = np.where(inner, 0, nodes.count)
        first[leaf] = leaf_refs + np.cumsum(count[leaf]) - count[leaf]
        leaf_refs += len(kept)
        refs.append(prim[kept])
        reach = _per_node(np.maximum, size[prim], nodes)
        levels.append((axis, splits.plane, child, first, count, reach, _areas(nodes)))
        split = np.flatnonzero(inner)
        cost = rules.traversal_cost + rules.intersection_cost * splits.cost[split]
        unpaid = np.repeat(unpaid[split] + (cost >= rules.intersection_cost * nodes.count[split]), 2)
        below = Splits(splits.cost[split], splits.axis[split], splits.plane[split], splits.flat_left[split])
        nodes, prim, lo, hi = _next_level(nodes.take(split), below, prim, lo, hi, corners, is_triangle)
    columns: list[Any] = [np.concatenate(column) for column in zip(*levels, strict=True)]
    share = columns[-1]
    columns[-1] = share / share[0] if share[0] > 0 else np.ones(len(share))
    columns += [np.concatenate(refs), len(levels) - 1, root_lo, root_hi]
    return KdTree(*columns)


def _choose(
    parts: Primitives, nodes: Nodes, unpaid: np.ndarray, lo: np.ndarray, hi: np.ndarray, rules: BuildRules, last: bool
) -> Splits:
    """The plane of each node; of infinite cost where it is better not split."""
    n = len(nodes)
    found = Splits(np.full(n, np.inf), np.zeros(n, np.int64), np.zeros(n, lo.dtype), np.zeros(n, bool))
    asked = np.flatnonzero(nodes.count > rules.max_leaf_size)
    if last or len(asked) == 0:
        return found
    best = cheapest_splits(parts.types, nodes.take(asked), lo, hi, rules.empty_bonus)
    cost = rules.traversal_cost + rules.intersection_cost * best.cost
    whole = rules.intersection_cost * nodes.count[asked]
    unpaid_next = unpaid[asked] + (cost >= whole)
    hopeless = (unpaid_next >= UNPAID_PLANES) | ((cost > 4 * whole) & (nodes.count[asked] < 16))
    best.cost[hopeless] = np.inf
    found.cost[asked], found.axis[asked] = best.cost, best.axis
    found.plane[asked], found.flat_left[asked] = best.plane, best.flat_left
    return found


def _sides(nodes: Nodes, splits: Splits, lo: np.ndarray, hi: np.ndarray) -> tuple[np.ndarray, ...]:
    """The references of ``nodes``, their node, and whether their boxes reach left and right of its plane."""
    ref, owner = nodes.references()
    axis, plane = splits.axis[owner], splits.plane[owner]
    a, b = lo[ref, axis], hi[ref, axis]
    flat = (a == plane) & (b == plane)
    left = (a < plane) | (flat & splits.flat_left[owner])
    right = (b > plane) | (flat & ~splits.flat_left[owner])
    return ref, owner, left, right


def _keep_within_budget(
    splits: Splits, inner: np.ndarray, nodes: Nodes, lo: np.ndarray, hi: np.ndarray, budget: int
) -> None:
    """Takes from ``inner`` the splits that gain least by the reference they add, to stay in ``budget``."""
    if 2 * nodes.count.sum() <= budget:
        return
    split = np.flatnonzero(inner)
    part = Splits(splits.cost[split], splits.axis[split], splits.plane[split], splits.flat_left[split])
    _, owner, left, right = _sides(nodes.take(split), part, lo, hi)
    added = np.bincount(owner[left & right], minlength=len(split))
    gain = (nodes.count[split] - part.cost) / np.maximum(added, 0.5)
    order = np.argsort(-gain, kind="stable")
    too_many = np.cumsum(added[order]) + nodes.count.sum() > budget
    inner[split[order[too_many]]] = False


def _next_level(
    nodes: Nodes,
    splits: Splits,
    prim: np.ndarray,
    lo: np.ndarray,
    hi: np.ndarray,
    corners: np.ndarray,
    is_triangle: np.ndarray,
) -> tuple[Nodes, np.ndarray, np.ndarray, np.ndarray]:
    """The children of ``nodes`` and their references: of each node the left child's, then the right child's."""
    if len(nodes) == 0:
        return nodes, prim[:0], lo[:0], hi[:0]
    ref, owner, left, right = _sides(nodes, splits, lo, hi)
    both = np.flatnonzero(left & right)
    axis, plane = splits.axis[owner[both]], splits.plane[owner[both]]
    whole = lo[ref[both]], hi[ref[both]]
    rows = np.arange(len(both))
    halves = []
    can_clip = np.flatnonzero(is_triangle[prim[ref[both]]])
    for side in range(2):
        box = whole[0].copy(), whole[1].copy()
        box[1 - side][rows, axis] = plane
        some = can_clip
        begin, end = box[0][some, axis[some]], box[1][some, axis[some]]
        cut = clip_boxes(box[0][some], box[1][some], axis[some], begin, end, corners[prim[ref[both[some]]]])
        box[0][some], box[1][some] = cut
        halves.append(box)
    left[both] = (halves[0][0] <= halves[0][1]).all(axis=1)
    right[both] = (halves[1][0] <= halves[1][1]).all(axis=1)

    n_left, n_right = (np.bincount(owner[side], minlength=len(nodes)) for side in (left, right))
    count = np.stack([n_left, n_right], axis=1).ravel()
    first = np.cumsum(count) - count
    new_prim = np.empty(count.sum(), prim.dtype)
    new_lo, new_hi = (np.empty((len(new_prim), 3), lo.dtype) for _ in range(2))
    for side, (goes, numbers) in enumerate(((left, n_left), (right, n_right))):
        rank = np.arange(np.count_nonzero(goes)) - np.repeat(np.cumsum(numbers) - numbers, numbers)
        target = first[2 * owner[goes] + side] + rank
        source = ref[goes]
        new_prim[target], new_lo[target], new_hi[target] = prim[source], lo[source], hi[source]
        place = np.empty(len(ref), np.int64)
        place[goes] = target
        kept = goes[both]
        at = place[both[kept]]
        new_lo[at], new_hi[at] = halves[side][0][kept], halves[side][1][kept]
    child_lo, child_hi = np.repeat(nodes.lo, 2, axis=0), np.repeat(nodes.hi, 2, axis=0)
    at = np.arange(len(nodes))
    child_hi[2 * at, splits.axis] = splits.plane
    child_lo[2 * at + 1, splits.axis] = splits.plane
    return Nodes(first, count, child_lo, child_hi), new_prim, new_lo, new_hi


def _per_node(reduce: np.ufunc, values: np.ndarray, nodes: Nodes) -> np.ndarray:
    """``reduce`` over the references of each node, which stand one node after the other; 0 for a node without any."""
    result = np.zeros(len(nodes))
    some = np.flatnonzero(nodes.count > 0)
    if len(some):
        result[some] = reduce.reduceat(values, nodes.first[some])
    return result


def _areas(nodes: Nodes) -> np.ndarray:
    x, y, z = (nodes.hi.astype(np.float64) - nodes.lo).T
    return x * y + y * z + z * x
