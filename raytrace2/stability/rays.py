"""Rays by recipe: aimed at vertices, edges and anywhere, from inside and from outside of a closed mesh.

Directions are computed in float64 and then rounded to the precision of the mesh, so that each passes its target within
a rounding error, on either side.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from .meshes import Closed

#: Rays that are made and traced at a time.
BATCH = 1_000_000

#: A hit this much farther than the target lies behind the faces around it.
BEHIND = 1.01


@dataclass(frozen=True, eq=False)
class Aimed:
    """Rays ``o + t d``, (n, 3) each, in the mesh's precision; ``reach`` (n,): a right hit has no larger t (inf where
    any hit will do); ``near`` (n, k): the faces around the target, or None."""

    o: np.ndarray
    d: np.ndarray
    reach: np.ndarray
    near: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.o)

    def first(self, count: int) -> Aimed:
        """The first ``count`` of them."""
        return self[slice(count)]

    def __getitem__(self, which: slice | np.ndarray) -> Aimed:
        near = None if self.near is None else self.near[which]
        return Aimed(self.o[which], self.d[which], self.reach[which], near)


def batches(closed: Closed, target: str, side: str, total: int, seed: int) -> Iterator[Aimed]:
    """``total`` rays at ``target`` ("vertex", "edge" or "random") from ``side`` ("inside" or "outside")."""
    for start in range(0, total, BATCH):
        rng = np.random.default_rng([seed, start])
        count = min(BATCH, total - start)
        if side == "inside":
            yield from_inside(closed, target, count, rng)
        else:
            yield from_outside(closed, target, count, rng)


def from_inside(closed: Closed, target: str, count: int, rng: np.random.Generator) -> Aimed:
    """From anywhere in the ball of 0.3 radii about the centre: every one of these rays meets the mesh."""
    o = _unit(rng.normal(size=(count, 3))) * np.cbrt(rng.random((count, 1)))
    o = _rounded(closed.center + 0.3 * closed.radius * o, closed.dtype)
    if target == "random":
        d = _unit(rng.normal(size=(count, 3)))
        return Aimed(o, d.astype(closed.dtype), np.full(count, np.inf))
    at, near = _targets(closed, target, count, rng)
    return Aimed(o, _unit(at - o).astype(closed.dtype), np.full(count, np.inf), near)


def from_outside(closed: Closed, target: str, count: int, rng: np.random.Generator) -> Aimed:
    """From the sphere of 3 radii at vertices or points of edges all of whose faces turn towards the origin of the ray:
    whichever way it is rounded, it meets one of these faces first."""
    found: list[Aimed] = []
    normal, offset = closed.planes
    while sum(len(part) for part in found) < count:
        at, near = _targets(closed, target, 2 * count, rng)
        outward = _unit(rng.normal(size=at.shape))
        outward *= np.sign((outward * (at - closed.center)).sum(axis=1, keepdims=True))
        o = _rounded(closed.center + 3 * closed.radius * outward, closed.dtype)
        in_front = np.ones(len(o), bool)
        for column in near.T:
            # Far above what rounding can do: of those kept, every face turns to the ray exactly.
            margin = 1e-9 * closed.radius * np.abs(normal[column]).sum(axis=1)
            in_front &= (normal[column] * o).sum(axis=1) - offset[column] > margin
        o, at, near = o[in_front], at[in_front], near[in_front]
        d = (at - o).astype(np.float64)
        length = np.linalg.norm(d, axis=1)
        found.append(Aimed(o, (d / length[:, None]).astype(closed.dtype), length * BEHIND, near))
    o, d, reach, near = (np.concatenate([getattr(p, key) for p in found]) for key in ("o", "d", "reach", "near"))
    return Aimed(o, d, reach, near).first(count)


def _targets(closed: Closed, target: str, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Points to aim at, and the faces around each."""
    if target == "vertex":
        k = rng.integers(0, len(closed.vertices), count)
        return closed.vertices[k], closed.fans[k]
    edge = closed.edges[rng.integers(0, len(closed.edges), count)]
    # Not so near to the ends that other faces might be met.
    s = rng.uniform(0.05, 0.95, (count, 1))
    return closed.vertices[edge[:, 0]] * (1 - s) + closed.vertices[edge[:, 1]] * s, edge[:, 2:]


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def _rounded(o: np.ndarray, dtype: str) -> np.ndarray:
    """The numbers of ``dtype`` nearest to ``o``, as float64."""
    return o.astype(dtype).astype(np.float64)
