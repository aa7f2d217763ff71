"""Traversal of trees of planes in one symbolic loop: a node or a primitive of each ray a turn.

A ray holds the node it is at, the interval of t in which it passes the node's cell, and a stack of cells to come. At a
plane there are four cases: the ray passes the near side alone, the far side alone, both, or runs along the plane: then
it passes both, too, if it runs in it to within rounding, and one of them otherwise. Which it is is decided with a
margin: a hit that a primitive's test reports at t may lie beside the primitive by rounding, and so beyond the plane;
the margin bounds how far.

A primitive that is listed in several cells may be tested several times, which changes nothing: of two equal hits the
first stays. Remembering the last one tested (mailboxing) saves no turn of the loop, for a turn costs the same whether
one ray of sixteen tests or all do; hits count wherever they lie, so that a primitive met is rarely met again.

A turn visits a node, tests a reference of a leaf, or throws away the cell on top of the stack. Of two children one is
gone to and one may be put on the stack, from where it is taken once: whatever the tests say, a ray comes to no node
twice, so it takes no more turns than there are nodes and references.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr

from ..surfaces.hit import Candidate
from ..surfaces.ordered import greater, lesser
from ..surfaces.primitives import DevicePrimitives, LocalRay
from ..surfaces.record import decode_integer
from ..surfaces.turns import Turns, after_turn, goes_on
from ..types import Types

#: In units of the round-off, what the rounding of a primitive's test, of the distance to a plane and of the clamping of
#: a direction add up to, relative to the distance from the origin to the farthest corner of the primitive (sums over
#: the axes; each contributes fewer than ten units).
ERROR = 32

#: Values of the lowest two bits of a link above the index of the first child, or of a leaf's first reference.
LEAF = 3
#: States that are no node: in a leaf, or in need of the next cell; finished.
NEXT, DONE = 0x7FFFFFFE, 0x7FFFFFFF
MAX_NODES = 1 << 29


@dataclass(frozen=True, eq=False)
class PlaneTree:
    """A tree of planes on the device: packets of ``words`` Floats a node, the last two of which are its *reach* and
    its link.

    The reach bounds how far (in the sum over the axes) a primitive below the node extends. A link is ``4 * child + x``
    with the first of two adjacent children, the one below the plane, and any x below LEAF; or ``4 * first + LEAF`` for
    a leaf with references from ``first`` on, as many as word 0 says. ``lo``, ``hi`` bound everything.
    """

    types: Types
    nodes: Any
    words: int
    references: Any
    primitives: DevicePrimitives
    stack_size: int
    lo: list[Any]
    hi: list[Any]


@dataclass
class Slopes:
    """What planes need of a ray: its direction and the reciprocal, finite, with its size; the margin per unit of t; and
    the ``least`` slope against a plane that is told from none."""

    o: Any
    d: Any
    inverse: Any
    size: Any
    per_t: Any
    tmin: Any
    round_off: Any
    least: Any


#: From a node's words, its link and a ray: t where the ray meets the plane, the margin of t per unit of distance, and
#: whether the ray comes from above the plane.
Meet = Callable[[list[Any], Any, Slopes], tuple[Any, Any, Any]]


def closest(
    tree: PlaneTree, meet: Meet, ray: LocalRay, best: Candidate, root: Any, active: Any, turns: Turns
) -> Candidate:
    """The closest hit of each active ray no farther than ``best.t``."""
    ready = tree.primitives.prepare(ray)
    slopes = _slopes(tree, ray)

    def visit(at: Any, *state: Any) -> tuple[Any, ...]:
        return _visit(tree, meet, slopes, at, *state)

    def test(i: Any, best: Candidate) -> tuple[Any, Candidate]:
        which = dr.gather(tree.types.UInt, tree.references, i)
        return i + 1, tree.primitives.intersect_one(which, ready, best)

    def turn(
        at: Any, i: Any, end: Any, t0: Any, t1: Any, stack: Any, size: Any, left: Any, best: Candidate
    ) -> tuple[Any, ...]:
        best = best.counted(at < NEXT, nodes=1) if best.counts is not None else best
        state = (at, i, end, t0, t1, stack, size)
        at, i, end, t0, t1, stack, size = dr.if_stmt(state, at < NEXT, visit, lambda *s: s)
        i, best = dr.if_stmt((i, best), i < end, test, lambda *s: s)
        at, t0, t1, size = _next_cell(tree, at, i, end, t0, t1, stack, size, best.t)
        return at, i, end, t0, t1, stack, size, after_turn(left), best

    left = turns.left(dr.width(root), best.counts is not None)
    return _loop((*_start(tree, slopes, best.t, root, active), left, best), turn, turns, "planes closest")


def anything(tree: PlaneTree, meet: Meet, ray: LocalRay, root: Any, active: Any, turns: Turns) -> Any:
    """Bool: whether each active ray meets anything between its tmin and tmax."""
    ready = tree.primitives.prepare(ray)
    slopes = _slopes(tree, ray)

    def visit(at: Any, *state: Any) -> tuple[Any, ...]:
        return _visit(tree, meet, slopes, at, *state)

    def test(i: Any, blocked: Any) -> tuple[Any, Any]:
        which = dr.gather(tree.types.UInt, tree.references, i)
        return i + 1, blocked | tree.primitives.occludes_one(which, ready)

    def turn(
        at: Any, i: Any, end: Any, t0: Any, t1: Any, stack: Any, size: Any, left: Any, blocked: Any
    ) -> tuple[Any, ...]:
        state = (at, i, end, t0, t1, stack, size)
        at, i, end, t0, t1, stack, size = dr.if_stmt(state, at < NEXT, visit, lambda *s: s)
        i, blocked = dr.if_stmt((i, blocked), i < end, test, lambda *s: s)
        at, t0, t1, size = _next_cell(tree, at, i, end, t0, t1, stack, size, ray.tmax)
        return dr.select(blocked, DONE, at), i, end, t0, t1, stack, size, after_turn(left), blocked

    width = dr.width(root)
    tmax = ray.tmax + dr.zeros(tree.types.Float, width)
    blocked = dr.full(tree.types.Bool, False, width)
    state = (*_start(tree, slopes, tmax, root, active), turns.left(width, False), blocked)
    return _loop(state, turn, turns, "planes anything")


def _loop(state: tuple[Any, ...], turn: Callable[..., tuple[Any, ...]], turns: Turns, label: str) -> Any:
    """Turn after turn, until every ray is done; what was found."""
    labels = ("at", "i", "end", "t0", "t1", "stack", "size", "left", "found")
    at, *_, left, found = dr.while_loop(
        state,
        lambda at, i, end, t0, t1, stack, size, left, found: goes_on(at != DONE, left),
        turn,
        labels=labels,
        label=label,
    )
    turns.note(at != DONE, left)
    return found


def meet_axis_plane(words: list[Any], link: Any, slopes: Slopes) -> tuple[Any, Any, Any]:
    """:data:`Meet` for planes across the axis in the link's lowest bits, at word 0."""
    axis = link & 3

    def pick(v: Any) -> Any:
        return dr.select(axis == 0, v.x, dr.select(axis == 1, v.y, v.z))

    inverse = pick(slopes.inverse)
    return (words[0] - pick(slopes.o)) * inverse, abs(inverse), inverse < 0


def _slopes(tree: PlaneTree, ray: LocalRay) -> Slopes:
    d = ray.d
    size = abs(d)
    # A component this much smaller than the largest moves the ray by less than the margin; the clamp keeps reciprocals
    # finite.
    least = dr.fmax(dr.fmax(size.x, size.y), size.z) * tree.types.epsilon
    clamped = type(d)(*(dr.select(s < least, dr.copysign(least, c), c) for s, c in zip(size, d, strict=True)))
    inverse = dr.rcp(clamped)
    round_off = tree.types.Float(ERROR * tree.types.epsilon)
    along = size.x + size.y + size.z
    return Slopes(ray.o, d, inverse, abs(inverse), along * round_off, ray.tmin, round_off, least)


def _start(tree: PlaneTree, slopes: Slopes, tmax: Any, root: Any, active: Any) -> tuple[Any, ...]:
    """The state at the root, for rays that meet the box around everything."""
    UInt, Float, width = tree.types.UInt, tree.types.Float, dr.width(root)
    far = [dr.fmax(abs(tree.lo[k] - slopes.o[k]), abs(tree.hi[k] - slopes.o[k])) for k in range(3)]
    error = (far[0] + far[1] + far[2]) * slopes.round_off
    t0, t1 = slopes.tmin + dr.zeros(Float, width), tmax
    for k in range(3):
        negative = slopes.inverse[k] < 0
        near = dr.select(negative, tree.hi[k], tree.lo[k]) - slopes.o[k]
        away = dr.select(negative, tree.lo[k], tree.hi[k]) - slopes.o[k]
        margin = error * slopes.size[k]
        t0 = greater(dr.fma(near, slopes.inverse[k], -margin), t0)
        t1 = lesser(dr.fma(away, slopes.inverse[k], margin), t1)
    zero = dr.zeros(UInt, width)
    at = dr.select(active & (t0 <= t1), root, DONE) + zero
    stack = dr.alloc_local(Float, 3 * tree.stack_size)
    # The stack grows downwards from its size, which so is a number in the kernel: Dr.Jit 1.5.0 takes kernels that
    # differ in nothing but the length of a local array for the same, and runs the one with the shorter array.
    return at, zero, zero + 0, t0, t1, stack, dr.full(UInt, 3 * tree.stack_size, width)


def _visit(
    tree: PlaneTree, meet: Meet, slopes: Slopes, at: Any, i: Any, end: Any, t0: Any, t1: Any, stack: Any, size: Any
) -> tuple[Any, ...]:
    """Goes on from node ``at`` to a child, the near one first, or opens the leaf."""
    types = tree.types
    packet = dr.gather(types.ArrayXf, tree.nodes, at, shape=(tree.words, dr.width(at)))
    words = [packet[k] for k in range(tree.words)]
    reach, link = words[-2], decode_integer(words[-1], types)
    is_leaf = (link & 3) == LEAF
    first = link >> 2
    i = dr.select(is_leaf, first, i)
    end = dr.select(is_leaf, first + decode_integer(words[0], types), end)

    t, per_distance, from_above = meet(words, link, slopes)
    # The origin may have been moved, and the cell lie before it: then it is t0 that is far from 0.
    distance = greater(t1, -t0)
    margin = dr.fma(distance, slopes.per_t, reach * slopes.round_off) * per_distance
    late, early = t + margin, t - margin
    # Comparisons that NaN fails: what is not known to be missed is visited.
    not_near, not_far = late < t0, early > t1
    near = dr.select(from_above, first + 1, first)
    far = dr.select(from_above, first, first + 1)
    push = ~(is_leaf | not_near | not_far)
    size = dr.select(push, size - 3, size)
    for k, value in enumerate((_as_float(far, types), greater(early, t0), t1)):
        stack.write(value, size + k, push)
    at = dr.select(is_leaf, NEXT, dr.select(not_near, far, near))
    t1 = dr.select(push, lesser(late, t1), t1)
    return at, i, end, t0, t1, stack, size


def _next_cell(
    tree: PlaneTree, at: Any, i: Any, end: Any, t0: Any, t1: Any, stack: Any, size: Any, tmax: Any
) -> tuple[Any, ...]:
    """After a leaf's last reference: the cell on top of the stack, unless it begins beyond ``tmax``; or the end."""
    needs = (at == NEXT) & (i >= end)
    pop = needs & (size < 3 * tree.stack_size)
    begin = stack.read(size + 1, pop)
    take = pop & ~(begin > tmax)
    cell = decode_integer(stack.read(size, take), tree.types)
    at = dr.select(take, cell, dr.select(needs & ~pop, DONE, at))
    t1 = dr.select(take, lesser(tmax, stack.read(size + 2, take)), t1)
    return at, dr.select(take, begin, t0), t1, dr.select(pop, size + 3, size)


def _as_float(value: Any, types: Types) -> Any:
    """An integer as :func:`decode_integer` takes it."""
    return dr.reinterpret_array(types.Float, value) if types.precision == "float32" else types.Float(value)
