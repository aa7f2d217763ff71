"""Grids in the cells of grids."""

from __future__ import annotations

from dataclasses import dataclass

from ..surfaces.geometry import Geometry
from .grid import MOST_CELLS, GridStructure, check_grid_options
from .grid_build import Rule


@dataclass(frozen=True)
class HierarchicalGridConfig:
    """``levels``: 2 or 3; ``density``: cells a primitive in the innermost grids; ``outer_density``: in all others;
    ``max_in_cell``: a cell with more primitives is filled with a grid; ``min_cell``: unless its cells would be
    smaller than this, in units of the longest side of all; ``max_cells``: the most in one grid."""

    levels: int = 2
    density: float = 1.0
    outer_density: float = 0.02
    max_in_cell: int = 8
    min_cell: float = 0.0
    max_cells: int = MOST_CELLS

    def __post_init__(self) -> None:
        check_grid_options(self.density, self.max_cells)
        check_grid_options(self.outer_density, self.max_cells)
        if self.levels not in (2, 3):
            raise ValueError(f"levels must be 2 or 3, not {self.levels}")
        if self.max_in_cell < 1:
            raise ValueError(f"max_in_cell must be at least 1, not {self.max_in_cell}")
        if not 0 <= self.min_cell < 1:
            raise ValueError(f"min_cell must lie in 0 to 1, not {self.min_cell}")


class HierarchicalGrid(GridStructure):
    """A coarse grid, with a grid of its own in every cell that holds many primitives, two or three levels deep.

    After Jevans and Wyvill, "Adaptive voxel subdivision for ray tracing" (Graphics Interface 1989).
    """

    kind = "hierarchical_grid"

    def __init__(self, geometry: Geometry, config: HierarchicalGridConfig | None = None) -> None:
        self.config = config or HierarchicalGridConfig()
        c = self.config
        density = (*[c.outer_density] * (c.levels - 1), c.density)
        super().__init__(geometry, Rule(c.levels, density, c.max_cells, c.max_in_cell, c.min_cell))
