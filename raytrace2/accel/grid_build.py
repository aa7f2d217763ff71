"""Builds grids: a uniform one over everything and, level by level, one in every cell that holds many."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from ..buffers import owned
from ..surfaces.primitives import Primitives
from .grid_cells import FULL, INNER, LAST, MOST
from .grid_content import Content, content_of
from .grid_fill import DUPLICATION, Level, fill, most_references
from .grid_frame import ERROR, NEAR
from .grid_lattice import WORDS, Lattices, choose_cells
from .grid_overlap import Subjects
from .grid_walk import DeviceGrids

#: No cell is smaller than so many times the margin by which it is widened.
LEAST_CELL = 8
#: Up to so many primitives are kept out of all cells, if their box has this share of the surface of the box around all.
LARGE_COUNT, LARGE_SHARE = 16, 0.25
#: A cell is filled with a grid if that leaves less than this share of the primitive tests.
GAIN = 0.75


@dataclass(frozen=True)
class Rule:
    """``levels`` of grids, of ``density`` cells a primitive (one number a level) and at most ``max_cells`` each; a cell
    with more than ``most_in_cell`` primitives is filled with a grid, unless its cells would be smaller than
    ``min_cell``, in units of the longest side of all."""

    levels: int
    density: tuple[float, ...]
    max_cells: int
    most_in_cell: int = 0
    min_cell: float = 0.0


@dataclass(frozen=True, eq=False)
class _Box:
    """Where the outermost grid lies: the map x -> (x - ``origin``) ``scale`` takes the longest side of all to between
    1/2 and 1. In those units the grid is of ``size``: on every side it reaches beyond all by twice ``margin``, by which
    cells are widened; ``near`` is how far origins may be."""

    origin: np.ndarray
    scale: float
    size: np.ndarray
    margin: float
    near: float

    @staticmethod
    def around(parts: Primitives, among: np.ndarray | slice) -> _Box:
        lo, hi = _bounds(parts, among)
        # A point has no size; any will do.
        least = max(float(np.abs([lo, hi]).max()) * parts.types.epsilon, 2.0**-100)
        longest = max(float((hi - lo).max()), least)
        scale = 2.0 ** -np.ceil(np.log2(longest))
        size = (hi - lo) * scale
        near = NEAR * max(float(size.sum()), longest * scale)
        margin = ERROR * parts.types.epsilon * near
        return _Box(lo, scale, size + 4 * margin, margin, near)


@dataclass(frozen=True, eq=False)
class _Job:
    """What is put into grids, and how: the primitives ``among`` all; ``least`` is the smallest cell."""

    parts: Primitives
    among: np.ndarray | slice
    subjects: Subjects
    box: _Box
    rule: Rule
    least: float


def build_grids(parts: Primitives, rule: Rule) -> tuple[DeviceGrids, dict[str, Any]]:
    """Grids over ``parts``, none of whose boxes is empty, and what there is to tell of them."""
    types = parts.types
    large = _large(parts)
    among = slice(None) if len(large) == 0 else np.delete(np.arange(len(parts)), large)
    box = _Box.around(parts, among)
    origin = box.origin.astype(types.numpy)
    device = parts.upload()
    subjects = Subjects.make(parts, device, origin, box.scale, box.near, box.margin)
    least = max(LEAST_CELL * box.margin, rule.min_cell * float(box.size.max()))
    job = _Job(parts, among, subjects, box, rule, least)
    levels = [_outermost(job)]
    for density in rule.density[1 : rule.levels]:
        level = _inner(job, levels, density)
        if level is None:
            break
        levels.append(level)
    lattices = functools.reduce(Lattices.followed_by, (level.lattices for level in levels))
    words = np.empty(lattices.end, np.uint32)
    everything = np.concatenate([np.arange(len(parts))[among], large]).astype(np.uint32)
    everything[-1] |= LAST
    held = sum(len(level.prims) for level in levels)
    if held + len(parts) >= MOST:
        raise ValueError(f"grids hold at most {MOST} references, not {held + len(parts)}: lower the density")
    before = inner = 0
    for level in levels:
        words[level.start : level.lattices.end] = level.clear
        words[level.cell] = FULL | (before + level.begin)
        before += len(level.prims)
        # All but the outermost of the grids so far are in a cell of the level before.
        grid = inner + np.arange(len(level.lattices))
        if inner:
            outer = level.lattices.parent
            place, shape = level.lattices.place, lattices.cells[outer]
            cell = lattices.first[outer] + (place[:, 0] * shape[:, 1] + place[:, 1]) * shape[:, 2] + place[:, 2]
            words[cell] = INNER | grid
        inner += len(grid)
    entries = np.concatenate([*(level.entries() for level in levels), everything])

    def opaque(value: float) -> Any:
        return dr.opaque(types.Float, float(value))

    grids = DeviceGrids(
        types,
        lattices=lattices.upload(types),
        words=owned(words, types.UInt),
        lists=owned(entries, types.UInt),
        all=dr.opaque(types.UInt, held),
        large=dr.opaque(types.UInt, held + len(parts) - len(large)) if len(large) else None,
        primitives=device,
        origin=types.Array3f(*map(opaque, origin)),
        scale=opaque(box.scale),
        size=opaque(box.size.sum()),
        near=opaque(box.near),
        tilt=opaque(max(level.tilt for level in levels)),
        nested=len(levels) > 1,
    )
    size = words.nbytes + entries.nbytes + parts.records.nbytes + len(lattices) * WORDS * parts.records.itemsize
    return grids, _describe(levels, len(parts), len(large), size)


def _bounds(parts: Primitives, among: np.ndarray | slice) -> tuple[np.ndarray, np.ndarray]:
    """Opposite corners of the box around the primitives ``among`` all."""
    lo = np.array([parts.lo[among, k].min() for k in range(3)]).astype(np.float64)
    return lo, np.array([parts.hi[among, k].max() for k in range(3)]).astype(np.float64)


def _large(parts: Primitives) -> np.ndarray:
    """The primitives that are kept out of cells, and met by every ray: few whose boxes are about as large as that of
    all, and would be in many cells. What is left may be in a much smaller place."""
    none = np.zeros(0, np.int64)
    if len(parts) <= LARGE_COUNT:
        return none
    lo, hi = _bounds(parts, slice(None))
    scale = 1 / max(float((hi - lo).max()), float(np.finfo(parts.lo.dtype).tiny) * 2**20)
    longest = np.maximum(parts.hi[:, 0] - parts.lo[:, 0], parts.hi[:, 1] - parts.lo[:, 1])
    longest = np.maximum(longest, parts.hi[:, 2] - parts.lo[:, 2])
    # A box has less than three times its longest side squared for its half surface.
    candidates = np.flatnonzero(longest * scale >= (LARGE_SHARE * _area((hi - lo) * scale) / 3) ** 0.5)
    sides = (parts.hi[candidates].astype(np.float64) - parts.lo[candidates]) * scale
    found = candidates[_area(sides) >= LARGE_SHARE * _area((hi - lo) * scale)]
    return found if len(found) <= LARGE_COUNT else none


def _outermost(job: _Job) -> Level:
    parts, box, rule = job.parts, job.box, job.rule
    dtype = parts.lo.dtype
    none = np.zeros((1, 3), np.int64)
    corner = np.full((1, 3), -2 * box.margin, dtype)
    prim = np.arange(len(parts), dtype=np.uint32)[job.among]

    def make(cells: np.ndarray) -> Lattices:
        return Lattices.make(corner, box.size[None], cells, 0, none[:, 0], none)

    target = np.array([min(max(1.0, rule.density[0] * len(prim)), rule.max_cells)])
    size, count = box.size[None], np.array([len(prim)])
    listed = owned(prim, parts.types.UInt)
    content = content_of(job.subjects, listed, np.zeros(1, np.int64), count, corner, corner + size.astype(dtype))
    extents = content.extents(count, size)
    grid = dr.zeros(parts.types.UInt, len(prim))
    return fill(job.subjects, listed, grid, make, size, extents, most_references(extents), target, job.least)


def _inner(job: _Job, levels: list[Level], density: float) -> Level | None:
    """A grid in every cell of the last level that holds too many and that a grid does good; None if there is none.

    Each encloses what is in its cell, which may be much smaller. The lists of these cells leave the last level.
    """
    outer, rule = levels[-1], job.rule
    # Where the lists are as long as one grid's may be, grids in their cells would only copy them.
    room = len(job.parts) / max(len(outer.prims), 1)
    many = np.flatnonzero(outer.count > rule.most_in_cell)
    if len(many) == 0 or DUPLICATION * room < 1:
        return None
    parent, place = outer.lattices.where(outer.cell[many])
    count, prim = outer.count[many], outer.list_of(many)
    step = outer.lattices.step[parent]
    low = outer.lattices.corner[parent] + place.astype(step.dtype) * step
    content = content_of(
        job.subjects, owned(prim, job.parts.types.UInt), np.cumsum(count) - count, count, low, low + step
    )
    corner, size = _enclosing(content, low, low + step, job.box.margin)
    extents = content.extents(count, size)
    # All levels together are to hold no more than twice what one may.
    most = most_references(extents, min(1.0, 2 * room))
    target = np.clip(density * count, 1, rule.max_cells)
    cells = choose_cells(size, extents, target, most, job.least)
    # Primitives that a ray through the cell is to be tested with.
    tested = extents.references(cells) * _area(size / cells) / _area(step)
    good = tested < GAIN * count
    if not good.any():
        return None
    chosen = np.flatnonzero(good)
    kept = prim if good.all() else prim[np.repeat(good, count)]
    grid = np.repeat(np.arange(len(chosen), dtype=np.uint32), count[chosen])
    before = sum(len(level.lattices) for level in levels)
    outermost = before - len(outer.lattices)

    def make(cells: np.ndarray) -> Lattices:
        return Lattices.make(
            corner[chosen], size[chosen], cells, outer.lattices.end, parent[chosen] + outermost, place[chosen]
        )

    UInt = job.parts.types.UInt
    extents, most, target = extents.take(chosen), most[chosen], target[chosen]
    listed, grids = owned(kept, UInt), owned(grid, UInt)
    level = fill(job.subjects, listed, grids, make, size[chosen], extents, most, target, job.least)
    gone = np.zeros(len(outer.count), bool)
    gone[many[chosen]] = True
    levels[-1] = outer.without(gone)
    return level


def _enclosing(content: Content, low: np.ndarray, high: np.ndarray, margin: float) -> tuple[np.ndarray, np.ndarray]:
    """Corner and size (m, 3) of boxes around what of primitives is within the boxes ``low``, ``high`` (m, 3).

    They are larger by twice the margin, so that they hold whatever cells widened by it may meet, but reach beyond a
    cell by a quarter only: so far rounding may lead a ray that is in it, and so far it lists whatever is met.
    """
    corner = np.maximum(content.lo - 2 * margin, low - margin / 4).astype(low.dtype)
    top = np.minimum(content.hi + 2 * margin, high + margin / 4)
    return corner, top.astype(np.float64) - corner


def _describe(levels: list[Level], primitives: int, large: int, size: int) -> dict[str, Any]:
    references = sum(len(level.prims) for level in levels) + large
    outermost = levels[0].lattices
    whole = _area(outermost.step[0] * outermost.cells[0])
    walked = tested = 0.0
    for level in levels:
        area = _area(level.lattices.step) / whole
        walked += float((area * level.lattices.cells.prod(axis=1)).sum())
        grid = level.lattices.where(level.cell)[0] if len(level.lattices) > 1 else np.zeros(len(level.cell), np.int64)
        tested += float((area[grid] * level.count).sum())
    return {
        "primitives": primitives,
        "references": references,
        "duplication": references / primitives,
        "nodes": sum(len(level.lattices) for level in levels),
        "leaves": sum(len(level.cell) for level in levels),
        "depth": len(levels),
        "bytes": int(size),
        "sah_cost": walked + tested + large,
        "expected_cells": walked,
        "expected_primitives": tested + large,
        "in_no_cell": large,
        "cells": sum(len(level.clear) for level in levels),
        "resolution": tuple(int(k) for k in outermost.cells[0]),
        "longest_list": max(int(level.count.max(initial=0)) for level in levels),
    }


def _area(sides: np.ndarray) -> Any:
    """Half the surface of boxes (..., 3)."""
    x, y, z = np.moveaxis(np.asarray(sides, np.float64), -1, 0)
    return x * y + y * z + z * x
