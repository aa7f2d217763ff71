"""Spheres huge and near or small and far, and cylinders and disks, against exact arithmetic on the same numbers."""

from __future__ import annotations

from decimal import Decimal, localcontext

import numpy as np
import pytest

from raytrace2 import accel
from raytrace2.rays.ray import Ray
from raytrace2.surfaces.quadrics import Cylinder, Disk, Rectangle, Sphere

N = 500


def directions(rng: np.random.Generator, n: int = N) -> np.ndarray:
    d = rng.normal(size=(n, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def exact_sphere(center, radius, o, d) -> tuple[np.ndarray, np.ndarray]:
    """t of the nearest hit ahead (NaN if there is none) and the normal there, in fifty digits."""
    ts, normals = [], []
    with localcontext() as context:
        context.prec = 50
        for origin, way in zip(o, d, strict=True):
            f = [Decimal(float(x)) - Decimal(float(y)) for x, y in zip(origin, center, strict=True)]
            w = [Decimal(float(x)) for x in way]
            r = Decimal(float(radius))
            a, b = sum(x * x for x in w), sum(x * y for x, y in zip(f, w, strict=True))
            square = b * b - a * (sum(x * x for x in f) - r * r)
            roots = [(-b - square.sqrt()) / a, (-b + square.sqrt()) / a] if square >= 0 else []
            ahead = [t for t in roots if t >= 0]
            ts.append(float(ahead[0]) if ahead else np.nan)
            normals.append([float((x + ahead[0] * y) / r) if ahead else np.nan for x, y in zip(f, w, strict=True)])
    return np.array(ts), np.array(normals)


def assert_exact(center, radius, o, d, digits: float = 4e-7) -> None:
    o, d = o.astype(np.float32), d.astype(np.float32)
    structure = accel.build(Sphere.at(center, radius))
    ray = Ray(o, d)
    si = structure.interact(ray, structure.intersect(ray))
    t, normal = exact_sphere(np.float32(center), np.float32(radius), o, d)
    met = np.isfinite(t)
    np.testing.assert_array_equal(si.valid, met)
    np.testing.assert_allclose(si.t.numpy()[met], t[met], rtol=digits)
    apart = np.linalg.norm(si.n.numpy().T[met] - normal[met], axis=1)
    assert np.degrees(apart).max() < 1e-3


@pytest.mark.parametrize("center", [(0, 0, -1e6), (0, -1e6, 0), (6e5, 0, -8e5)])
def test_a_huge_sphere_just_below(center):
    rng = np.random.default_rng(0)
    down = np.array(center) / 1e6
    o = np.tile(-down, (N, 1))
    d = directions(rng)
    d *= np.sign(d @ down)[:, None]
    assert_exact(center, 1e6, o, d)
    level = d - np.outer(d @ down, down)
    level /= np.linalg.norm(level, axis=1, keepdims=True)
    # The horizon is 1.4 thousandths below level.
    assert_exact(center, 1e6, o, level + down * rng.uniform(1.5e-3, 4e-3, (N, 1)))


@pytest.mark.parametrize("center", [(0, 0, 0), (6e5, -5e5, 6e5)])
def test_a_small_sphere_a_million_radii_away(center):
    rng = np.random.default_rng(1)
    center = np.array(center, float)
    o = np.zeros((N, 3)) if center.any() else 1e6 * directions(rng)
    o = o.astype(np.float32).astype(float)
    d = center + 0.9 * directions(rng) - o
    assert_exact(center, 1.0, o, d / np.linalg.norm(d, axis=1, keepdims=True))


def test_a_huge_cylinder_just_below():
    m = np.diag([1e6, 1e6, 1e6, 1.0])
    m[:3, 3] = 0, -1e6, -5e5
    rng = np.random.default_rng(2)
    d = directions(rng) - [0, 1, 0]
    o = np.tile([0.0, 1.0, 0.0], (N, 1))
    found = []
    for precision in ("float32", "float64"):
        ray = Ray(o.astype(np.float32), d.astype(np.float32), precision=precision)
        found.append(accel.build(Cylinder(m.astype(np.float32)), precision=precision).intersect(ray))
    single, double = found
    np.testing.assert_array_equal(single.valid, double.valid)
    assert single.valid.numpy().mean() > 0.9
    met = single.valid.numpy()
    # The reciprocal of the radius is rounded: of the height above the surface, that is what is left.
    np.testing.assert_allclose(single.t.numpy()[met], double.t.numpy()[met], rtol=0.1)


@pytest.mark.parametrize("size", [2.0**-40, 1.0, 2.0**40])
@pytest.mark.parametrize("kind", [Rectangle, Disk])
def test_flat_shapes_edge_on_far_from_the_origin(kind, size):
    rng = np.random.default_rng(3)
    m = np.diag([size, size, size, 1.0])
    m[:3, 3] = size * np.array([1000.0, -3000.0, 500.0])
    d = np.c_[directions(rng)[:, :2], 10.0 ** -rng.uniform(1, 6, N)]
    o = m[:3, 3] + size * np.c_[rng.uniform(-0.4, 0.4, (N, 2)), np.zeros(N)] - size * d
    o, d = o.astype(np.float32), d.astype(np.float32)
    hit = accel.build(kind(m)).intersect(Ray(o, d))
    t = (m[2, 3] - o[:, 2].astype(float)) / d[:, 2].astype(float)
    local = (o + t[:, None] * d.astype(float) - m[:3, 3]) / size
    inside = (np.abs(local[:, :2]).max(axis=1) if kind is Rectangle else np.linalg.norm(local[:, :2], axis=1)) <= 1
    np.testing.assert_array_equal(hit.valid.numpy(), inside & (t >= 0))
    met = hit.valid.numpy()
    assert met.any()
    np.testing.assert_allclose(hit.t.numpy()[met], t[met], rtol=2e-7)
    np.testing.assert_allclose(hit.uv.numpy().T[met], local[met, :2], atol=1e-5)


@pytest.mark.parametrize("kind", [Sphere, Rectangle, Disk, Cylinder])
def test_occluded_is_intersect_at_every_end(kind):
    rng = np.random.default_rng(4)
    structure = accel.build(kind())
    o, d = directions(rng) * 3, None
    d = 0.5 * directions(rng) - o
    t = structure.intersect(Ray(o, d)).t.numpy()
    t[~np.isfinite(t)] = 1.0
    up, down = np.nextafter(t, np.float32(9)), np.nextafter(t, np.float32(-9))
    nan, zero = np.full(N, np.nan), np.zeros(N)
    ends = [(zero, t), (zero, down), (t, t), (t, up), (up, t), (zero, -t), (-t, -zero), (t, zero)]
    ends += [(nan, t), (zero, nan), (nan, nan), (-np.inf + zero, np.inf + zero), (zero, -np.inf + zero)]
    for tmin, tmax in ends:
        ray = Ray(o, d, tmin, tmax)
        np.testing.assert_array_equal(structure.intersect(ray).valid, structure.occluded(ray))
    assert (
        structure.intersect(Ray(o, d, 0.0, t)).valid.numpy().sum()
        == np.isfinite(structure.intersect(Ray(o, d)).t.numpy()).sum()
    )
