"""Rays that slip through closed meshes, at vertices, edges and anywhere."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from . import exact
from .meshes import Closed, icosphere, spiky
from .rays import Aimed, batches
from .sweep import Counts, Record, load, traced
from .tracers import Answer, Tracer

#: Misses from inside of which exact arithmetic is asked over the whole mesh, in each batch.
_SAMPLE = 16


#: Who traces every ray in float32, however long it takes.
WHOLE = ("bvh", "Embree default", "Embree robust")


def leaks(closed: Closed, aimed: Aimed, answer: Answer) -> int:
    """How many rays miss what they meet in exact arithmetic: the faces around the target, or the mesh from inside."""
    missed = ~(answer.t <= aimed.reach) | ~np.isfinite(answer.t)
    if aimed.near is not None:
        # A face seen edge-on may be met farther along the ray than its corner lies.
        missed &= ~(np.isfinite(answer.t)[:, None] & (aimed.near == answer.prim[:, None])).any(axis=1)
    suspects = np.flatnonzero(missed)
    if len(suspects) == 0:
        return 0
    rays = aimed[suspects]
    if np.isfinite(rays.reach).all():
        assert rays.near is not None
        return int(exact.really_meets(closed.vertices, closed.faces[rays.near], rays.o, rays.d).sum())
    # From inside of a closed mesh there is no way out: a proof for all, put to the test on some.
    assert ball_is_inside(closed)
    for k in range(min(_SAMPLE, len(rays))):
        assert exact.meets_mesh(closed.vertices, closed.faces, rays.o[k], rays.d[k])
    return len(suspects)


def ball_is_inside(closed: Closed) -> bool:
    """Whether the ball that inside rays start from is surely within the mesh: no face comes as near to its centre."""
    corners = closed.vertices[closed.faces] - np.array(closed.center)
    # Along the direction of one corner every point of the face reaches at least as far as the least of the three.
    along = corners[:, :1] / np.linalg.norm(corners[:, :1], axis=2, keepdims=True)
    nearest = float((corners * along).sum(axis=2).min())
    rounding = 4 * float(np.finfo(closed.dtype).eps) * float(np.abs(closed.vertices).max())
    return nearest > 0.3 * closed.radius + rounding


def vertices_outside(tracers: Sequence[Tracer], dtype: str, counts: Counts) -> dict[str, Record]:
    """Rays at vertices of the icosphere, from outside."""
    return _count(tracers, icosphere(counts.levels, dtype), "vertex", "outside", counts.aimed, counts)


def vertices_inside(tracers: Sequence[Tracer], dtype: str, counts: Counts) -> dict[str, Record]:
    """Rays at vertices of the spiky mesh, from inside."""
    return _count(tracers, spiky(counts.levels, dtype), "vertex", "inside", counts.aimed, counts)


def edges_inside(tracers: Sequence[Tracer], dtype: str, counts: Counts) -> dict[str, Record]:
    """Rays at edges of the spiky mesh, from inside."""
    return _count(tracers, spiky(counts.levels, dtype), "edge", "inside", counts.aimed, counts)


def edges_outside(tracers: Sequence[Tracer], dtype: str, counts: Counts) -> dict[str, Record]:
    """Rays at edges of the icosphere, from outside."""
    return _count(tracers, icosphere(counts.levels, dtype), "edge", "outside", counts.aimed, counts)


def translated(tracers: Sequence[Tracer], dtype: str, counts: Counts) -> dict[str, Record]:
    """Random rays in the icosphere, a million of its radii from the origin."""
    closed = icosphere(counts.levels, dtype).placed(1, 1e6)
    return _count(tracers, closed, "random", "inside", counts.random, counts)


def _count(
    tracers: Sequence[Tracer], closed: Closed, target: str, side: str, total: int, counts: Counts
) -> dict[str, Record]:
    source = batches(closed, target, side, total, counts.seed)
    scenes = load(tracers, [closed.mesh])
    whole = WHOLE if closed.dtype == "float32" else ()
    return traced(
        scenes, source, total, counts.longest, lambda aimed, answer: leaks(closed, aimed, answer), whole=whole
    )
