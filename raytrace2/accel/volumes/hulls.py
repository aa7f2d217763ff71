"""Groups of primitives as groups of points with radii, whose convex hulls bounding volumes must hold."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from ...surfaces import record
from ...surfaces.primitives import Primitives

# The cube's and the octahedron's corners: where a sphere is sampled to fit volumes to it.
_ON_SPHERE = np.concatenate([np.array(list(itertools.product((-1.0, 1.0), repeat=3))) / 3**0.5, np.eye(3), -np.eye(3)])


@dataclass(frozen=True, eq=False)
class Hulls:
    """``points`` (n, 3) float64 with ``radii`` (n,) or None for zero, those of group k from ``starts[k]`` up to the
    next.

    Every group has a point. Triangles give their vertices, spheres their centres, others the corners of their boxes.
    """

    points: np.ndarray
    radii: np.ndarray | None
    starts: np.ndarray

    @staticmethod
    def of(parts: Primitives, firsts: np.ndarray) -> Hulls:
        """The hulls of primitives ``firsts[k]`` up to ``firsts[k + 1]``, for each k."""
        kinds = _kinds(parts)
        counts = np.select([kinds == record.TRIANGLE, kinds == record.SPHERE], [3, 1], 8)
        begins = np.concatenate([[0], np.cumsum(counts)])
        points = np.empty((begins[-1], 3))
        words = parts.records
        triangle, sphere = (np.flatnonzero(kinds == k) for k in (record.TRIANGLE, record.SPHERE))
        for k in range(3):
            points[begins[triangle] + k] = words[triangle, 3 * k : 3 * k + 3]
        points[begins[sphere]] = words[sphere, :3]
        other = np.flatnonzero(counts == 8)
        for k, corner in enumerate(itertools.product((False, True), repeat=3)):
            points[begins[other] + k] = np.where(corner, parts.hi[other], parts.lo[other])
        radii = None
        if len(sphere):
            radii = np.zeros(len(points))
            # A sphere's box is wider than the sphere by what its ray test rounds, and so must be its radius.
            half = (parts.hi[sphere].astype(np.float64) - parts.lo[sphere]).max(axis=1) / 2
            radii[begins[sphere]] = np.maximum(half, words[sphere, 3])
        return Hulls(points, radii, begins[firsts[:-1]])

    def __len__(self) -> int:
        return len(self.starts)

    @property
    def counts(self) -> np.ndarray:
        """How many points each group has."""
        return np.diff(self.starts, append=len(self.points))

    @property
    def group(self) -> np.ndarray:
        """The group of each point."""
        return np.repeat(np.arange(len(self)), self.counts)

    def samples(self) -> Hulls:
        """Points without radii that stand for the same hulls, to within an eighth of the radii."""
        if self.radii is None:
            return self
        round_ = self.radii > 0
        counts = np.where(round_, len(_ON_SPHERE), 1)
        begins = np.concatenate([[0], np.cumsum(counts)])
        points = np.empty((begins[-1], 3))
        points[begins[:-1][~round_]] = self.points[~round_]
        at = begins[:-1][round_]
        for k, direction in enumerate(_ON_SPHERE):
            points[at + k] = self.points[round_] + self.radii[round_, None] * direction
        return Hulls(points, None, begins[self.starts])

    def some(self, groups: np.ndarray) -> Hulls:
        """Only these ``groups``, in their order, which must rise."""
        keep = np.zeros(len(self), dtype=bool)
        keep[groups] = True
        counts = self.counts
        which = np.repeat(keep, counts)
        starts = np.concatenate([[0], np.cumsum(counts[keep])[:-1]])
        return Hulls(self.points[which], None if self.radii is None else self.radii[which], starts)

    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """Opposite corners (groups, 3) of the axis-aligned box around each group."""
        lo, hi = (np.empty((len(self), 3)) for _ in range(2))
        for k in range(3):
            column = np.ascontiguousarray(self.points[:, k])
            less, more = (column, column) if self.radii is None else (column - self.radii, column + self.radii)
            lo[:, k] = np.minimum.reduceat(less, self.starts)
            hi[:, k] = np.maximum.reduceat(more, self.starts)
        return lo, hi

    def farthest(self, centers: np.ndarray) -> np.ndarray:
        """How far each group reaches from ``centers`` (groups, 3)."""
        distance = np.sqrt(self.squared_distances(centers))
        return np.maximum.reduceat(distance if self.radii is None else distance + self.radii, self.starts)

    def squared_distances(self, centers: np.ndarray) -> np.ndarray:
        """Of each point to its group's center."""
        offset = self.points - np.repeat(centers, self.counts, axis=0)
        return np.einsum("ij,ij->i", offset, offset)

    def first_with(self, values: np.ndarray, wanted: np.ndarray) -> np.ndarray:
        """The first point of each group whose value is the ``wanted`` one of the group, which must be there."""
        index = np.where(values == np.repeat(wanted, self.counts), np.arange(len(values)), len(values))
        return np.minimum.reduceat(index, self.starts)


def _kinds(parts: Primitives) -> np.ndarray:
    words = parts.records[:, record.KIND]
    codes = words.view(np.uint32) if words.dtype == np.float32 else words.astype(np.uint32)
    return codes & 7
