"""Uniform grids."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from ..surfaces.geometry import Geometry
from ..surfaces.hit import Candidate
from ..surfaces.levels import Level
from ..surfaces.primitives import LocalRay
from ..surfaces.structure import Structure
from ..surfaces.turns import Turns
from . import grid_walk
from .grid_build import Rule, build_grids
from .held import held
from .level_boxes_grid import grid_levels

#: Cells of one grid are counted in floating point: all numbers up to here are exact in either precision.
MOST_CELLS = 1 << 24


@dataclass(frozen=True)
class GridConfig:
    """``density``: cells a primitive; ``max_cells``: the most there may be in all, four bytes each."""

    density: float = 4.0
    max_cells: int = MOST_CELLS

    def __post_init__(self) -> None:
        check_grid_options(self.density, self.max_cells)


def check_grid_options(density: float, max_cells: int) -> None:
    """``ValueError`` unless the options are ones that grids can have."""
    if not (density > 0 and np.isfinite(density)):
        raise ValueError(f"density must be positive and finite, not {density}")
    if not 1 <= max_cells <= MOST_CELLS:
        raise ValueError(f"max_cells must lie in 1 to {MOST_CELLS}, not {max_cells}")


class GridStructure(Structure):
    """Grids over the primitives of a geometry, built by a :class:`.Rule`."""

    def __init__(self, geometry: Geometry, rule: Rule) -> None:
        super().__init__(geometry)
        begin = time.perf_counter()
        self._grids: grid_walk.DeviceGrids | None = None
        parts = geometry.primitives()
        parts = None if parts is None else held(parts)
        keys = ("primitives", "references", "duplication", "nodes", "leaves", "depth", "bytes", "sah_cost")
        found: dict[str, Any] = dict.fromkeys(keys, 0)
        if parts is not None and len(parts):
            self._grids, found = build_grids(parts, rule)
            self.turns = Turns(self.types, self.kind, grid_walk.most_turns(self._grids))
        seconds = time.perf_counter() - begin
        self._statistics = {"kind": self.kind, **found, "build_seconds": seconds}

    def traverse(self, ray: LocalRay, best: Candidate, root: Any, active: Any) -> Candidate:
        if self._grids is None:
            return best
        return grid_walk.closest(self._grids, ray, best, active, self.turns)

    def traverse_any(self, ray: LocalRay, root: Any, active: Any) -> Any:
        if self._grids is None:
            return dr.full(self.types.Bool, False, dr.width(root))
        return grid_walk.anything(self._grids, ray, dr.width((root, active)), active, self.turns)

    def own_levels(self, bounds: tuple[np.ndarray, np.ndarray]) -> Iterator[Level]:
        return iter(()) if self._grids is None else grid_levels(bounds, self._grids)

    def statistics(self) -> dict[str, Any]:
        """Counts of primitives, references to them from cells, grids (``nodes``), cells, cells with a list (``leaves``)
        and levels (``depth``), bytes on the device, the seconds that the build took, and what a random ray through all
        of the outermost grid would meet if it stopped nowhere and crossed empty space cell by cell:
        ``expected_cells``, ``expected_primitives`` and their sum, ``sah_cost``."""
        return dict(self._statistics)


class Grid(GridStructure):
    """One uniform grid, in whose cells primitives are listed.

    Cells are as near to cubes as whole numbers of them allow; a primitive is listed in every cell that it may meet.
    """

    kind = "grid"

    def __init__(self, geometry: Geometry, config: GridConfig | None = None) -> None:
        self.config = config or GridConfig()
        super().__init__(geometry, Rule(1, (self.config.density,), self.config.max_cells))
