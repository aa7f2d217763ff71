"""Mitsuba with Embree as one that takes part in counts of what goes wrong at the extremes."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from ..errors import GeometryError
from ..surfaces.mesh import TriangleMesh
from ..surfaces.quadrics import Sphere
from ..surfaces.surface import Surface


@dataclass(frozen=True)
class MitsubaAnswer:
    """The closest hits: ``t`` (n,), inf on a miss, ``prim`` (n,), ``uv`` (n, 2); the ``seconds`` they took."""

    t: np.ndarray
    prim: np.ndarray
    uv: np.ndarray
    seconds: float = 0.0

    def content(self) -> bytes:
        """The bits of the answer; Mitsuba leaves garbage in what belongs to a miss."""
        return self.t.tobytes() + np.where(np.isfinite(self.t), self.prim, 0).tobytes()


@dataclass(frozen=True)
class Mitsuba:
    """Mitsuba in float32 (its wheels have nothing else), with Embree's robust flag or without; ``mi`` is the module
    with a variant set."""

    mi: Any
    robust: bool
    precision: str = "float32"

    @property
    def name(self) -> str:
        """As tables call it."""
        return "Embree robust" if self.robust else "Embree default"

    def load(self, surfaces: Sequence[Surface]) -> MitsubaScene:
        """A Mitsuba scene of triangle meshes and spheres; ``GeometryError`` for anything else."""
        shapes: dict[str, Any] = {}
        for k, surface in enumerate(surfaces):
            if isinstance(surface, TriangleMesh):
                made = self.mi.Mesh(f"shape{k}", len(surface.vertices), len(surface.faces))
                params = self.mi.traverse(made)
                params["vertex_positions"] = surface.vertices.astype(np.float32).ravel()
                params["faces"] = surface.faces.ravel()
                params.update()
            elif isinstance(surface, Sphere):
                made = {"type": "sphere", "center": [float(c) for c in surface.center], "radius": surface.radius}
            else:
                raise GeometryError(f"{type(surface).__name__}: only meshes and spheres are compared here")
            shapes[f"shape{k}"] = made
        begin = time.perf_counter()
        scene = self.mi.load_dict({"type": "scene", "embree_use_robust_intersections": self.robust, **shapes})
        return MitsubaScene(self.mi, scene, time.perf_counter() - begin)


@dataclass(frozen=True)
class MitsubaScene:
    """Surfaces that rays can be sent into. Rays are NumPy arrays (n, 3)."""

    mi: Any
    scene: Any
    build_seconds: float

    def _ray(self, o: np.ndarray, d: np.ndarray, tmax: Any = np.inf) -> Any:
        mi = self.mi
        o, d = (np.ascontiguousarray(v.astype(np.float32).T) for v in (o, d))
        ray = mi.Ray3f(mi.Point3f(o), mi.Vector3f(d))
        ray.maxt = mi.Float(np.broadcast_to(np.asarray(tmax, np.float32), o.shape[1:]).copy())
        dr.eval(ray)
        dr.sync_thread()
        return ray

    def closest(self, o: np.ndarray, d: np.ndarray, tmax: Any = np.inf) -> MitsubaAnswer:
        """The closest hits."""
        return self._closest(self._ray(o, d, tmax))

    def _closest(self, ray: Any) -> MitsubaAnswer:
        begin = time.perf_counter()
        pi = self.scene.ray_intersect_preliminary(ray, coherent=False)
        dr.eval(pi)
        dr.sync_thread()
        seconds = time.perf_counter() - begin
        return MitsubaAnswer(np.array(pi.t), np.array(pi.prim_index), np.array(pi.prim_uv).T, seconds)

    def occluded(self, o: np.ndarray, d: np.ndarray, tmax: Any) -> np.ndarray:
        """(n,) bool: whether anything lies before ``tmax``."""
        return np.array(self.scene.ray_test(self._ray(o, d, tmax)))

    def normals(self, o: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """t (n,) and the geometric normal (n, 3) where each ray hits."""
        si = self.scene.ray_intersect(self._ray(o, d))
        return np.array(si.t), np.array(si.n).T

    def spawned(
        self, o: np.ndarray, d: np.ndarray, turn: Callable[[np.ndarray], np.ndarray]
    ) -> tuple[MitsubaAnswer, MitsubaAnswer]:
        """The closest hits, and those of rays that go on from there along ``turn(outward normals)``."""
        si = self.scene.ray_intersect(self._ray(o, d))
        n = np.array(si.n).T.astype(np.float64)
        n = np.where((n * d).sum(axis=1, keepdims=True) > 0, -n, n)
        along = np.ascontiguousarray(turn(n).astype(np.float32).T)
        spawned = si.spawn_ray(self.mi.Vector3f(along))
        dr.eval(spawned)
        first = MitsubaAnswer(np.array(si.t), np.array(si.prim_index), np.array(si.uv).T)
        return first, self._closest(spawned)
