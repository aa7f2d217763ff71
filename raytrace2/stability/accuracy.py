"""How far t and normals are from what the numbers given really mean, and rays that end before they begin."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ..surfaces.quadrics import Sphere
from ..surfaces.surface import Surface
from .meshes import Closed, icosphere
from .rays import Aimed, batches
from .sweep import Counts, Record, digest_of, load, traced
from .tracers import Answer, Loaded, Tracer

#: More digits than float64 where the machine has them.
Long = np.longdouble


def mesh_t(tracers: Sequence[Tracer], dtype: str, counts: Counts) -> dict[str, Record]:
    """The worst relative error of t of random rays in the icosphere, given the face that was hit."""
    closed = icosphere(counts.levels, dtype)
    total = counts.other
    source = batches(closed, "random", "inside", total, counts.seed)
    judge = lambda aimed, answer: worst_on_planes(closed, aimed, answer)  # noqa: E731
    return traced(load(tracers, [closed.mesh]), source, total, counts.longest, judge, max)


def worst_on_planes(closed: Closed, aimed: Aimed, answer: Answer) -> float:
    """The worst relative error of t, as if the ray met the plane of the face that it is said to hit."""
    hit = np.isfinite(answer.t)
    a, b, c = (closed.vertices.astype(Long)[closed.faces[answer.prim[hit], k]] for k in range(3))
    o, d = aimed.o[hit].astype(Long), aimed.d[hit].astype(Long)
    n = np.cross(b - a, c - a)
    t = (n * (a - o)).sum(axis=1) / (n * d).sum(axis=1)
    return float(np.abs(answer.t[hit] / t - 1).max())


def ground(tracers: Sequence[Tracer], dtype: str, counts: Counts) -> dict[str, Record]:
    """The worst relative error of t on a sphere of radius 1e6, seen from 1 above it, at 6 degrees or more from the
    horizon. A miss counts as 1."""
    d = _unit(np.random.default_rng(counts.seed).normal(size=(counts.other, 3)))
    d[:, 2] = -np.abs(d[:, 2])
    d = d[d[:, 2] < -0.1].astype(dtype)
    o = np.repeat(np.array([[0.0, 0.0, 1.0]]), len(d), axis=0)
    sphere = Sphere.at((0, 0, -1e6), 1e6)

    def worst(scene: Loaded) -> tuple[float, Answer]:
        answer = scene.closest(o, d)
        exact = _sphere_t(o, d, sphere)
        return float(np.abs(np.where(np.isfinite(answer.t), answer.t, 0) / exact - 1).max()), answer

    return _each(tracers, [sphere], worst, len(d))


def far_sphere(tracers: Sequence[Tracer], dtype: str, counts: Counts) -> dict[str, Record]:
    """The worst error, in degrees, of the normal on a sphere a million of its radii away. A miss counts as 180."""
    center = np.array([6e5, 0.0, 8e5])
    rng = np.random.default_rng(counts.seed)
    disk = rng.normal(size=(counts.other, 3))
    disk -= np.outer(disk @ center, center) / (center @ center)
    disk = _unit(disk) * 0.9 * np.sqrt(rng.random((counts.other, 1)))
    d = _unit(center + disk).astype(dtype)
    o = np.zeros_like(d, dtype=np.float64)
    sphere = Sphere.at(center, 1)

    # Rounding a direction moves it by a few percent of the radius here: only what surely hits is asked for.
    closest = np.linalg.norm(np.cross(d.astype(Long), center.astype(Long)), axis=1) / np.linalg.norm(d, axis=1)
    o, d = o[closest < 0.95], d[closest < 0.95]

    def worst(scene: Loaded) -> tuple[float, Answer]:
        t, n = scene.normals(o, d)
        at = d.astype(Long) * _sphere_t(o, d, sphere)[:, None]
        exact = _unit(at - center.astype(Long))
        found = _unit(np.where(np.isfinite(t)[:, None], n, -exact).astype(Long))
        angle = 2 * np.arctan2(np.linalg.norm(found - exact, axis=1), np.linalg.norm(found + exact, axis=1))
        answer = scene.closest(o, d)
        return float(np.degrees(angle.max())), answer

    return _each(tracers, [sphere], worst, len(d))


def ended(tracers: Sequence[Tracer], dtype: str, counts: Counts) -> dict[str, Record]:
    """Of 1000 rays that end before they begin (tmax < 0), how many are occluded though they meet nothing."""
    closed = icosphere(counts.levels, dtype)
    rays = next(batches(closed, "random", "inside", 1000, counts.seed))
    tmax = np.full(len(rays), -1.0)

    def disagreeing(scene: Loaded) -> tuple[float, Answer]:
        answer = scene.closest(rays.o, rays.d, tmax)
        return int((scene.occluded(rays.o, rays.d, tmax) != np.isfinite(answer.t)).sum()), answer

    return _each(tracers, [closed.mesh], disagreeing, len(rays))


def _each(
    tracers: Sequence[Tracer], surfaces: Sequence[Surface], measure: Callable[[Loaded], tuple[float, Answer]], rays: int
) -> dict[str, Record]:
    records = {}
    for name, scene in load(tracers, surfaces).items():
        measure(scene)
        value, answer = measure(scene)
        digest = digest_of(answer)
        records[name] = {"value": value, "rays": rays, "rate": rays / answer.seconds, "few": digest, "all": digest}
    return records


def _sphere_t(o: np.ndarray, d: np.ndarray, sphere: Sphere) -> np.ndarray:
    """The nearer root, in long numbers and without a difference of like ones where it matters."""
    o, d = o.astype(Long), d.astype(Long)
    center, radius = sphere.center.astype(Long), Long(sphere.radius)
    arm = center - o
    length = (d * d).sum(axis=1)
    along = (arm * d).sum(axis=1)
    aside = np.cross(arm, d)
    root = np.sqrt(np.maximum(radius * radius * length - (aside * aside).sum(axis=1), 0))
    # |arm|^2 - R^2 as a product.
    reach = np.sqrt((arm * arm).sum(axis=1))
    return (reach - radius) * (reach + radius) / (along + root)


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v, axis=1, keepdims=True)
