"""What lies of primitives in the cells of a BSP tree: convex polygons, cut by planes at any tilt."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..surfaces.primitives import Primitives
from .kdtree_clip import triangle_corners

#: Most corners of a polygon where all are triangles' parts. One that a cut would give more is left uncut: that lists it
#: in more leaves than need be, never in fewer.
CORNERS = 6
#: As many where some primitives are no triangles: those have the corners of their boxes, which are never cut.
BOX_CORNERS = 8


@dataclass(frozen=True, eq=False)
class Polygons:
    """``corner`` (n, CORNERS or BOX_CORNERS, 4) in float64 (the fourth number means nothing), of which ``count`` (n,)
    count: the others repeat one of them. ``is_flat`` (n,) is false for the corners of boxes."""

    corner: np.ndarray
    count: np.ndarray
    is_flat: np.ndarray

    @staticmethod
    def of(parts: Primitives) -> Polygons:
        """The triangles as they are, and the corners of the boxes of everything else."""
        triangles, is_triangle = triangle_corners(parts)
        slots = CORNERS if is_triangle.all() else BOX_CORNERS
        corner = np.zeros((len(parts), slots, 4))
        corner[is_triangle, :3, :3] = triangles[is_triangle]
        corner[is_triangle, 3:, :3] = triangles[is_triangle, :1]
        boxes = np.flatnonzero(~is_triangle)
        upper = (np.arange(slots)[:, None] >> np.arange(3)) & 1 == 1
        corner[boxes, :, :3] = np.where(upper, parts.hi[boxes, None], parts.lo[boxes, None])
        return Polygons(corner, np.where(is_triangle, 3, slots).astype(np.int8), is_triangle)

    def take(self, which: np.ndarray) -> Polygons:
        """Some of the polygons."""
        return Polygons(self.corner[which], self.count[which], self.is_flat[which])

    def heights(self, normal: np.ndarray, point: np.ndarray) -> np.ndarray:
        """How far each corner (n, slots) lies above the plane through ``point`` (n, 3) across ``normal`` (n, 3)."""
        x, y, z = ((self.corner[:, :, k] - point[:, None, k]) * normal[:, None, k] for k in range(3))
        return x + y + z

    def above(self, height: np.ndarray) -> Polygons:
        """The parts where ``height`` (n, slots) at the corners is not negative (Sutherland and Hodgman 1974)."""
        n, slots = height.shape
        rows = np.arange(n)
        out = np.zeros((n, 2 * slots, 4))
        length = np.zeros(n, np.int64)
        for k in range(slots):
            next_ = np.where(k + 1 == self.count, 0, min(k + 1, slots - 1))
            real = k < self.count
            p, q, hp, hq = self.corner[:, k], self.corner[rows, next_], height[:, k], height[rows, next_]
            keep = real & (hp >= 0)
            out[rows[keep], length[keep]] = p[keep]
            length += keep
            cut = real & ((hp < 0) != (hq < 0))
            part = (hp[cut] / (hp[cut] - hq[cut]))[:, None]
            out[rows[cut], length[cut]] = p[cut] + part * (q[cut] - p[cut])
            length += cut
        fits = self.is_flat & (length <= slots) & (length > 0)
        slot = np.minimum(np.arange(slots), np.maximum(length, 1)[:, None] - 1)
        corner = np.where(fits[:, None, None], np.take_along_axis(out, slot[:, :, None], axis=1), self.corner)
        return Polygons(corner, np.where(fits, length, self.count).astype(np.int8), self.is_flat)
