"""Grids, uniform and in each other's cells, give what brute force gives, to the bit, wherever rays come from."""

import agreement_cases as cases
import drjit as dr
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from raytrace2 import accel
from raytrace2.accel import grid_cells
from raytrace2.rays.ray import Ray
from raytrace2.surfaces.mesh import TriangleMesh
from raytrace2.surfaces.quadrics import Sphere
from raytrace2.surfaces.surface import Surface

KINDS = ("grid", "hierarchical_grid", "hierarchical_grid:levels=3,max_in_cell=2,density=4")
CASES = cases.cases(np.random.default_rng(0))
FLAT = cases.leaves(np.random.default_rng(0))


def assert_same(items: list[Surface], ray: Ray, precision: str, kinds: tuple[str, ...] = KINDS) -> int:
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


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("name", CASES)
def test_agreement_to_the_bit(name, precision):
    case = CASES[name]
    ray = cases.rays(np.random.default_rng(1), case.points, 8_000, precision)
    kinds = KINDS if "inside" not in name else KINDS[:2]
    assert assert_same(case.items(precision), ray, precision, kinds) > 400


@pytest.mark.parametrize(("scale", "shift"), [(1e-9, 0.0), (1e-6, 0.0), (1e6, 0.0), (1e9, 0.0), (1.0, 1e4)])
@pytest.mark.parametrize("name", ["triangle soup", "flat grid", "closed mesh"])
def test_agreement_at_any_scale_and_offset(name, scale, shift):
    items = [cases.moved(item, scale, shift) for item in FLAT[name]]
    ray = cases.rays(np.random.default_rng(2), cases.points_of(items), 8_000, "float32")
    assert_same(items, ray, "float32")


def slivers(rng: np.random.Generator, n: int, width: np.ndarray) -> TriangleMesh:
    """Triangles of length 1 and any slant, as narrow as ``width`` (n,)."""
    begin, along, across = (rng.normal(size=(n, 3)) for _ in range(3))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    third = begin + along * rng.uniform(size=(n, 1)) + across * width[:, None]
    return TriangleMesh(np.stack([begin, begin + along, third], 1).reshape(-1, 3), np.arange(3 * n).reshape(-1, 3))


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_slivers_are_found_from_everywhere(precision):
    rng = np.random.default_rng(3)
    items: list[Surface] = [slivers(rng, 500, 10.0 ** rng.uniform(-8, -1, 500))]
    assert_same(items, cases.rays(rng, cases.points_of(items), 16_000, precision), precision)


def test_diagonal_slivers_do_not_fill_their_boxes():
    shifts = np.random.default_rng(10).uniform(-0.05, 0.05, (20, 1, 3))
    corners = np.array([[0, 0, 0], [1, 1, 1], [0.5, 0.52, 0.49]]) + shifts
    mesh = TriangleMesh(corners.reshape(-1, 3), np.arange(60).reshape(-1, 3))
    points = np.random.default_rng(11).uniform(0, 1, (20_000, 1, 3)) + np.zeros((20_000, 3, 3))
    crowd = TriangleMesh(points.reshape(-1, 3), np.arange(60_000).reshape(-1, 3))
    alone = accel.build(crowd, "grid:density=8").statistics()
    both = accel.build([crowd, mesh], "grid:density=8").statistics()
    n = max(both["resolution"])
    assert n > 30
    assert both["references"] - alone["references"] < 20 * 3 * n**2 < 20 * n**3 / 10


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_rays_through_the_vertices_of_a_fine_mesh(precision):
    """Vertices by chance a rounding away from a wall: which side a primitive is listed on must not matter."""
    items: list[Surface] = [cases.icosphere(4)]
    for seed in range(3):
        ray = cases.rays(np.random.default_rng(seed), items[0].vertices, 16_000, precision)
        assert_same(items, ray, precision, KINDS[:2])


def teapot_in_a_stadium() -> list[Surface]:
    """Many tiny triangles, a huge flat floor and a huge slanted triangle."""
    small = cases.icosphere(4)
    slope = TriangleMesh([[-50, -50, -1], [50, -40, -2], [0, 60, 30.0]], [[0, 1, 2]])
    floor = TriangleMesh([[-50, -50, -1], [50, -50, -1], [50, 50, -1], [-50, 50, -1.0]], [[0, 1, 2], [0, 2, 3]])
    return [TriangleMesh(small.vertices * 0.1, small.faces), floor, slope]


def test_a_teapot_in_a_stadium():
    items = teapot_in_a_stadium()
    rng = np.random.default_rng(4)
    ray = cases.rays(rng, items[0].vertices, 8_000, "float32")
    assert assert_same(items, ray, "float32") > 4_000
    assert_same(items, cases.rays(rng, cases.points_of(items), 8_000, "float32"), "float32")
    found = accel.build(items, "grid").statistics()
    assert found["in_no_cell"] == 3
    assert found["longest_list"] < 40


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_rays_along_walls_and_from_walls_and_corners(precision):
    """A mesh whose vertices, and rays whose origins and directions, lie in the planes of walls."""
    items = FLAT["flat grid"] + [cases.moved(FLAT["closed mesh"][0], 0.5, 0.0)]
    for kind in KINDS[:2]:
        fast = accel.build(items, kind, precision=precision)
        lo, hi = fast.bounds()
        n = fast.statistics()["resolution"]
        walls = [lo[k] + (hi[k] - lo[k]) * np.arange(n[k] + 1) / n[k] for k in range(3)]
        x, y, z = np.meshgrid(walls[0][::3], walls[1][::3], walls[2], indexing="ij")
        o = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)
        signs = np.array([(a, b, c) for a in (-1, 0, 1) for b in (-1, 0, 1) for c in (-1, 0, 1) if a or b or c])
        ray = Ray(np.repeat(o, 26, axis=0), np.tile(signs, (len(o), 1)).astype(float), precision=precision)
        assert_same(items, ray, precision, (kind,))


@pytest.mark.parametrize("distance", [3.0, 30.0, 300.0, 3e4, 3e6, 3e12, 1e30])
def test_rays_from_far_away(distance):
    items = FLAT["closed mesh"] + [slivers(np.random.default_rng(9), 20, np.full(20, 1e-3))]
    rng = np.random.default_rng(5)
    aim = rng.uniform(-1, 1, (2_000, 3))
    o = rng.normal(size=aim.shape)
    o *= distance / np.linalg.norm(o, axis=1, keepdims=True)
    assert_same(items, Ray(o, aim - o), "float32")


@pytest.mark.parametrize("length", [1e-35, 1e-12, 1e12, 1e30])
def test_directions_of_any_length(length):
    rng = np.random.default_rng(6)
    ray = cases.rays(rng, cases.points_of(FLAT["triangle soup"]), 4_000, "float32")
    assert_same(FLAT["triangle soup"], Ray(ray.o, ray.d * length), "float32")


def test_rays_that_are_no_rays_meet_nothing():
    nan, inf = np.nan, np.inf
    o = [[nan, 0, 0], [0, 0, 0], [0, 0, -3], [0, 0, -3], [inf, 0, 0], [0, 0, -3], [0, 0, -3], [3e38, 3e38, -3e38]]
    d = [[0, 0, 1], [0, nan, 1], [0, 0, 0], [0, 0, inf], [0, 0, 1], [0, 0, 1], [0, 0, 1], [-1, -1, 1]]
    tmin, tmax = [0, 0, 0, 0, 0, nan, 5, 0], [inf, inf, inf, inf, inf, inf, 4, inf]
    for kind in KINDS:
        structure = accel.build(FLAT["closed mesh"], kind)
        assert not structure.intersect(Ray(o, d, tmin, tmax)).valid.numpy()[:7].any()
        assert not structure.occluded(Ray(o, d, tmin, tmax)).numpy()[:7].any()


@pytest.mark.parametrize("kind", KINDS)
def test_degenerate_geometry(kind):
    ray = Ray([[0, 0, -5], [0.25, 0.25, -5], [9, 9, 9]], [[0, 0, 1]] * 3)
    many = TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]] * 100_000)
    built = accel.build(many, kind)
    assert built.statistics()["references"] <= 16 * 100_000
    assert built.intersect(ray).prim.numpy()[1] == 0
    point = TriangleMesh([[2, 3, 4]], [[0, 0, 0]] * 3)
    assert not accel.build(point, kind).intersect(Ray([[2, 3, 0]], [[0, 0, 1]])).valid.numpy().any()
    nothing = accel.build([], kind)
    assert not nothing.intersect(ray).valid.numpy().any()
    assert not nothing.occluded(ray).numpy().any()
    assert nothing.statistics()["references"] == 0
    inside = accel.build([nothing, Sphere()], kind)
    assert inside.intersect(ray).t.numpy()[0] == 4


def test_each_other_s_leaves():
    inner = [accel.build(cases.soup(np.random.default_rng(k), 60), kind) for k, kind in enumerate((*KINDS[:2], "bvh"))]
    items = [
        *inner,
        accel.build([inner[0], cases.icosphere(1)], "hierarchical_grid"),
        cases.soup(np.random.default_rng(8)),
    ]
    ray = cases.rays(np.random.default_rng(7), cases.points_of([cases.icosphere(2)]), 4_000, "float32")
    assert assert_same(items, ray, "float32", KINDS[:2]) > 1_000


coordinate = st.one_of(
    st.sampled_from([0.0, -0.0, 1.0, -1.0, 0.5]), st.floats(-2, 2, width=32).filter(lambda x: x == 0 or abs(x) > 1e-6)
)
direction = st.tuples(coordinate, coordinate, coordinate).filter(lambda d: any(x != 0 for x in d))


@settings(max_examples=15, deadline=None, derandomize=True)
@given(
    st.lists(st.tuples(*[st.tuples(*[coordinate] * 3)] * 3), min_size=1, max_size=6),
    st.lists(st.tuples(st.tuples(*[coordinate] * 3), direction), min_size=1, max_size=8),
)
def test_agreement_on_any_few_triangles(corners, rays):
    items = [TriangleMesh(np.array(corners).reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))]
    o, d = (np.array(v) for v in zip(*rays, strict=True))
    for precision in ("float32", "float64"):
        assert_same(items, Ray(o, d, precision=precision), precision, ("grid:density=64",))


def test_clear_distances_are_what_they_say():
    rng = np.random.default_rng(0)
    shapes = np.array([[9, 7, 12], [5, 5, 5], [1, 30, 30], [5, 5, 5], [40, 40, 40]])
    count = shapes.prod(axis=1)
    first = np.cumsum(count) - count
    full = rng.uniform(size=count.sum()) < 0.004
    found = grid_cells.clear_distances(full, shapes, first)
    assert found.max() >= 3
    for shape, begin, n in zip(shapes, first, count, strict=True):
        block, clear = (v[begin : begin + n].reshape(shape) for v in (full, found))
        for place in np.argwhere(clear):
            r = int(clear[tuple(place)])
            assert (place >= r).all() and (place + r < shape).all()
            assert not block[tuple(slice(p - r, p + r + 1) for p in place)].any()


def test_statistics_count_what_there_is():
    items = [cases.soup(np.random.default_rng(11), 300)]
    stats = accel.build(items, "grid").statistics()
    assert 300 < stats["references"] < 300 * 16
    assert stats["duplication"] == stats["references"] / 300
    assert stats["cells"] == np.prod(stats["resolution"]) <= 4 * 300
    deep = accel.build(items, "hierarchical_grid:levels=3,max_in_cell=2,density=4").statistics()
    assert deep["depth"] == 3 and deep["nodes"] > 1


def test_the_same_every_time():
    mesh = cases.icosphere(4)
    for kind in KINDS:
        one, two = (accel.build(mesh, kind) for _ in range(2))
        for name in ("words", "lists", "lattices"):
            a, b = (getattr(s._grids, name).numpy().view(np.uint32) for s in (one, two))
            np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize(
    "kind",
    ["grid:density=0", "grid:density=nan", "grid:max_cells=0", "grid:max_cells=100000000", "grid:levels=2"]
    + [f"hierarchical_grid:{o}" for o in ("levels=1", "levels=4", "max_in_cell=0", "min_cell=1", "outer_density=-1")],
)
def test_options_that_make_no_sense_are_refused(kind):
    with pytest.raises((ValueError, TypeError)):
        accel.build(cases.icosphere(0), kind)
