"""Primitives in groups that lie together, for a volume around each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Groups:
    """Group k holds primitives ``order[firsts[k]]`` up to ``order[firsts[k + 1] - 1]``; none is empty."""

    order: np.ndarray
    firsts: np.ndarray

    def __len__(self) -> int:
        return len(self.firsts) - 1


#: A primitive is large if its box has more than this share of the area of the box around everything, and primitives are
#: few if they are no more than this share of all.
_LARGE = _FEW = 1 / 32


def few_large(lo: np.ndarray, hi: np.ndarray) -> np.ndarray:
    """Which primitives (n,) are large, if they are few, else none: a floor would stretch the volume around whatever
    else was in its group over the whole scene."""
    share = half_area(lo, hi) / max(half_area(lo.min(axis=0)[None], hi.max(axis=0)[None])[0], 1e-300)
    large = share > _LARGE
    return large if large.sum() <= _FEW * len(lo) else np.zeros(len(lo), dtype=bool)


def with_singles(groups: Groups, alone: np.ndarray) -> Groups:
    """``groups`` of the primitives that are not ``alone`` (n,), numbered among all, and a group for each of the
    others."""
    rest, singles = np.flatnonzero(~alone), np.flatnonzero(alone)
    ends = len(rest) + 1 + np.arange(len(singles))
    return Groups(np.append(rest[groups.order], singles), np.append(groups.firsts, ends))


def halved(lo: np.ndarray, hi: np.ndarray, most: int) -> list[Groups]:
    """Groupings by halving, coarsest first: all in one group, then each group in two equal ones along the longest
    side of the box around its centroids, until none has more than ``most`` primitives.

    ``lo``, ``hi`` (n, 3) are the primitives' bounds. Ties go by the primitives' numbers.
    """
    n = len(lo)
    centroid = lo.astype(np.float64) + hi
    by_axis = np.argsort(centroid, axis=0, kind="stable").T
    rank = np.empty((3, n), dtype=np.uint64)
    for axis in range(3):
        rank[axis, by_axis[axis]] = np.arange(n, dtype=np.uint64)
    order, firsts = np.arange(n), np.array([0, n])
    found = [Groups(order, firsts)]
    while np.diff(firsts).max() > most:
        starts, sizes = firsts[:-1], np.diff(firsts)
        moved = centroid[order]
        extent = np.maximum.reduceat(moved, starts, axis=0) - np.minimum.reduceat(moved, starts, axis=0)
        longest = np.repeat(extent.argmax(axis=1), sizes)
        group = np.repeat(np.arange(len(starts), dtype=np.uint64), sizes)
        keys = np.sort((group << np.uint64(32)) | rank[longest, order])
        order = by_axis[longest, (keys & np.uint64(0xFFFFFFFF)).astype(np.int64)]
        middles = starts + (sizes + 1) // 2
        firsts = np.unique(np.concatenate([firsts, middles]))
        found.append(Groups(order, firsts))
    return found


def in_runs(labels: np.ndarray) -> Groups:
    """A group for each run of equal ``labels`` (n,), which lie together already."""
    starts = np.flatnonzero(np.concatenate([[True], labels[1:] != labels[:-1]]))
    return Groups(np.arange(len(labels)), np.append(starts, len(labels)))


def expected_tests(groups: Groups, lo: np.ndarray, hi: np.ndarray) -> float:
    """How many primitives a random line that meets the box around everything tests, with a box around each group: the
    sum of sizes times the boxes' shares of its area (Goldsmith and Salmon 1987)."""
    low = np.minimum.reduceat(lo[groups.order].astype(np.float64), groups.firsts[:-1], axis=0)
    high = np.maximum.reduceat(hi[groups.order].astype(np.float64), groups.firsts[:-1], axis=0)
    whole = half_area(low.min(axis=0)[None], high.max(axis=0)[None])[0]
    share = half_area(low, high) / whole if whole > 0 else np.ones(len(groups))
    return float((np.diff(groups.firsts) * share).sum())


def half_area(lo: np.ndarray, hi: np.ndarray) -> np.ndarray:
    """Half the surface areas (n,) of boxes (n, 3)."""
    x, y, z = (hi.astype(np.float64) - lo).T
    return x * y + y * z + z * x
