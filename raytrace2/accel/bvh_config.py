"""Settings of bounding volume hierarchies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from . import wide_node
from .volumes import VOLUMES

Builder = Literal["median", "middle", "sah", "sweep", "morton", "ploc", "spatial"]


@dataclass(frozen=True)
class BvhConfig:
    """How a hierarchy is built and what it is made of.

    ``builder``: ``median`` (equal counts, the axes in turn), ``middle`` (equal space), ``sah`` (surface areas, by bins;
    with boxes, parts that hardly tell their triangles apart are built as ``spatial`` does), ``sweep`` (surface areas,
    every plane), ``morton`` (prefixes of a space-filling curve: the fastest), ``ploc`` (clustering from the bottom up)
    or ``spatial`` (surface areas, with large triangles cut). ``width``: most children of a node, 2, 4 or 8.
    ``volume``: the shape around each child. ``max_leaf_size``: most primitives in a leaf.
    ``node_cost`` and ``primitive_cost``: what a visit and a test cost, in any unit, for the choice between splitting
    and stopping. ``reference_budget``, of ``spatial`` alone: at most this many parts beyond the first, per primitive.
    """

    builder: Builder = "sah"
    width: Literal[2, 4, 8] = 4
    volume: Literal["box", "sphere", "oriented_box"] = "box"
    max_leaf_size: int = 4
    node_cost: float = 1.0
    primitive_cost: float = 1.0
    reference_budget: float = 0.5

    def __post_init__(self) -> None:
        if self.builder not in get_args(Builder):
            raise ValueError(f"builder must be one of {', '.join(get_args(Builder))}, not {self.builder!r}")
        if isinstance(self.width, bool) or self.width not in wide_node.LAYOUTS:
            raise ValueError(f"width must be 2, 4 or 8, not {self.width!r}")
        if self.volume not in VOLUMES:
            raise ValueError(f"volume must be one of {', '.join(VOLUMES)}, not {self.volume!r}")
        size = self.max_leaf_size
        if isinstance(size, bool) or not isinstance(size, int) or not 1 <= size <= wide_node.MAX_LEAF_SIZE:
            raise ValueError(f"max_leaf_size must be a whole number in 1 to {wide_node.MAX_LEAF_SIZE}, not {size!r}")
        for name in ("node_cost", "primitive_cost"):
            if not 0 < _number(name, getattr(self, name)) < float("inf"):
                raise ValueError(f"{name} must be positive, not {getattr(self, name)!r}")
        if not 0 <= _number("reference_budget", self.reference_budget) <= 10:
            raise ValueError(f"reference_budget must lie in 0 to 10, not {self.reference_budget!r}")


def _number(name: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{name} must be a number, not {value!r}")
    return float(value)
