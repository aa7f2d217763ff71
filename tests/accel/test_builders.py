"""Every builder makes trees that hold their contract, and hierarchies that meet what brute force meets."""

from __future__ import annotations

import agreement_cases as cases
import drjit as dr
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from raytrace2 import accel
from raytrace2.accel import BvhConfig
from raytrace2.accel.binary_layout import FREE_LEVELS, ranges
from raytrace2.accel.binary_tree import BinaryTree, surface_area
from raytrace2.accel.binned_sah import build_binned_sah
from raytrace2.accel.median import build_median
from raytrace2.accel.middle import build_middle
from raytrace2.accel.morton import build_morton
from raytrace2.accel.morton_codes import sorted_codes
from raytrace2.accel.ploc import build_ploc
from raytrace2.accel.spatial import build_spatial
from raytrace2.accel.sweep_sah import build_sweep
from raytrace2.accel.triangle_parts import part_boxes
from raytrace2.surfaces.mesh import TriangleMesh
from raytrace2.types import types

BUILDERS = {
    "median": build_median,
    "middle": build_middle,
    "sweep": build_sweep,
    "morton": build_morton,
    "ploc": build_ploc,
}
CASES = cases.cases(np.random.default_rng(0))
Boxes = tuple[np.ndarray, np.ndarray]


def check_tree(tree: BinaryTree, lo: np.ndarray, hi: np.ndarray) -> None:
    """The tree's contract, over primitives that may be in several leaves or several in a leaf."""
    inner, leaves = np.flatnonzero(tree.left >= 0), np.flatnonzero(tree.left < 0)
    left = tree.left[inner]
    assert set(tree.order) == set(range(len(lo)))
    assert (left > inner).all()
    assert np.array_equal(np.sort(np.concatenate([[0], left, left + 1])), np.arange(len(tree.left)))
    assert tree.count[0] == len(tree.order)
    assert np.array_equal(tree.count[inner], tree.count[left] + tree.count[left + 1])
    assert np.array_equal(tree.first[left], tree.first[inner])
    assert np.array_equal(tree.first[left + 1], tree.first[inner] + tree.count[left])
    assert (tree.count > 0).all()
    assert np.array_equal(tree.lo[inner], np.minimum(tree.lo[left], tree.lo[left + 1]))
    assert np.array_equal(tree.hi[inner], np.maximum(tree.hi[left], tree.hi[left + 1]))
    assert tree.lo.dtype == lo.dtype
    if len(tree.order) == len(lo):
        for k in leaves:
            inside = tree.order[tree.first[k] : tree.first[k] + tree.count[k]]
            assert np.array_equal(tree.lo[k], lo[inside].min(axis=0))
            assert np.array_equal(tree.hi[k], hi[inside].max(axis=0))


def soup(n: int, size: float = 0.1, dtype: str = "float32") -> Boxes:
    rng = np.random.default_rng(n)
    middle, half = rng.uniform(-1, 1, (n, 3)), rng.uniform(0, size, (n, 3))
    return (middle - half).astype(dtype), (middle + half).astype(dtype)


def cost(tree: BinaryTree) -> float:
    return float(surface_area(tree.lo, tree.hi).sum() / surface_area(tree.lo[0], tree.hi[0]))


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("name", BUILDERS)
def test_trees_hold_every_primitive_within_its_bounds(name: str, dtype: str) -> None:
    for n in (1, 2, 3, 7, 1000):
        lo, hi = soup(n, dtype=dtype)
        tree = BUILDERS[name](lo, hi)
        check_tree(tree, lo, hi)
        again = BUILDERS[name](lo, hi)
        assert np.array_equal(tree.order, again.order) and np.array_equal(tree.left, again.left)


@pytest.mark.parametrize("leaf_size", [2, 5])
def test_morton_leaves_hold_no_more_than_asked(leaf_size: int) -> None:
    lo, hi = soup(1000)
    tree = build_morton(lo, hi, leaf_size)
    check_tree(tree, lo, hi)
    assert tree.count[tree.left < 0].max() <= leaf_size
    assert tree.count[tree.left >= 0].min() > leaf_size


@st.composite
def boxes(draw: st.DrawFn) -> Boxes:
    n = draw(st.integers(1, 40))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    scale, offset = 2.0 ** draw(st.integers(-80, 80)), draw(st.sampled_from([0.0, 1.0, 1e7]))
    spread = 2.0 ** (rng.uniform(-draw(st.sampled_from([0, 20, 60])), 0, size=(n, 1)))
    middle = rng.uniform(-1, 1, size=(n, 3)) * spread
    if draw(st.booleans()):
        middle = np.round(middle * 4) / 4
    half = rng.uniform(0, draw(st.sampled_from([0.0, 1e-3, 1.0])), size=(n, 3)) * spread
    lo, hi = (((middle + s * half + offset) * scale).astype("float32") for s in (-1, 1))
    return lo, hi


@settings(max_examples=25, deadline=None, derandomize=True)
@given(boxes())
def test_trees_over_any_boxes(given_boxes: Boxes) -> None:
    for build in BUILDERS.values():
        check_tree(build(*given_boxes), *given_boxes)


def degenerate(n: int) -> dict[str, Boxes]:
    k, points = np.arange(n)[:, None] * np.ones(3), np.random.default_rng(0).uniform(size=(n, 3))
    return {
        "identical": (np.zeros((n, 3)), np.ones((n, 3))),
        "points on a line": (points * [1, 0, 0], points * [1, 0, 0]),
        "coplanar": (points * [1, 1, 0], (points + 0.01) * [1, 1, 0]),
        "concentric": (-k, k),
        "one corner": (0 * k, k),
        "geometric": (2.0 ** -(k % 120), 2.0 ** (1 - k % 120)),
        "growing": (0 * k, 1.005 ** np.minimum(k, 13000)),
    }


@pytest.mark.parametrize("name", BUILDERS)
def test_degenerate_input_keeps_the_depth_bounded(name: str) -> None:
    n = 3000
    for pair in degenerate(n).values():
        lo, hi = (x.astype(np.float32) for x in pair)
        tree = BUILDERS[name](lo, hi)
        check_tree(tree, lo, hi)
        # Of a Morton tree the bits of a key; of clustering the rounds it may take, log n to the base 17/16.
        limit = {"median": np.log2(n) + 2, "morton": 64, "ploc": np.log(n) / np.log(17 / 16) + 1}
        assert len(tree.levels()) <= limit.get(name, FREE_LEVELS + np.log2(n) + 2)
    lo, hi = (x.astype(np.float32) for x in degenerate(n)["identical"])
    assert len(BUILDERS[name](lo, hi).levels()) <= 2 * np.log2(n)


def test_the_better_builders_make_the_cheaper_trees() -> None:
    lo, hi = soup(5000, 0.05)
    costs = {name: cost(build(lo, hi)) for name, build in BUILDERS.items()}
    assert costs["sweep"] <= 1.02 * cost(build_binned_sah(lo, hi))
    assert costs["sweep"] < min(costs["morton"], costs["middle"])
    assert max(costs["morton"], costs["middle"]) < costs["median"]
    assert costs["ploc"] < 1.15 * costs["sweep"]


def reference_sweep(lo: np.ndarray, hi: np.ndarray) -> float:
    """The cost of the tree that trying every plane gives, one node at a time in float64."""
    total, pending = 0.0, [np.arange(len(lo))]
    while pending:
        some = pending.pop()
        total += float(surface_area(lo[some].min(axis=0), hi[some].max(axis=0)))
        if len(some) == 1:
            continue
        best, halves = np.inf, (some[: len(some) // 2], some[len(some) // 2 :])
        for axis in range(3):
            order = some[np.argsort((lo + hi)[some, axis], kind="stable")]
            for k in range(1, len(order)):
                sides = order[:k], order[k:]
                here = sum(surface_area(lo[s].min(axis=0), hi[s].max(axis=0)) * len(s) for s in sides)
                if here < best:
                    best, halves = here, sides
        pending += halves
    return total / float(surface_area(lo.min(axis=0), hi.max(axis=0)))


def test_sweep_is_what_its_definition_says() -> None:
    lo, hi = soup(120, 0.2, "float64")
    assert cost(build_sweep(lo, hi)) == pytest.approx(reference_sweep(lo, hi), rel=1e-9)


def test_morton_codes_are_those_of_the_definition() -> None:
    lo, hi = soup(64, dtype="float64")
    middle = (lo + hi) / 2
    cell = ((middle - middle.min(axis=0)) / np.ptp(middle, axis=0).max() * (2**19 - 1e-9)).astype(int)
    codes = [int("".join(f"{x:019b}"[b] + f"{y:019b}"[b] + f"{z:019b}"[b] for b in range(19)), 2) for x, y, z in cell]
    keys, order = sorted_codes(lo, hi)
    assert (np.diff(keys.astype(object)) > 0).all()
    assert np.array_equal(order, np.argsort(codes, kind="stable"))


def test_ranges() -> None:
    assert ranges(np.array([5, 0, 9]), np.array([2, 3, 1])).tolist() == [5, 6, 0, 1, 2, 9]


@settings(max_examples=100, deadline=None, derandomize=True)
@given(st.integers(0, 2**32 - 1), st.sampled_from([1.0, 1e-6, 1e5]), st.sampled_from([0.0, 1e4]))
def test_parts_of_triangles_are_enclosed(seed: int, scale: float, shift: float) -> None:
    rng = np.random.default_rng(seed)
    corners = (rng.uniform(-1, 1, (20, 3, 3)) * scale + shift).astype(np.float32).astype(np.float64)
    axis = rng.integers(0, 3, 20)
    along = np.take_along_axis(corners, axis[:, None, None], axis=2)[:, :, 0]
    plane = (along * rng.dirichlet(np.ones(3), 20)).sum(axis=1).astype(np.float32)
    weights = rng.dirichlet(np.ones(3) * 0.5, 200)
    below, above = part_boxes(corners, axis, plane, np.dtype("float32"))
    slack = 1e-12 * np.abs(corners).max()
    for k in range(20):
        points = weights @ corners[k]
        side = points[:, axis[k]] <= plane[k]
        for some, (lo, hi) in ((points[side], below), (points[~side], above)):
            assert (some >= lo[k] - slack).all() and (some <= hi[k] + slack).all()
        assert (below[1][k] <= corners[k].max(axis=0) * (1 + 1e-6) + 1e-6 * scale + 1e-6 * abs(shift)).all()
        assert below[1][k, axis[k]] == plane[k] == above[0][k, axis[k]]


def slivers(n: int) -> TriangleMesh:
    rng = np.random.default_rng(1)
    start = rng.uniform(-1, 1, (n, 3))
    along, across = rng.normal(size=(n, 3)), rng.normal(size=(n, 3)) * 0.01
    corners = np.stack([start, start + along, start + along * 0.5 + across], axis=1)
    return TriangleMesh(corners.reshape(-1, 3), np.arange(3 * n).reshape(-1, 3))


def test_spatial_splits_cut_slivers_within_their_budget() -> None:
    mesh = slivers(2000)
    parts = mesh.primitives(types("float32"))
    for budget in (0.0, 0.1, 1.0):
        tree = build_spatial(parts, budget)
        check_tree(tree, parts.lo, parts.hi)
        assert len(tree.order) <= (1 + budget) * 2000
        assert (len(tree.order) > 2000) == (budget > 0)
        # Every part lies in its primitive's box.
        leaf = np.flatnonzero(tree.left < 0)
        of = tree.order[tree.first[leaf]]
        assert (tree.lo[leaf] >= parts.lo[of]).all() and (tree.hi[leaf] <= parts.hi[of]).all()
    tests = [accel.build(mesh, f"bvh:builder={b}").statistics()["expected_primitives"] for b in ("sweep", "spatial")]
    assert tests[1] < 0.85 * tests[0]


@pytest.mark.parametrize("builder", ["median", "middle", "sweep", "morton", "ploc", "spatial"])
@pytest.mark.parametrize("name", ["all kinds", "closed mesh", "degenerate triangles", "flat grid", "structures inside"])
def test_agreement_to_the_bit(name: str, builder: str) -> None:
    case = CASES[name]
    for precision in ("float32", "float64") if name == "all kinds" else ("float32",):
        assert_agreement(case.items(precision), case.points, f"bvh:builder={builder}", precision)


@pytest.mark.parametrize(("scale", "shift"), [(1e-6, 0.0), (1.0, 1e4)])
def test_parts_agree_to_the_bit_at_any_scale_and_offset(scale: float, shift: float) -> None:
    items = [cases.moved(slivers(300), scale, shift)]
    for precision in ("float32", "float64"):
        assert_agreement(items, cases.points_of(items), "bvh:builder=spatial,reference_budget=2", precision)


def assert_agreement(items: list, points: np.ndarray, kind: str, precision: str, n: int = 6000) -> None:
    ray = cases.rays(np.random.default_rng(1), points, n, precision)
    slow, fast = (accel.build(items, k, precision=precision) for k in ("brute_force", kind))
    a, b, shadow_a, shadow_b = slow.intersect(ray), fast.intersect(ray), slow.occluded(ray), fast.occluded(ray)
    dr.eval(a, b, shadow_a, shadow_b)
    assert np.isfinite(a.t.numpy()).sum() > n // 20
    for field in ("t", "prim", "surface", "instance", "uv"):
        np.testing.assert_array_equal(getattr(a, field).numpy(), getattr(b, field).numpy(), err_msg=field)
    np.testing.assert_array_equal(shadow_a.numpy(), shadow_b.numpy())


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"builder": "fast"}, "builder must be one of median, middle, sah, sweep, morton, ploc, spatial"),
        ({"width": 3}, "width must be 2, 4 or 8"),
        ({"volume": "cone"}, "volume must be one of"),
        ({"max_leaf_size": 32}, "max_leaf_size must be a whole number"),
        ({"max_leaf_size": 2.0}, "max_leaf_size must be a whole number"),
        ({"node_cost": 0}, "node_cost must be positive"),
        ({"primitive_cost": float("nan")}, "primitive_cost must be positive"),
        ({"primitive_cost": "x"}, "primitive_cost must be a number"),
        ({"reference_budget": -1}, "reference_budget must lie in"),
    ],
)
def test_settings_that_do_not_exist_are_refused(options: dict, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        BvhConfig(**options)
