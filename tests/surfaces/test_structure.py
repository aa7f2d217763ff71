"""Rays that are no rays, limits, masks, lists of nothing: an answer, never a hang or a crash."""

import numpy as np
import pytest
import surface_cases as cases

from raytrace2 import accel
from raytrace2.rays.ray import Ray
from raytrace2.surfaces.mesh import TriangleMesh
from raytrace2.surfaces.quadrics import Cylinder, Disk, Rectangle, Sphere
from raytrace2.types import types

NONE = 0xFFFFFFFF
BOTH = pytest.mark.parametrize("kind", accel.names())
WALLS = {
    "mesh": TriangleMesh([[-9, -9, 0], [9, -9, 0], [0, 9, 0]], [[0, 1, 2]]),
    "sphere": Sphere.at((0, 0, -1), 1),
    "rectangle": Rectangle(),
    "disk": Disk(),
    "cylinder": Cylinder(np.array([[0, 0, 1, -0.5], [0, 1, 0, 0], [1, 0, 0, -1], [0, 0, 0, 1.0]])),
}


def assert_missed(structure, ray, active=True, lanes=slice(None)):
    hit = structure.intersect(ray, active)
    assert np.isposinf(hit.t.numpy()[lanes]).all()
    for index in (hit.prim, hit.surface, hit.instance):
        assert (index.numpy()[lanes] == NONE).all()
    assert not structure.occluded(ray, active).numpy()[lanes].any()
    si = structure.interact(ray, hit)
    assert not si.valid.numpy()[lanes].any()
    assert np.isfinite(si.p.numpy()).all()


@BOTH
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_rays_that_are_none_miss(kind, precision):
    structure = accel.build(cases.everything(precision), kind, precision=precision)
    bad = []
    for k in range(6):
        for value in (np.nan, np.inf, -np.inf):
            ray = np.array([0.1, 0.2, 0.3, 0.5, 0.6, 0.7])
            ray[k] = value
            bad.append(ray)
    bad += [np.zeros(6), np.full(6, -0.0), np.full(6, np.nan), np.full(6, np.inf)]
    bad = np.array(bad)
    assert_missed(structure, Ray(bad[:, :3], bad[:, 3:], precision=precision))
    limits = [(np.nan, np.inf), (0, np.nan), (0, -1), (2, 1), (np.inf, np.inf), (0, -np.inf)]
    tmin, tmax = np.repeat(limits, 50, axis=0).T
    o, d = cases.rays(300)
    assert_missed(structure, Ray(o, d, tmin, tmax, precision=precision))


@BOTH
@pytest.mark.parametrize("wall", WALLS)
def test_limits_count_as_inside(kind, wall):
    structure = accel.build(WALLS[wall], kind)
    o, d = [[0.1, 0.05, 2.0]] * 6, [[0, 0, -1.0]] * 6
    at = structure.intersect(Ray(o[0], d[0])).t.numpy()[0]
    assert at == pytest.approx(2, abs=0.01)
    before, after = np.nextafter(at, np.float32(0)), np.nextafter(at, np.float32(9))
    tmin = [0, at, after, 0, 0, at]
    tmax = [at, np.inf, after, before, np.inf, at]
    hit = structure.intersect(Ray(o, d, tmin, tmax))
    assert (hit.t.numpy() == at).tolist() == [True, True, False, False, True, True]
    np.testing.assert_array_equal(structure.occluded(Ray(o, d, tmin, tmax)), np.isfinite(hit.t))


@BOTH
def test_nothing_to_meet(kind):
    structure = accel.build([], kind)
    assert structure.primitive_count == 0
    assert_missed(structure, Ray(*cases.rays(10)))
    assert_missed(accel.build([structure, structure], kind), Ray(*cases.rays(10)))
    lo, hi = structure.bounds()
    assert (lo > hi).all()
    assert structure.statistics()["primitives"] == 0


@BOTH
def test_one_ray_and_one_triangle(kind):
    structure = accel.build(WALLS["mesh"], kind)
    hit = structure.intersect(Ray([0, 0, 1], [0, 0, -1]))
    assert [hit.t.numpy().tolist(), hit.prim.numpy().tolist()] == [[1], [0]]
    # One origin or one limit for many.
    many = Ray([0, 0, 1], np.repeat([[0, 0, -1.0]], 5, 0))
    np.testing.assert_array_equal(structure.intersect(many).t, [1] * 5)
    limits = Ray([0, 0, 1], [0, 0, -1], tmin=np.array([0, 0.5, 1, 1.5]))
    np.testing.assert_array_equal(structure.intersect(limits).t, [1, 1, 1, np.inf])
    np.testing.assert_array_equal(structure.occluded(limits), [True, True, True, False])


@BOTH
def test_lanes_that_are_not_active_miss(kind):
    structure = accel.build(cases.everything("float32"), kind)
    o, d = cases.rays(400)
    ray = Ray(o, d)
    assert_missed(structure, ray, active=False)
    active = np.arange(400) % 3 == 0
    for mask in (active, types("float32").Bool(active)):
        assert_missed(structure, ray, mask, ~active)
        hit, free = structure.intersect(ray, mask), structure.intersect(ray)
        np.testing.assert_array_equal(hit.t.numpy()[active], free.t.numpy()[active])
    # One ray, many lanes.
    one = structure.intersect(Ray(o[0], d[0]), types("float32").Bool([True, False, True]))
    assert one.t.numpy().shape == (3,)
    assert one.prim.numpy()[1] == NONE


def test_a_surface_by_itself_answers():
    o, d = cases.rays(300)
    for item in cases.everything("float32"):
        ray = Ray(o, d)
        hit = item.intersect(ray)
        np.testing.assert_array_equal(item.occluded(ray), hit.valid)
        np.testing.assert_array_equal(hit.t, accel.build(item).intersect(ray).t)
        lo, hi = item.bounds()
        p = item.interact(ray, hit).p.numpy()[:, hit.valid.numpy()].T
        assert len(p)
        assert ((p >= lo - 1e-5) & (p <= hi + 1e-5)).all()


def test_build_refuses_what_it_does_not_know():
    with pytest.raises(ValueError, match="there are"):
        accel.build([], "octree")
    with pytest.raises(ValueError, match="option=value"):
        accel.build([], "bvh:fast")
    with pytest.raises(ValueError, match="no option 'speed'"):
        accel.build([], "bvh:speed=9")
    with pytest.raises(ValueError, match="speed"):
        accel.build([], "brute_force:speed=9")
    with pytest.raises(TypeError, match="Surfaces"):
        accel.build([np.eye(4)])
    with pytest.raises(ValueError, match="max_leaf_size"):
        accel.build([], "bvh:max_leaf_size=0")
    with pytest.raises(ValueError, match="precision"):
        accel.build([], precision="float16")
