"""kd-trees and BSP trees give what brute force gives, to the bit, and are bounded whatever they are built over."""

import agreement_cases as cases
import drjit as dr
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from raytrace2 import accel
from raytrace2.accel.kdtree_clip import clip_boxes
from raytrace2.errors import SettingError
from raytrace2.rays.ray import Ray
from raytrace2.surfaces.instance import Instance
from raytrace2.surfaces.mesh import TriangleMesh
from raytrace2.surfaces.quadrics import Disk, Sphere
from raytrace2.surfaces.surface import Surface

KINDS = ("kdtree", "bsp")
CASES = cases.cases(np.random.default_rng(0))
FLAT = cases.leaves(np.random.default_rng(0))


def assert_same(items: list[Surface], ray: Ray, precision: str, kinds: tuple[str, ...] = KINDS) -> int:
    """Compares closest and any hit of each kind with brute force; gives the number of hits."""
    slow = accel.build(items, "brute_force", precision=precision)
    a, shadow = slow.intersect(ray), slow.occluded(ray)
    dr.eval(a, shadow)
    for kind in kinds:
        fast = accel.build(items, kind, precision=precision)
        b, other = fast.intersect(ray), fast.occluded(ray)
        dr.eval(b, other)
        for name in ("t", "prim", "surface", "instance", "uv"):
            np.testing.assert_array_equal(getattr(a, name).numpy(), getattr(b, name).numpy(), f"{kind}: {name}")
        np.testing.assert_array_equal(shadow.numpy(), other.numpy(), f"{kind}: occluded")
    return int(np.isfinite(a.t.numpy()).sum())


def crowd(rng: np.random.Generator, n: int) -> TriangleMesh:
    corners = rng.uniform(-1, 1, (n, 1, 3)) + rng.normal(size=(n, 3, 3)) * 0.02
    return TriangleMesh(corners.reshape(-1, 3), np.arange(3 * n).reshape(-1, 3))


def slivers(rng: np.random.Generator, n: int) -> TriangleMesh:
    """Long thin triangles, nearly along one diagonal."""
    begin = rng.uniform(-1, 1, (n, 3))
    end = begin + np.array([0.5, 0.5, 0.5]) + rng.normal(size=(n, 3)) * 0.02
    third = end + rng.normal(size=(n, 3)) * 0.003
    return TriangleMesh(np.stack([begin, end, third], 1).reshape(-1, 3), np.arange(3 * n).reshape(-1, 3))


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("name", CASES)
def test_agreement_to_the_bit(name, precision):
    case = CASES[name]
    ray = cases.rays(np.random.default_rng(1), case.points, 8_000, precision)
    assert assert_same(case.items(precision), ray, precision) > 400


@pytest.mark.parametrize(("scale", "shift"), [(1e-9, 0.0), (1e6, 0.0), (1e9, 0.0), (1.0, 1e4)])
@pytest.mark.parametrize("name", ["triangle soup", "flat grid", "closed mesh", "all kinds"])
def test_agreement_at_any_scale_and_offset(name, scale, shift):
    items = [cases.moved(item, scale, shift) for item in FLAT[name]]
    assert_same(items, cases.rays(np.random.default_rng(2), cases.points_of(items), 8_000, "float32"), "float32")


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_slivers_are_found_from_everywhere(precision):
    rng = np.random.default_rng(3)
    items: list[Surface] = [slivers(rng, 400)]
    assert assert_same(items, cases.rays(rng, cases.points_of(items), 16_000, precision), precision) > 1_000


def test_rays_in_the_planes_of_splits():
    """Along the lines of a grid of points that are corners of triangles, hence places of planes; along either axis."""
    items: list[Surface] = [cases.grid_mesh(12, lambda x, y: 0.3 * np.round(3 * np.sin(3 * x) * np.cos(2 * y)) / 3)]
    rng = np.random.default_rng(4)
    lines = np.linspace(-1, 1, 13)
    o = np.stack([np.full(4_000, -3.0), rng.choice(lines, 4_000), rng.choice([-0.3, -0.1, 0, 0.1, 0.3], 4_000)], axis=1)
    o = np.stack([rng.permuted(row) for row in o])
    d = np.where(np.abs(o) == 3, 1.0, rng.choice([0.0, -0.0, 1e-12, -1e-9], o.shape))
    for precision in ("float32", "float64"):
        assert assert_same(items, Ray(o, d, precision=precision), precision) > 100


def test_one_triangle_larger_than_all_else():
    """A floor that reaches far beyond the cells it is listed in: its corners' rounding is felt near the ray."""
    rng = np.random.default_rng(5)
    floor = TriangleMesh(np.array([[-1e4, -1e4, -1.1], [2e4, -9e3, -0.9], [-8e3, 2e4, -1.0]]), np.array([[0, 1, 2]]))
    items = [crowd(rng, 300), floor]
    points = np.concatenate([rng.uniform(-1, 1, (300, 3)), rng.uniform(-1, 1, (300, 3)) * [1, 1, 0] - [0, 0, 1]])
    assert assert_same(items, cases.rays(rng, points, 16_000, "float32"), "float32") > 5_000


def test_trees_of_different_depth_in_turn():
    """Kernels of different stacks must not stand in for one another."""
    rng = np.random.default_rng(6)
    shallow, deep = [crowd(rng, 9)], [crowd(rng, 5_000)]
    for items in (shallow, deep, shallow, deep):
        assert_same(items, cases.rays(rng, np.array([[-1.0, -1, -1], [1, 1, 1]]), 2_000, "float32"), "float32")


@pytest.mark.parametrize(
    "options",
    ["max_leaf_size=1", "max_leaf_size=100", "max_depth=0", "max_depth=3", "empty_bonus=0.9", "intersection_cost=50"],
)
def test_agreement_whatever_the_options(options):
    items = FLAT["all kinds"]
    ray = cases.rays(np.random.default_rng(7), cases.points_of(items), 4_000, "float32")
    assert_same(items, ray, "float32", tuple(f"{kind}:{options}" for kind in KINDS))


coordinate = st.one_of(
    st.sampled_from([0.0, -0.0, 1.0, -1.0, 0.5]), st.floats(-2, 2, width=32).filter(lambda x: x == 0 or abs(x) > 1e-6)
)
direction = st.tuples(coordinate, coordinate, coordinate).filter(lambda d: any(x != 0 for x in d))


@settings(max_examples=20, deadline=None, derandomize=True)
@given(
    st.lists(st.tuples(coordinate, coordinate, coordinate), min_size=1, max_size=7),
    st.lists(st.tuples(*[st.integers(0, 6)] * 3), min_size=1, max_size=8),
    st.lists(st.tuples(st.tuples(*[coordinate] * 3), direction), min_size=1, max_size=8),
)
def test_agreement_on_any_small_mesh(vertices, faces, rays):
    v, f = np.array(vertices), np.array(faces) % len(vertices)
    items: list[Surface] = [TriangleMesh(v, f), TriangleMesh(v[::-1], f)]
    o, d = (np.array(values) for values in zip(*rays, strict=True))
    at = np.repeat(o, len(v), axis=0)
    towards = np.tile(v, (len(o), 1)) - at
    real = (towards != 0).any(axis=1)
    for precision in ("float32", "float64"):
        ray = Ray(np.concatenate([o, at[real]]), np.concatenate([d, towards[real]]), precision=precision)
        kinds = ("kdtree", "bsp:max_leaf_size=1,traversal_cost=0.1")
        assert_same(items, ray, precision, kinds)


@pytest.mark.parametrize("kind", KINDS)
def test_nested_in_each_other_and_under_instances(kind):
    rng = np.random.default_rng(8)

    def items() -> list[Surface]:
        inner = accel.build([crowd(rng, 60), Sphere.at((0, 0, 0), 0.3)], kind)
        other = accel.build([inner, Disk()], "kdtree" if kind == "bsp" else "bsp")
        return [other, *(Instance(inner, cases.matrix(rng, 0.5)) for _ in range(6))]

    ray = cases.rays(rng, rng.uniform(-1, 1, (100, 3)), 4_000, "float32")
    assert assert_same(items(), ray, "float32", (kind,)) > 500


@pytest.mark.parametrize("kind", KINDS)
def test_rays_that_are_no_rays_miss(kind):
    structure = accel.build(FLAT["triangle soup"], kind)
    bad = np.array([np.nan, np.inf, -np.inf, 0.0])
    o = np.zeros((8, 3))
    d = np.ones((8, 3))
    o[:3, 0], d[3:6, 1], d[6] = bad[:3], bad[:3], 0
    hit = structure.intersect(Ray(o, d))
    assert not hit.valid.numpy()[:7].any()
    assert not structure.occluded(Ray(o, d)).numpy()[:7].any()


@pytest.mark.parametrize("kind", KINDS)
def test_bounded_for_degenerate_input(kind):
    one = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    same = TriangleMesh(one, np.zeros((100_000, 3), int) + np.arange(3))
    point = TriangleMesh(np.zeros((1, 3)), np.zeros((1_000, 3), int))
    line = TriangleMesh(np.linspace(0, 1, 3_000)[:, None] * [1.0, 0, 0], np.arange(3_000).reshape(-1, 3))
    for items in ([same], [point], [line], [cases.grid_mesh(100)]):
        statistics = accel.build(items, kind).statistics()
        assert statistics["references"] <= 8 * statistics["primitives"]
        assert statistics["nodes"] < 8 * statistics["primitives"] + 100
    hit = accel.build(same, kind).intersect(Ray([[0.2, 0.2, 1]], [[0, 0, -1]]))
    assert hit.t.numpy() == [1] and hit.prim.numpy() == [0]


@pytest.mark.parametrize("kind", KINDS)
def test_over_nothing(kind):
    nothing = accel.build([], kind)
    assert nothing.statistics()["nodes"] == 0
    assert not nothing.intersect(Ray([[0, 0, 0]], [[0, 0, 1]])).valid.numpy().any()
    around = accel.build([nothing, Sphere()], kind)
    assert around.occluded(Ray([[0, 0, -3]], [[0, 0, 1]])).numpy().all()


@pytest.mark.parametrize("kind", KINDS)
def test_deterministic_and_described(kind):
    items = [crowd(np.random.default_rng(9), 2_000)]
    first, second = (accel.build(items, kind).statistics() for _ in range(2))
    assert {k: v for k, v in first.items() if k != "build_seconds"} == {
        k: v for k, v in second.items() if k != "build_seconds"
    }
    assert first["nodes"] == 2 * first["leaves"] - 1
    assert first["references"] == pytest.approx(first["duplication"] * 2_000)
    assert 0 < first["expected_primitives"] < 100 and 0 < first["expected_nodes"] < 500


def test_planes_are_perfect_splits():
    """Two rows of boxes with a gap and a step: planes go where boxes end, and no triangle is cut."""
    faces = [Sphere.at((x, y, 0), 0.25) for x in range(4) for y in range(4)]
    statistics = accel.build(faces, "kdtree:max_leaf_size=1,traversal_cost=0.1").statistics()
    assert statistics["references"] == 16
    assert statistics["leaves"] - statistics["empty_leaves"] == 16


def test_tilted_planes_keep_slivers_apart():
    mesh = slivers(np.random.default_rng(10), 2_000)
    kd, bsp = (accel.build(mesh, kind).statistics() for kind in KINDS)
    assert bsp["tilted_planes"] > 100
    assert bsp["references"] < kd["references"] / 2


def test_clipped_boxes_enclose_every_part():
    rng = np.random.default_rng(11)
    corners = rng.normal(size=(2_000, 3, 3)).astype(np.float32).astype(float)
    lo, hi = (f(corners, axis=1).astype(np.float32) for f in (np.min, np.max))
    axis = rng.integers(0, 3, 2_000)
    rows = np.arange(2_000)
    part = np.sort(rng.uniform(size=(2, 2_000)), axis=0)
    begin, end = (lo[rows, axis] + (hi - lo)[rows, axis] * p.astype(np.float32) for p in part)
    below, above = clip_boxes(lo, hi, axis, begin, end, corners)
    weight = rng.dirichlet([0.5] * 3, (200, 2_000))
    points = (weight[..., None] * corners).sum(axis=2)
    here = (points[:, rows, axis] >= begin) & (points[:, rows, axis] <= end)
    outside = ((points < below) | (points > above)).any(axis=2)
    assert here.any() and not (here & outside).any()
    # And they are tight: half the parts would fill less than 60 % of the slab's box.
    slab_lo, slab_hi = lo.copy(), hi.copy()
    slab_lo[rows, axis], slab_hi[rows, axis] = begin, end
    assert np.median(np.prod(above - below, axis=1) / np.prod(slab_hi - slab_lo, axis=1)) < 0.6


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "options", ["max_leaf_size=0", "max_depth=-1", "max_depth=121", "traversal_cost=0", "empty_bonus=1", "width=4"]
)
def test_settings_are_checked(kind, options):
    with pytest.raises(SettingError):
        accel.build(Sphere(), f"{kind}:{options}")
