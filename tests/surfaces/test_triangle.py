"""No ray slips through a closed mesh, and none is stopped beside a triangle."""

import itertools

import drjit as dr
import numpy as np
import pytest

from raytrace2 import accel
from raytrace2.rays.ray import Ray
from raytrace2.surfaces.mesh import TriangleMesh
from raytrace2.types import types


def icosphere(levels: int) -> tuple[np.ndarray, np.ndarray]:
    g = (1 + 5**0.5) / 2
    v = [(s, t * g, 0) for s in (-1, 1) for t in (-1, 1)]
    v = np.array(v + [p[i:] + p[:i] for p in v for i in (1, 2)], dtype=float)
    near = np.linalg.norm(v[:, None] - v, axis=-1)
    linked = np.isclose(near, 2)
    triples = itertools.combinations(range(12), 3)
    f = np.array([(a, b, c) for a, b, c in triples if linked[a, b] & linked[b, c] & linked[a, c]])
    for _ in range(levels):
        edges = np.sort(np.concatenate([f[:, [0, 1]], f[:, [1, 2]], f[:, [2, 0]]]), axis=1)
        unique, inverse = np.unique(edges, axis=0, return_inverse=True)
        a, b, c = inverse.reshape(3, -1) + len(v)
        v = np.concatenate([v, v[unique].mean(axis=1)])
        x, y, z = f.T
        f = np.concatenate([np.stack(t, 1) for t in ((x, a, c), (a, y, b), (c, b, z), (a, b, c))])
        v /= np.linalg.norm(v, axis=1, keepdims=True)
    return v, f


@pytest.mark.parametrize(("scale", "shift"), [(1.0, 0.0), (1e-6, 0.0), (1e6, 0.0), (1.0, 1e4), (3e-15, 0.0)])
@pytest.mark.parametrize("kind", ["bvh", "brute_force"])
def test_no_ray_leaves_a_closed_mesh(kind, scale, shift):
    v, f = icosphere(3 if kind == "bvh" else 1)
    v = v * scale + shift
    mesh = TriangleMesh(v, f)
    rng = np.random.default_rng(0)
    n = 100_000 if kind == "bvh" else 20_000
    # The vertices as float32 has them: the target is the very corner that triangles share.
    v = v.astype(np.float32).astype(float)
    o = shift + rng.uniform(-0.3, 0.3, (n, 3)) * scale
    weight = np.where(rng.uniform(size=(n, 1)) < 0.5, 0.0, rng.uniform(size=(n, 1)))
    face = f[rng.integers(0, len(f), n)]
    target = v[face[:, 0]] * (1 - weight) + v[face[:, 1]] * weight
    ray = Ray(o, target - o)
    structure = accel.build(mesh, kind)
    assert dr.all(structure.intersect(ray).valid)
    assert dr.all(structure.occluded(ray))


def test_rays_between_lattice_points_never_slip_through_a_plane():
    k = np.arange(33)
    x, y = (a.ravel() for a in np.meshgrid(k, k))
    at = (np.arange(32)[:, None] * 33 + np.arange(32)).ravel()
    faces = np.concatenate([np.stack([at, at + 1, at + 33], 1), np.stack([at + 1, at + 34, at + 33], 1)])
    plane = accel.build(TriangleMesh(np.stack([x, y, 0 * x], 1), faces))
    rng = np.random.default_rng(0)
    target = np.c_[rng.integers(1, 64, (50_000, 2)) / 2, np.zeros(50_000)]
    o = np.c_[rng.integers(0, 32, (50_000, 2)), rng.choice([-5.0, 0.25, 5.0], 50_000)]
    assert dr.all(plane.intersect(Ray(o, target - o)).valid)


def test_products_are_rounded_apart():
    t = types("float32")
    rng = np.random.default_rng(0)
    a, b, c, d = (t.Float(rng.normal(size=100_000).astype(np.float32)) for _ in range(4))
    dr.eval(a, b, c, d)
    one, other = a * b - c * d, c * d - a * b
    assert dr.all(one == -other)
    fused = dr.fma(a, b, -(c * d)) == -dr.fma(c, d, -(a * b))
    assert not dr.all(fused)  # what a compiler that contracts would have made of it


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_a_ray_in_a_triangles_plane_but_beside_it_meets_nothing(precision):
    rng = np.random.default_rng(1)
    # Slopes of few digits keep every ray in the plane exactly, where edge functions are nothing but rounding.
    slope = rng.integers(-9, 9, 2) / 10
    for seed in range(20):
        xy = np.random.default_rng(seed).uniform(-1, 1, (3, 2))
        corners = np.c_[xy, xy @ slope].astype(np.float32)
        a, b, c = corners
        away = rng.uniform(0.1, 2, (500, 1))
        o = a + (a - (b + c) / 2) * away
        hit = TriangleMesh(corners, [[0, 1, 2]]).intersect(Ray(o, np.repeat([c - b], 500, 0), precision=precision))
        assert not dr.any(hit.valid)


def test_both_sides_and_barycentric_weights():
    mesh = TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    hit = mesh.intersect(Ray([[0.25, 0.5, 3], [0.25, 0.5, -3]], [[0, 0, -2], [0, 0, 2]]))
    np.testing.assert_array_equal(hit.t, [1.5, 1.5])
    np.testing.assert_array_equal(hit.uv, [[0.25, 0.25], [0.5, 0.5]])
