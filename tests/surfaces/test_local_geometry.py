"""Interactions against Mitsuba's, and against closed forms in float64."""

import numpy as np
import pytest
import surface_cases as cases

from raytrace2 import accel
from raytrace2.rays.ray import Ray
from raytrace2.surfaces.instance import Instance
from raytrace2.surfaces.quadrics import Cylinder, Disk, Rectangle, Sphere

FIELDS = ("t", "p", "n", "uv", "dp_du", "dp_dv", "wi")


@pytest.fixture(scope="module")
def mi():
    mitsuba = pytest.importorskip("mitsuba")
    mitsuba.set_variant("llvm_ad_rgb")
    return mitsuba


def compare(mi, shapes, items, *, tolerance=1e-4, typical=1e-6, rays=4000):
    """Almost all lanes within rounding, none further than what grazing makes of it."""
    o, d = cases.rays(rays)
    scene = mi.load_dict({"type": "scene", **shapes})  # must outlive the kernel that reads it
    theirs = scene.ray_intersect(mi.Ray3f(mi.Point3f(o.T.copy()), mi.Vector3f(d.T.copy())))
    structure = accel.build(items)
    ray = Ray(o, d)
    ours = structure.interact(ray, structure.intersect(ray))
    met, met_there = ours.valid.numpy(), np.array(theirs.is_valid())
    assert (met != met_there).sum() <= 1  # at a silhouette
    both = met & met_there
    assert both.sum() > rays / 10
    pairs = [(name, getattr(ours, name), getattr(theirs, name)) for name in FIELDS]
    pairs += [(f"sh_frame.{k}", getattr(ours.sh_frame, k), getattr(theirs.sh_frame, k)) for k in "stn"]
    for name, a, b in pairs:
        a, b = np.atleast_2d(np.array(a))[:, both], np.atleast_2d(np.array(b))[:, both]
        error = np.abs(a - b).max(axis=0) / np.maximum(1, np.abs(b).max(axis=0))
        if name == "uv":  # the azimuth wraps around
            error = np.minimum(error, np.abs(1 - np.abs(a - b)).max(axis=0))
        assert np.median(error) < typical, name
        assert np.quantile(error, 0.995) < tolerance, name
        assert error.max() < 100 * tolerance, name


@pytest.mark.parametrize("flipped", [False, True])
@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("kind", cases.QUADRICS)
def test_quadric_equals_mitsubas(mi, kind, mirrored, flipped):
    to_world = cases.matrix(1, cases.SCALES[kind], mirrored)
    shape = {"type": kind, "to_world": mi.ScalarTransform4f(to_world), "flip_normals": flipped}
    # Mitsuba turns mirrored spheres inside out; here only flip_normals does.
    inward = flipped != (mirrored and kind == "sphere")
    compare(mi, {"shape": shape}, [cases.QUADRICS[kind](to_world, inward)])


@pytest.mark.parametrize("uv", [False, True])
@pytest.mark.parametrize("normals", [False, True])
def test_mesh_equals_mitsubas(mi, normals, uv):
    ours = cases.mesh(normals, uv)
    compare(mi, {"mesh": cases.mitsuba_mesh(mi, ours)}, [ours])


@pytest.mark.parametrize("mirrored", [False, True])
def test_instance_equals_mitsubas(mi, mirrored, tmp_path):
    items, structure = cases.group()
    path = str(tmp_path / "mesh.ply")
    cases.mitsuba_mesh(mi, items[0]).write_ply(path)
    shapes = {"type": "shapegroup", "mesh": {"type": "ply", "filename": path}}
    for kind, item in zip(cases.QUADRICS, items[1:], strict=True):
        shapes[kind] = {"type": kind, "to_world": mi.ScalarTransform4f(item.to_world)}
    places = [cases.matrix(5, (0.5, 0.9, 0.7), mirrored), cases.matrix(6, 0.4, not mirrored)]
    scene = {"group": shapes}
    for k, m in enumerate(places):
        reference = {"type": "ref", "id": "group"}
        scene[f"i{k}"] = {"type": "instance", "to_world": mi.ScalarTransform4f(m), "shapegroup": reference}
    compare(mi, scene, [Instance(structure, m) for m in places])


def interact64(item, o, d):
    structure = accel.build(item, precision="float64")
    ray = Ray(o, d, precision="float64")
    return structure.interact(ray, structure.intersect(ray))


def test_sphere_is_the_closed_form():
    center, radius = np.array([0.3, -0.2, 0.5]), 1.7
    rng = np.random.default_rng(0)
    at = rng.normal(size=(3, 500))
    at /= np.linalg.norm(at, axis=0)
    point = center[:, None] + radius * at
    d = -at + 0.3 * rng.normal(size=at.shape)
    d *= np.sign((d * -at).sum(axis=0))
    si = interact64(Sphere.at(center, radius), (point - 2 * d).T, d.T)
    theta, phi = np.arccos(at[2]), np.arctan2(at[1], at[0]) % (2 * np.pi)
    np.testing.assert_allclose(si.t, 2, atol=1e-12)
    np.testing.assert_allclose(si.p, point, atol=1e-12)
    np.testing.assert_allclose(si.n, at, atol=1e-12)
    np.testing.assert_allclose(si.uv, [phi / (2 * np.pi), theta / np.pi], atol=1e-12)
    zero = np.zeros_like(phi)
    dp_du = 2 * np.pi * radius * np.sin(theta) * np.stack([-np.sin(phi), np.cos(phi), zero])
    dp_dv = np.stack([np.cos(theta) * np.cos(phi), np.cos(theta) * np.sin(phi), -np.sin(theta)]) * np.pi * radius
    np.testing.assert_allclose(si.dp_du, dp_du, atol=2e-11)
    np.testing.assert_allclose(si.dp_dv, dp_dv, atol=2e-11)


def test_flat_shapes_are_the_closed_form():
    rng = np.random.default_rng(1)
    x, y = rng.uniform(-0.7, 0.7, (2, 300))
    m = cases.matrix(2, (1.0, 0.5, 2.0), True)
    local = np.stack([x, y, 0 * x])
    point = m[:3, :3] @ local + m[:3, 3:]
    d = rng.normal(size=point.shape)
    rectangle, disk = (interact64(kind(m), (point - 3 * d).T, d.T) for kind in (Rectangle, Disk))
    for si in (rectangle, disk):
        np.testing.assert_allclose(si.t, 3, atol=1e-11)
        np.testing.assert_allclose(si.p, point, atol=1e-11)
        np.testing.assert_allclose(si.sh_frame.n, np.outer(m[:3, 2] / 2, np.ones(300)), atol=1e-12)
    r, phi = np.hypot(x, y), np.arctan2(y, x)
    np.testing.assert_allclose(rectangle.uv, [(x + 1) / 2, (y + 1) / 2], atol=1e-11)
    np.testing.assert_allclose(rectangle.dp_du, np.outer(2 * m[:3, 0], np.ones(300)), atol=1e-12)
    np.testing.assert_allclose(disk.uv, [r, phi % (2 * np.pi) / (2 * np.pi)], atol=1e-9)
    np.testing.assert_allclose(disk.dp_du, m[:3, :2] @ [np.cos(phi), np.sin(phi)], atol=1e-9)
    np.testing.assert_allclose(disk.dp_dv, m[:3, :2] @ [-y, x] * 2 * np.pi, atol=1e-10)


def test_cylinder_is_the_closed_form():
    rng = np.random.default_rng(2)
    phi, z = rng.uniform(0, 2 * np.pi, 300), rng.uniform(0.05, 0.95, 300)
    m = cases.matrix(4, (0.6, 0.6, 1.5), True)
    out = np.stack([np.cos(phi), np.sin(phi), 0 * phi])
    point = m[:3, :3] @ (out + [[0], [0], [1]] * z) + m[:3, 3:]
    n = m[:3, :3] @ out / 0.6
    d = rng.normal(size=n.shape)
    d *= -np.sign((d * n).sum(axis=0))
    si = interact64(Cylinder(m), (point - 2 * d).T, d.T)
    np.testing.assert_allclose(si.p, point, atol=1e-10)
    np.testing.assert_allclose(si.n, n, atol=1e-10)
    np.testing.assert_allclose(si.uv, [phi / (2 * np.pi), z], atol=1e-10)
    np.testing.assert_allclose(si.dp_dv, np.outer(m[:3, 2], np.ones(300)), atol=1e-12)


def test_triangles_are_the_closed_form():
    mesh = cases.mesh(False, True)
    rng = np.random.default_rng(3)
    b1, b2 = rng.uniform(0.1, 0.4, (2, 100, 1))
    p0, p1, p2 = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    t0, t1, t2 = (mesh.uv[mesh.faces[:, k]] for k in range(3))
    point = p0 + b1 * (p1 - p0) + b2 * (p2 - p0)
    n = np.cross(p1 - p0, p2 - p0)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    # From so near that nothing is in the way.
    si = interact64(mesh, point + 1e-4 * n, -n)
    mine = np.array(si.prim) == np.arange(100)
    assert mine.sum() > 95
    uv = (t0 + b1 * (t1 - t0) + b2 * (t2 - t0))[mine]
    np.testing.assert_allclose(si.p.numpy().T[mine], point[mine], atol=1e-12)
    np.testing.assert_allclose(si.n.numpy().T[mine], n[mine], atol=1e-12)
    np.testing.assert_allclose(si.uv.numpy().T[mine], uv, atol=1e-9)
    spans = mine & (np.arange(100) >= 10)
    step = t1 - t0
    along = si.dp_du.numpy().T * step[:, :1] + si.dp_dv.numpy().T * step[:, 1:]
    np.testing.assert_allclose(along[spans], (p1 - p0)[spans], atol=1e-9)


def test_poles_and_centres_are_finite():
    for item, o, d in (
        (Sphere(), (0, 0, 3), (0, 0, -1)),
        (Sphere(), (0, 0, -3), (0, 0, 1)),
        (Disk(), (0, 0, 3), (0, 0, -1)),
    ):
        si = interact64(item, o, d)
        values = np.concatenate([np.array(v).ravel() for v in (si.p, si.n, si.uv, si.dp_du, si.dp_dv, si.sh_frame.s)])
        assert np.isfinite(values).all()
        np.testing.assert_allclose(np.linalg.norm(si.sh_frame.s.numpy()), 1, atol=1e-12)
