"""The walk of rays through grids in one symbolic loop: a step or a primitive of each ray a turn.

From cell to cell as in Amanatides and Woo, "A fast voxel traversal algorithm for ray tracing" (Eurographics 1987),
across the wall that is met first; in empty space several cells at once. A ray stops when its hit lies before the wall:
every primitive whose hit lies there has been listed in a cell that it came through (:mod:`.grid_frame` says why
rounding does not matter).

A turn is a step, and may test the first entry of a list as well, or tests another entry. Every step moves on along an
axis and none moves back: times that a ray crosses walls at are numbers, as only rays of a finite reach walk from wall
to wall, and places are clamped to lie ahead. So a walk takes no more steps than a grid has layers, which is two more
than its cells at most, and one to enter; a beam (:mod:`.grid_beam`) no more than cells and layers, and one to leave.
A cell's list and the grid in it are met no more often than the cell. In all there are no more turns than entries, twice
the cells and thrice the grids (:func:`most_turns`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr

from ..surfaces.hit import Candidate
from ..surfaces.ordered import greater, lesser
from ..surfaces.primitives import DevicePrimitives, LocalRay
from ..surfaces.turns import Turns, after_turn, goes_on
from ..types import Types
from .grid_beam import first_slice, next_cell
from .grid_cells import FULL, INNER, LAST, NUMBER
from .grid_frame import ERROR, Frame, WalkRay, frame_of, unpack_place, walk_ray
from .grid_lattice import WORDS
from .grid_overlap import PLANE_ERROR

#: States of a ray that is not at an entry of a list: on its way to the next cell, on entering a grid, finished.
STEP, READ, DONE = 0x7FFFFFFD, 0x7FFFFFFE, 0x7FFFFFFF
#: A beam wider than the sum of the outermost grid's sides by this is as good as wide as everything.
WIDE = 8


@dataclass(frozen=True, eq=False)
class DeviceGrids:
    """Grids on the device: ``lattices``; ``words`` of their cells; ``lists``, where from ``all`` on every primitive is
    listed once, those that are in no cell last, from ``large`` on (None if there are none); the map x -> (x -
    ``origin``) ``scale`` to their coordinates; the sum ``size`` of the outermost's sides; how far ``near`` origins may
    be; the largest ``tilt`` (2 L^2 / A, see :mod:`.grid_overlap`) of a triangle kept out of a cell by its plane; and
    whether grids are ``nested`` in cells."""

    types: Types
    lattices: Any
    words: Any
    lists: Any
    all: Any
    large: Any
    primitives: DevicePrimitives
    origin: Any
    scale: Any
    size: Any
    near: Any
    tilt: Any
    nested: bool


@dataclass
class _Walk:
    """What stays the same for a ray all along."""

    grids: DeviceGrids
    ray: WalkRay
    root: Frame
    far: Any
    radius: Any
    leaves: Any

    def frame(self, grid: Any) -> Frame:
        return frame_of(self.ray, self.grids.lattices, grid, self.grids.types) if self.grids.nested else self.root


def most_turns(grids: DeviceGrids) -> int:
    """The most turns that a ray's walk can take."""
    return dr.width(grids.lists) + 2 * dr.width(grids.words) + 3 * (dr.width(grids.lattices) // WORDS)


def closest(grids: DeviceGrids, ray: LocalRay, best: Candidate, active: Any, turns: Turns) -> Candidate:
    """The closest hit no farther than ``best.t``."""
    ready = grids.primitives.prepare(ray)

    def test(i: Any, at: Any, best: Candidate) -> tuple[Any, Candidate]:
        return at, grids.primitives.intersect_one(i, ready, best)

    return _walk(grids, ray, active, best, test, lambda best: best.t, turns, "grid closest")


def anything(grids: DeviceGrids, ray: LocalRay, width: int, active: Any, turns: Turns) -> Any:
    """Bool: whether each ray meets anything between its tmin and tmax."""
    ready = grids.primitives.prepare(ray)

    def test(i: Any, at: Any, blocked: Any) -> tuple[Any, Any]:
        hit = grids.primitives.occludes_one(i, ready)
        return dr.select(hit, DONE, at), blocked | hit

    start = dr.full(grids.types.Bool, False, width)
    return _walk(grids, ray, active, start, test, lambda _: ray.tmax, turns, "grid anything")


def _walk(
    grids: DeviceGrids,
    ray: LocalRay,
    active: Any,
    found: Any,
    test: Callable[[Any, Any, Any], tuple[Any, Any]],
    farthest: Callable[[Any], Any],
    turns: Turns,
    label: str,
) -> Any:
    """The loop. ``found`` is carried along; ``test(i, at, found)`` meets primitive i; beyond ``farthest(found)`` no
    hit matters."""
    types = grids.types
    walk, begin, enters = _start(grids, ray, farthest(found))
    zero = dr.zeros(types.Float, dr.width((enters, active, found)))
    # A beam that is as wide as everything meets each primitive once rather than in each of its cells.
    scans = enters & ~(walk.radius * WIDE <= grids.size)
    first = dr.select(enters, types.UInt(READ), DONE)
    next_after_all = dr.select(scans, DONE, first)
    if grids.large is not None:
        first = grids.large
    at = dr.select(active, dr.select(scans, grids.all, first), DONE) + types.UInt(zero)
    # The only grid is entered here; grids in grids on the way, at the time that is carried.
    place = [zero + 0 if grids.nested else p + zero for p in walk.root.cell_at(begin)]
    inner = (types.UInt(zero), begin + zero) if grids.nested else ()

    def step(at: Any, place: list[Any], clear: Any, inner: tuple[Any, ...], found: Any) -> tuple[Any, ...]:
        return _step(walk, walk.ray.time(farthest(found)), at, place, clear, inner)

    def meet(at: Any, found: Any) -> tuple[Any, Any]:
        entry = dr.gather(types.UInt, grids.lists, at)
        among_all = scans if grids.large is None else at >= grids.all
        after_list = dr.select(among_all, next_after_all, STEP)
        after = dr.select((entry & LAST) != 0, after_list, at + 1)
        return test(entry & ~types.UInt(LAST), after, found)

    def turn(at: Any, place: list[Any], clear: Any, inner: tuple[Any, ...], left: Any, found: Any) -> tuple[Any, ...]:
        state = (at, place, clear, inner, found)
        walks = (at == STEP) | (at == READ)
        if isinstance(found, Candidate) and found.counts is not None:
            found = found.counted(walks, nodes=1)
            state = (at, place, clear, inner, found)
        at, place, clear, inner = dr.if_stmt(state, walks, step, lambda *s: s[:4])
        at, found = dr.if_stmt((at, found), at < STEP, meet, lambda *s: s)
        return at, place, clear, inner, after_turn(left), found

    left = turns.left(dr.width(zero), isinstance(found, Candidate) and found.counts is not None)
    at, _, _, _, left, found = dr.while_loop(
        (at, place, zero + 0, inner, left, found),
        lambda at, place, clear, inner, left, found: goes_on(at != DONE, left),
        turn,
        labels=("at", "place", "clear", "inner", "left", "found"),
        label=label,
    )
    turns.note(at != DONE, left)
    return found


def _start(grids: DeviceGrids, ray: LocalRay, farthest: Any) -> tuple[_Walk, Any, Any]:
    """What is known of each ray, when it enters the outermost grid, and whether it does."""
    types = grids.types
    walker = walk_ray(ray, grids.origin, grids.scale, types)
    reach = abs(walker.o.x) + abs(walker.o.y) + abs(walker.o.z) + grids.size
    unit = reach * types.epsilon
    radius = unit * (ERROR + PLANE_ERROR + PLANE_ERROR * grids.tilt)
    root = frame_of(walker, grids.lattices, dr.zeros(types.UInt, 1), types)
    far_end = [dr.select(walker.negative[k], 0, root.cells[k]) for k in range(3)]
    error = [ERROR * unit * abs(walker.inverse[k]) for k in range(3)]
    enter = [root.crossing(k, root.cells[k] - far_end[k]) - error[k] for k in range(3)]
    leave = [root.crossing(k, far_end[k]) for k in range(3)]
    leaves = lesser(lesser(leave[0], leave[1]), leave[2])
    slack = [leave[k] + error[k] for k in range(3)]
    begin = greater(greater(enter[0], enter[1]), greater(enter[2], walker.start))
    end = lesser(lesser(slack[0], slack[1]), lesser(slack[2], walker.time(farthest)))
    return _Walk(grids, walker, root, ~(reach <= grids.near), radius, leaves), begin, begin <= end


def _step(walk: _Walk, limit: Any, at: Any, place: list[Any], clear: Any, inner: tuple[Any, ...]) -> tuple[Any, ...]:
    """On to the next cell: the entry of its list, the grid in it, or how far around it all is empty."""
    grids = walk.grids
    types = grids.types
    frame = walk.frame(inner[0]) if inner else walk.root
    reads = at == READ
    time = inner[1] if inner else None

    def near(place: list[Any], time: Any) -> tuple[Any, ...]:
        entry = place
        further, out, leaves = _cross(walk, frame, place, clear)
        if inner:
            walls = [frame.crossing(k, dr.select(walk.ray.negative[k], frame.cells[k], 0)) for k in range(3)]
            time = greater(greater(walls[0], walls[1]), greater(walls[2], time))
            entry = frame.cell_at(time)
        place = [dr.select(reads, a, b) for a, b in zip(entry, further, strict=True)]
        if not inner:
            done = ~reads & (out >= limit)
            left = ~reads & (out >= leaves)
            return place, None, ~(done | left), left, done
        time = dr.select(reads, time, out)
        left = (time > leaves) | (~reads & (time == leaves))
        # A ray that misses an inner grid reaches its planes at times that mean nothing.
        done = ((time > limit) & ~(reads & left)) | (~reads & (time == limit))
        return place, time, ~(done | left), left, done

    def beyond(place: list[Any], time: Any) -> tuple[Any, ...]:
        before = first_slice(walk.ray, frame)
        place = [dr.select(reads, a, b) for a, b in zip(before, place, strict=True)]
        place, is_cell, left = next_cell(walk.ray, frame, walk.radius, place, limit)
        return place, time, is_cell, left, types.Bool(False) & left

    place, time, is_cell, left, done = dr.if_stmt((place, time), walk.far, beyond, near)
    cell = frame.first + types.UInt(dr.fma(dr.fma(place[0], frame.cells[1], place[1]), frame.cells[2], place[2]))
    word = dr.gather(types.UInt, grids.words, cell, is_cell)
    full = is_cell & ((word & FULL) != 0)
    at = dr.select(full, word & NUMBER, STEP)
    if not inner:
        return dr.select(left | done, DONE, at), place, types.Float(dr.select(full, 0, word)), ()
    enters = is_cell & ~full & ((word & INNER) != 0)
    grid = dr.select(enters, word & NUMBER, inner[0])
    up = left & (grid != 0)
    place = [dr.select(up, a, b) for a, b in zip(unpack_place(frame.place, types), place, strict=True)]
    grid = dr.select(up, frame.parent, grid)
    at = dr.select(enters, READ, dr.select(done | (left & ~up), DONE, at))
    clear = types.Float(dr.select(full | enters | up, 0, word))
    return at, place, clear, (grid, time)


def _cross(walk: _Walk, frame: Frame, place: list[Any], clear: Any) -> tuple[list[Any], Any, Any]:
    """The cell beyond the wall that a ray at ``place`` meets first, when it does, and when it leaves the grid. As cells
    up to ``clear`` away are empty, the wall is that of the block that they make."""
    negative = walk.ray.negative
    walls = [place[k] + dr.select(negative[k], -clear, clear + 1) for k in range(3)]
    times = [frame.crossing(k, walls[k]) for k in range(3)]
    time = lesser(lesser(times[0], times[1]), times[2])
    found = []
    for k in range(3):
        beyond = dr.select(negative[k], walls[k] - 1, walls[k])
        # Never back, so that rounding cannot send a ray round and round.
        low, high = dr.select(negative[k], walls[k], place[k]), dr.select(negative[k], place[k], walls[k] - 1)
        beside = lesser(greater(dr.floor(frame.position(k, time)), low), high)
        found.append(dr.select(times[k] == time, beyond, beside))
    leaves = walk.leaves
    if walk.grids.nested:
        ends = [frame.crossing(k, dr.select(negative[k], 0, frame.cells[k])) for k in range(3)]
        leaves = lesser(lesser(ends[0], ends[1]), ends[2])
    return found, time, leaves


__all__ = ["DeviceGrids", "anything", "closest"]
