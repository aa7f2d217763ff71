"""Scenes and rays on which structures must agree: ordinary ones, and those that find fault."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from raytrace2 import accel
from raytrace2.rays.ray import Ray
from raytrace2.surfaces.instance import Instance
from raytrace2.surfaces.mesh import TriangleMesh
from raytrace2.surfaces.quadrics import Cylinder, Disk, Quadric, Rectangle, Sphere
from raytrace2.surfaces.surface import Surface


@dataclass(frozen=True)
class Case:
    """Surfaces (or, for structures inside, what makes them in a precision) and points that rays should be aimed at."""

    items: Callable[[str], list[Surface]]
    points: np.ndarray


def rotation(rng: np.random.Generator) -> np.ndarray:
    q = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return q * np.sign(np.linalg.det(q))


def matrix(rng: np.random.Generator, scale: Any = 0.3, mirrored: bool = False) -> np.ndarray:
    """A random rotation after ``scale`` (a number or three), then a random translation within the unit cube."""
    result = np.eye(4)
    linear = rotation(rng) @ np.diag(np.broadcast_to(scale, 3))
    result[:3, :3] = linear @ np.diag([-1, 1, 1]) if mirrored else linear
    result[:3, 3] = rng.uniform(-1, 1, 3)
    return result


def soup(rng: np.random.Generator, n: int = 200) -> TriangleMesh:
    corners = rng.uniform(-1, 1, (n, 1, 3)) + rng.normal(size=(n, 3, 3)) * 0.15
    return TriangleMesh(corners.reshape(-1, 3), np.arange(3 * n).reshape(-1, 3))


def grid_mesh(n: int = 12, height: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None) -> TriangleMesh:
    """A height field of n x n squares over [-1, 1]^2, flat without ``height``: edges and planes along the axes."""
    x, y = np.meshgrid(np.linspace(-1, 1, n + 1), np.linspace(-1, 1, n + 1), indexing="ij")
    z = np.zeros_like(x) if height is None else height(x, y)
    corner = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    faces = np.concatenate(
        [np.stack([corner, corner + n + 1, corner + 1], 1), np.stack([corner + 1, corner + n + 1, corner + n + 2], 1)]
    )
    return TriangleMesh(np.stack([x, y, z], -1).reshape(-1, 3), faces)


def icosphere(levels: int = 2, radius: float = 1.0) -> TriangleMesh:
    """A closed mesh: an icosahedron, its triangles split in four ``levels`` times."""
    g = (1 + 5**0.5) / 2
    points = [(-1, g, 0), (1, g, 0), (-1, -g, 0), (1, -g, 0), (0, -1, g), (0, 1, g), (0, -1, -g), (0, 1, -g)]
    points += [(g, 0, -1), (g, 0, 1), (-g, 0, -1), (-g, 0, 1)]
    faces = "0 11 5 0 5 1 0 1 7 0 7 10 0 10 11 1 5 9 5 11 4 11 10 2 10 7 6 7 1 8"
    faces += " 3 9 4 3 4 2 3 2 6 3 6 8 3 8 9 4 9 5 2 4 11 6 2 10 8 6 7 9 8 1"
    f = np.array(faces.split(), dtype=int).reshape(-1, 3)
    v = np.array(points, dtype=float)
    for _ in range(levels):
        edges = np.sort(np.concatenate([f[:, [0, 1]], f[:, [1, 2]], f[:, [2, 0]]]), axis=1)
        unique, inverse = np.unique(edges, axis=0, return_inverse=True)
        a, b, c = inverse.reshape(3, -1) + len(v)
        v = np.concatenate([v, v[unique].mean(axis=1)])
        x, y, z = f.T
        f = np.concatenate([np.stack(t, 1) for t in ((x, a, c), (a, y, b), (c, b, z), (a, b, c))])
        v = v / np.linalg.norm(v, axis=1, keepdims=True)
    return TriangleMesh(v / np.linalg.norm(v, axis=1, keepdims=True) * radius, f)


def degenerate(rng: np.random.Generator) -> TriangleMesh:
    """Duplicates, slivers, triangles with a vertex twice or with coincident vertices, and ones wound the other way."""
    v = rng.uniform(-1, 1, (30, 3))
    v[10:20] = v[:10] + rng.normal(size=(10, 3)) * 1e-3
    v[20:25] = v[:5]
    f = rng.integers(0, 30, (80, 3))
    f[10:20] = f[:10]
    f[20:30] = f[:10][:, ::-1]
    f[30:35] = f[30:35, [0, 0, 1]]
    f[35:40] = np.stack([np.arange(5), np.arange(5) + 5, np.arange(5) + 20], 1)
    return TriangleMesh(v, f)


def moved(item: Surface, scale: float, shift: float) -> Surface:
    """A leaf surface, scaled and then shifted along every axis."""
    if isinstance(item, TriangleMesh):
        return TriangleMesh(item.vertices * scale + shift, item.faces)
    assert isinstance(item, Quadric)
    m = np.array(item.to_world)
    m[:3] *= scale
    m[:3, 3] += shift
    return type(item)(m)


def leaves(rng: np.random.Generator) -> dict[str, list[Surface]]:
    """The kinds of primitive, alone and together."""
    waves = grid_mesh(12, lambda x, y: 0.2 * np.sin(5 * x) * np.cos(4 * y))
    found: dict[str, list[Surface]] = {
        "triangle soup": [soup(rng)],
        "one triangle": [soup(rng, 1)],
        "flat grid": [grid_mesh()],
        "height field": [waves],
        "closed mesh": [icosphere()],
        "degenerate triangles": [degenerate(rng)],
        "spheres": [Sphere(matrix(rng, rng.uniform(0.05, 0.5))) for _ in range(20)],
        "nested spheres": [Sphere.at((0, 0, 0), 1 - k / 8) for k in range(8)] + [Sphere.at((0, 0, 0), 1)],
        "rectangles": [Rectangle(matrix(rng, rng.uniform(0.05, 0.5, 3))) for _ in range(20)]
        + [Rectangle(), Rectangle()],
        "disks": [Disk(matrix(rng, rng.uniform(0.05, 0.5, 3), k % 2 == 0)) for k in range(20)] + [Disk(), Disk()],
        "cylinders": [Cylinder(matrix(rng, rng.uniform(0.05, 0.5, 3))) for _ in range(20)] + [Cylinder()],
    }
    found["all kinds"] = [item for key in ("spheres", "rectangles", "disks", "cylinders") for item in found[key][:8]]
    found["all kinds"] += [soup(rng, 50), degenerate(rng)]
    return found


def cases(rng: np.random.Generator) -> dict[str, Case]:
    """Every scene by name, those with structures inside included."""
    flat = leaves(rng)
    found = {name: Case(lambda _, items=items: items, points_of(items)) for name, items in flat.items()}
    places = [matrix(rng, rng.uniform(0.2, 0.6, 3), k % 3 == 0) for k in range(12)]
    inner: list[Surface] = [soup(rng, 40), Sphere(matrix(rng)), Cylinder(matrix(rng))]

    def instances(precision: str) -> list[Surface]:
        group = accel.build(inner, precision=precision)
        same_place = [Instance(group, places[0])]
        return [*(Instance(group, m) for m in places), *same_place, grid_mesh()]

    def nested(precision: str) -> list[Surface]:
        one = accel.build(inner, "bvh", precision=precision)
        two = accel.build([one, Disk()], "brute_force", precision=precision)
        return [two, accel.build(flat["closed mesh"], precision=precision), *flat["disks"][:3]]

    def instances_inside(precision: str) -> list[Surface]:
        group = accel.build(inner, "brute_force", precision=precision)
        row = accel.build([Instance(group, m) for m in places[:5]], precision=precision)
        return [row, soup(np.random.default_rng(3), 5), Instance(group, places[6])]

    corners = points_of(inner)
    placed = np.concatenate([corners @ m[:3, :3].T + m[:3, 3] for m in places])
    found["instances"] = Case(instances, placed)
    found["structures inside"] = Case(nested, np.concatenate([corners, points_of(flat["closed mesh"])]))
    found["instances inside"] = Case(instances_inside, placed)
    return found


def points_of(items: list[Surface]) -> np.ndarray:
    """Points on surfaces where rays are decided by rounding: vertices, points of edges, rims and poles."""
    found = []
    for item in items:
        if isinstance(item, TriangleMesh):
            corner = item.vertices[item.faces]
            found += [item.vertices, (corner[:, 0] + corner[:, 1]) / 2, corner[:, 0] * 0.25 + corner[:, 2] * 0.75]
        elif isinstance(item, Quadric):
            local = [(1, 0, 0), (0, 1, 0), (0, 0, 1), (-1, -1, 0), (1, 1, 0), (0, 0, 0), (0.6, 0.8, 0), (0.6, 0.8, 1)]
            found.append(np.array(local) @ item.to_world[:3, :3].T + item.to_world[:3, 3])
    return np.concatenate(found)


def rays(rng: np.random.Generator, points: np.ndarray, n: int, precision: str) -> Ray:
    """About ``n`` rays: random, along the axes with either zero, at and from ``points``, along edges, from far away."""
    center, reach = points.mean(axis=0), float(np.ptp(points, axis=0).max())
    m = n // 8
    pick = lambda: points[rng.integers(0, len(points), m)]  # noqa: E731
    random_origin = lambda: center + rng.uniform(-1.2, 1.2, (m, 3)) * reach  # noqa: E731
    random_direction = lambda: rng.normal(size=(m, 3))  # noqa: E731
    axis = np.zeros((m, 3)) * rng.choice([-1.0, 1.0], (m, 3))
    axis[np.arange(m), rng.integers(0, 3, m)] = rng.choice([-1.0, 1.0], m)
    plane = random_direction() * rng.choice([-0.0, 0.0, 1e-8, 1.0], (m, 3))
    a, b, c, d = pick(), pick(), pick(), pick()
    far = center + random_direction() * reach * 1e6
    pairs = [
        (random_origin(), random_direction()),
        (a - axis * reach, axis),
        (center + rng.uniform(-1, 1, (m, 3)) * reach * 0.5, axis[::-1]),
        (b, random_direction()),
        (c, d - c),
        (random_origin(), None),
        (far, None),
        (pick(), plane),
    ]
    aims = pick()
    o = np.concatenate([np.asarray(o) for o, _ in pairs])
    d_ = np.concatenate([(aims - o) if d is None else d for o, d in pairs])
    scale = 10.0 ** rng.uniform(-2, 2, (len(o), 1))
    some = rng.uniform(size=len(o))
    tmin = np.where(some < 0.1, 0.5, 0.0)
    tmax = np.where(some > 0.9, 1.0, np.inf)
    return Ray(o, np.where(some[:, None] < 0.5, d_, d_ * scale), tmin, tmax, precision=precision)


def rays_in_planes(
    rng: np.random.Generator, levels: list[tuple[np.ndarray, np.ndarray]], n: int, precision: str
) -> Ray:
    """About ``n`` rays in the planes of the boxes ``levels``, every level as often: within a face, along an edge, from
    and through corners, either exactly or off by a round-off, from inside as from outside."""
    low, high = levels[0][0][0], levels[0][1][0]
    reach = max(float((high - low).max()), 1e-30)
    m = n // 5
    rows = np.arange(m)

    def boxes() -> tuple[np.ndarray, np.ndarray]:
        level = rng.integers(0, len(levels), m)
        number = (rng.uniform(size=m) * np.array([len(lo) for lo, _ in levels])[level]).astype(int)
        lo, hi = (np.array([levels[a][k][b] for a, b in zip(level, number, strict=True)]) for k in (0, 1))
        return lo, hi

    def corners() -> np.ndarray:
        lo, hi = boxes()
        return np.where(rng.uniform(size=(m, 3)) < 0.5, lo, hi)

    dtype = np.dtype(precision)

    def jogged(points: np.ndarray) -> np.ndarray:
        """Two of three times as they are, else the next number in either direction."""
        points = points.astype(dtype)
        towards = rng.choice([0, 0, 0, 0, np.finfo(dtype).max, np.finfo(dtype).min], points.shape).astype(dtype)
        return np.where(towards == 0, points, np.nextafter(points, towards)).astype(float)

    axis = rng.integers(0, 3, m)
    zero = np.array([0.0, -0.0, 1e-20])
    face = rng.uniform(low - 0.2 * reach, high + 0.2 * reach, (m, 3))
    face[rows, axis] = jogged(corners())[rows, axis]
    within = rng.normal(size=(m, 3))
    within[rows, axis] = rng.choice(zero, m)
    # In the face itself, too: within one box, where the structure has most to decide.
    lo, hi = boxes()
    inside = jogged(rng.uniform(lo, hi))
    inside[rows, axis] = jogged(np.where(rng.uniform(size=(m, 3)) < 0.5, lo, hi))[rows, axis]
    turned = rng.normal(size=(m, 3))
    turned[rows, axis] = rng.choice(zero, m)
    along = rng.choice(zero, (m, 3))
    along[rows, axis] = rng.choice([-1.0, 1.0], m)
    outside = rng.uniform(-1.5, 1.5, (m, 3)) * reach + (low + high) / 2
    edge = jogged(corners()) - along * rng.choice([0.0, 0.25, 2.0], (m, 1)) * reach
    o = np.concatenate([face, inside, edge, jogged(corners()), outside])
    d = np.concatenate([within, turned, along, rng.normal(size=(m, 3)), corners() - outside])
    d[(d == 0).all(axis=1)] = 1.0
    return Ray(o, d, precision=precision)


def disagreements(items: list[Surface], ray: Ray, precision: str) -> dict[str, int]:
    """On how many rays brute force and the hierarchy differ in each field, and how many hits there are."""
    slow = accel.build(items, "brute_force", precision=precision)
    fast = accel.build(items, "bvh", precision=precision)
    a, b = slow.intersect(ray), fast.intersect(ray)
    shadow_a, shadow_b = slow.occluded(ray), fast.occluded(ray)
    dr.eval(a, b, shadow_a, shadow_b)
    found = {"hits": int(np.isfinite(a.t.numpy()).sum())}
    for name in ("t", "prim", "surface", "instance"):
        found[name] = int((getattr(a, name).numpy() != getattr(b, name).numpy()).sum())
    found["uv"] = int((a.uv.numpy() != b.uv.numpy()).any(axis=0).sum())
    found["occluded"] = int((shadow_a.numpy() != shadow_b.numpy()).sum())
    found["shadow"] = int((shadow_a.numpy() != np.isfinite(a.t.numpy())).sum())
    return found
