"""Meshes that deform: each a rest pose, a view of every pose, and where the vertices are at a time in 0 to 1."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

import raytrace2 as rt
from raytrace2.scene.procedural import View, bumpy_sphere, terrain


@dataclass(frozen=True, eq=False)
class Deformation:
    """``rest`` is the mesh at time 0; ``vertices_at`` takes a time and gives its vertices (n, 3)."""

    name: str
    about: str
    rest: rt.TriangleMesh
    view: View
    vertices_at: Callable[[float], np.ndarray]

    def mesh_at(self, time: float) -> rt.TriangleMesh:
        return rt.TriangleMesh(self.vertices_at(time), self.rest.faces, name=self.name)


def wave(triangles: int) -> Deformation:
    """Gentle: neighbours stay neighbours, and boxes move as wholes."""
    rest = terrain(triangles)
    v = rest.vertices

    def vertices_at(time: float) -> np.ndarray:
        moved = v.copy()
        for kx, ky, size in ((3.0, 2.0, 0.12), (-5.0, 4.0, 0.05), (2.0, -9.0, 0.03)):
            along = kx * v[:, 0] + ky * v[:, 1]
            moved[:, 2] += size * (np.sin(along - 2 * np.pi * time) - np.sin(along))
        return moved

    view = View(eye=(1.9, -1.7, 1.3), target=(0.0, 0.0, -0.1), x_fov=45.0)
    return Deformation("wave", "waves run over a terrain", rest, view, vertices_at)


def twist(triangles: int) -> Deformation:
    """Violent: what was compact becomes long and winds about the axis."""
    rest = bumpy_sphere(triangles)
    v = rest.vertices

    def vertices_at(time: float) -> np.ndarray:
        angle = 4 * np.pi * time * v[:, 2]
        c, s = np.cos(angle), np.sin(angle)
        return np.stack([c * v[:, 0] - s * v[:, 1], s * v[:, 0] + c * v[:, 1], v[:, 2]], axis=1)

    view = View(eye=(2.4, -2.2, 1.4), target=(0.0, 0.0, 0.0), x_fov=50.0)
    return Deformation(
        "twist", "a body is wrung about its axis, in the end by almost five turns", rest, view, vertices_at
    )


def burst(triangles: int, seed: int = 0) -> Deformation:
    """Most violent: triangles that were neighbours part for good, and others fly between them."""
    whole = bumpy_sphere(triangles)
    corners = whole.vertices[whole.faces]
    middle = corners.mean(axis=1, keepdims=True)
    rng = np.random.default_rng(seed)
    speed = middle * rng.uniform(0.2, 1.2, (len(corners), 1, 1)) + rng.normal(size=middle.shape) * 0.15
    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    rest = rt.TriangleMesh(corners.reshape(-1, 3), faces)

    def vertices_at(time: float) -> np.ndarray:
        return (corners + time * speed).reshape(-1, 3)

    view = View(eye=(3.6, -3.3, 2.1), target=(0.0, 0.0, 0.0), x_fov=50.0)
    about = "the triangles of a body fly apart, each at a speed of its own"
    return Deformation("burst", about, rest, view, vertices_at)


DEFORMATIONS = {"wave": wave, "twist": twist, "burst": burst}
