"""No ray takes more turns through a structure than its module derives, and one that did would be told of."""

from __future__ import annotations

import drjit as dr
import numpy as np
import pytest

import raytrace2 as rt
from raytrace2 import accel
from raytrace2.errors import RayTraceError
from raytrace2.rays.ray import Ray
from raytrace2.surfaces.instance import Instance
from raytrace2.surfaces.mesh import TriangleMesh
from raytrace2.surfaces.quadrics import Sphere
from raytrace2.surfaces.turns import Turns

KINDS = [
    *accel.names(),
    "bvh:volume=sphere",
    "bvh:width=8,builder=spatial",
    "bounding_volumes:volume=oriented_box,group_size=4",
    "hierarchical_grid:density=16",
]


def soup(rng: np.random.Generator, n: int = 300) -> TriangleMesh:
    """Triangles in the unit cube, some large, some in its lattice planes, some many times over."""
    corners = rng.uniform(size=(n, 1, 3)) + rng.uniform(-0.1, 0.1, (n, 3, 3))
    corners[:20] = rng.uniform(size=(20, 3, 3))
    corners[20:60] = np.round(corners[20:60] * 4) / 4
    corners[60:100] = corners[60]
    return TriangleMesh(corners.reshape(-1, 3), np.arange(3 * n).reshape(-1, 3))


def extreme_rays(rng: np.random.Generator, precision: str, n: int = 600) -> Ray:
    """Rays along axes, in planes, from afar and from infinity, with directions of any size, and what is no ray."""
    o = rng.uniform(-0.5, 1.5, (n, 3))
    d = rng.normal(size=(n, 3))
    kind = np.arange(n) % 12
    d[kind == 0] = np.eye(3)[rng.integers(0, 3, (kind == 0).sum())]
    o[kind == 1] = np.round(o[kind == 1] * 4) / 4
    d[kind == 1, 0] = -0.0
    d[kind == 2] *= 1e-30
    d[kind == 3] *= 1e30
    o[kind == 4] *= 1e9
    d[kind == 4] = 0.5 - o[kind == 4]
    o[kind == 5] *= 1e37
    d[kind == 5] = -o[kind == 5]
    d[kind == 6, :2] *= 1e-42
    o[kind == 7, 0] = np.inf
    d[kind == 8, 1] = np.nan
    d[kind == 9] = 0
    o[kind == 10] *= 30
    d[kind == 10] = 0.5 - o[kind == 10]
    tmax = np.where(np.arange(n) % 5 == 0, np.inf, 10.0 ** rng.uniform(-3, 38, n))
    tmin = np.where(np.arange(n) % 7 == 0, -np.inf, 0.0)
    tmax[kind == 11] = np.nan
    return Ray(o, d, tmin, tmax, precision=precision)


def shorten(structure, most: int) -> None:
    """Let ``structure`` believe that rays take no more than ``most`` turns."""
    structure.turns = Turns(structure.types, structure.kind, most)


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("kind", KINDS)
def test_rays_end_within_the_bound(kind: str, precision: str) -> None:
    rng = np.random.default_rng(0)
    structure = accel.build([soup(rng), Sphere()], kind, precision=precision)
    ray = extreme_rays(rng, precision)
    _, counts = structure.count(ray)
    turns = np.array(counts.nodes).astype(np.int64) + np.array(counts.primitives)
    structure.check_turns()
    assert 0 < turns.max()
    # A turn may count for a node and a primitive.
    assert turns.max() <= 2 * structure.turns.most
    with dr.scoped_set_flag(dr.JitFlag.Debug, True):
        np.testing.assert_array_equal(structure.intersect(ray).t, structure.count(ray)[0].t)
        dr.eval(structure.occluded(ray))
        structure.check_turns()


@pytest.mark.parametrize("kind", KINDS)
def test_a_ray_that_takes_more_is_stopped_and_told_of(kind: str) -> None:
    rng = np.random.default_rng(1)
    structure = accel.build(soup(rng), kind)
    ray = Ray(rng.uniform(-0.5, 1.5, (500, 3)), rng.normal(size=(500, 3)))
    before = structure.intersect(ray).t.numpy()
    most = structure.turns.most
    shorten(structure, 2)
    message = f"{structure.kind}: a ray took more than 2 turns"
    dr.eval(structure.count(ray))
    with pytest.raises(RayTraceError, match=message):
        structure.check_turns()
    structure.check_turns()  # told once
    for query in (structure.intersect, structure.occluded):
        with dr.scoped_set_flag(dr.JitFlag.Debug, True):
            dr.eval(query(ray))
        with pytest.raises(RayTraceError, match=message):
            structure.intersect(ray)
    # Nobody watches: the bound is no part of the loop.
    np.testing.assert_array_equal(structure.intersect(ray).t, before)
    structure.check_turns()
    shorten(structure, most)
    np.testing.assert_array_equal(structure.count(ray)[0].t, before)
    structure.check_turns()


def test_bounds_that_are_met_exactly() -> None:
    rng = np.random.default_rng(2)
    mesh, ray = soup(rng), Ray([[5.0, 5, 5]], [[1.0, 0, 0]])
    scan = accel.build(mesh, "brute_force")
    assert scan.turns.most == len(mesh.faces)
    dr.eval(scan.count(ray))
    scan.check_turns()
    shorten(scan, len(mesh.faces) - 1)
    dr.eval(scan.count(ray))
    with pytest.raises(RayTraceError, match="brute_force"):
        scan.check_turns()
    # A stack of triangles: a ray beside them meets all of their boxes.
    k = np.arange(50.0)
    corners = np.stack(
        [np.stack([0 * k, 0 * k, k], 1), np.stack([0 * k + 1, 0 * k, k], 1), np.stack([0 * k, 0 * k + 1, k], 1)], 1
    )
    stack = TriangleMesh(corners.reshape(-1, 3), np.arange(150).reshape(-1, 3))
    ray = Ray([[0.7, 0.7, -1]], [[0, 0, 1.0]])
    bvh = accel.build(stack, "bvh")
    _, counts = bvh.count(ray)
    # A turn may visit a node and test the first primitive below it.
    found, tests = int(counts.nodes[0] + counts.primitives[0]), int(counts.primitives[0])
    assert found == bvh.statistics()["nodes"] + bvh.statistics()["references"] <= bvh.turns.most
    bvh.check_turns()
    shorten(bvh, found)
    dr.eval(bvh.count(ray))
    bvh.check_turns()
    shorten(bvh, tests - 1)
    dr.eval(bvh.count(ray))
    with pytest.raises(RayTraceError, match="bvh: a ray took more than"):
        bvh.check_turns()


@pytest.mark.parametrize("kind", accel.names())
def test_structures_inside_are_watched_too(kind: str) -> None:
    rng = np.random.default_rng(3)
    inner = accel.build(soup(rng), kind)
    ray = Ray(rng.uniform(-0.5, 1.5, (500, 3)), rng.normal(size=(500, 3)))
    for placed in (inner, Instance(inner, np.diag([2.0, 1, 1, 1]))):
        outer = accel.build([placed, Sphere()], "bvh")
        dr.eval(outer.count(ray))
        outer.check_turns()
        most = inner.turns.most
        shorten(inner, 2)
        dr.eval(outer.count(ray))
        with pytest.raises(RayTraceError, match=f"{inner.kind}: a ray took more than 2 turns"):
            outer.intersect(ray)
        shorten(inner, most)


@pytest.mark.parametrize("kind", ["bvh", "grid", "kdtree"])
def test_queries_in_symbolic_loops_are_watched(kind: str) -> None:
    rng = np.random.default_rng(4)
    structure = accel.build(soup(rng), kind)
    structure.prepare()
    shorten(structure, 2)
    ray = Ray(rng.uniform(-0.5, 1.5, (500, 3)), rng.normal(size=(500, 3)))
    UInt = structure.types.UInt

    def bounce(i, total):
        return i + 1, total + dr.select(structure.occluded(ray), UInt(1), UInt(0))

    with dr.scoped_set_flag(dr.JitFlag.Debug, True):
        state = (dr.zeros(UInt, 500), dr.zeros(UInt, 500))
        dr.eval(dr.while_loop(state, lambda i, total: i < 3, bounce))
    with pytest.raises(RayTraceError, match=structure.kind):
        structure.check_turns()


def test_what_nobody_watches_costs_nothing() -> None:
    rng = np.random.default_rng(5)
    ray = Ray(rng.uniform(-0.5, 1.5, (500, 3)), rng.normal(size=(500, 3)))
    dr.eval(ray)
    for kind in accel.names():
        structure = accel.build(soup(rng), kind)
        states = []
        while_loop = dr.while_loop

        def recorded(state, *rest, while_loop=while_loop, states=states, **options):
            states.append(state)
            return while_loop(state, *rest, **options)

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(dr, "while_loop", recorded)
            structure.intersect(ray)
            structure.occluded(ray)
        assert states
        assert all(any(part is None for part in state) for state in states)


def test_renders_tell_of_rays_that_were_stopped() -> None:
    film = {"type": "hdrfilm", "width": 8, "height": 8}
    scene = rt.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path"},
            "camera": {"type": "perspective", "film": film},
            "light": {"type": "constant"},
            "ball": {"type": "sphere", "center": [0, 0, 4]},
        }
    )
    structure = scene.traced().structure
    most = structure.turns.most
    shorten(structure, 0)
    with dr.scoped_set_flag(dr.JitFlag.Debug, True):
        with pytest.raises(RayTraceError, match="bvh: a ray took more than 0 turns"):
            rt.render(scene)
        shorten(structure, most)
        watched = np.array(rt.render(scene))
    np.testing.assert_array_equal(watched, rt.render(scene))
