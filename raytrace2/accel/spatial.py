"""Hierarchies with spatial splits: large primitives are cut, each part in a node of its own.

Stich, Friedrich and Dietrich 2009, "Spatial splits in bounding volume hierarchies".
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..buffers import owned
from ..surfaces.primitives import Primitives
from ..types import Types
from .binary_layout import FREE_LEVELS, with_bounds
from .binary_tree import BinaryTree, surface_area
from .spatial_split import References, cut, plan_by_cut, plan_by_middle
from .triangle_parts import triangle_corners

#: Cuts are tried where the children of the best other split overlap by more than this share of the root's area.
OVERLAP = 1e-5
#: Triangles longer than this many times their height are not cut: rounding moves their hits about too far.
SLENDEREST = 1e4


def build_spatial(parts: Primitives, budget: float) -> BinaryTree:
    """A binary tree over primitives, one reference a leaf, with at most ``budget`` times as many further references as
    there are primitives. Only triangles are cut; ``order`` names some more than once.

    Where in a level more cuts pay than the budget allows, those that save most are made.
    """
    n = len(parts)
    return build_spatial_forest(parts, np.arange(n), np.array([n]), most=int(budget * n))


def build_spatial_forest(
    parts: Primitives, held: np.ndarray, counts: np.ndarray, *, most: int, depth: int = 0, overlap: float = OVERLAP
) -> BinaryTree:
    """Trees like that over some of the primitives: the first over ``counts[0]`` of those that ``held`` names, and so
    on, with at most ``most`` further references in all. Node k of the result is the root of the k-th, which stands
    ``depth`` levels below that of a greater tree; ``overlap`` stands for :data:`OVERLAP`."""
    kinds, roots = parts.types, len(counts)
    corners, cuttable, margin = _what_can_be_cut(parts)
    rows = np.zeros((len(parts), 16), kinds.numpy)
    rows[:, :9] = corners.reshape(-1, 9)
    rows[:, 9] = cuttable
    device = owned(rows, kinds.Float)
    remaining = most
    references = References.of(parts.lo[held], parts.hi[held], held, counts)
    everything = np.ones(len(held), bool)
    whole = surface_area(*references.boxes(everything))
    lefts, leaves = [], []
    made = roots
    root = np.arange(roots)
    while len(references.starts):
        inner = references.counts > 1
        left = np.full(len(inner), -1, np.int64)
        left[inner] = made + 2 * np.arange(np.count_nonzero(inner))
        made += 2 * int(np.count_nonzero(inner))
        lefts.append(left)
        leaves.append(references.some(~inner))
        references, root = references.some(inner), root[inner]
        if len(references.starts) == 0:
            break
        goes_right, cost = plan_by_middle(kinds, references)
        if depth >= FREE_LEVELS:
            goes_right = np.arange(len(references.owner)) - references.starts[references.owner] >= (
                references.counts[references.owner] // 2
            )
        elif remaining > 0:
            tried = (_overlap(references, goes_right) > overlap * whole[root]) & np.isfinite(cost)
            if tried.any():
                references, goes_right, added = _cut_some(
                    kinds, references, goes_right, cost, tried, remaining, (device, corners, cuttable, margin)
                )
                remaining -= added
        references, root = _shared(references, goes_right), np.repeat(root, 2)
        depth += 1
    return _joined(lefts, leaves, roots)


def _what_can_be_cut(parts: Primitives) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Corners (n, 3, 3) of triangles, which primitives may be cut, and by how much parts are to be widened.

    A ray test moves a triangle's vertices by less than ten round-offs of their distance from the ray's origin. As far
    as the part's box is away the traversal's own margin covers that; it takes the triangle's length besides. The
    weights of the vertices are off by less than ten round-offs of length over height, and by as much more as the ray
    is slanted; the sixteenfold allows for that.
    """
    corners, is_triangle = triangle_corners(parts)
    edges = corners[:, [1, 2, 0]] - corners
    length = np.sqrt(np.square(edges).sum(axis=2).max(axis=1))
    doubled = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        slenderness = length * length / doubled
        cuttable = is_triangle & (slenderness < SLENDEREST)
        margin = np.where(cuttable, 16 * (1 + 16 * slenderness) * parts.types.epsilon * length, 0)
    return corners, cuttable, margin.astype(parts.lo.dtype)


def _overlap(references: References, goes_right: np.ndarray) -> np.ndarray:
    """The area that the boxes of both sides of each node share."""
    (a, b), (c, d) = references.boxes(~goes_right), references.boxes(goes_right)
    lo, hi = np.maximum(a, c), np.minimum(b, d)
    return np.where((lo <= hi).all(axis=1), surface_area(lo, hi), 0)


def _cut_some(
    kinds: Types,
    references: References,
    goes_right: np.ndarray,
    cost: np.ndarray,
    tried: np.ndarray,
    remaining: int,
    geometry: tuple[Any, np.ndarray, np.ndarray, np.ndarray],
) -> tuple[References, np.ndarray, int]:
    """Cuts those of the nodes ``tried`` where that costs less, the best first, while the budget lasts; gives the
    references, which go right, and how many have been added."""
    device, corners, cuttable, margin = geometry
    candidates = np.flatnonzero(tried)
    some = references.some(tried)
    plans = plan_by_cut(kinds, some, device)
    saving = cost[candidates] - plans.cost
    pays = saving > 0
    if not pays.any():
        return references, goes_right, 0
    some, plans = some.some(pays), type(plans)(plans.axis[pays], plans.plane[pays], plans.cost[pays])
    candidates, saving = candidates[pays], saving[pays]
    parted, right = cut(some, plans, corners, cuttable, margin)
    number = np.stack([np.bincount(parted.owner[side], minlength=len(candidates)) for side in (~right, right)])
    added = number.sum(axis=0) - some.counts
    # Each cut takes from the budget or leaves both sides fewer: so they come to an end.
    useful = (number > 0).all(axis=0)
    best = np.argsort(np.where(useful, -saving, np.inf), kind="stable")
    affordable = np.zeros(len(candidates), bool)
    affordable[best] = np.cumsum(np.where(useful, added, 0)[best]) <= remaining
    made = useful & affordable
    chosen = np.zeros(len(references.starts), bool)
    chosen[candidates[made]] = True
    stay = ~chosen[references.owner]
    taken = made[parted.owner]
    joined = References(
        np.concatenate([references.lo[stay], parted.lo[taken]]),
        np.concatenate([references.hi[stay], parted.hi[taken]]),
        np.concatenate([references.prim[stay], parted.prim[taken]]),
        references.starts,
        references.counts,
        np.concatenate([references.owner[stay], candidates[parted.owner[taken]]]),
    )
    return joined, np.concatenate([goes_right[stay], right[taken]]), int(added[made].sum())


def _shared(references: References, goes_right: np.ndarray) -> References:
    """The references of the children, siblings side by side. A node that would not be divided is halved by number."""
    n = len(references.starts)
    child = 2 * references.owner + goes_right
    counts = np.bincount(child, minlength=2 * n)
    if (counts == 0).any():
        order = np.argsort(references.owner, kind="stable")
        owner, total = references.owner[order], np.bincount(references.owner, minlength=n)
        second = np.arange(len(owner)) - (np.cumsum(total) - total)[owner] >= total[owner] // 2
        undivided = (counts.reshape(-1, 2) == 0).any(axis=1)
        child[order] = np.where(undivided[owner], 2 * owner + second, child[order])
        counts = np.bincount(child, minlength=2 * n)
    order = np.argsort(child, kind="stable")
    return References.of(references.lo[order], references.hi[order], references.prim[order], counts)


def _joined(lefts: list[np.ndarray], leaves: list[References], roots: int) -> BinaryTree:
    """The trees, side by side, of the levels' left children and leaves."""
    left = np.concatenate(lefts)
    ends = np.cumsum([len(level) for level in lefts])
    begins = ends - [len(level) for level in lefts]
    count = np.ones(len(left), np.int64)
    for begin, end in zip(begins[::-1], ends[::-1], strict=True):
        inner = begin + np.flatnonzero(left[begin:end] >= 0)
        count[inner] = count[left[inner]] + count[left[inner] + 1]
    first = np.zeros(len(left), np.int64)
    first[:roots] = np.cumsum(count[:roots]) - count[:roots]
    for begin, end in zip(begins, ends, strict=True):
        inner = begin + np.flatnonzero(left[begin:end] >= 0)
        first[left[inner]] = first[inner]
        first[left[inner] + 1] = first[inner] + count[left[inner]]
    place = first[left < 0]
    order = np.empty(len(place), np.int64)
    lo, hi = (np.empty((len(place), 3), leaves[0].lo.dtype) for _ in range(2))
    order[place] = np.concatenate([level.prim for level in leaves])
    lo[place] = np.concatenate([level.lo for level in leaves])
    hi[place] = np.concatenate([level.hi for level in leaves])
    return with_bounds(left, first, count, order, [int(end) for end in ends], lo, hi)
