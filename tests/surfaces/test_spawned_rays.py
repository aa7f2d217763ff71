"""Rays that leave a surface neither meet it again nor miss what lies behind it, at any scale and place."""

from __future__ import annotations

import numpy as np
import pytest
from test_triangle import icosphere

from raytrace2 import accel
from raytrace2.rays.ray import Ray
from raytrace2.stability import spawned
from raytrace2.stability.sweep import Counts
from raytrace2.stability.tracers import Ours
from raytrace2.surfaces.mesh import TriangleMesh
from raytrace2.surfaces.quadrics import Cylinder, Disk, Quadric, Rectangle, Sphere

N = 30_000


def outward(v: np.ndarray, f: np.ndarray) -> np.ndarray:
    """``f`` with normals that point away from the origin."""
    a, b, c = (v[f[:, k]] for k in range(3))
    return np.where(((np.cross(b - a, c - a) * (a + b + c)).sum(axis=1) > 0)[:, None], f, f[:, ::-1])


def directions(rng: np.random.Generator, n: int) -> np.ndarray:
    d = rng.normal(size=(n, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def leaving(structure, ray, rng, side: int, grazing: bool):
    """Where ``ray`` hits, rays into the half space that the normal points to (``side`` 1) or the other (-1)."""
    si = structure.interact(ray, structure.intersect(ray))
    n = si.n.numpy().T.astype(float)
    d = directions(rng, len(n))
    across = (d * n).sum(axis=1, keepdims=True)
    if grazing:
        d = d - across * n + n * 10.0 ** -rng.uniform(1, 5, (len(n), 1))
    else:
        d *= np.sign(across)
    d = type(si.p)(np.ascontiguousarray(side * d.T))
    return si, si.spawn_ray(d)


@pytest.mark.parametrize(
    ("precision", "beside_edges", "grazing"),
    [("float32", False, False), ("float32", True, False), ("float32", False, True), ("float64", True, False)],
)
@pytest.mark.parametrize("bumps", [0.0, 0.5])
@pytest.mark.parametrize(("scale", "shift"), [(1.0, 0.0), (1e-5, 0.0), (1.0, 1e4), (1e3, 1e6), (2.0**50, 0.0)])
def test_closed_meshes(scale, shift, bumps, precision, beside_edges, grazing):
    v, f = icosphere(3)
    f = outward(v, f)
    rng = np.random.default_rng(0)
    v = ((v * (1 + bumps * rng.uniform(size=(len(v), 1)))) * scale + shift).astype(np.float32).astype(float)
    structure = accel.build(TriangleMesh(v, f), precision=precision)
    o, d = shift + 0.3 * scale * rng.uniform(-0.5, 0.5, (N, 3)), directions(rng, N)
    if beside_edges:
        corners = v[f[rng.integers(0, len(f), N)]]
        weights = np.c_[rng.uniform(size=N), 10.0 ** -rng.uniform(2, 8, N)]
        edge = corners[:, 0] + weights[:, :1] * (corners[:, 1] - corners[:, 0])
        d = edge + weights[:, 1:] * (corners[:, 2] - edge) - o
        d /= np.linalg.norm(d, axis=1, keepdims=True)
    ray = Ray(o, d, precision=precision)
    for side in (1, -1):
        si, out = leaving(structure, ray, rng, side, grazing)
        assert si.valid.numpy().all()
        hit = structure.intersect(out)
        met = hit.valid.numpy()
        np.testing.assert_array_equal(structure.occluded(out), met)
        assert not (met & (hit.prim == si.prim).numpy()).any()
        # From inside every wall is met from behind, from outside from its front.
        n = structure.interact(out, hit).n.numpy().T
        behind = (n * out.d.numpy().T).sum(axis=1) > 0
        if side == -1:
            assert met.all()
            assert behind.all() or bumps == 0.5 or beside_edges
        else:
            assert not (met & behind).any()


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize(("scale", "shift"), [(1.0, 0.0), (1e-5, 0.0), (1.0, 1e4), (1e6, 0.0)])
@pytest.mark.parametrize("kind", [Sphere, Cylinder, Disk, Rectangle])
def test_quadrics(kind: type[Quadric], scale: float, shift: float, precision: str):
    rng = np.random.default_rng(1)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0] if kind is not Sphere else np.eye(3)
    m = np.eye(4)
    m[:3, :3], m[:3, 3] = scale * turn, shift
    structure = accel.build(kind(m), precision=precision)
    at = shift + scale * directions(rng, N) * 0.5
    ray = Ray(at, directions(rng, N), precision=precision)
    for side in (1, -1):
        si, out = leaving(structure, ray, rng, side, False)
        met = si.valid.numpy()
        assert met.any()
        again = structure.intersect(out).valid.numpy() & met
        if kind is Sphere and side == -1:
            assert again[met].all()
        elif kind is not Cylinder or side == 1:
            assert not again.any()


@pytest.mark.parametrize("gap", [1e-6, 1e-4])
@pytest.mark.parametrize("kind", ["mesh", "sphere"])
def test_a_gap_of_a_millionth_is_not_stepped_over(kind, gap):
    radius = 1e-3
    if kind == "mesh":
        v, f = icosphere(4)
        f = outward(v, f)
        shells = [TriangleMesh(v * radius * r, f) for r in (1.0, 1 + gap)]
    else:
        shells = [Sphere.at(radius=radius * r) for r in (1.0, 1 + gap)]
    structure = accel.build(shells)
    rng = np.random.default_rng(2)
    d = directions(rng, N)
    si, out = leaving(structure, Ray(np.zeros((N, 3)), d), rng, 1, False)
    assert (si.surface == 0).numpy().all()
    hit = structure.intersect(out)
    assert (hit.surface == 1).numpy().all()


def test_from_triangles_one_step_between_numbers_wide():
    # A million radii away, where 26 neighbours of an origin lie as far apart as the corners of its triangle.
    found = spawned.far([Ours("bvh", "float32")], "float32", Counts(other=100_000, longest=60.0))["bvh"]
    assert found["rays"] > 70_000
    assert (found["value"], found["self_hits"]) == (0, 0)


@pytest.mark.parametrize(("precision", "uneven"), [("float32", 3e-7), ("float64", 1e-14), ("float64", 1e-5)])
def test_from_spheres_whose_matrices_are_rounded(precision, uneven):
    rng = np.random.default_rng(1)
    matrix = np.eye(4)
    matrix[:3, :3] = 0.7 * np.linalg.qr(rng.normal(size=(3, 3)))[0] * (1 + uneven * rng.uniform(-1, 1, (3, 3)))
    structure = accel.build(Sphere(matrix), "brute_force", precision=precision)
    d = directions(rng, N)
    ray = Ray(directions(rng, N) * 0.6 - 2 * d, d, precision=precision)
    for side in (1, -1):
        si, onward = leaving(structure, ray, rng, side, False)
        assert np.array_equal(structure.occluded(onward).numpy(), si.valid.numpy() & (side < 0))
