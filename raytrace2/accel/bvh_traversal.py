"""Traversal of wide nodes in one symbolic loop: a node or a primitive of each ray a turn.

A ray holds the child it is at, the *group* of its latest node's children that it has yet to visit (nearest first), and a
stack of older groups. Boxes are widened by :data:`ERROR` times the distance to them, which bounds the rounding of the slab test
(Ize 2013), of the primitive tests and of the clamped direction, so that no hit is culled that a test would have found.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from ..surfaces.hit import Candidate
from ..surfaces.ordered import greater, lesser
from ..surfaces.primitives import DevicePrimitives, LocalRay
from ..types import Types
from .wide_node import (
    CHILDREN,
    CORNER,
    COUNT_MASK,
    COUNT_SHIFT,
    DONE,
    EXPONENTS,
    FIRST_MASK,
    LEAF,
    LOWER,
    NEXT,
    UPPER,
    WIDTH,
    WORDS,
    NodeFormat,
)

#: In units of the round-off, what the rounding of a slab test, a primitive test and the clamping of a direction add up to,
#: relative to the sum over the axes of the distances to the box's far planes (each contributes fewer than ten units).
ERROR = 32


@dataclass(frozen=True, eq=False)
class DeviceTree:
    """Node words and primitives on the device; ``stack_size`` groups can be pending at most."""

    types: Types
    nodes: Any
    primitives: DevicePrimitives
    stack_size: int


@dataclass
class Slabs:
    """What the slab test needs of a ray: origin, reciprocal direction and its size, and whether each component is negative."""

    o: Any
    inverse: Any
    size: Any
    negative: list[Any]
    tmin: Any


def closest(tree: DeviceTree, ray: LocalRay, best: Candidate, root: Any, active: Any) -> Candidate:
    """The closest hit below node or leaf ``root``, no farther than ``best.t``."""
    ready = tree.primitives.prepare(ray)
    slabs = _slabs(tree, ray)

    def visit(at: Any, group: Any, stack: Any, size: Any, best: Candidate) -> tuple[Any, ...]:
        return _visit_node(tree, slabs, best.t, at, group, stack, size, ordered=True)

    def test(at: Any, best: Candidate) -> tuple[Any, Candidate]:
        best = tree.primitives.intersect_one(at & FIRST_MASK, ready, best)
        return _after_primitive(at), best

    def turn(at: Any, group: Any, stack: Any, size: Any, best: Candidate) -> tuple[Any, ...]:
        at, group, stack, size = dr.if_stmt((at, group, stack, size, best), at < NEXT, visit, lambda *s: s[:4])
        at, best = dr.if_stmt((at, best), (at & LEAF) != 0, test, lambda *s: s)
        at, group, stack, size = _next_child(tree, at, group, stack, size, ordered=True)
        return at, group, stack, size, best

    state = (*_start(tree, root, active), best)
    labels = ("at", "group", "stack", "size", "best")
    return dr.while_loop(state, lambda at, *_: at != DONE, turn, labels=labels, label="bvh closest")[-1]


def anything(tree: DeviceTree, ray: LocalRay, root: Any, active: Any) -> Any:
    """Bool: whether each ray meets anything below ``root`` between its tmin and tmax."""
    ready = tree.primitives.prepare(ray)
    slabs = _slabs(tree, ray)

    def visit(at: Any, group: Any, stack: Any, size: Any, blocked: Any) -> tuple[Any, ...]:
        return _visit_node(tree, slabs, ray.tmax, at, group, stack, size, ordered=False)

    def test(at: Any, blocked: Any) -> tuple[Any, Any]:
        hit = tree.primitives.occludes_one(at & FIRST_MASK, ready)
        return dr.select(hit, DONE, _after_primitive(at)), blocked | hit

    def turn(at: Any, group: Any, stack: Any, size: Any, blocked: Any) -> tuple[Any, ...]:
        at, group, stack, size = dr.if_stmt((at, group, stack, size, blocked), at < NEXT, visit, lambda *s: s[:4])
        at, blocked = dr.if_stmt((at, blocked), (at & LEAF) != 0, test, lambda *s: s)
        at, group, stack, size = _next_child(tree, at, group, stack, size, ordered=False)
        return at, group, stack, size, blocked

    state = (*_start(tree, root, active), dr.full(tree.types.Bool, False, dr.width(root)))
    labels = ("at", "group", "stack", "size", "blocked")
    return dr.while_loop(state, lambda at, *_: at != DONE, turn, labels=labels, label="bvh anything")[-1]


def _start(tree: DeviceTree, root: Any, active: Any) -> tuple[Any, ...]:
    UInt, width = tree.types.UInt, dr.width(root)
    zero = dr.zeros(UInt, width)
    return dr.select(active, root, DONE) + zero, zero, dr.alloc_local(UInt, tree.stack_size), zero + 0


def _slabs(tree: DeviceTree, ray: LocalRay) -> Slabs:
    d = ray.d
    size = abs(d)
    # A component this much smaller than the largest moves the ray by less than the boxes are widened; the clamp keeps
    # reciprocals finite, so that no product with zero is NaN.
    least = dr.fmax(dr.fmax(size.x, size.y), size.z) * tree.types.epsilon
    clamped = type(d)(*(dr.select(s < least, dr.copysign(least, c), c) for s, c in zip(size, d, strict=True)))
    inverse = dr.rcp(clamped)
    return Slabs(ray.o, inverse, abs(inverse), [c < 0 for c in clamped], ray.tmin)


def _visit_node(
    tree: DeviceTree, slabs: Slabs, tmax: Any, at: Any, group: Any, stack: Any, size: Any, *, ordered: bool
) -> tuple[Any, ...]:
    """Tests the four boxes of node ``at``: goes on to the nearest that is met and makes the others the group."""
    types = tree.types
    UInt = types.UInt
    words = _load(tree, at)
    near, far = _planes(tree, words, slabs)
    met = []
    for child in range(WIDTH):
        enter = greater(greater(near(0, child), near(1, child)), greater(near(2, child), slabs.tmin))
        leave = lesser(lesser(far(0, child), far(1, child)), lesser(far(2, child), tmax))
        met.append((enter, enter <= leave))
    if ordered:
        first, code = _by_distance(tree, met)
    else:
        mask = UInt(0)
        for child, (_, hit) in enumerate(met):
            mask |= dr.select(hit, UInt(1 << child), UInt(0))
        first, code = dr.select(mask != 0, dr.tzcnt(mask), WIDTH), mask & (mask - 1)
    refs = [_low_word(words[CHILDREN + k]) for k in range(WIDTH)]
    nearest = dr.select(first < 2, dr.select(first == 0, refs[0], refs[1]), dr.select(first == 2, refs[2], refs[3]))
    more = code != 0
    push = more & (group != 0)
    stack.write(group, size, push)
    size = dr.select(push, size + 1, size)
    group = dr.select(more, (at << 8) | code, group)
    return dr.select(first < WIDTH, nearest, NEXT), group, stack, size


def _by_distance(tree: DeviceTree, met: list[tuple[Any, Any]]) -> tuple[Any, Any]:
    """The nearest child met (WIDTH if none), and the others as a list in distance order: two bits a child, and from bit 6 on
    how many. The order need not be exact: it only decides who is asked first."""
    double = tree.types.precision == "float64"
    Word = tree.types.UInt64 if double else tree.types.UInt
    none = Word(0xFFFFFFFFFFFFFFFF if double else 0xFFFFFFFF)
    low_two = Word(3)
    # Distances are not negative (or nearly so), and such floats compare like their bits; the lowest bits carry the child.
    keys = [
        dr.select(hit, (dr.reinterpret_array(Word, enter) & ~low_two) | Word(child), none)
        for child, (enter, hit) in enumerate(met)
    ]
    for i, j in ((0, 1), (2, 3), (0, 2), (1, 3), (1, 2)):
        keys[i], keys[j] = dr.select(keys[i] < keys[j], keys[i], keys[j]), dr.select(keys[i] < keys[j], keys[j], keys[i])
    UInt = tree.types.UInt
    slots = [UInt(key & low_two) for key in keys]
    count = dr.select(keys[3] != none, UInt(3 << 6), dr.select(keys[2] != none, UInt(2 << 6), UInt(1 << 6)))
    code = dr.select(keys[1] != none, slots[1] | (slots[2] << 2) | (slots[3] << 4) | count, 0)
    return dr.select(keys[0] != none, slots[0], WIDTH), code


def _next_child(tree: DeviceTree, at: Any, group: Any, stack: Any, size: Any, *, ordered: bool) -> tuple[Any, ...]:
    """Where a ray stands at NEXT: takes the next child of its group, or of the group on top of the stack, or is done."""
    needs = at == NEXT
    pop = needs & (group == 0) & (size > 0)
    size = dr.select(pop, size - 1, size)
    group = dr.select(pop, stack.read(size, pop), group)
    has = needs & (group != 0)
    if ordered:
        slot = group & 3
        count = (group >> 6) & 3
        rest = dr.select(count > 1, (group & 0xFFFFFF00) | ((group >> 2) & 0xF) | ((count - 1) << 6), 0)
    else:
        slot = dr.tzcnt(group & 15)
        rest = group & (group - 1)
        rest = dr.select((rest & 15) != 0, rest, 0)
    Word = tree.types.UInt if tree.types.precision == "float32" else tree.types.UInt64
    child = _low_word(dr.gather(Word, tree.nodes, ((group >> 8) * WORDS) + CHILDREN + slot, has))
    at = dr.select(needs, dr.select(has, child, DONE), at)
    return at, dr.select(has, rest, group), stack, size


def _after_primitive(at: Any) -> Any:
    """The leaf reference without its first primitive, or NEXT after the last."""
    last = ((at >> COUNT_SHIFT) & COUNT_MASK) == 1
    return dr.select(last, NEXT, at + 1 - (1 << COUNT_SHIFT))


def _load(tree: DeviceTree, at: Any) -> list[Any]:
    """The node's words, as unsigned integers of the precision's width."""
    import drjit.llvm.ad as ad

    kind = ad.ArrayXu if tree.types.precision == "float32" else ad.ArrayXu64
    packet = dr.gather(kind, tree.nodes, at, shape=(WORDS, dr.width(at)))
    return [packet[k] for k in range(WORDS)]


def _low_word(word: Any) -> Any:
    return dr.uint32_array_t(type(word))(word)


def _planes(tree: DeviceTree, words: list[Any], slabs: Slabs) -> tuple[Any, Any]:
    """Functions of (axis, child) that give the t of the plane where a ray enters and leaves the child's slab.

    With the byte q put into a float as 1 + q / 256, its plane is corner + 256 step (float - 1), so t is one multiply-add.
    """
    layout = NodeFormat.of(tree.types)
    Float = tree.types.Float
    Word = type(words[0])
    exponent_mask = Word(((1 << layout.exponent_bits) - 1) << layout.mantissa)
    offsets = [dr.reinterpret_array(Float, words[CORNER + k]) - slabs.o[k] for k in range(3)]
    scales = []
    for k in range(3):
        shift = layout.mantissa - k * layout.exponent_bits
        shifted = words[EXPONENTS] << shift if shift >= 0 else words[EXPONENTS] >> -shift
        scales.append(dr.reinterpret_array(Float, shifted & exponent_mask))
    reach = abs(offsets[0]) + abs(offsets[1]) + abs(offsets[2]) + (scales[0] + scales[1] + scales[2])
    error = reach * (ERROR * tree.types.epsilon)
    slopes, near_bases, far_bases, near_words, far_words = [], [], [], [], []
    for k in range(3):
        slope = scales[k] * slabs.inverse[k]
        base = dr.fma(offsets[k], slabs.inverse[k], -slope)
        slopes.append(slope)
        near_bases.append(dr.fma(-error, slabs.size[k], base))
        far_bases.append(dr.fma(error, slabs.size[k], base))
        lower, upper = words[LOWER + k], words[UPPER + k]
        near_words.append(dr.select(slabs.negative[k], upper, lower))
        far_words.append(dr.select(slabs.negative[k], lower, upper))
    byte_mask = Word(0xFF << (layout.mantissa - 8))
    one = Word(layout.bias << layout.mantissa)

    def decoded(word: Any, child: int) -> Any:
        shift = layout.mantissa - 8 - 8 * child
        moved = word << shift if shift >= 0 else word >> -shift
        return dr.reinterpret_array(Float, (moved & byte_mask) | one)

    def near(axis: int, child: int) -> Any:
        return dr.fma(decoded(near_words[axis], child), slopes[axis], near_bases[axis])

    def far(axis: int, child: int) -> Any:
        return dr.fma(decoded(far_words[axis], child), slopes[axis], far_bases[axis])

    return near, far


__all__ = ["ERROR", "DeviceTree", "anything", "closest"]
