"""At the extremes every structure gives what brute force gives, to the bit; what is no ray is a miss."""

import drjit as dr
import extremes
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings

from raytrace2 import accel
from raytrace2.errors import GeometryError
from raytrace2.rays.ray import Ray
from raytrace2.surfaces.mesh import TriangleMesh

PRECISIONS = ("float32", "float64")
OTHERS = [kind for kind in accel.names() if kind != "brute_force"]


def answers(structure, ray):
    hit = structure.intersect(ray)
    fields = {"t": hit.t, "prim": hit.prim, "surface": hit.surface, "uv": hit.uv, "occluded": structure.occluded(ray)}
    dr.eval(fields)  # one kernel
    valid = hit.valid.numpy()
    return {k: np.where(valid, v.numpy(), 0) if k == "uv" else v.numpy() for k, v in fields.items()}


def assert_agreement(surfaces, rays, precision, kinds=OTHERS):
    o, d, tmin, tmax = rays
    with np.errstate(over="ignore", invalid="ignore"):
        ray = Ray(o, d, tmin, tmax, precision=precision)
        wanted = answers(accel.build(surfaces, "brute_force", precision=precision), ray)
        real = extremes.are_rays(ray.o.numpy().T, ray.d.numpy().T)
    assert not np.isfinite(wanted["t"][~real]).any()
    assert not wanted["occluded"][~real].any()
    # What lies where t is beyond the largest number is not met.
    for seen in (np.isfinite(wanted["t"]), wanted["occluded"]):
        np.testing.assert_array_equal(seen, wanted["surface"] != 0xFFFFFFFF)
    for kind in kinds:
        found = answers(accel.build(surfaces, kind, precision=precision), ray)
        for key, value in wanted.items():
            np.testing.assert_array_equal(found[key], value, err_msg=f"{kind} {precision} {key}")
    return wanted


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("name", extremes.MESHES)
def test_every_mesh(name, precision):
    rng = np.random.default_rng(1)
    mesh = extremes.MESHES[name](rng)
    wanted = assert_agreement(TriangleMesh(*mesh), extremes.rays(rng, mesh, 2000), precision)
    assert np.isfinite(wanted["t"]).any()


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize(("scale", "offset"), [(2.0**-60, 0), (2.0**60, 0), (1, 1e7)])
def test_every_scale_and_offset(scale, offset, precision):
    rng = np.random.default_rng(2)
    meshes, rays = [], []
    for name in ("tetrahedron", "slivers", "duplicates"):
        mesh = extremes.MESHES[name](rng)
        mesh, found = extremes.moved(mesh, extremes.rays(rng, mesh, 1000), scale, offset)
        meshes.append(TriangleMesh(*mesh))
        rays.append(found)
    assert_agreement(meshes, [np.concatenate(part) for part in zip(*rays, strict=True)], precision)


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize(("scale", "offset"), [(1, 0), (2.0**-40, 0), (1, 1e4)])
def test_quadrics(scale, offset, precision):
    rng = np.random.default_rng(3)
    mesh, rays = extremes.sheet(), extremes.rays(rng, extremes.sheet(), 1000)
    _, rays = extremes.moved(mesh, rays, scale, offset)
    assert_agreement(extremes.quadrics(scale, offset), rays, precision)


@settings(max_examples=4, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(extremes.scenes())
def test_anything(scene):
    (vertices, faces), rays = scene
    for precision in PRECISIONS:
        assert_agreement(TriangleMesh(vertices, faces), rays, precision)


@pytest.mark.parametrize("kind", OTHERS)
def test_hundreds_of_thousands_in_the_same_place(kind):
    """Built in bounded time and depth, and every ray that misses them all is quick."""
    structure = accel.build(TriangleMesh(*extremes.coincident(100_000)), kind)
    o = np.array([[0.2, 0.2, 2.0], [3.0, 3.0, 2.0]])
    hit = structure.intersect(Ray(o, [[0, 0, -1]]))
    np.testing.assert_array_equal(hit.prim, [0, 0xFFFFFFFF])


@pytest.mark.parametrize("value", extremes.NO_NUMBERS)
def test_geometry_without_numbers_is_refused(value):
    vertices, faces = extremes.tetrahedron()
    vertices[2, 1] = value
    with pytest.raises(GeometryError, match="vertices 2"):
        TriangleMesh(vertices, faces)
