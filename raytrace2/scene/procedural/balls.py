"""Sphereflake and shells: scenes of nothing but spheres, over many sizes (after Haines, "A Proposal for Standard
Graphics Environments", IEEE CG&A 7(11), 1987)."""

from __future__ import annotations

import numpy as np

from ...surfaces.mesh import TriangleMesh
from .mesh_parts import floor
from .round_parts import perpendicular, spheres
from .scene import ProceduralScene, View


def balls(size: int, seed: int = 0) -> ProceduralScene:
    """The sphereflake: every sphere bears nine of a third its radius, six about its waist and three above. ``seed``
    has no effect."""
    center, radius, axis = np.array([[0.0, 0.0, 1.0]]), np.array([1.0]), np.array([[0.0, 0.0, 1.0]])
    centers, radii = [center], [radius]
    while sum(map(len, radii)) < size - 2:
        x, y = perpendicular(axis)
        waist, above = np.arange(6) * np.pi / 3, np.arange(3) * 2 * np.pi / 3 + np.pi / 6
        angle = np.concatenate([waist, above])
        tilt = np.concatenate([np.full(6, np.pi / 2), np.full(3, np.arccos(np.sqrt(2 / 3)))])
        across = np.cos(angle)[:, None] * x[:, None] + np.sin(angle)[:, None] * y[:, None]
        direction = np.sin(tilt)[:, None] * across + np.cos(tilt)[:, None] * axis[:, None]
        center = (center[:, None] + direction * (radius * 4 / 3)[:, None, None]).reshape(-1, 3)
        radius, axis = np.repeat(radius / 3, 9), direction.reshape(-1, 3)
        centers.append(center)
        radii.append(radius)
    all_centers, all_radii = np.concatenate(centers)[: size - 2], np.concatenate(radii)[: size - 2]
    ground = TriangleMesh(*floor(12.0, -0.5), name="floor")
    view = View(eye=(3.1, 4.2, 3.0), target=(0.0, 0.0, 0.9), x_fov=42.0)
    return ProceduralScene("balls", (ground, *spheres(all_centers, all_radii)), view)


def shells(size: int, seed: int = 0) -> ProceduralScene:
    """Sea shells: spheres along spirals that widen as they climb, each overlapping many others."""
    rng = np.random.default_rng(seed)
    count = 1 if size < 1000 else 5
    found = []
    for k, part in enumerate(np.array_split(np.arange(size - 2), count)):
        turns = np.linspace(0, 1, len(part)) ** 0.7
        angle = turns * 2 * np.pi * rng.uniform(4, 6) + rng.uniform(0, 2 * np.pi)
        growth = np.exp(-3.5 * turns)
        wobble = 1 + 0.06 * np.sin(angle * rng.integers(9, 15))
        place = np.array([0.0, 0.0]) if k == 0 else 2.6 * np.array([np.cos(k * np.pi / 2), np.sin(k * np.pi / 2)])
        scale = 1.0 if k == 0 else rng.uniform(0.5, 0.8)
        x, y = place[0] + scale * growth * np.cos(angle), place[1] + scale * growth * np.sin(angle)
        found.append(np.column_stack([x, y, scale * (0.55 + 2.2 * (1 - growth)), scale * growth * 0.5 * wobble]))
    data = np.concatenate(found)
    ground = TriangleMesh(*floor(9.0), name="floor")
    view = View(eye=(6.5, 4.0, 4.5), target=(0.0, 0.0, 0.9), x_fov=48.0)
    return ProceduralScene("shells", (ground, *spheres(data[:, :3], data[:, 3])), view)
