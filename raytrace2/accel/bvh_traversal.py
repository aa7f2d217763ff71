"""Traversal of wide nodes in one symbolic loop: a node or a primitive of each ray a turn.

A ray holds the child it is at, the *group* of its latest node's children that it has yet to visit (nearest first), and
a stack of older groups. How nodes are tested is the :class:`Nodes`' business; their tests must be wide enough that no
hit is culled that a primitive test would have found.

A turn visits a node, tests a primitive of a leaf, or finds that a node has no child in a slot. Every reference stands
in one slot; a visit goes to one slot and makes the others a group of bits, and each bit is taken out once: whatever the
tests say, a ray comes to no slot twice, so it takes no more turns than there are nodes, primitives and empty slots.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import drjit as dr

from ..surfaces.hit import Candidate
from ..surfaces.primitives import DevicePrimitives, LocalRay
from ..surfaces.turns import Turns, after_turn, goes_on
from ..types import Types
from .child_order import ChildOrder
from .wide_node import COUNT_MASK, COUNT_SHIFT, DONE, FIRST_MASK, LEAF, NEXT


class Nodes(Protocol):
    """Wide nodes of one shape."""

    @property
    def width(self) -> int:
        """The most children of a node."""
        ...

    @property
    def bytes(self) -> int:
        """On the device."""
        ...

    def prepare(self, ray: LocalRay) -> Any:
        """What the tests need, once per ray."""
        ...

    def visit(self, at: Any, ready: Any, tmax: Any) -> tuple[list[tuple[Any, Any]], list[Any]]:
        """For each child of node ``at`` a distance, not negative, to order it by and whether a ray meets it up to
        ``tmax``; and the references to the children, NEXT where there is none (which no ray meets, or goes to in
        vain)."""
        ...

    def octant(self, ready: Any) -> Any:
        """UInt: a bit for each negative component of the direction."""
        ...

    def child(self, node: Any, slot: Any, active: Any) -> Any:
        """The reference to child ``slot`` of ``node``."""
        ...


@dataclass(frozen=True, eq=False)
class DeviceTree:
    """Nodes and primitives on the device; ``stack_size`` groups can be pending at most."""

    types: Types
    nodes: Nodes
    primitives: DevicePrimitives
    stack_size: int


@dataclass(frozen=True, eq=False)
class _Walk:
    """What stays the same while a ray goes through a tree."""

    tree: DeviceTree
    ready: Any
    order: ChildOrder
    octant: Any

    @staticmethod
    def of(tree: DeviceTree, ray: LocalRay, *, ordered: bool) -> _Walk:
        ready, order = tree.nodes.prepare(ray), ChildOrder(tree.types, tree.nodes.width, ordered)
        return _Walk(tree, ready, order, tree.nodes.octant(ready) if order.by_octant else None)


def closest(tree: DeviceTree, ray: LocalRay, best: Candidate, root: Any, active: Any, turns: Turns) -> Candidate:
    """The closest hit below node or leaf ``root``, no farther than ``best.t``."""
    ready = tree.primitives.prepare(ray)
    walk = _Walk.of(tree, ray, ordered=True)

    def visit(at: Any, group: Any, stack: Any, top: Any, best: Candidate) -> tuple[Any, ...]:
        return _visit_node(walk, best.t, at, group, stack, top)

    def test(at: Any, best: Candidate) -> tuple[Any, Candidate]:
        best = tree.primitives.intersect_one(at & FIRST_MASK, ready, best)
        return _after_primitive(at), best

    def turn(at: Any, group: Any, stack: Any, top: Any, left: Any, best: Candidate) -> tuple[Any, ...]:
        best = best.counted(at < NEXT, nodes=1, volumes=tree.nodes.width) if best.counts is not None else best
        at, group, stack, top = dr.if_stmt((at, group, stack, top, best), at < NEXT, visit, lambda *s: s[:4])
        at, best = dr.if_stmt((at, best), (at & LEAF) != 0, test, lambda *s: s)
        at, group, stack, top = _next_child(walk, at, group, stack, top)
        return at, group, stack, top, after_turn(left), best

    state = (*_start(tree, root, active), turns.left(dr.width(root), best.counts is not None), best)
    return _loop(state, turn, turns, "bvh closest")


def anything(tree: DeviceTree, ray: LocalRay, root: Any, active: Any, turns: Turns) -> Any:
    """Bool: whether each ray meets anything below ``root`` between its tmin and tmax."""
    ready = tree.primitives.prepare(ray)
    walk = _Walk.of(tree, ray, ordered=False)

    def visit(at: Any, group: Any, stack: Any, top: Any, blocked: Any) -> tuple[Any, ...]:
        return _visit_node(walk, ray.tmax, at, group, stack, top)

    def test(at: Any, blocked: Any) -> tuple[Any, Any]:
        hit = tree.primitives.occludes_one(at & FIRST_MASK, ready)
        return dr.select(hit, DONE, _after_primitive(at)), blocked | hit

    def turn(at: Any, group: Any, stack: Any, top: Any, left: Any, blocked: Any) -> tuple[Any, ...]:
        at, group, stack, top = dr.if_stmt((at, group, stack, top, blocked), at < NEXT, visit, lambda *s: s[:4])
        at, blocked = dr.if_stmt((at, blocked), (at & LEAF) != 0, test, lambda *s: s)
        at, group, stack, top = _next_child(walk, at, group, stack, top)
        return at, group, stack, top, after_turn(left), blocked

    width = dr.width(root)
    state = (*_start(tree, root, active), turns.left(width, False), dr.full(tree.types.Bool, False, width))
    return _loop(state, turn, turns, "bvh anything")


def _loop(state: tuple[Any, ...], turn: Callable[..., tuple[Any, ...]], turns: Turns, label: str) -> Any:
    """Turn after turn, until every ray is done; what was found."""
    labels = ("at", "group", "stack", "top", "left", "found")
    at, _, _, _, left, found = dr.while_loop(
        state, lambda at, group, stack, top, left, found: goes_on(at != DONE, left), turn, labels=labels, label=label
    )
    turns.note(at != DONE, left)
    return found


def _start(tree: DeviceTree, root: Any, active: Any) -> tuple[Any, ...]:
    UInt, width = tree.types.UInt, dr.width(root)
    zero = dr.zeros(UInt, width)
    # The stack grows downwards from its length, which so is a number in the kernel: Dr.Jit 1.5.0 takes kernels that
    # differ in nothing but the length of a local array for one and the same, and runs whichever it compiled first.
    stack, top = dr.alloc_local(UInt, tree.stack_size), dr.full(UInt, tree.stack_size, width)
    return dr.select(active, root, DONE) + zero, zero, stack, top


def _visit_node(walk: _Walk, tmax: Any, at: Any, group: Any, stack: Any, top: Any) -> tuple[Any, ...]:
    """Tests the children of node ``at``: goes on to the nearest that is met and makes the others the group."""
    met, refs = walk.tree.nodes.visit(at, walk.ready, tmax)
    nearest, code = walk.order.split(met, refs, walk.octant)
    more = code != 0
    push = more & (group != 0)
    top = dr.select(push, top - 1, top)
    stack.write(group, top, push)
    group = dr.select(more, (at << 8) | code, group)
    return nearest, group, stack, top


def _next_child(walk: _Walk, at: Any, group: Any, stack: Any, top: Any) -> tuple[Any, ...]:
    """Where a ray stands at NEXT: takes the next child of its group, or of the group on top of the stack, or is
    done."""
    needs = at == NEXT
    pop = needs & (group == 0) & (top < walk.tree.stack_size)
    group = dr.select(pop, stack.read(top, pop), group)
    top = dr.select(pop, top + 1, top)
    has = needs & (group != 0)
    slot, rest = walk.order.next(group, walk.octant)
    child = walk.tree.nodes.child(group >> 8, slot, has)
    at = dr.select(needs, dr.select(has, child, DONE), at)
    return at, dr.select(has, rest, group), stack, top


def _after_primitive(at: Any) -> Any:
    """The leaf reference without its first primitive, or NEXT after the last."""
    last = ((at >> COUNT_SHIFT) & COUNT_MASK) == 1
    return dr.select(last, NEXT, at + 1 - (1 << COUNT_SHIFT))
