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


def benchmark_rays(mesh: TriangleMesh, structure: Structure, side: int = 1024, seed: int = 0) -> dict[str, Ray]:
    """The rays of the benchmark: ``side``^2 primary rays that frame the mesh, cosine-distributed bounces from where
    those hit it, and shadow rays from there to points on a square light above of the mesh's own size."""
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
    si = structure.interact(primary, structure.intersect(primary))
    rng = np.random.default_rng(seed)
    hit = np.flatnonzero(np.array(si.valid))
    p, n, error = np.array(si.p).T[hit], np.array(si.n).T[hit], np.array(si.p_error)[hit]
    n = np.where((n * d[hit]).sum(axis=1, keepdims=True) > 0, -n, n)
    # Well off the surface for either renderer, so that what is timed is the way out.
    o = p + n * np.maximum(error * 8, 1e-4 * radius)[:, None]
    sphere = rng.normal(size=n.shape)
    bounce = n + 0.9999 * sphere / np.linalg.norm(sphere, axis=1, keepdims=True)
    bounce /= np.linalg.norm(bounce, axis=1, keepdims=True)
    light = center + radius * np.array([1.0, 2.0, 1.0])
    light = light + radius * rng.uniform(-0.5, 0.5, size=n.shape) * [1, 0, 1]
    to_light = light - o
    distance = np.linalg.norm(to_light, axis=1)
    return {
        "primary": primary,
        "bounce": Ray(o, bounce),
        "shadow": Ray(o, to_light / distance[:, None], 0.0, distance),
    }


def ray_speed(
    mesh: TriangleMesh, structures: Sequence[str] = ("bvh",), *, side: int = 1024, repeat: int = 15
) -> list[RaySpeed]:
    """Measures every structure of ``structures`` (as ``rt.accel.build`` names them) on the three kinds of rays.

    Closest hits are ``intersect`` against ``scene.ray_intersect_preliminary``, shadow rays ``occluded`` against
    ``ray_test``. Each rate is the best of ``repeat`` runs; ours and Mitsuba's alternate, so that both meet the same
    disturbances.
    """
    built = {name: build(mesh, name) for name in structures}
    rays = benchmark_rays(mesh, next(iter(built.values())), side)
    rows = []
    with mitsuba_variant("llvm_ad_rgb") as mi:
        scene = _mitsuba_scene(mi, mesh)
        for kind, ray in rays.items():
            dr.eval(ray)
            other = mi.Ray3f(mi.Point3f(ray.o), mi.Vector3f(ray.d))
            other.maxt = ray.tmax + dr.zeros(types("float32").Float, len(ray))
            dr.eval(other)
            tasks: dict[Any, Callable[[], Any]] = {
                coherent: _mitsuba_task(scene, other, kind == "shadow", coherent) for coherent in (True, False)
            }
            tasks |= {name: _our_task(structure, ray, kind == "shadow") for name, structure in built.items()}
            best = _best_times(tasks, repeat)
            coherent = best[True] <= best[False]
            for name in structures:
                rate = len(ray) / 1e6
                rows.append(RaySpeed(kind, name, len(ray), rate / best[name], rate / best[coherent], coherent))
    return rows


def _best_times(tasks: dict[Any, Callable[[], Any]], repeat: int) -> dict[Any, float]:
    best = dict.fromkeys(tasks, np.inf)
    for _ in range(repeat + 1):  # the first run compiles and is never the best
        for key, task in tasks.items():
            begin = time.perf_counter()
            dr.eval(task())
            dr.sync_thread()
            best[key] = min(best[key], time.perf_counter() - begin)
    return best


def _our_task(structure: Structure, ray: Ray, shadow: bool) -> Callable[[], Any]:
    def task() -> Any:
        if shadow:
            return structure.occluded(ray)
        hit = structure.intersect(ray)
        return hit.t, hit.prim, hit.uv

    return task


def _mitsuba_task(scene: Any, ray: Any, shadow: bool, coherent: bool) -> Callable[[], Any]:
    def task() -> Any:
        if shadow:
            return scene.ray_test(ray, coherent=coherent)
        pi = scene.ray_intersect_preliminary(ray, coherent=coherent)
        return pi.t, pi.prim_index, pi.prim_uv

    return task


def _mitsuba_scene(mi: Any, mesh: TriangleMesh) -> Any:
    made = mi.Mesh("mesh", len(mesh.vertices), len(mesh.faces))
    params = mi.traverse(made)
    params["vertex_positions"] = mesh.vertices.astype(np.float32).ravel()
    params["faces"] = mesh.faces.ravel()
    params.update()
    return mi.load_dict({"type": "scene", "mesh": made})


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
