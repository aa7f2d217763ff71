"""What stays of a hierarchy when its vertices move: which node holds what."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..buffers import owned
from ..types import Types
from .binary_tree import BinaryTree
from .collapse import WideTree
from .wide_encode import references
from .wide_node import COUNT_MASK, COUNT_SHIFT, FIRST_MASK, LEAF, NEXT, leaf_reference


@dataclass(frozen=True, eq=False)
class Topology:
    """``references`` (nodes, width), as :mod:`.wide_node` has them, of the nodes in depth-first order; ``order``, the
    primitives of a geometry in the order of the leaves, repeated where they have several parts; ``depth`` of the
    nodes."""

    types: Types
    references: np.ndarray
    order: np.ndarray
    depth: int

    @staticmethod
    def of(tree: BinaryTree, wide: WideTree, order: np.ndarray, types: Types) -> Topology:
        """That of ``wide``, whose leaves' primitives are ``order``."""
        return Topology(types, references(tree, wide), order.astype(np.uint32), wide.depth)

    @property
    def width(self) -> int:
        """The most children of a node."""
        return int(self.references.shape[1])

    @property
    def is_leaf(self) -> np.ndarray:
        """Which children (nodes, width) are leaves."""
        return self.references >= LEAF

    @property
    def is_inner(self) -> np.ndarray:
        """Which children (nodes, width) are nodes."""
        return self.references < NEXT

    @property
    def leaves(self) -> int:
        """How many leaves there are."""
        return int(np.count_nonzero(self.is_leaf)) if len(self.references) else 1

    @property
    def root(self) -> int:
        """The reference to the root: a node, or a leaf of everything."""
        if len(self.references):
            return 0
        return int(leaf_reference(np.zeros(1, np.int64), np.array([len(self.order)]))[0])

    @functools.cached_property
    def spans(self) -> tuple[np.ndarray, np.ndarray]:
        """The first primitive and the number of primitives below each child, (nodes, width) each; zero where there is
        none."""
        leaf = self.is_leaf
        first = np.where(leaf, self.references & FIRST_MASK, 0).astype(np.int64)
        count = np.where(leaf, (self.references >> COUNT_SHIFT) & COUNT_MASK, 0).astype(np.int64)
        for level in reversed(self.levels):
            node, slot = np.nonzero(self.is_inner[level])
            node = level[node]
            child = self.references[node, slot]
            count[node, slot] = count[child].sum(axis=1)
            some = np.where(count[child] > 0, first[child], len(self.order))
            first[node, slot] = some.min(axis=1)
        return first, count

    @functools.cached_property
    def levels(self) -> list[np.ndarray]:
        """The nodes of each level, root first."""
        level = np.arange(min(1, len(self.references)))
        found = []
        while len(level):
            found.append(level)
            below = self.references[level]
            level = below[below < NEXT].astype(np.int64)
        return found

    @functools.cached_property
    def device_references(self) -> Any:
        """The references in a device buffer."""
        return owned(self.references, self.types.UInt)
