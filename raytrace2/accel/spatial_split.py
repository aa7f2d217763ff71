"""How the references of nodes are shared between children: by their middles, or by a plane that cuts through them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from ..buffers import owned
from ..surfaces.record import encode_integers
from ..types import Types
from .binary_tree import surface_area
from .sah_bins import BINS, BY_COUNT, cheapest_plane, fill_bins
from .sah_boxes import FIRST, WORDS, Group, centre, empty, group_of, lanes, load, union
from .sah_split_large import Chunks
from .spatial_bins import cheapest_cut, fill_cut_bins
from .spatial_chunks import cut_bins_by_chunks
from .triangle_parts import part_boxes

#: The bins of nodes of more references than LARGE are filled by lanes that take CHUNK of them each.
LARGE, CHUNK = 1024, 64


@dataclass(frozen=True, eq=False)
class References:
    """Boxes ``lo``, ``hi`` (m, 3) of parts of primitives ``prim`` (m,), those of node k from ``starts[k]`` on,
    ``counts[k]`` of them; ``owner`` is the k of each."""

    lo: np.ndarray
    hi: np.ndarray
    prim: np.ndarray
    starts: np.ndarray
    counts: np.ndarray
    owner: np.ndarray

    @staticmethod
    def of(lo: np.ndarray, hi: np.ndarray, prim: np.ndarray, counts: np.ndarray) -> References:
        """References that stand in the order of their nodes."""
        owner = np.repeat(np.arange(len(counts)), counts)
        return References(lo, hi, prim, np.cumsum(counts) - counts, counts, owner)

    def some(self, keep: np.ndarray) -> References:
        """Only the nodes where ``keep`` (nodes,) is true."""
        which = keep[self.owner]
        return References.of(self.lo[which], self.hi[which], self.prim[which], self.counts[keep])

    def packets(self, kinds: Types) -> Any:
        """The boxes and numbers on the device."""
        rows = np.zeros((len(self.lo), WORDS), self.lo.dtype)
        rows[:, :3] = self.lo
        np.negative(self.hi, out=rows[:, 3:6])
        rows[:, FIRST] = encode_integers(self.prim, kinds)
        return owned(rows, kinds.Float)

    def boxes(self, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The box around each node's references for which ``which`` (m,) is true; lo > hi where there are none."""
        found = np.empty((2, len(self.starts), 3), self.lo.dtype)
        for k in range(3):
            found[0, :, k] = np.minimum.reduceat(np.where(which, self.lo[:, k], np.inf), self.starts)
            found[1, :, k] = np.maximum.reduceat(np.where(which, self.hi[:, k], -np.inf), self.starts)
        return found[0], found[1]


@dataclass(frozen=True, eq=False)
class Plans:
    """For each node the axis, the plane and the cost of a split; costs are in units of area."""

    axis: np.ndarray
    plane: np.ndarray
    cost: np.ndarray


def plan_by_middle(kinds: Types, references: References) -> tuple[np.ndarray, np.ndarray]:
    """Which references (m,) go right by the cheapest plane between their middles, and the cost for each node. Where no
    plane divides a node, its second half goes right."""
    packets = references.packets(kinds)
    bounds, group = _groups(kinds, packets, references)
    axis, plane, cost = cheapest_plane(kinds, fill_bins(kinds, packets, group), group.end - group.begin, group.unit)
    scale, least = group.scale, group.least
    dr.eval(axis, plane, cost, scale, least, group.unit)
    by_axis = axis.numpy().astype(np.int64)
    counted = by_axis == BY_COUNT
    rows, owner = np.arange(len(by_axis)), references.owner
    column = np.where(counted, 0, by_axis)
    offset = np.stack([x.numpy() for x in least])[column, rows]
    factor = np.stack([x.numpy() for x in scale])[column, rows]
    half = references.lo.dtype.type(0.5)
    middle = references.lo * half + references.hi * half
    along = middle[np.arange(len(owner)), column[owner]]
    goes_right = (along - offset[owner]) * factor[owner] >= plane.numpy()[owner]
    second = np.arange(len(owner)) - references.starts[owner] >= references.counts[owner] // 2
    return np.where(counted[owner], second, goes_right), _in_areas(cost, group.unit)


def plan_by_cut(kinds: Types, references: References, corners: Any) -> Plans:
    """The cheapest plane that may cut references, for each node."""
    large = references.counts > LARGE
    if large.all() or not large.any():
        return _plan_by_cut(kinds, references, corners, by_chunks=bool(large.any()))
    both = [_plan_by_cut(kinds, references.some(w), corners, c) for w, c in ((large, True), (~large, False))]
    found = [np.empty(len(large), x.dtype) for x in (both[0].axis, both[0].plane, both[0].cost)]
    for which, plans in zip((large, ~large), both, strict=True):
        for array, part in zip(found, (plans.axis, plans.plane, plans.cost), strict=True):
            array[which] = part
    return Plans(*found)


def _plan_by_cut(kinds: Types, references: References, corners: Any, by_chunks: bool) -> Plans:
    packets = references.packets(kinds)
    bounds, group = _groups(kinds, packets, references)
    if by_chunks:
        chunks = Chunks.of(references.starts, references.counts, CHUNK)
        bins = cut_bins_by_chunks(kinds, packets, corners, bounds, chunks)
    else:
        bins = fill_cut_bins(kinds, packets, corners, bounds, group.begin, group.end)
    cost, axis, bin = cheapest_cut(kinds, bins, group.unit, len(references.starts))
    dr.eval(cost, axis, bin, bounds, group.unit)
    by_axis = np.where(axis.numpy() < 3, axis.numpy(), 0).astype(np.int64)
    rows = np.arange(len(by_axis))
    least = np.stack([bounds[k].numpy() for k in range(3)])[by_axis, rows].astype(np.float64)
    most = -np.stack([bounds[k + 3].numpy() for k in range(3)])[by_axis, rows].astype(np.float64)
    plane = least + (most - least) * (bin.numpy() / BINS)
    return Plans(by_axis, plane.astype(references.lo.dtype), _in_areas(cost, group.unit))


def cut(
    references: References, plans: Plans, corners: np.ndarray, cuttable: np.ndarray, margin: np.ndarray
) -> tuple[References, np.ndarray]:
    """References with those that a node's plane cuts in two, and which go right; a node's are not together any more.

    ``corners`` (n, 3, 3), ``cuttable`` (n,) and ``margin`` (n,), by which parts are widened, are those of all
    primitives. A reference that costs less whole on one side, or that may not be cut, stays whole ("unsplitting").
    """
    rows, owner = np.arange(len(references.owner)), references.owner
    axis, plane = plans.axis[owner], plans.plane[owner]
    begin, end = references.lo[rows, axis], references.hi[rows, axis]
    left, right = end <= plane, begin >= plane
    right &= ~left
    across = np.flatnonzero(~left & ~right)
    prim, at = references.prim[across], owner[across]
    lo, hi = references.lo[across], references.hi[across]
    parts = [
        _within(part, margin[prim], lo, hi)
        for part in part_boxes(corners[prim], axis[across], plane[across], references.lo.dtype)
    ]
    whole = _costs(references, left, right, across, lo, hi, parts)
    may = cuttable[prim] & (parts[0][0] <= parts[0][1]).all(axis=1) & (parts[1][0] <= parts[1][1]).all(axis=1)
    split = may & (whole[0] < np.minimum(whole[1], whole[2]))
    left[across[~split & (whole[1] <= whole[2])]] = True
    right[across[~split & (whole[1] > whole[2])]] = True
    keep = left | right
    goes_right = np.concatenate([right[keep], np.zeros(split.sum(), bool), np.ones(split.sum(), bool)])
    joined = References(
        np.concatenate([references.lo[keep], parts[0][0][split], parts[1][0][split]]),
        np.concatenate([references.hi[keep], parts[0][1][split], parts[1][1][split]]),
        np.concatenate([references.prim[keep], prim[split], prim[split]]),
        references.starts,
        references.counts,
        np.concatenate([owner[keep], at[split], at[split]]),
    )
    return joined, goes_right


def _within(
    part: tuple[np.ndarray, np.ndarray], margin: np.ndarray, lo: np.ndarray, hi: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """``part``, widened by ``margin``, within the box that the reference had."""
    return np.maximum(part[0] - margin[:, None], lo), np.minimum(part[1] + margin[:, None], hi)


def _costs(
    references: References,
    left: np.ndarray,
    right: np.ndarray,
    across: np.ndarray,
    lo: np.ndarray,
    hi: np.ndarray,
    parts: list[tuple[np.ndarray, np.ndarray]],
) -> list[np.ndarray]:
    """What a node costs with each of ``across`` cut, all on the left or all on the right (Stich et al., section
    4.4)."""
    owner, n = references.owner, len(references.starts)
    at = owner[across]
    sides, numbers = [], []
    for side, (below, above) in zip((left, right), parts, strict=True):
        low, high = references.boxes(side)
        for k in range(3):
            np.minimum.at(low[:, k], at, below[:, k])
            np.maximum.at(high[:, k], at, above[:, k])
        sides.append((low, high))
        numbers.append(np.bincount(owner[side], minlength=n) + np.bincount(at, minlength=n))
    areas = [surface_area(*side)[at] for side in sides]
    grown = [surface_area(np.minimum(s[0][at], lo), np.maximum(s[1][at], hi)) for s in sides]
    nl, nr = numbers[0][at], numbers[1][at]
    return [
        areas[0] * nl + areas[1] * nr,
        grown[0] * nl + areas[1] * (nr - 1),
        areas[0] * (nl - 1) + grown[1] * nr,
    ]


def _groups(kinds: Types, packets: Any, references: References) -> tuple[list[Any], Group]:
    """The box around each node's references, and the group they make."""
    begin, count = lanes(kinds, references.starts, references.counts)
    end, width = begin + count, len(references.starts)

    def around(i: Any, bounds: list[Any], middles: list[Any]) -> tuple[Any, ...]:
        box = load(kinds, packets, i)
        middle = centre(box)
        return i + 1, union(bounds, box), union(middles, [*middle, *(-c for c in middle)])

    start = (begin + 0, empty(kinds, width), empty(kinds, width))
    _, bounds, middles = dr.while_loop(start, lambda i, *_: i < end, around, label="around references")
    dr.eval(bounds, middles)
    return bounds, group_of(kinds, bounds, middles, begin, end, BINS)


def _in_areas(cost: Any, unit: Any) -> np.ndarray:
    """Costs in units of area, from those in units of ``1 / unit**2``."""
    per_unit = unit.numpy().astype(np.float64)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        return np.where(per_unit > 0, cost.numpy() / per_unit / per_unit, 0.0)
