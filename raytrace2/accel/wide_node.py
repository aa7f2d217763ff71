"""Wide nodes of sixteen words: four child boxes in eight-bit steps of their parent's (after Ylitie, Karras and Laine 2017).

Words 0 to 2 are the node's lower corner; word 3 the exponents of the step on each axis; words 4 to 6 the lower and 7 to 9 the
upper planes of the children on x, y, z, a byte a child; words 10 to 13 the children. Boxes are rounded outwards,
so a child's box encloses everything below it exactly. A child that does not exist has its lower plane above its upper one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..types import Types
from .binary_tree import BinaryTree
from .collapse import WideTree

WIDTH = 4
WORDS = 16
CORNER, EXPONENTS, LOWER, UPPER, CHILDREN = 0, 3, 4, 7, 10

#: A child reference: the index of a wide node below :data:`NEXT`, or a leaf: this bit, the number of primitives in the five
#: bits from 26 on, and the index of the first primitive.
LEAF = 0x80000000
COUNT_SHIFT, COUNT_MASK, FIRST_MASK = 26, 31, 0x03FFFFFF
#: Traversal states that are neither: take the next pending child; finished.
NEXT, DONE = 0x7FFFFFFE, 0x7FFFFFFF
MAX_LEAF_SIZE = COUNT_MASK
#: A pending group packs a node's index above eight bits that say which children are left.
MAX_NODES = 1 << 24
MAX_PRIMITIVES = FIRST_MASK + 1


@dataclass(frozen=True)
class NodeFormat:
    """How words are laid out in one precision: mantissa bits, exponent bits and bias of its floats."""

    word: np.dtype
    mantissa: int
    exponent_bits: int
    bias: int

    @staticmethod
    def of(types: Types) -> NodeFormat:
        """The format for the precision of ``types``."""
        if types.precision == "float32":
            return NodeFormat(np.dtype(np.uint32), 23, 8, 127)
        return NodeFormat(np.dtype(np.uint64), 52, 11, 1023)


def leaf_reference(first: np.ndarray, count: np.ndarray) -> np.ndarray:
    """References to leaves of ``count`` primitives from ``first`` on."""
    return (LEAF | (count.astype(np.int64) << COUNT_SHIFT) | first).astype(np.uint32)


def encode_nodes(tree: BinaryTree, wide: WideTree, types: Types) -> np.ndarray:
    """The nodes of ``wide`` as words (n, 16). Bounds of ``tree`` must be exact in the precision of ``types``."""
    layout = NodeFormat.of(types)
    words = np.zeros((len(wide.binary), WORDS), layout.word)
    corner = tree.lo[wide.binary].astype(types.numpy)
    words[:, CORNER : CORNER + 3] = corner.view(layout.word)
    origin = corner.astype(np.longdouble)
    size = tree.hi[wide.binary].astype(np.longdouble) - origin
    step = np.maximum(np.ceil(np.log2(np.maximum(size, np.longdouble(1e-4000)) / 255)), 9 - layout.bias).astype(np.int64)
    exponents = (step + 8 + layout.bias).astype(layout.word)
    shifts = (np.arange(3) * layout.exponent_bits).astype(layout.word)
    words[:, EXPONENTS] = np.bitwise_or.reduce(exponents << shifts, axis=1)
    exists = wide.children >= 0
    child = np.maximum(wide.children, 0)
    scale = np.ldexp(np.longdouble(1), step)[:, None, :]
    lower = np.floor((tree.lo[child].astype(np.longdouble) - origin[:, None]) / scale)
    upper = np.ceil((tree.hi[child].astype(np.longdouble) - origin[:, None]) / scale)
    lower = np.where(exists[..., None], np.clip(lower, 0, 255), 255).astype(layout.word)
    upper = np.where(exists[..., None], np.clip(upper, 0, 255), 0).astype(layout.word)
    byte = (8 * np.arange(WIDTH)).astype(layout.word)[:, None]
    words[:, LOWER : LOWER + 3] = np.bitwise_or.reduce(lower << byte, axis=1)
    words[:, UPPER : UPPER + 3] = np.bitwise_or.reduce(upper << byte, axis=1)
    is_inner = wide.inner >= 0
    leaf = leaf_reference(tree.first[child], tree.count[child])
    words[:, CHILDREN : CHILDREN + WIDTH] = np.where(is_inner, wide.inner, np.where(exists, leaf, DONE))
    return words
