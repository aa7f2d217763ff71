"""Wide nodes in words: child boxes in eight-bit steps of their parent's (after Ylitie, Karras and Laine 2017).

Words 0 to 2 are the node's lower corner; word 3 the exponents of the step on each axis; then come the lower and the
upper planes of the children on x, y, z, a byte a child and four children a word; then the children. Boxes are rounded
outwards, so a child's box encloses everything below it exactly. A child that does not exist has its lower plane above
its upper one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..types import Types

CORNER, EXPONENTS = 0, 3


@dataclass(frozen=True)
class NodeLayout:
    """Where the words of a node with ``width`` children stand: ``words`` in all, the planes on axis k from ``lower + k
    * per_axis`` and ``upper + k * per_axis`` on, the children from ``children`` on."""

    width: int
    words: int
    per_axis: int
    lower: int
    upper: int
    children: int


#: Rows are multiples of the packets of four and eight words that processors gather fastest.
LAYOUTS = {
    2: NodeLayout(2, 12, 1, 4, 7, 10),
    4: NodeLayout(4, 16, 1, 4, 7, 10),
    8: NodeLayout(8, 24, 2, 4, 10, 16),
}
WIDTH = 4
WORDS, LOWER, UPPER, CHILDREN = LAYOUTS[4].words, LAYOUTS[4].lower, LAYOUTS[4].upper, LAYOUTS[4].children

#: A child reference: the index of a wide node below :data:`NEXT`, or a leaf: this bit, the number of primitives in the
#: five bits from 26 on, and the index of the first primitive.
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
