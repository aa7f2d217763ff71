"""Binary trees by the rule of a name."""

from __future__ import annotations

from collections.abc import Callable

from ..surfaces.primitives import Primitives
from .binary_tree import BinaryTree
from .binned_sah import build_binned_sah
from .bvh_config import BvhConfig
from .median import build_median
from .middle import build_middle
from .morton import build_morton
from .ploc import build_ploc
from .spatial import build_spatial
from .sweep_sah import build_sweep

#: Most primitives in a leaf of a Morton tree before the surface areas decide which leaves to join: fewer and smaller
#: nodes for twice the speed, at a few per cent of their quality.
_MORTON_LEAF = 2

BUILDERS: dict[str, Callable[[Primitives, BvhConfig], BinaryTree]] = {
    "median": lambda parts, _: build_median(parts.lo, parts.hi),
    "middle": lambda parts, _: build_middle(parts.lo, parts.hi),
    "sah": lambda parts, _: build_binned_sah(parts.lo, parts.hi),
    "sweep": lambda parts, _: build_sweep(parts.lo, parts.hi),
    "morton": lambda parts, config: build_morton(parts.lo, parts.hi, min(_MORTON_LEAF, config.max_leaf_size)),
    "ploc": lambda parts, _: build_ploc(parts.lo, parts.hi),
    "spatial": lambda parts, config: build_spatial(parts, config.reference_budget),
}
