"""Child boxes to the words of wide nodes, all nodes in one kernel."""

from __future__ import annotations

from typing import Any

import drjit as dr
import drjit.llvm.ad as ad
import numpy as np

from ..buffers import aligned_zeros
from ..types import Types
from .binary_tree import BinaryTree
from .collapse import WideTree
from .sah_boxes import WORDS as BOX_WORDS
from .sah_boxes import load, union
from .wide_node import CORNER, EXPONENTS, LAYOUTS, NEXT, NodeFormat, NodeLayout, leaf_reference


def encode_nodes(tree: BinaryTree, wide: WideTree, types: Types) -> np.ndarray:
    """The nodes of ``wide`` as words (n, words). Bounds of ``tree`` must be exact in the precision of ``types``."""
    layout = LAYOUTS[wide.children.shape[1]]
    refs = types.UInt(references(tree, wide).ravel())
    words = encode(types.Float(child_boxes(tree, wide).ravel()), None, refs, layout, types)
    return words.numpy()[: len(wide.binary) * layout.words].reshape(-1, layout.words)


def child_boxes(tree: BinaryTree, wide: WideTree) -> np.ndarray:
    """Packets (n * width, 8) with the boxes of every node's children; the box around nothing where there is no
    child."""
    child = wide.children.ravel()
    absent = np.flatnonzero(child < 0)
    child = np.maximum(child, 0)
    boxes = aligned_zeros((len(child), BOX_WORDS), tree.lo.dtype)
    boxes[:, :3] = tree.lo.take(child, axis=0)
    np.negative(tree.hi.take(child, axis=0), out=boxes[:, 3:6])
    boxes[absent, :6] = np.inf
    return boxes


def references(tree: BinaryTree, wide: WideTree) -> np.ndarray:
    """What stands for each child (n, width): a node, a leaf, or NEXT where there is none."""
    leaf = leaf_reference(tree.first[wide.children], tree.count[wide.children])
    return np.where(wide.inner >= 0, wide.inner, np.where(wide.children >= 0, leaf, NEXT)).astype(np.uint32)


def encode(boxes: Any, rows: Any, references: Any, layout: NodeLayout, types: Types) -> Any:
    """Node words, an evaluated buffer, from ``boxes`` (packets), of which child k of node n has number ``rows[n *
    width + k]`` (or that itself, with None), and ``references``.

    The step is the least 2**s with 255 * 2**s >= upper - lower corner: for a size m 2**e with m in [1/2, 1), s is e - 8
    where m <= 255/256 and e - 7 elsewhere. The plane of byte q lies at corner + q 2**s. ``_difference`` gives
    x - corner = d + r exactly, with |r| at most half a unit in the last place of d. Dividing by the step is exact, or d
    / 2**s is far below one. So if d / 2**s is no integer, none lies between it and (d + r) / 2**s, and floor and ceil
    are those of the exact quotient; if it is one, the sign of r says whether the exact quotient lies below or above.
    """
    UInt, Float, form = types.UInt, types.Float, NodeFormat.of(types)
    Word = UInt if types.precision == "float32" else types.UInt64
    n = dr.width(references) // layout.width
    if n == 0:
        return dr.zeros(Word, 1)
    node = dr.arange(UInt, n)
    first = node * layout.width
    place = [first + slot for slot in range(layout.width)]
    box = [load(types, boxes, p if rows is None else dr.gather(UInt, rows, p)) for p in place]
    reference = [dr.gather(UInt, references, p) for p in place]
    whole = box[0][:6]
    for other in box[1:]:
        whole = union(whole, other)

    words = [Word(0) for _ in range(layout.words)]
    for axis in range(3):
        corner, size, shift, scale = _scaled(whole[axis], -whole[axis + 3], types, form)
        size, rest = _difference(size, corner)
        bits = dr.reinterpret_array(Word, size)
        bits = dr.select(rest > 0, bits + 1, bits)
        wide_mantissa = (bits & ((1 << form.mantissa) - 1)) > (127 << (form.mantissa - 7))
        # Biased: that of 256 steps, and no less than what keeps all of a node's planes normal numbers.
        exponent = dr.select(wide_mantissa, (bits >> form.mantissa) + 2, (bits >> form.mantissa) + 1)
        exponent = dr.minimum(dr.maximum(exponent, shift + 17) - shift, Word(2 * form.bias))
        words[CORNER + axis] = dr.reinterpret_array(Word, whole[axis])
        words[EXPONENTS] |= exponent << (axis * form.exponent_bits)
        per_step = dr.reinterpret_array(Float, (2 * form.bias + 8 - exponent - shift) << form.mantissa)
        for slot in range(layout.width):
            exists = reference[slot] != NEXT
            distance, rest = _difference(box[slot][axis] * scale, corner)
            steps = distance * per_step
            lower = dr.floor(steps)
            lower = dr.select((lower == steps) & (rest < 0), lower - 1, lower)
            lower = dr.select(exists, dr.fmin(dr.fmax(lower, 0), 255), 255)
            distance, rest = _difference(-box[slot][axis + 3] * scale, corner)
            steps = distance * per_step
            upper = dr.fmax(dr.ceil(steps), dr.select(-box[slot][axis + 3] > whole[axis], Float(1), Float(0)))
            upper = dr.select((upper == steps) & (rest > 0), upper + 1, upper)
            upper = dr.select(exists, dr.fmin(dr.fmax(upper, 0), 255), 0)
            word, place_in_word = axis * layout.per_axis + slot // 4, 8 * (slot % 4)
            words[layout.lower + word] |= Word(lower) << place_in_word
            words[layout.upper + word] |= Word(upper) << place_in_word
    for slot in range(layout.width):
        words[layout.children + slot] = Word(reference[slot])

    target = dr.empty(Word, n * layout.words)
    packet = dr.zeros(ad.ArrayXu if Word is UInt else ad.ArrayXu64, shape=(layout.words, n))
    for k, word in enumerate(words):
        packet[k] = word
    dr.scatter(target, packet, node)
    dr.eval(target)
    return target


def _scaled(low: Any, high: Any, types: Types, form: NodeFormat) -> tuple[Any, Any, Any, Any]:
    """``low`` and ``high`` times a power of two, its exponent and itself: large enough that the last digits of numbers
    near the smallest are normal numbers, because processors may be set to take smaller ones for zero; 1 for large
    numbers, whose digits are."""
    Word = types.UInt if types.precision == "float32" else types.UInt64
    digits = form.mantissa + 1
    is_small = dr.fmax(abs(low), abs(high)) < 2.0 ** (form.bias - digits - 3)
    shift = dr.select(is_small, Word(digits), Word(0))
    scale = dr.select(is_small, types.Float(2.0**digits), types.Float(1))
    return low * scale, high * scale, shift, scale


def _difference(a: Any, b: Any) -> tuple[Any, Any]:
    """a - b as rounded, and what the rounding took away (Knuth 1969, theorem 4.2.2B): their sum is exact."""
    difference = a - b
    back = difference - a
    return difference, (a - (difference - back)) - (b + back)
