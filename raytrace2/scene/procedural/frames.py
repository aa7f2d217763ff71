"""Lattice, rings and tree: scenes of spheres and cylinders (after Haines 1987)."""

from __future__ import annotations

import numpy as np

from ...surfaces.mesh import TriangleMesh
from .mesh_parts import floor
from .round_parts import cylinders, perpendicular, spheres
from .scene import ProceduralScene, View

_RING = 10  # spheres in a ring, with as many cylinders between them


def lattice(size: int, seed: int = 0) -> ProceduralScene:
    """A cubic lattice of spheres joined by cylinders, evenly spread. ``seed`` has no effect."""
    m = 2
    while abs(_lattice_count(m + 1) - size) < abs(_lattice_count(m) - size):
        m += 1
    ticks = np.linspace(-1, 1, m)
    points = np.stack(np.meshgrid(ticks, ticks, ticks, indexing="ij"), axis=-1)
    spacing = 2 / (m - 1)
    begins = [points[:-1].reshape(-1, 3), points[:, :-1].reshape(-1, 3), points[:, :, :-1].reshape(-1, 3)]
    ends = [points[1:].reshape(-1, 3), points[:, 1:].reshape(-1, 3), points[:, :, 1:].reshape(-1, 3)]
    bars = cylinders(np.concatenate(begins), np.concatenate(ends), 0.06 * spacing)
    view = View(eye=(3.3, -2.4, 2.1), target=(0.0, 0.0, -0.1), x_fov=44.0)
    return ProceduralScene("lattice", (*spheres(points.reshape(-1, 3), 0.16 * spacing), *bars), view)


def _lattice_count(m: int) -> int:
    return m**3 + 3 * m * m * (m - 1)


def rings(size: int, seed: int = 0) -> ProceduralScene:
    """A pyramid of rings, linked like chain mail: each ten spheres with cylinders between them, turned at random."""
    rng = np.random.default_rng(seed)
    count = max(1, (size - 2) // (2 * _RING))
    layers = 1
    while layers * (layers + 1) * (2 * layers + 1) // 6 < count:
        layers += 1
    places = []
    for k in range(layers):
        j, i = np.meshgrid(np.arange(k + 1), np.arange(k + 1), indexing="ij")
        places.append(np.stack([i - k / 2, j - k / 2, np.full(i.shape, -0.8 * k)], axis=-1).reshape(-1, 3))
    centers = np.concatenate(places)[:count]
    axis = rng.normal(size=(count, 3))
    x, y = perpendicular(axis)
    angle = np.arange(_RING) * 2 * np.pi / _RING
    around = np.cos(angle)[:, None] * x[:, None] + np.sin(angle)[:, None] * y[:, None]
    joints = centers[:, None] + 0.6 * around
    bars = cylinders(joints.reshape(-1, 3), np.roll(joints, -1, axis=1).reshape(-1, 3), 0.05)
    ground = TriangleMesh(*floor(4.0 * layers, -0.8 * layers), name="floor")
    view = View(
        eye=(1.5 * layers + 1.2, -1.1 * layers - 1.0, 0.9 * layers + 0.6), target=(0.0, 0.0, -0.46 * layers), x_fov=36.0
    )
    return ProceduralScene("rings", (ground, *spheres(joints.reshape(-1, 3), 0.1), *bars), view)


def tree(size: int, seed: int = 0) -> ProceduralScene:
    """A tree of cylinders that fork in three and thin out, with a sphere at each fork and each end."""
    rng = np.random.default_rng(seed)
    begin, end, radius = np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]), np.array([0.08])
    begins, ends, radii = [begin], [end], [radius]
    wanted = max(1, (size - 2) // 2)
    while sum(map(len, radii)) < wanted:
        along = np.repeat(end - begin, 3, axis=0)
        length = np.linalg.norm(along, axis=1, keepdims=True)
        x, y = perpendicular(along)
        start = rng.uniform(0, 2, (len(begin), 1))
        angle = (start + np.arange(3) * 2 * np.pi / 3).reshape(-1, 1)
        tilt = rng.uniform(0.35, 0.75, (len(along), 1))
        across = np.cos(angle) * x + np.sin(angle) * y
        direction = np.cos(tilt) * along / length + np.sin(tilt) * across
        begin = np.repeat(end, 3, axis=0)
        end = begin + direction * length * rng.uniform(0.6, 0.8, (len(along), 1))
        radius = np.repeat(radius, 3) * 0.62
        begins.append(begin)
        ends.append(end)
        radii.append(radius)
    b, e, r = (np.concatenate(v)[:wanted] for v in (begins, ends, radii))
    ground = TriangleMesh(*floor(6.0), name="floor")
    view = View(eye=(4.6, -4.4, 2.2), target=(0.0, 0.0, 1.5), x_fov=47.0)
    return ProceduralScene("tree", (ground, *cylinders(b, e, r), *spheres(e, r * 1.02)), view)
