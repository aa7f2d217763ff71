"""Who takes part, behind one interface: our structures, and whatever else answers the same questions."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import drjit as dr
import numpy as np

from ..accel.build import build
from ..accel.bvh import Bvh
from ..rays.ray import Ray
from ..surfaces.primitives import Intersection
from ..surfaces.structure import Structure
from ..surfaces.surface import Surface


class Answer(Protocol):
    """The closest hits: ``t`` (n,), inf on a miss, ``prim`` (n,), ``uv`` (n, 2); the ``seconds`` they took."""

    @property
    def t(self) -> np.ndarray: ...

    @property
    def prim(self) -> np.ndarray: ...

    @property
    def uv(self) -> np.ndarray: ...

    @property
    def seconds(self) -> float: ...

    def content(self) -> bytes:
        """The bits of the answer."""
        ...


@dataclass(frozen=True, eq=False)
class OurAnswer:
    """The closest hits: ``t`` (n,), inf on a miss, ``prim`` (n,), ``uv`` (n, 2); the ``seconds`` they took."""

    t: np.ndarray
    prim: np.ndarray
    uv: np.ndarray
    seconds: float = 0.0

    def content(self) -> bytes:
        """The bits of the answer."""
        missed = ~np.isfinite(self.t)
        prim, uv = np.where(missed, 0, self.prim), np.where(missed[:, None], 0, self.uv)
        return self.t.tobytes() + prim.tobytes() + uv.tobytes()


#: From outward normals (n, 3) to directions (n, 3).
Turn = Callable[[np.ndarray], np.ndarray]


class Loaded(Protocol):
    """Surfaces that rays can be sent into. Rays are NumPy arrays (n, 3)."""

    @property
    def build_seconds(self) -> float: ...

    def closest(self, o: np.ndarray, d: np.ndarray, tmax: Any = np.inf) -> Answer:
        """The closest hits."""
        ...

    def occluded(self, o: np.ndarray, d: np.ndarray, tmax: Any) -> np.ndarray:
        """(n,) bool: whether anything lies before ``tmax``."""
        ...

    def normals(self, o: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """t (n,) and the normal (n, 3) where each ray hits."""
        ...

    def spawned(self, o: np.ndarray, d: np.ndarray, turn: Turn) -> tuple[Answer, Answer]:
        """The closest hits, and those of rays that go on from there along ``turn(outward normals)``."""
        ...


class Tracer(Protocol):
    """A way to trace rays; ``name`` is what tables call it, ``precision`` "float32" or "float64"."""

    @property
    def name(self) -> str: ...

    @property
    def precision(self) -> str: ...

    def load(self, surfaces: Sequence[Surface]) -> Loaded:
        """Makes a scene of meshes and spheres."""
        ...


@dataclass(frozen=True)
class Ours:
    """One of our structures; ``padded``: whether a bvh widens its boxes, if not as its test of triangles has it."""

    kind: str
    precision: str
    intersection: Intersection = "watertight"
    padded: bool | None = None

    @property
    def name(self) -> str:
        """The structure's kind, and how it tests if not as usual."""
        return self.kind + ("" if self.intersection == "watertight" else f", {self.intersection}")

    def load(self, surfaces: Sequence[Surface]) -> Loaded:
        """A structure over ``surfaces``."""
        begin = time.perf_counter()
        structure = build(list(surfaces), self.kind, precision=self.precision, intersection=self.intersection)
        if self.padded is not None:
            assert isinstance(structure, Bvh)
            structure = structure.with_margins(self.padded)
        structure.prepare()
        dr.sync_thread()
        return _OurScene(structure, self.precision, time.perf_counter() - begin)


@dataclass(frozen=True, eq=False)
class _OurScene:
    structure: Structure
    precision: str
    build_seconds: float

    def _ray(self, o: np.ndarray, d: np.ndarray, tmax: Any = np.inf) -> Ray:
        ray = Ray(o, d, 0.0, tmax, precision=self.precision)
        dr.eval(ray)
        dr.sync_thread()
        return ray

    def closest(self, o: np.ndarray, d: np.ndarray, tmax: Any = np.inf) -> Answer:
        return self._closest(self._ray(o, d, tmax))

    def _closest(self, ray: Ray) -> Answer:
        begin = time.perf_counter()
        hit = self.structure.intersect(ray)
        dr.eval(hit.t, hit.prim, hit.uv)
        dr.sync_thread()
        return OurAnswer(np.array(hit.t), np.array(hit.prim), np.array(hit.uv).T, time.perf_counter() - begin)

    def occluded(self, o: np.ndarray, d: np.ndarray, tmax: Any) -> np.ndarray:
        return np.array(self.structure.occluded(self._ray(o, d, tmax)))

    def normals(self, o: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        ray = self._ray(o, d)
        si = self.structure.interact(ray, self.structure.intersect(ray))
        return np.array(si.t), np.array(si.n).T

    def spawned(self, o: np.ndarray, d: np.ndarray, turn: Turn) -> tuple[Answer, Answer]:
        ray = self._ray(o, d)
        hit = self.structure.intersect(ray)
        si = self.structure.interact(ray, hit)
        n = np.array(si.n).T.astype(np.float64)
        along = self._ray(o, turn(outward(n, d))).d
        spawned = si.spawn_ray(along)
        dr.eval(spawned, hit.t, hit.prim, hit.uv)
        return OurAnswer(np.array(hit.t), np.array(hit.prim), np.array(hit.uv).T), self._closest(spawned)


def outward(n: np.ndarray, d: np.ndarray) -> np.ndarray:
    """The normals on the side that rays along ``d`` come from."""
    return np.where((n * d).sum(axis=1, keepdims=True) > 0, -n, n)
