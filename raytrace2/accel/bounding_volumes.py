"""A flat list of bounding volumes over groups of primitives: the simplest thing better than testing everything."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

import drjit as dr
import numpy as np

from ..buffers import owned
from ..surfaces import record
from ..surfaces.geometry import Geometry
from ..surfaces.hit import Candidate
from ..surfaces.levels import Level
from ..surfaces.primitives import LocalRay, Primitives
from ..surfaces.structure import Structure
from ..surfaces.turns import Turns
from . import bounding_volumes_traversal as traversal
from .held import held
from .level_boxes_bvh import volume_levels
from .volume_groups import Groups, expected_tests, few_large, half_area, halved, in_runs, with_singles
from .volumes import VOLUMES
from .volumes.hulls import Hulls

#: Groups of fewer are not tried: volumes cost as much as what is in them.
_SMALLEST_GROUP = 4


@dataclass(frozen=True)
class BoundingVolumesConfig:
    """``volume``: the shape. ``group_size``: most primitives in a group; ``"surface"``, one group for each surface
    (mesh, sphere, nested structure ...); or ``"auto"``, groups of the size that costs least by the surface areas of
    their boxes.

    ``volume_cost`` and ``primitive_cost``: what a test of either costs, in any unit, for that choice.
    """

    volume: Literal["sphere", "box", "oriented_box"] = "box"
    group_size: int | Literal["auto", "surface"] = "auto"
    volume_cost: float = 1.0
    primitive_cost: float = 2.0

    def __post_init__(self) -> None:
        if self.volume not in VOLUMES:
            raise ValueError(f"volume must be one of {', '.join(VOLUMES)}, not {self.volume!r}")
        size = self.group_size
        if isinstance(size, str):
            if size not in ("auto", "surface"):
                raise ValueError(f"group_size must be a number, 'auto' or 'surface', not {size!r}")
        elif isinstance(size, bool) or not isinstance(size, int) or size < 1:
            raise ValueError(f"group_size must be a whole number from 1 on, not {size!r}")
        for name in ("volume_cost", "primitive_cost"):
            if not 0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name} must be positive, not {getattr(self, name)!r}")


class BoundingVolumes(Structure):
    """Every ray asks every volume whether it meets it, and tests the primitives of those that it does."""

    kind = "bounding_volumes"

    def __init__(self, geometry: Geometry, config: BoundingVolumesConfig | None = None) -> None:
        super().__init__(geometry)
        self.config = config or BoundingVolumesConfig()
        begin = time.perf_counter()
        parts = geometry.primitives()
        parts = None if parts is None else held(parts)
        self._device: traversal.DeviceVolumes | None = None
        empty = dict.fromkeys(("primitives", "references", "volumes", "largest_group", "bytes"), 0)
        self._statistics: dict[str, Any] = {"kind": self.kind, "volume": self.config.volume, **empty}
        self._statistics |= dict.fromkeys(("expected_volume_tests", "expected_primitive_tests", "sah_cost"), 0.0)
        if parts is not None and len(parts):
            self._build(parts)
        self._statistics["build_seconds"] = time.perf_counter() - begin

    def _build(self, parts: Primitives) -> None:
        groups = self._groups(parts)
        if len(groups) > traversal.MAX_VOLUMES:
            most = traversal.MAX_VOLUMES
            raise ValueError(f"there can be {most} bounding volumes, not {len(groups)}: raise group_size")
        parts = parts.reordered(groups.order)
        volume = VOLUMES[self.config.volume]
        words = volume.fit(Hulls.of(parts, groups.firsts), self.types)
        UInt = self.types.UInt
        self._device = traversal.DeviceVolumes(
            self.types,
            volume,
            owned(traversal.padded(words), self.types.Float),
            owned(traversal.ranges(groups.firsts), UInt),
            dr.opaque(UInt, len(groups)),
            parts.upload(),
        )
        self.turns = Turns(self.types, self.kind, traversal.most_turns(len(groups), len(parts)))
        sizes = np.diff(groups.firsts)
        everything = 2 * half_area(parts.lo.min(axis=0)[None], parts.hi.max(axis=0)[None])[0]
        share = np.minimum(volume.areas(words) / everything, 1) if everything > 0 else np.ones(len(groups))
        tests = float((sizes * share).sum())
        config = self.config
        self._statistics |= {
            "primitives": len(parts),
            "references": len(parts),
            "volumes": len(groups),
            "largest_group": int(sizes.max()),
            "bytes": int(words.nbytes + groups.firsts.size * 4 + parts.records.nbytes),
            "expected_volume_tests": float(len(groups)),
            "expected_primitive_tests": tests,
            "sah_cost": config.volume_cost * len(groups) + config.primitive_cost * tests,
        }

    def _groups(self, parts: Primitives) -> Groups:
        size = self.config.group_size
        if size == "surface":
            return in_runs(self._surfaces_of(parts))
        large = few_large(parts.lo, parts.hi)
        lo, hi = parts.lo[~large], parts.hi[~large]
        if size != "auto":
            return with_singles(halved(lo, hi, int(size))[-1], large)
        config = self.config
        found = halved(lo, hi, _SMALLEST_GROUP)
        # Relative to the box around the others, for rays go to where things are rather than to all of the floor.
        costs = [config.volume_cost * len(g) + config.primitive_cost * expected_tests(g, lo, hi) for g in found]
        return with_singles(found[int(np.argmin(costs))], large)

    def _surfaces_of(self, parts: Primitives) -> np.ndarray:
        """A number for each primitive that is the same within a surface; what leads inside is by itself."""
        words = parts.records[:, [record.ID, record.KIND]]
        whole = words.view(np.uint32) if words.dtype == np.float32 else words.astype(np.uint32)
        ids, codes = whole.astype(np.int64).T
        surface = np.searchsorted(np.array(self.geometry.first_ids), ids, side="right") - 1
        inside = (codes & 7) >= record.INSTANCE
        return np.where(inside, len(self.geometry.first_ids) + np.arange(len(ids)), surface)

    def traverse(self, ray: LocalRay, best: Candidate, root: Any, active: Any) -> Candidate:
        if self._device is None:
            return best
        return traversal.closest(self._device, ray, best, active, self.turns)

    def traverse_any(self, ray: LocalRay, root: Any, active: Any) -> Any:
        if self._device is None:
            return dr.full(self.types.Bool, False, dr.width(root))
        return traversal.anything(self._device, ray, root, active, self.turns)

    def own_levels(self, bounds: tuple[np.ndarray, np.ndarray]) -> Iterator[Level]:
        return iter(()) if self._device is None else volume_levels(bounds, self._device, self.config.volume)

    def statistics(self) -> dict[str, Any]:
        """Counts of volumes and primitives, bytes on the device, the seconds that the build took, how many volumes
        and primitives a random line that meets the box around everything is expected to test, and ``sah_cost``, what
        that costs."""
        return dict(self._statistics)
