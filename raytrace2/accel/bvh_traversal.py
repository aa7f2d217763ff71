"""Traversal of wide nodes in one symbolic loop: a node or a primitive of each ray a turn.

A ray holds the child it is at, the *group* of its latest node's children that it has yet to visit (nearest first), and
a stack of older groups. How nodes are tested is the :class:`Nodes`' business; their tests must be wide enough that no
hit is culled that a primitive test would have found.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import drjit as dr

from ..surfaces.hit import Candidate
from ..surfaces.primitives import DevicePrimitives, LocalRay
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


def closest(tree: DeviceTree, ray: LocalRay, best: Candidate, root: Any, active: Any) -> Candidate:
    """The closest hit below node or leaf ``root``, no farther than ``best.t``."""
    ready = tree.primitives.prepare(ray)
    walk = _Walk.of(tree, ray, ordered=True)

    def visit(at: Any, group: Any, stack: Any, top: Any, best: Candidate) -> tuple[Any, ...]:
        return _visit_node(walk, best.t, at, group, stack, top)

    def test(at: Any, best: Candidate) -> tuple[Any, Candidate]:
        best = tree.primitives.intersect_one(at & FIRST_MASK, ready, best)
        return _after_primitive(at), best

    def turn(at: Any, group: Any, stack: Any, top: Any, best: Candidate) -> tuple[Any, ...]:
        best = best.counted(at < NEXT, nodes=1, volumes=tree.nodes.width) if best.counts is not None else best
        at, group, stack, top = dr.if_stmt((at, group, stack, top, best), at < NEXT, visit, lambda *s: s[:4])
        at, best = dr.if_stmt((at, best), (at & LEAF) != 0, test, lambda *s: s)
        at, group, stack, top = _next_child(walk, at, group, stack, top)
        return at, group, stack, top, best

    state = (*_start(tree, root, active), best)
    labels = ("at", "group", "stack", "top", "best")
    return dr.while_loop(state, lambda at, *_: at != DONE, turn, labels=labels, label="bvh closest")[-1]


def anything(tree: DeviceTree, ray: LocalRay, root: Any, active: Any) -> Any:
    """Bool: whether each ray meets anything below ``root`` between its tmin and tmax."""
    ready = tree.primitives.prepare(ray)
    walk = _Walk.of(tree, ray, ordered=False)

    def visit(at: Any, group: Any, stack: Any, top: Any, blocked: Any) -> tuple[Any, ...]:
        return _visit_node(walk, ray.tmax, at, group, stack, top)

    def test(at: Any, blocked: Any) -> tuple[Any, Any]:
        hit = tree.primitives.occludes_one(at & FIRST_MASK, ready)
        return dr.select(hit, DONE, _after_primitive(at)), blocked | hit

    def turn(at: Any, group: Any, stack: Any, top: Any, blocked: Any) -> tuple[Any, ...]:
        at, group, stack, top = dr.if_stmt((at, group, stack, top, blocked), at < NEXT, visit, lambda *s: s[:4])
        at, blocked = dr.if_stmt((at, blocked), (at & LEAF) != 0, test, lambda *s: s)
        at, group, stack, top = _next_child(walk, at, group, stack, top)
        return at, group, stack, top, blocked

    state = (*_start(tree, root, active), dr.full(tree.types.Bool, False, dr.width(root)))
    labels = ("at", "group", "stack", "top", "blocked")
    return dr.while_loop(state, lambda at, *_: at != DONE, turn, labels=labels, label="bvh anything")[-1]


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
