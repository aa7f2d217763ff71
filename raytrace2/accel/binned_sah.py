"""Surface-area-heuristic build, a whole level of nodes at a time.

After Wald 2007, "On fast construction of SAH-based bounding volume hierarchies".
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np

from ..buffers import owned
from ..surfaces.record import encode_integers
from ..types import Types, types
from .binary_tree import BinaryTree
from .sah_boxes import COUNT, FIRST, WORDS, lanes
from .sah_level import Level
from .sah_split import split_small
from .sah_split_large import split_large

#: Nodes of up to TINY primitives are split by an exact sweep, those of more than LARGE by several lanes together.
TINY = 8
LARGE = 4096
#: Levels split by cost. Below, nodes are halved by number: no input makes a tree deeper than this and its logarithm.
COST_LEVELS = 128


def build_binned_sah(lo: np.ndarray, hi: np.ndarray) -> BinaryTree:
    """A binary tree over boxes ``lo``, ``hi`` (n, 3), float32 or float64, with one primitive a leaf.

    Primitives move with their boxes from level to level, so that a node's are side by side in memory; all nodes of a
    level are split by the same few kernels. The result does not depend on how the work is shared.
    """
    kinds = types(str(lo.dtype))
    primitives, nodes, middles = _start(lo, hi, kinds)
    spare = dr.empty(kinds.Float, dr.width(primitives))
    order = np.empty(len(lo), np.int64)
    found: list[tuple[np.ndarray, np.ndarray]] = []
    made = 1
    while True:
        table = nodes.numpy().reshape(-1, WORDS)
        first, count = (_integers(table[:, k], kinds) for k in (FIRST, COUNT))
        single = first[count == 1]
        order[single] = _integers(primitives.numpy().reshape(-1, WORDS)[single, FIRST], kinds)
        inner = np.flatnonzero(count > 1)
        left = np.full(len(table), -1, np.int64)
        left[inner] = made + 2 * np.arange(len(inner))
        found.append((table, left))
        if len(inner) == 0:
            break
        made += 2 * len(inner)
        next_nodes, next_middles = (dr.empty(kinds.Float, 2 * WORDS * len(inner)) for _ in range(2))
        level = Level(
            kinds, primitives, nodes, middles, spare, next_nodes, next_middles, by_count=len(found) > COST_LEVELS
        )
        _split_level(level, inner, first[inner], count[inner])
        primitives, spare, nodes, middles = spare, primitives, next_nodes, next_middles
    packets, left = (np.concatenate(parts) for parts in zip(*found, strict=True))
    np.negative(packets[:, 3:6], out=packets[:, 3:6])
    integers = packets[:, FIRST:]
    integers = integers.view(np.uint32) if kinds.precision == "float32" else integers.astype(np.uint32)
    first, count = integers[:, 0], integers[:, 1]
    return BinaryTree(packets[:, :3], packets[:, 3:6], left, first, count, order)


def _start(lo: np.ndarray, hi: np.ndarray, kinds: Types) -> tuple[Any, Any, Any]:
    """The primitives, the root and the box around the primitives' middles, as packets."""
    n = len(lo)
    primitives = np.zeros((n, WORDS), lo.dtype)
    primitives[:, :3] = lo
    np.negative(hi, out=primitives[:, 3:6])
    primitives[:, FIRST] = encode_integers(np.arange(n), kinds)
    root = np.zeros((2, WORDS), lo.dtype)
    root[0] = _least(primitives)
    root[0, FIRST:] = encode_integers(np.array([0, n]), kinds)
    middle = lo * 0.5 + hi * 0.5
    root[1, :3], root[1, 3:6] = _least(middle), _least(-middle)
    return owned(primitives, kinds.Float), owned(root[0], kinds.Float), owned(root[1], kinds.Float)


def _least(rows: np.ndarray) -> np.ndarray:
    """The least of each column. NumPy is slow at reducing long thin tables: so they are folded to short wide ones."""
    fold = 64
    while len(rows) > 16 * fold:
        whole = len(rows) // fold * fold
        folded = rows[:whole].reshape(fold, -1).min(axis=0).reshape(-1, rows.shape[1])
        rows = np.concatenate([folded, rows[whole:]])
    return rows.min(axis=0)


def _split_level(level: Level, node: np.ndarray, first: np.ndarray, count: np.ndarray) -> None:
    """Splits nodes ``node`` of the level, each of two or more primitives."""
    place = 2 * np.arange(len(node))
    large = np.flatnonzero(count > LARGE)
    if len(large):
        split_large(level, node[large], place[large], first[large], count[large], LARGE)
    for exact, some in ((True, count <= TINY), (False, (count > TINY) & (count <= LARGE))):
        chosen = np.flatnonzero(some)
        if len(chosen):
            chosen = chosen[_like_sizes_together(count[chosen])]
            split_small(level, *lanes(level.types, node[chosen], place[chosen]), exact=exact)
    dr.eval(level.next_nodes, level.next_middles, level.next_primitives)


def _like_sizes_together(count: np.ndarray) -> np.ndarray:
    """An order in which neighbours, which run in step, have like counts, while each quarter, which a thread may take,
    has its share of every count."""
    lanes = 16
    order = np.argsort(count.astype(np.uint16), kind="stable")
    whole = len(order) // (4 * lanes) * 4 * lanes
    dealt = order[:whole].reshape(-1, 4, lanes).transpose(1, 0, 2).ravel()
    return np.concatenate([dealt, order[whole:]])


def _integers(words: np.ndarray, kinds: Types) -> np.ndarray:
    words = np.ascontiguousarray(words)
    return (words.view(np.uint32) if kinds.precision == "float32" else words).astype(np.int64)
