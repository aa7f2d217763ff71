"""Doors of the quadrics and of instances, and their digits at a distance and edge-on."""

import numpy as np
import pytest
import surface_cases as cases

from raytrace2 import accel
from raytrace2.errors import GeometryError
from raytrace2.rays.ray import Ray
from raytrace2.surfaces.instance import Instance
from raytrace2.surfaces.quadrics import Cylinder, Disk, Rectangle, Sphere

KINDS = [Sphere, Rectangle, Disk, Cylinder]


@pytest.mark.parametrize("kind", [*KINDS, lambda m: Instance(accel.build(Sphere()), m)])
def test_maps_that_are_none_are_refused(kind):
    projective = np.eye(4)
    projective[3, 0] = 1
    for bad in (np.eye(3), np.zeros((4, 4)), np.diag([1, 1, 0, 1]), np.eye(4) * np.nan, projective, np.eye(4) + np.inf):
        with pytest.raises(GeometryError, match="to_world") as caught:
            kind(bad)
        assert "\n" not in str(caught.value)


def test_uneven_spheres_are_refused():
    for bad in (np.diag([1, 2, 1, 1.0]), np.diag([1, 1, 1.01, 1.0])):
        with pytest.raises(GeometryError, match="evenly"):
            Sphere(bad)
    with pytest.raises(GeometryError, match="radius"):
        Sphere.at(radius=0)
    Sphere(cases.matrix(0, 1e-6, True))


def test_what_instances_are_refused():
    with pytest.raises(GeometryError, match="structure"):
        Instance(Sphere())
    with pytest.raises(GeometryError, match="nest"):
        Instance(accel.build(Instance(accel.build(Sphere()))))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("distance", [3, 1e3, 1e6])
def test_digits_hold_from_afar(kind, distance):
    """The same float32 rays in both precisions: from a million radii away nothing is lost but the digits of t."""
    rng = np.random.default_rng(0)
    n = 10_000
    o = rng.normal(size=(n, 3))
    o *= distance / np.linalg.norm(o, axis=1, keepdims=True)
    d = (rng.uniform(-1, 1, (n, 3)) - o) / distance
    o, d = o.astype(np.float32), d.astype(np.float32)
    item = kind(cases.matrix(1))
    found = []
    for precision in ("float32", "float64"):
        structure = accel.build(item, "brute_force", precision=precision)
        ray = Ray(o, d, precision=precision)
        found.append(structure.interact(ray, structure.intersect(ray)))
    single, double = found
    assert (single.valid.numpy() != double.valid.numpy()).sum() <= 2
    both = single.valid.numpy() & double.valid.numpy()
    assert both.sum() > n / 5
    t = double.t.numpy()[both]
    assert (np.abs(single.t.numpy()[both] - t) / t).max() < 3e-6
    off = np.abs(single.p.numpy() - double.p.numpy()).max(axis=0)[both]
    assert np.median(off) < 3e-7
    assert np.quantile(off, 0.99) < 1e-4  # near the rim t cannot tell one side from the other


@pytest.mark.parametrize("kind", [Rectangle, Disk])
def test_flat_shapes_edge_on(kind):
    rng = np.random.default_rng(0)
    angle = rng.uniform(0, 2 * np.pi, 5000)
    target = np.c_[rng.uniform(-0.5, 0.5, (5000, 2)), np.zeros(5000)]
    for slope in (1e-2, 1e-5, 1e-8):
        d = np.stack([np.cos(angle), np.sin(angle), np.full(5000, slope)], 1)
        ray = Ray(target - 2 * d, d)
        hit = accel.build(kind()).intersect(ray)
        assert hit.valid.numpy().all()
        np.testing.assert_allclose(hit.t, 2, rtol=1e-6)
    flat = Ray([[-2, 0, 0], [0, 0, 0]], [[1, 0, 0], [0, 1, -0.0]])
    assert not accel.build(kind()).intersect(flat).valid.numpy().any()


def test_grazing_a_sphere():
    """Further from the rim than rounding: a hit inside, a miss outside."""
    sphere = accel.build(Sphere())
    for gap in (1e-6, 1e-5, 1e-3):
        hit = sphere.intersect(Ray([[1 - gap, 0, -5], [1 + gap, 0, -5]], [0, 0, 1]))
        np.testing.assert_array_equal(hit.valid, [True, False])
        np.testing.assert_allclose(hit.t.numpy()[0], 5 - np.sqrt(2 * gap - gap**2), rtol=2e-4)


@pytest.mark.parametrize("kind", [Sphere, Cylinder])
def test_from_inside_the_far_wall_is_met(kind):
    m = np.eye(4)
    m[2, 3] = -0.5 if kind is Cylinder else 0
    rng = np.random.default_rng(0)
    d = rng.normal(size=(1000, 3)) * [1, 1, 0.2]
    hit = accel.build(kind(m)).intersect(Ray(np.zeros((1000, 3)), d))
    reach = np.linalg.norm(d[:, : 2 if kind is Cylinder else 3], axis=1)
    met = np.abs(d[:, 2] / reach) < 0.499 if kind is Cylinder else np.ones(1000, bool)
    np.testing.assert_allclose(hit.t.numpy()[met], 1 / reach[met], rtol=1e-5)
