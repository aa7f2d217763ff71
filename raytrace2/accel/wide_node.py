"""Wide nodes of sixteen words: child boxes in eight-bit steps of their parent's (after Ylitie, Karras and Laine 2017).

Words 0 to 2 are the node's lower corner; word 3 the exponents of the step on each axis; words 4 to 6 the lower and 7 to
9 the upper planes of the children on x, y, z, a byte a child; words 10 to 13 the children. Boxes are rounded outwards,
so a child's box encloses everything below it exactly. A child that does not exist has its lower plane above its upper
one.
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


#: Nodes encoded at a time, so that temporaries stay in the cache.
_BLOCK = 4096


def encode_nodes(tree: BinaryTree, wide: WideTree, types: Types) -> np.ndarray:
    """The nodes of ``wide`` as words (n, 16). Bounds of ``tree`` must be exact in the precision of ``types``."""
    layout = NodeFormat.of(types)
    words = np.zeros((len(wide.binary), WORDS), layout.word)
    lo, hi = tree.lo.astype(types.numpy, copy=False), tree.hi.astype(types.numpy, copy=False)
    for begin in range(0, len(words), _BLOCK):
        block = slice(begin, begin + _BLOCK)
        node, child, inner = wide.binary[block], wide.children[block], wide.inner[block]
        # Slots without a child are computed from boxes that have nothing to do with the node.
        with np.errstate(over="ignore", invalid="ignore"):
            _encode_boxes(words[block], lo, hi, node, child, layout)
        leaf = leaf_reference(tree.first[child], tree.count[child])
        references = np.where(inner >= 0, inner, np.where(child >= 0, leaf, NEXT))
        words[block, CHILDREN : CHILDREN + WIDTH] = references
    return words


def _encode_boxes(
    words: np.ndarray, lo: np.ndarray, hi: np.ndarray, node: np.ndarray, child: np.ndarray, layout: NodeFormat
) -> None:
    """Corner, step and planes of nodes ``node`` with children ``child`` (m, WIDTH).

    The step is the least 2**s with 255 * 2**s >= upper - lower corner: for a size m 2**e with m in [1/2, 1), s is e - 8
    where m <= 255/256 and e - 7 elsewhere. The plane of byte q lies at corner + q 2**s. ``_difference`` gives
    x - corner = d + r exactly, with |r| at most half a unit in the last place of d. Dividing by the step is exact, or d
    / 2**s is far below one. So if d / 2**s is no integer, none lies between it and (d + r) / 2**s, and floor and ceil
    are those of the exact quotient; if it is one, the sign of r says whether the exact quotient lies below or above.
    """
    corner = lo[node]
    words[:, CORNER : CORNER + 3] = corner.view(layout.word)
    size, rest = _difference(hi[node], corner)
    mantissa, exponent = np.frexp(np.where(rest > 0, np.nextafter(size, np.inf, dtype=size.dtype), size))
    step = exponent - 8 + (mantissa > 255 / 256)
    step = np.where(size > 0, np.maximum(step, 9 - layout.bias), 9 - layout.bias)
    shifts = (np.arange(3) * layout.exponent_bits).astype(layout.word)
    words[:, EXPONENTS] = np.bitwise_or.reduce((step + 8 + layout.bias).astype(layout.word) << shifts, axis=1)

    per_step = np.ldexp(size.dtype.type(1), -step)
    for slot in range(WIDTH):
        one = child[:, slot]
        exists = (one >= 0)[:, None]
        distance, rest = _difference(lo[one], corner)
        steps = distance * per_step
        lower = np.floor(steps)
        lower = np.where(exists, np.clip(lower - ((lower == steps) & (rest < 0)), 0, 255), 255)
        distance, rest = _difference(hi[one], corner)
        steps = distance * per_step
        upper = np.maximum(np.ceil(steps), distance > 0)
        upper = np.where(exists, np.clip(upper + ((upper == steps) & (rest > 0)), 0, 255), 0)
        words[:, LOWER : LOWER + 3] |= lower.astype(layout.word) << layout.word.type(8 * slot)
        words[:, UPPER : UPPER + 3] |= upper.astype(layout.word) << layout.word.type(8 * slot)


def _difference(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """a - b as rounded, and what the rounding took away (Knuth 1969, theorem 4.2.2B): their sum is exact."""
    difference = a - b
    back = difference - a
    return difference, (a - (difference - back)) - (b + back)
