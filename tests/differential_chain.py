"""Rays with differentials through a few surfaces of one material, and closed forms to compare them with."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

import raytrace2 as rt
from raytrace2.materials.table import MaterialTable
from raytrace2.rays.camera import make_camera
from raytrace2.rays.differentials import make_differentials
from raytrace2.rays.film_plane import perspective_axes
from raytrace2.rays.ray import Ray
from raytrace2.scene.description import Bsdf, Camera, ConductorBsdf, Film, PerspectiveCamera
from raytrace2.types import types

MIRROR = ConductorBsdf()


@dataclass
class Stop:
    """Where rays met a surface: uv, the footprint (n, 2) and its flags (n,), which lanes did and on what, and the
    ray that came with its differentials."""

    valid: np.ndarray
    met: np.ndarray
    uv: np.ndarray
    dx: np.ndarray
    dy: np.ndarray
    flags: np.ndarray
    second: list[np.ndarray]
    ray: Any
    state: Any
    si: Any


def look(origin: Any, target: Any, up: Any = (0, 0, 1)) -> np.ndarray:
    """A camera's to_world."""
    z = np.subtract(target, origin).astype(float)
    z /= np.linalg.norm(z)
    x = np.cross(up, z)
    x /= np.linalg.norm(x)
    matrix = np.eye(4)
    matrix[:3] = np.column_stack([x, np.cross(z, x), z, origin])
    return matrix


def perspective(origin: Any, target: Any, fov: float = 40, size: int = 64) -> PerspectiveCamera:
    """A pinhole camera with a square film."""
    film = Film(size, size, crop_width=size, crop_height=size)
    return PerspectiveCamera(to_world=look(origin, target), film=film, x_fov=fov)


def through(camera: PerspectiveCamera, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Its centre (3, 1) and directions (3, n) for complex film positions, not of unit length."""
    axes = perspective_axes(camera) @ camera.to_world[:3, :3].T
    return camera.to_world[:3, 3:], axes[0][:, None] + np.outer(axes[1], x) + np.outer(axes[2], y)


def places(n: int = 24) -> tuple[np.ndarray, np.ndarray]:
    """Film positions all over the film, float32 numbers."""
    g = (np.arange(n) + 0.37) / n
    x, y = np.meshgrid(g, g)
    return x.ravel().astype(np.float32).astype(float), y.ravel().astype(np.float32).astype(float)


def derivatives(position: Any, camera: PerspectiveCamera, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Those of ``position(o, d)`` (2, n) by ``step`` to the right and down, to the last digits: by complex steps."""
    x, y = places()
    h = 1e-30
    right, down = (
        position(*through(camera, x + dx * 1j * h, y + dy * 1j * h)).imag.T / h * step for dx, dy in ((1, 0), (0, 1))
    )
    return right, down


def chain(
    surfaces: list[Any], camera: Camera, name: str, *, bsdf: Bsdf = MIRROR, lobe: float = 0.9999, stops: int = 2,
    precision: str = "float64", step: float = 1 / 64, spacing: float = 1.0, where: Any = None,
) -> list[Stop]:  # fmt: skip
    """Rays at :func:`places`, and how they go on: reflected for ``lobe`` 0, refracted where possible for 1."""
    t = types(precision)
    structure = rt.accel.build(surfaces, "brute_force", precision=precision)
    table = MaterialTable.build([bsdf], t)
    material = t.UInt(table.indices[0])
    way = make_differentials(name, (t.Float(step), t.Float(step)), spacing)
    x, y = places() if where is None else where
    lens = t.Array2f(np.full(len(x), 0.8), np.full(len(x), 0.3))
    ray, state = way.start(make_camera(camera, t), t.Array2f(x, y), lens)
    ray = Ray.of(ray.o, ray.d, ray.tmin, ray.tmax)
    dr.eval(ray, state)
    active, found = dr.full(t.Bool, True, len(x)), []
    for _ in range(stops):
        hit = structure.intersect(ray, active)
        meeting = way.meet(structure, ray, state, hit)
        si = meeting.si
        sample = table.sample(meeting.scatter, material, t.Float(lobe), t.Array2f(0.3, 0.7), si.valid)
        onward = meeting.scatter.spawn_ray(meeting.scatter.to_world(sample.wo))
        after = way.leave(meeting, sample, onward, state)
        onward = dr.detach(onward)
        active = active & si.valid
        # A kernel a stop, the same each time: one for all that happens would take seconds to compile.
        dr.eval(si, si.footprint, onward, after, active)
        found.append(_stop(si, ray, state, len(x)))
        ray, state = Ray.of(onward.o, onward.d, onward.tmin, onward.tmax), after
    return found


def _stop(si: Any, ray: Any, state: Any, n: int) -> Stop:
    def columns(v: Any) -> np.ndarray:
        return np.stack([np.broadcast_to(c.numpy().astype(float), n) for c in v], axis=1)

    f = si.footprint
    second = [columns(v) for v in (f.dxx, f.dxy, f.dyy) if v is not None]
    valid = np.broadcast_to(si.valid.numpy(), n)
    met = np.stack([np.broadcast_to(v.numpy(), n) for v in (si.surface, si.prim, si.instance)], axis=1)
    flags = np.broadcast_to(f.flags.numpy(), n)
    return Stop(valid, met, columns(si.uv), columns(f.dx), columns(f.dy), flags, second, ray, state, si)


def error(stop: Stop, truth: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """How far the footprint is off, relative to its own size, where no flag says that it is not the derivative's."""
    apart = np.hypot(np.linalg.norm(stop.dx - truth[0], axis=1), np.linalg.norm(stop.dy - truth[1], axis=1))
    size = np.hypot(np.linalg.norm(truth[0], axis=1), np.linalg.norm(truth[1], axis=1))
    plain = stop.valid & (stop.flags & 7 == 0)
    assert plain.sum() > 100
    return apart[plain] / size[plain]
