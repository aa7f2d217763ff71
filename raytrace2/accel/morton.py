"""Linear hierarchies: the prefix tree of Morton codes, fast to build and the coarsest of the clever ones.

After Lauterbach et al. 2009, "Fast BVH construction on GPUs", with the splits of all nodes found at once as in Karras
2012, "Maximizing parallelism in the construction of BVHs, octrees, and k-d trees".
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import drjit.llvm.ad as ad
import numpy as np

from .binary_layout import with_bounds
from .binary_tree import BinaryTree
from .morton_codes import sorted_codes


def build_morton(lo: np.ndarray, hi: np.ndarray, leaf_size: int = 1) -> BinaryTree:
    """A binary tree over boxes (n, 3) with up to ``leaf_size`` primitives a leaf: nodes are split where the highest
    bit of their keys changes, so that none is deeper than a key has bits."""
    keys, order = sorted_codes(lo, hi)
    n = len(keys)
    last_left = _last_of_left(keys) if n > 1 else np.zeros(0, np.int64)
    # Node k of those that split is the k-th: a left child ends with the node of its number, a right one begins with it.
    name, first, count = np.zeros(1, np.int64), np.zeros(1, np.int64), np.array([n])
    firsts, counts, lefts, level_ends = [], [], [], []
    made = 1
    while len(first):
        inner = np.flatnonzero(count > leaf_size)
        left = np.full(len(first), -1, np.int64)
        left[inner] = np.arange(made, made + 2 * len(inner), 2)
        level_ends.append(made)
        made += 2 * len(inner)
        firsts.append(first)
        counts.append(count)
        lefts.append(left)
        cut, begin, number = last_left[name[inner]], first[inner], count[inner]
        size = cut + 1 - begin
        name = np.stack([cut, cut + 1], axis=1).ravel()
        first = np.stack([begin, cut + 1], axis=1).ravel()
        count = np.stack([size, number - size], axis=1).ravel()
    left, first, count = (np.concatenate(parts) for parts in (lefts, firsts, counts))
    lo, hi = lo.take(order, axis=0), hi.take(order, axis=0)
    return with_bounds(left, first, count, order, level_ends, lo, hi)


def _last_of_left(keys: np.ndarray) -> np.ndarray:
    """For each of the n - 1 nodes of the prefix tree over ``keys``, the last key of its left child (Karras, section
    4)."""
    UInt, Int, UInt64 = ad.UInt32, ad.Int32, ad.UInt64
    n = len(keys)
    source = UInt64(keys)
    count = dr.opaque(Int, n)

    def differing(a: Any, b: Any) -> Any:
        """The bits in which keys a and b differ; all where b is out of range, the highest of which no two keys differ
        in."""
        inside = (b >= 0) & (b < count)
        other = dr.gather(UInt64, source, UInt(b), inside)
        mine = dr.gather(UInt64, source, UInt(a))
        return dr.select(inside, mine ^ other, UInt64(0xFFFFFFFFFFFFFFFF))

    i = Int(dr.arange(UInt, n - 1))
    after, before = differing(i, i + 1), differing(i, i - 1)
    forward = dr.lzcnt(after) > dr.lzcnt(before)
    step = dr.select(forward, Int(1), Int(-1))
    limit = dr.lzcnt(dr.select(forward, before, after))

    def longer(length: Any) -> tuple[Any]:
        return (length * 2,)

    most = dr.while_loop(
        (dr.full(Int, 2, n - 1),), lambda m: dr.lzcnt(differing(i, i + m * step)) > limit, longer, label="morton reach"
    )[0]

    def search(length: Any, part: Any, least: Any) -> tuple[Any, ...]:
        shares = dr.lzcnt(differing(i, i + (length + part) * step)) > least
        return dr.select(shares, length + part, length), part >> 1, least

    length = dr.while_loop(
        (dr.zeros(Int, n - 1), most >> 1, limit), lambda _, part, __: part > 0, search, label="morton length"
    )[0]
    own = dr.lzcnt(differing(i, i + length * step))
    cut = dr.while_loop(
        (dr.zeros(Int, n - 1), most >> 1, own), lambda _, part, __: part > 0, search, label="morton split"
    )[0]
    found = i + cut * step + dr.select(forward, Int(0), Int(-1))
    return found.numpy().astype(np.int64)
