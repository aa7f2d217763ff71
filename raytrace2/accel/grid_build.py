"""Builds grids: a uniform one over everything and, level by level, one in every cell that holds many."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from ..buffers import owned
from ..surfaces import record
from ..surfaces.primitives import Primitives
from .grid_cells import FULL, INNER, LAST, MOST
from .grid_fill import Level, fill
from .grid_frame import ERROR, NEAR
from .grid_lattice import WORDS, Extents, Lattices
from .grid_overlap import Subjects
from .grid_walk import DeviceGrids

#: No cell is smaller than so many times the margin by which it is widened.
LEAST_CELL = 8


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
    def around(parts: Primitives) -> _Box:
        lo = np.array([parts.lo[:, k].min() for k in range(3)]).astype(np.float64)
        hi = np.array([parts.hi[:, k].max() for k in range(3)]).astype(np.float64)
        # A point has no size; any will do.
        least = max(float(np.abs([lo, hi]).max()) * parts.types.epsilon, 2.0**-100)
        longest = max(float((hi - lo).max()), least)
        scale = 2.0 ** -np.ceil(np.log2(longest))
        size = (hi - lo) * scale
        near = NEAR * max(float(size.sum()), longest * scale)
        margin = ERROR * parts.types.epsilon * near
        return _Box(lo, scale, size + 4 * margin, margin, near)


def build_grids(parts: Primitives, rule: Rule) -> tuple[DeviceGrids, dict[str, Any]]:
    """Grids over ``parts``, none of whose boxes is empty, and what there is to tell of them."""
    types = parts.types
    box = _Box.around(parts)
    origin = box.origin.astype(types.numpy)
    device = parts.upload()
    subjects = Subjects.make(parts, device, origin, box.scale, box.near, box.margin)
    sides = (parts.hi - parts.lo) * (box.scale / box.size).astype(types.numpy)
    solid = _solid(parts)
    least = max(LEAST_CELL * box.margin, rule.min_cell * float(box.size.max()))
    levels = [_outermost(subjects, sides, solid, box, rule, least)]
    for density in rule.density[1 : rule.levels]:
        level = _inner(subjects, sides, solid, box, levels, density, rule, least)
        if level is None:
            break
        levels.append(level)
    lattices = functools.reduce(Lattices.followed_by, (level.lattices for level in levels))
    words = np.empty(lattices.end, np.uint32)
    everything = np.arange(len(parts), dtype=np.uint32)
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
        primitives=device,
        origin=types.Array3f(*map(opaque, origin)),
        scale=opaque(box.scale),
        size=opaque(box.size.sum()),
        near=opaque(box.near),
        tilt=opaque(max(level.tilt for level in levels)),
        nested=len(levels) > 1,
    )
    size = words.nbytes + entries.nbytes + parts.records.nbytes + len(lattices) * WORDS * parts.records.itemsize
    return grids, _describe(levels, len(parts), size)


def _solid(parts: Primitives) -> np.ndarray | None:
    """Which primitives are met by their box alone: all but triangles. None if there are only triangles."""
    if parts.kinds == (record.TRIANGLE,):
        return None
    codes = np.ascontiguousarray(parts.records[:, record.KIND])
    codes = codes.view(np.uint32) if codes.dtype == np.float32 else codes.astype(np.uint32)
    return codes != record.TRIANGLE


def _outermost(
    subjects: Subjects, sides: np.ndarray, solid: np.ndarray | None, box: _Box, rule: Rule, least: float
) -> Level:
    n = len(sides)
    none = np.zeros((1, 3), np.int64)
    corner = np.full((1, 3), -2 * box.margin, sides.dtype)

    def make(cells: np.ndarray) -> Lattices:
        return Lattices.make(corner, box.size[None], cells, 0, none[:, 0], none)

    target = np.array([min(max(1.0, rule.density[0] * n), rule.max_cells)])
    everything = np.arange(n, dtype=np.uint32)
    extents = Extents.of(sides, solid)
    return fill(subjects, everything, np.zeros(n, np.uint32), make, box.size[None], extents, target, least)


def _inner(
    subjects: Subjects,
    sides: np.ndarray,
    solid: np.ndarray | None,
    box: _Box,
    levels: list[Level],
    density: float,
    rule: Rule,
    least: float,
) -> Level | None:
    """A grid in every cell of the last level that holds too many, noted there; None if no cell does."""
    outer = levels[-1]
    before = sum(len(level.lattices) for level in levels)
    step = outer.lattices.step.astype(np.float64)
    parent, _ = outer.lattices.where(outer.cell)
    many = (outer.count > rule.most_in_cell) & (step[parent].max(axis=1) >= 2 * least)
    chosen = np.flatnonzero(many)
    if len(chosen) == 0:
        return None
    parent, place = outer.lattices.where(outer.cell[chosen])
    size = step[parent]
    corner = (outer.lattices.corner[parent] + place * size).astype(sides.dtype)
    count = outer.count[chosen]
    grid = np.repeat(np.arange(len(chosen), dtype=np.uint32), count)
    prim = outer.list_of(chosen)
    within = np.minimum(sides[prim] * (box.size / size).astype(sides.dtype)[grid], 1)
    extents = Extents.of_each(within, None if solid is None else solid[prim], count)
    outermost = before - len(outer.lattices)

    def make(cells: np.ndarray) -> Lattices:
        return Lattices.make(corner, size, cells, outer.lattices.end, parent + outermost, place)

    target = np.clip(density * count, 1, rule.max_cells)
    level = fill(subjects, prim, grid, make, size, extents, target, least)
    levels[-1] = outer.without(many)
    return level


def _describe(levels: list[Level], primitives: int, size: int) -> dict[str, Any]:
    references = sum(len(level.prims) for level in levels)
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
        "sah_cost": walked + tested,
        "expected_cells": walked,
        "expected_primitives": tested,
        "cells": sum(len(level.clear) for level in levels),
        "resolution": tuple(int(k) for k in outermost.cells[0]),
        "longest_list": max(int(level.count.max(initial=0)) for level in levels),
    }


def _area(sides: np.ndarray) -> Any:
    """Half the surface of boxes (..., 3)."""
    x, y, z = np.moveaxis(np.asarray(sides, np.float64), -1, 0)
    return x * y + y * z + z * x
