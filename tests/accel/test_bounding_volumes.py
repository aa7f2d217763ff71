"""Flat lists of volumes give what brute force gives, to the bit, whatever the shape and the size of groups."""

import agreement_cases as cases
import drjit as dr
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from raytrace2 import accel
from raytrace2.accel.volume_groups import halved
from raytrace2.rays.ray import Ray
from raytrace2.surfaces.mesh import TriangleMesh
from raytrace2.surfaces.quadrics import Disk, Sphere
from raytrace2.surfaces.surface import Surface

SHAPES = ("sphere", "box", "oriented_box")
CASES = cases.cases(np.random.default_rng(0))
FLAT = cases.leaves(np.random.default_rng(0))


def assert_same(items: list[Surface], ray: Ray, precision: str, *kinds: str) -> int:
    """Compares closest and any hit of each kind with brute force; gives the number of hits."""
    slow = accel.build(items, "brute_force", precision=precision)
    a, shadow = slow.intersect(ray), slow.occluded(ray)
    dr.eval(a, shadow)
    for kind in kinds:
        fast = accel.build(items, kind, precision=precision)
        b = fast.intersect(ray)
        dr.eval(b)
        for name in ("t", "prim", "surface", "instance", "uv"):
            np.testing.assert_array_equal(getattr(a, name).numpy(), getattr(b, name).numpy(), f"{kind}: {name}")
        np.testing.assert_array_equal(shadow.numpy(), fast.occluded(ray).numpy(), f"{kind}: occluded")
    return int(np.isfinite(a.t.numpy()).sum())


def kinds(*options: str) -> list[str]:
    return [f"bounding_volumes:volume={shape}{''.join(',' + o for o in options)}" for shape in SHAPES]


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("name", CASES)
def test_agreement_to_the_bit(name, precision):
    case = CASES[name]
    ray = cases.rays(np.random.default_rng(1), case.points, 8_000, precision)
    assert assert_same(case.items(precision), ray, precision, *kinds("group_size=4")) > 400


@pytest.mark.parametrize(("scale", "shift"), [(1e-6, 0.0), (1e6, 0.0), (1.0, 1e4)])
@pytest.mark.parametrize("name", ["flat grid", "closed mesh", "all kinds"])
def test_agreement_at_any_scale_and_offset(name, scale, shift):
    items = [cases.moved(item, scale, shift) for item in FLAT[name]]
    ray = cases.rays(np.random.default_rng(2), cases.points_of(items), 8_000, "float32")
    assert_same(items, ray, "float32", *kinds("group_size=2"))


@pytest.mark.parametrize("group_size", ["1", "1000", "auto", "surface"])
def test_agreement_whatever_the_groups(group_size):
    items = FLAT["all kinds"]
    ray = cases.rays(np.random.default_rng(3), cases.points_of(items), 4_000, "float32")
    assert_same(items, ray, "float32", *kinds(f"group_size={group_size}"))


def test_more_volumes_than_a_chapter_holds():
    mesh = cases.icosphere(3)
    ray = cases.rays(np.random.default_rng(4), mesh.vertices, 8_000, "float32")
    assert accel.build(mesh, "bounding_volumes", group_size=1).statistics()["volumes"] == 1280
    assert_same([mesh], ray, "float32", *kinds("group_size=1"))


# Less than the smallest normal number, which a tiny component comes to where directions are scaled, is zero to some
# kernels and not to others.
small = st.floats(-2, 2, width=32).filter(lambda x: x == 0 or abs(x) > 1e-30)
coordinate = st.one_of(st.sampled_from([0.0, -0.0, 1.0, -1.0, 0.5]), small)
point = st.tuples(coordinate, coordinate, coordinate)


@settings(max_examples=15, deadline=None, derandomize=True)
@given(
    st.lists(st.tuples(point, point, point), min_size=1, max_size=8),
    st.lists(st.tuples(point, point.filter(lambda d: any(abs(x) > 1e-6 for x in d))), min_size=1, max_size=8),
)
def test_agreement_on_any_few_triangles(triangles, rays):
    corners = np.array(triangles).reshape(-1, 3)
    items = [TriangleMesh(corners, np.arange(len(corners)).reshape(-1, 3))]
    o, d = (np.array(v) for v in zip(*rays, strict=True))
    at = np.repeat(o, len(corners), axis=0)
    towards = np.tile(corners, (len(o), 1)) - at
    real = (np.abs(towards) > 1e-6).any(axis=1)
    ray = Ray(np.concatenate([o, at[real]]), np.concatenate([d, towards[real]]))
    assert_same(items, ray, "float32", *kinds("group_size=2"))


def test_rays_that_are_no_rays_miss_and_end():
    bad = [np.nan, np.inf, -np.inf]
    o = np.array([[b, 0, 0] for b in bad] + [[0, 0, -3]] * 4 + [[0, 0, -3]], dtype=float)
    d = np.array([[0, 0, 1]] * 3 + [[b, 0, 1] for b in bad] + [[0, 0, 0]] + [[0, 0, 1]], dtype=float)
    tmin, tmax = np.zeros(8), np.full(8, np.inf)
    for shape in SHAPES:
        structure = accel.build(Sphere(), "bounding_volumes", volume=shape)
        np.testing.assert_array_equal(structure.intersect(Ray(o, d, tmin, tmax)).valid, [False] * 7 + [True])
        for nan in (Ray(o[7], d[7], np.nan), Ray(o[7], d[7], 0.0, np.nan)):
            assert not structure.intersect(nan).valid[0] and not structure.occluded(nan)[0]


def test_empty_and_enclosing_nothing():
    ray = Ray([[0, 0, -3]], [[0, 0, 1]])
    empty = accel.build([], "bounding_volumes")
    assert not empty.intersect(ray).valid[0] and not empty.occluded(ray)[0]
    assert empty.statistics()["volumes"] == 0
    around = accel.build([empty, Disk()], "bounding_volumes", volume="sphere")
    assert around.intersect(ray).t[0] == 3 and around.statistics()["primitives"] == 1


@pytest.mark.parametrize("shape", SHAPES)
def test_a_hundred_thousand_of_the_same_and_points(shape):
    corners = np.array([(0.0, 0, 0), (1, 0, 0), (0, 1, 0), (3, 3, 3)])
    faces = np.tile([[0, 1, 2]], (100_000, 1))
    same = accel.build(TriangleMesh(corners, faces), "bounding_volumes", volume=shape, group_size=64)
    found = same.intersect(Ray([[0.2, 0.2, -1]], [[0, 0, 1]]))
    assert found.t[0] == 1 and found.prim[0] == 0
    dots = accel.build(TriangleMesh(corners, np.full((1000, 3), 3)), "bounding_volumes", volume=shape)
    assert not dots.intersect(Ray([[0.2, 0.2, -1]], [[0, 0, 1]])).valid[0]


@pytest.mark.parametrize(
    "options",
    [
        {"volume": "cone"}, {"group_size": 0}, {"group_size": "some"}, {"group_size": 2.5}, {"volume_cost": 0.0},
        {"primitive_cost": float("nan")},
    ],
)  # fmt: skip
def test_settings_that_make_no_sense_are_refused(options):
    with pytest.raises(ValueError, match=next(iter(options))):
        accel.build(Sphere(), "bounding_volumes", **options)


def test_one_group_for_each_surface_and_each_structure():
    rng = np.random.default_rng(0)
    items = [cases.soup(rng), Sphere(), cases.soup(rng, 3), accel.build(Disk()), accel.build(Sphere.at((3, 0, 0)))]
    found = accel.build(items, "bounding_volumes", group_size="surface").statistics()
    assert found["volumes"] == 5 and found["largest_group"] == 200


def test_tighter_shapes_promise_fewer_tests_where_things_are_slanted():
    t = np.linspace(0, 1, 400)[:, None]
    line = np.concatenate([t, t, t], axis=1) * 10
    rng = np.random.default_rng(0)
    corners = (line[:, None] + rng.normal(size=(400, 3, 3)) * 0.01).reshape(-1, 3)
    mesh = TriangleMesh(corners, np.arange(1200).reshape(-1, 3))
    ball, box, oriented = (accel.build(mesh, k) for k in kinds("group_size=16"))
    tests = [s.statistics()["expected_primitive_tests"] for s in (ball, box, oriented)]
    assert tests[2] < tests[1] / 3 < tests[0] / 4
    ray = Ray(np.tile([[5.0, 5.0, -20.0]], (200, 1)), rng.normal(size=(200, 3)) + [0, 0, 5])
    assert_same([mesh], ray, "float32", *kinds("group_size=16"))


def test_counts_are_those_of_the_list():
    mesh = cases.icosphere(2)
    ray = cases.rays(np.random.default_rng(6), mesh.vertices, 2_000, "float32")
    everything = Ray(ray.o, ray.d, dr.full(type(ray.tmin), 0, len(ray)), dr.full(type(ray.tmin), np.inf, len(ray)))
    structure = accel.build(mesh, "bounding_volumes", group_size=8)
    hit, counts = structure.count(everything)
    real = (ray.d.numpy() != 0).any(axis=0)
    listed, tested = (c.numpy().astype(int)[real] for c in (counts.volumes, counts.primitives))
    assert (counts.volumes.numpy()[~real] == 0).all()
    volumes = structure.statistics()["volumes"]
    # Those that were met are asked once more when their turn has come.
    assert (listed >= volumes).all() and (listed <= 2 * volumes).all() and (counts.nodes.numpy() == 0).all()
    sizes = np.diff(halved(*_bounds(mesh), 8)[-1].firsts)
    again = listed - volumes
    assert (tested >= np.where(hit.valid.numpy()[real], sizes.min(), 0)).all() and (tested <= again * sizes.max()).all()


def _bounds(mesh: TriangleMesh) -> tuple[np.ndarray, np.ndarray]:
    corners = mesh.vertices[mesh.faces]
    return corners.min(axis=1), corners.max(axis=1)
