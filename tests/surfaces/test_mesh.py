"""What a mesh accepts and refuses at the door."""

import numpy as np
import pytest

from raytrace2 import accel
from raytrace2.errors import GeometryError
from raytrace2.rays.ray import Ray
from raytrace2.surfaces.mesh import TriangleMesh
from raytrace2.types import types

V = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
F = np.array([[0, 1, 2]])


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ((V[:, :2], F), "shape"),
        ((V[None], F), "shape"),
        ((V, F[:, :2]), "shape"),
        ((V, [[0, 1, 3]]), "index 3"),
        ((V, [[0, 1, -1]]), "index -1"),
        ((V, [[0, 1, 2**32]]), "index 4294967296"),
        ((V, np.zeros((0, 3), int)), "no faces"),
        ((np.zeros((0, 3)), F), "0 vertices"),
        ((V, [[0, 1, 1.5]]), "integers"),
        ((V, [[0, 1, np.nan]]), "integers"),
        ((V, [["a", "b", "c"]]), "numbers"),
        ((V * np.nan, F), "finite"),
        ((V + np.inf, F), "finite"),
        ((V * 1e31, F), "1e+31"),
        ((V * 1e300, F), "1e+300"),
        (("abc", F), "numbers"),
        ((V, F, V), "uv"),
        ((V, F, V[:2, :2]), "2 uv for 3 vertices"),
        ((V, F, V[:, :2] * np.nan), "finite"),
        ((V, F, None, V[:, :2]), "normals"),
        ((V, F, None, V[:2]), "2 normals for 3 vertices"),
    ],
)
def test_refused_in_one_line(arguments, says):
    with pytest.raises(GeometryError, match=says.replace("+", r"\+")) as caught:
        TriangleMesh(*arguments, name="shape 7")
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith("shape 7: ")


def test_any_array_will_do():
    t, t64 = types("float32"), types("float64")
    strided = np.zeros((6, 6))
    strided[::2, ::2] = V
    vertices = [V, V.tolist(), V.astype(np.float32), np.asfortranarray(V), strided[::2, ::2], V.astype(int), V.ravel()]
    vertices += [t.Array3f(V.T), t64.Array3f(V.T), t.TensorXf(V), t.Float(V.ravel())]
    faces = [F, F.tolist(), F.astype(np.int64), F.astype(np.uint8), F.astype(float), F.ravel()]
    faces += [t.Array3u(F.T), t.UInt(F.ravel())]
    for v, f in [(v, F) for v in vertices] + [(V, f) for f in faces]:
        mesh = TriangleMesh(v, f, v[:, :2] if isinstance(v, np.ndarray) and v.ndim == 2 else None)
        np.testing.assert_array_equal(mesh.vertices, V)
        np.testing.assert_array_equal(mesh.faces, F)


def test_arrays_are_copied_and_kept():
    v = V.copy()
    mesh = TriangleMesh(v, F)
    v[:] = 9
    np.testing.assert_array_equal(mesh.vertices, V)
    with pytest.raises(ValueError, match="read-only"):
        mesh.vertices[0] = 1


def test_mitsuba_arrays_and_rays():
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    # Four vertices, so that rows and columns cannot be taken for one another.
    quad = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    faces = np.array([[0, 1, 2], [1, 3, 2]])
    mesh = TriangleMesh(mi.Point3f(quad.T.copy()), mi.Vector3u(faces.T.copy()), mi.Point2f(quad[:, :2].T.copy()))
    np.testing.assert_array_equal(mesh.vertices, quad)
    np.testing.assert_array_equal(mesh.faces, faces)
    o, d = np.array([[0.2, 0.3, 2], [0.9, 0.8, 2]]), np.array([[0, 0, -1.0], [0, 0, -1.0]])
    point, vector = mi.Point3f(o.T.copy()), mi.Vector3f(d.T.copy())
    limited = mi.Ray3f(point, vector)
    limited.maxt = mi.Float([5.0, 1.0])
    for structure in (mesh, accel.build(mesh)):
        for ray in (Ray(point, vector), Ray(mi.Ray3f(point, vector)), mi.Ray3f(point, vector)):
            hit = structure.intersect(ray)
            np.testing.assert_array_equal(hit.prim, [0, 1])
            np.testing.assert_allclose(structure.interact(ray, hit).uv.numpy(), o[:, :2].T, atol=1e-6)
        np.testing.assert_array_equal(structure.intersect(limited).t, [2, np.inf])


def test_rays_from_any_array():
    t = types("float32")
    o = np.array([[0.2, 0.3, 2], [0.1, 0.1, 3]])
    d = np.array([[0, 0, -1], [0, 0, -1]])
    both = np.concatenate([o, d], axis=1)
    mesh = accel.build(TriangleMesh(V, F))
    for ray in (
        Ray(o, d),
        Ray(o.tolist(), d.tolist()),
        Ray(both[:, :3], both[:, 3:]),
        Ray(np.asfortranarray(o), d.astype(np.int64)),
        Ray(t.Array3f(o.T.copy()), t.Array3f(0, 0, -1)),
        Ray(o, [0, 0, -1]),
        Ray(types("float64").Array3f(o.T.copy()), [0, 0, -1], precision="float32"),
    ):
        np.testing.assert_allclose(mesh.intersect(ray).t, [2, 3], rtol=1e-6)
    for bad in ((o[:, :2], d), (o, d[:1].repeat(3, 0)), (o,), (o, d, [[0.0]])):
        with pytest.raises(ValueError):
            Ray(*bad)


def test_precisions_do_not_mix():
    with pytest.raises(TypeError, match="float32"):
        accel.build(TriangleMesh(V, F)).intersect(Ray(V, V + 1, precision="float64"))
    with pytest.raises(TypeError, match="float64"):
        accel.build(accel.build(TriangleMesh(V, F), precision="float64"))
