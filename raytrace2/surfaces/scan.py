"""Every ray against every primitive: slow, and by its plainness the oracle for everything faster.

A turn of the loop tests one primitive and goes on to the next, so a ray takes as many turns as there are primitives.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import drjit as dr

from .hit import Candidate
from .primitives import LocalRay
from .structure import Structure
from .turns import Turns, after_turn, goes_on

if TYPE_CHECKING:
    from .geometry import Geometry


class Scan(Structure):
    """A list of primitives, each tested against every ray, in the order of their numbers."""

    kind = "brute_force"

    def __init__(self, geometry: Geometry) -> None:
        super().__init__(geometry)
        parts = geometry.primitives()
        self._count = len(parts) if parts else 0
        self._opaque_count = dr.opaque(self.types.UInt, self._count)
        self._bytes = parts.records.nbytes if parts else 0
        self._device = parts.upload() if parts else None
        self.turns = Turns(self.types, self.kind, self._count)

    def traverse(self, ray: LocalRay, best: Candidate, root: Any, active: Any) -> Candidate:
        if self._device is None:
            return best
        device = self._device
        ready = device.prepare(ray)
        end, width = self._end(best.t, active), dr.width(best.t)
        i, end, left, best = dr.while_loop(
            (dr.zeros(self.types.UInt, width), end, self.turns.left(width, best.counts is not None), best),
            lambda i, end, left, best: goes_on(i < end, left),
            lambda i, end, left, best: (i + 1, end, after_turn(left), device.intersect_one(i, ready, best)),
            labels=("i", "end", "left", "best"),
        )
        self.turns.note(i < end, left)
        return best

    def traverse_any(self, ray: LocalRay, root: Any, active: Any) -> Any:
        width = dr.width(root)
        blocked = dr.full(self.types.Bool, False, width)
        if self._device is None:
            return blocked
        device = self._device
        ready = device.prepare(ray)
        i, end, left, blocked = dr.while_loop(
            (dr.zeros(self.types.UInt, width), self._end(root, active), self.turns.left(width, False), blocked),
            lambda i, end, left, blocked: goes_on((i < end) & ~blocked, left),
            lambda i, end, left, blocked: (i + 1, end, after_turn(left), device.occludes_one(i, ready)),
            labels=("i", "end", "left", "blocked"),
        )
        self.turns.note((i < end) & ~blocked, left)
        return blocked

    def _end(self, like: Any, active: Any) -> Any:
        return dr.select(active, self._opaque_count, 0) + dr.zeros(self.types.UInt, dr.width(like))

    def statistics(self) -> dict[str, Any]:
        """How many primitives are tested per ray, and the bytes that they take."""
        return {"kind": self.kind, "primitives": self._count, "bytes": self._bytes, "build_seconds": 0.0}
