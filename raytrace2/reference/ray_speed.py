"""Rays per second of our structures beside Mitsuba and Embree: the same rays, in the same process, in turn."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from ..accel.build import build
from ..rays.ray import Ray
from ..surfaces.mesh import TriangleMesh
from ..surfaces.primitives import Intersection
from ..surfaces.structure import Structure
from ..types import types
from .mitsuba_scene import mitsuba_variant

KINDS = ("primary", "bounce", "shadow")


@dataclass(frozen=True)
class RaySpeed:
    """One row of the benchmark: ``ours`` and Mitsuba's rates in million rays per second, Mitsuba's the better of
    ``coherent``
    True and False."""

    rays: str
    structure: str
    count: int
    ours: float
    mitsuba: float
    coherent: bool

    @property
    def ratio(self) -> float:
        """Our rate over Mitsuba's."""
        return self.ours / self.mitsuba


def benchmark_rays(structure: Structure, side: int = 1024, seed: int = 0) -> dict[str, Ray]:
    """``side``^2 primary rays that frame everything, and the :func:`secondary_rays` from where they hit."""
    lo, hi = structure.bounds()
    center, radius = (lo + hi) / 2.0, float(np.linalg.norm(hi - lo)) / 2
    view = np.array([-0.3, -0.25, -1.0]) / np.linalg.norm([0.3, 0.25, 1.0])
    right = np.cross(view, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, view)
    eye = center - 3 * radius * view
    y, x = np.mgrid[0:side, 0:side]
    half = np.tan(np.arcsin(1 / 3))
    u, v = ((x.ravel() + 0.5) / side * 2 - 1) * half, ((y.ravel() + 0.5) / side * 2 - 1) * half
    d = view + u[:, None] * right + v[:, None] * up
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    primary = Ray(np.repeat(eye[None], side * side, axis=0), d)
    return {"primary": primary, **secondary_rays(structure, primary, seed)}


def secondary_rays(structure: Structure, primary: Ray, seed: int = 0, up: int = 1) -> dict[str, Ray]:
    """Cosine-distributed bounces from where ``primary`` meets the structure, and shadow rays from there to points on a
    square above everything along axis ``up``, of its size. Where nothing is met, one ray of each, far away."""
    lo, hi = structure.bounds()
    center, radius = (lo + hi) / 2.0, float(np.linalg.norm(hi - lo)) / 2
    d = np.array(primary.d).T
    si = structure.interact(primary, structure.intersect(primary))
    rng = np.random.default_rng(seed)
    hit = np.flatnonzero(np.array(si.valid))
    if len(hit) == 0:
        away = Ray(center[None] + 3 * radius, np.ones((1, 3)))
        return {"bounce": away, "shadow": away}
    p, n, error = np.array(si.p).T[hit], np.array(si.n).T[hit], np.array(si.p_error)[hit]
    n = np.where((n * d[hit]).sum(axis=1, keepdims=True) > 0, -n, n)
    # Well off the surface for either renderer, so that what is timed is the way out.
    o = p + n * np.maximum(error * 8, 1e-4 * radius)[:, None]
    sphere = rng.normal(size=n.shape)
    bounce = n + 0.9999 * sphere / np.linalg.norm(sphere, axis=1, keepdims=True)
    bounce /= np.linalg.norm(bounce, axis=1, keepdims=True)
    above = np.eye(3)[up]
    light = center + radius * (1 + above)
    light = light + radius * rng.uniform(-0.5, 0.5, size=n.shape) * (1 - above)
    to_light = light - o
    distance = np.linalg.norm(to_light, axis=1)
    return {"bounce": Ray(o, bounce), "shadow": Ray(o, to_light / distance[:, None], 0.0, distance)}


def ray_speed(
    mesh: TriangleMesh,
    structures: Sequence[str] = ("bvh",),
    *,
    side: int = 1024,
    repeat: int = 15,
    intersection: Intersection = "watertight",
) -> list[RaySpeed]:
    """Measures every structure of ``structures`` (as ``rt.accel.build`` names them, with ``intersection``) on the
    three kinds of rays.

    Closest hits are ``intersect`` against ``scene.ray_intersect_preliminary``, shadow rays ``occluded`` against
    ``ray_test``. Each rate is the best of ``repeat`` runs; ours and Mitsuba's alternate, so that both meet the same
    disturbances.
    """
    built = {name: build(mesh, name, intersection=intersection) for name in structures}
    rays = benchmark_rays(next(iter(built.values())), side)
    rows = []
    with mitsuba_variant("llvm_ad_rgb") as mi:
        scene = mitsuba_meshes(mi, [mesh])
        for kind, ray in rays.items():
            dr.eval(ray)
            tasks: dict[Any, Callable[[], Any]] = dict(mitsuba_tasks(mi, scene, ray, kind == "shadow"))
            tasks |= {name: our_task(structure, ray, kind == "shadow") for name, structure in built.items()}
            best = best_times(tasks, repeat)
            coherent = best[True] <= best[False]
            for name in structures:
                rate = len(ray) / 1e6
                rows.append(RaySpeed(kind, name, len(ray), rate / best[name], rate / best[coherent], coherent))
    return rows


def best_times(tasks: dict[Any, Callable[[], Any]], repeat: int, longest: float = np.inf) -> dict[Any, float]:
    """The seconds of each task's best run of ``repeat``, all in turn; fewer runs, but one, when ``longest`` seconds are
    over."""
    best = dict.fromkeys(tasks, np.inf)
    end = np.inf
    for turn in range(repeat + 1):
        for key, task in tasks.items():
            begin = time.perf_counter()
            dr.eval(task())
            dr.sync_thread()
            # The first run compiles.
            if turn:
                best[key] = min(best[key], time.perf_counter() - begin)
        if turn == 0:
            end = time.perf_counter() + longest
        elif time.perf_counter() > end:
            break
    return best


def our_task(structure: Structure, ray: Ray, shadow: bool) -> Callable[[], Any]:
    """What is timed of ours: everything that a query returns of geometry, or occlusion alone."""

    def task() -> Any:
        if shadow:
            return structure.occluded(ray)
        hit = structure.intersect(ray)
        return hit.t, hit.prim, hit.uv

    return task


def mitsuba_tasks(mi: Any, scene: Any, ray: Ray, shadow: bool) -> dict[bool, Callable[[], Any]]:
    """What is timed of Mitsuba on the same rays: both answers to ``coherent``."""
    theirs = mi.Ray3f(mi.Point3f(ray.o), mi.Vector3f(ray.d))
    theirs.maxt = ray.tmax + dr.zeros(types("float32").Float, len(ray))
    dr.eval(theirs)
    return {coherent: _mitsuba_task(scene, theirs, shadow, coherent) for coherent in (True, False)}


def _mitsuba_task(scene: Any, ray: Any, shadow: bool, coherent: bool) -> Callable[[], Any]:
    def task() -> Any:
        if shadow:
            return scene.ray_test(ray, coherent=coherent)
        pi = scene.ray_intersect_preliminary(ray, coherent=coherent)
        return pi.t, pi.prim_index, pi.prim_uv

    return task


def mitsuba_meshes(mi: Any, meshes: Sequence[TriangleMesh]) -> Any:
    """A Mitsuba scene of these triangles."""
    shapes = {}
    for k, mesh in enumerate(meshes):
        made = mi.Mesh(f"mesh{k}", len(mesh.vertices), len(mesh.faces))
        params = mi.traverse(made)
        params["vertex_positions"] = mesh.vertices.astype(np.float32).ravel()
        params["faces"] = mesh.faces.ravel()
        params.update()
        shapes[f"mesh{k}"] = made
    return mi.load_dict({"type": "scene", **shapes})


def as_table(rows: Sequence[RaySpeed]) -> str:
    """The rows as a Markdown table."""
    lines = [
        "| rays | structure | raytrace2, Mrays/s | Mitsuba (Embree), Mrays/s | ratio |",
        "|---|---|---:|---:|---:|",
    ]
    for r in rows:
        mode = "coherent" if r.coherent else "incoherent"
        lines.append(
            f"| {r.rays} ({r.count:,}) | {r.structure} | {r.ours:.1f} | {r.mitsuba:.1f} ({mode}) | {r.ratio:.2f} |"
        )
    return "\n".join(lines)
