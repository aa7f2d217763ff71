"""The quick test of triangles agrees with the watertight one wherever a ray is not within rounding of an edge."""

from __future__ import annotations

import functools

import drjit as dr
import numpy as np
import pytest

from raytrace2 import accel
from raytrace2.errors import SettingError
from raytrace2.rays.ray import Ray
from raytrace2.surfaces.instance import Instance
from raytrace2.surfaces.mesh import TriangleMesh
from raytrace2.surfaces.quadrics import Sphere

PRECISIONS = ("float32", "float64")


def soup(rng: np.random.Generator, n: int = 400) -> TriangleMesh:
    """``n`` triangles in the unit cube."""
    corners = rng.uniform(size=(n, 1, 3)) + rng.uniform(-0.1, 0.1, (n, 3, 3))
    return TriangleMesh(corners.reshape(-1, 3), np.arange(3 * n).reshape(-1, 3))


def rays_through(rng: np.random.Generator, precision: str, n: int = 20_000) -> Ray:
    """Rays through the unit cube, from in and around it."""
    return Ray(rng.uniform(-1, 2, (n, 3)), rng.normal(size=(n, 3)), precision=precision)


def operations(query) -> list[int]:
    """The operations of each kernel of ``query``."""
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        dr.eval(query())
        return [k["operation_count"] for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT]


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("kind", [*accel.names(), "bvh:width=2", "bvh:builder=spatial", "bvh:volume=sphere"])
def test_fast_agrees_with_watertight(kind: str, precision: str) -> None:
    rng = np.random.default_rng(0)
    surfaces, ray = [soup(rng), Sphere()], rays_through(rng, precision)
    safe = accel.build(surfaces, kind, precision=precision)
    fast = accel.build(surfaces, kind, precision=precision, intersection="fast")
    a, b = safe.intersect(ray), fast.intersect(ray)
    same = np.array(a.prim == b.prim) & np.array(a.surface == b.surface)
    # What is left passes an edge, or a triangle edge-on, within rounding.
    assert (~same).sum() <= 4
    hit = same & np.array(a.valid)
    assert 0.2 < hit.mean() < 1
    unit = 2e-7 if precision == "float32" else 4e-16
    exact, quick = np.array(a.t)[hit], np.array(b.t)[hit]
    error = np.abs(quick - exact) / np.maximum(exact, 0.1)
    assert np.median(error) < 4 * unit
    assert np.quantile(error, 0.99) < 1000 * unit
    weights = np.abs(np.array(b.uv) - np.array(a.uv))[:, hit]
    assert np.quantile(weights, 0.99) < 1000 * unit
    assert (np.array(safe.occluded(ray)) != np.array(fast.occluded(ray))).sum() <= 4


@pytest.mark.parametrize("precision", PRECISIONS)
def test_triangles_that_are_lines_or_points_are_not_met(precision: str) -> None:
    corners = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [1, 1, 0], [1, 1, 0], [1, 1, 0]])
    mesh = TriangleMesh(corners, [[0, 1, 2], [3, 4, 5]])
    rng = np.random.default_rng(1)
    target = np.concatenate([rng.uniform(0, 2, (500, 1)) * [1, 0, 0], np.tile([1.0, 1, 0], (500, 1))])
    o = rng.normal(size=(1000, 3))
    # In the plane of both, and along the line, too.
    o[::3, 2] = 0
    o[::7, 1:] = 0
    fast = accel.build(mesh, "brute_force", precision=precision, intersection="fast")
    hit = fast.intersect(Ray(o, target - o, precision=precision))
    assert not np.array(hit.valid).any()


def test_structures_inside_keep_their_own() -> None:
    rng = np.random.default_rng(2)
    mesh, ray = soup(rng), rays_through(rng, "float32")
    safe, fast = (accel.build(mesh, intersection=how) for how in ("watertight", "fast"))
    assert safe.geometry.intersection == "watertight"
    wanted = {how: s.intersect(ray).t.numpy() for how, s in (("watertight", safe), ("fast", fast))}
    assert (wanted["watertight"] != wanted["fast"]).any()
    for how, inner in (("watertight", safe), ("fast", fast)):
        for outer in ("watertight", "fast"):
            nested = accel.build([inner], "brute_force", intersection=outer)
            np.testing.assert_array_equal(nested.intersect(ray).t, wanted[how])
            placed = accel.build([Instance(inner, np.eye(4))], "brute_force", intersection=outer)
            np.testing.assert_array_equal(placed.intersect(ray).t, wanted[how])


def test_refitted_structures_keep_their_own() -> None:
    rng = np.random.default_rng(3)
    mesh, ray = soup(rng), rays_through(rng, "float32")
    moved = TriangleMesh(mesh.vertices + rng.normal(size=mesh.vertices.shape) * 0.01, mesh.faces)
    fast = accel.build(mesh, "bvh", intersection="fast").refit(moved)
    anew = accel.build(moved, "bvh", intersection="fast")
    assert fast.geometry.intersection == "fast"
    assert operations(lambda: fast.intersect(ray)) == operations(lambda: anew.intersect(ray))
    assert (np.array(fast.intersect(ray).prim) != np.array(anew.intersect(ray).prim)).sum() <= 4


@pytest.mark.parametrize("precision", PRECISIONS)
def test_fast_is_less_to_do(precision: str) -> None:
    rng = np.random.default_rng(4)
    mesh, ray = soup(rng), rays_through(rng, precision)
    dr.eval(ray)
    for kind in accel.names():
        safe, fast = (accel.build(mesh, kind, precision=precision, intersection=h) for h in ("watertight", "fast"))
        for query in ("intersect", "occluded"):
            counts = [sum(operations(functools.partial(getattr(s, query), ray))) for s in (fast, safe)]
            assert counts[0] < counts[1], (kind, query)


def test_the_way_may_be_written_with_the_kind() -> None:
    mesh = soup(np.random.default_rng(5), 10)
    assert accel.build(mesh, "bvh:intersection=fast,max_leaf_size=2").geometry.intersection == "fast"
    assert accel.build(mesh, "grid:intersection=watertight").geometry.intersection == "watertight"
    with pytest.raises(SettingError, match="intersection must be one of watertight, fast, not 'loose'"):
        accel.build(mesh, intersection="loose")
