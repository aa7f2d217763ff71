"""The build of the hierarchy: trees, their collapse into wide nodes, and the nodes' words."""

from __future__ import annotations

from fractions import Fraction

import drjit as dr
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import raytrace2 as rt
from raytrace2.accel import wide_node
from raytrace2.accel.binary_tree import BinaryTree, surface_area
from raytrace2.accel.binned_sah import COST_LEVELS, LARGE, TINY, build_binned_sah
from raytrace2.accel.collapse import WideTree, collapse
from raytrace2.accel.sah_bins import BINS
from raytrace2.accel.wide_encode import encode_nodes
from raytrace2.types import types

COSTS = {"max_leaf_size": 4, "node_cost": 1.0, "primitive_cost": 1.0}


def check_tree(tree: BinaryTree, lo: np.ndarray, hi: np.ndarray) -> None:
    n = len(lo)
    inner = np.flatnonzero(tree.left >= 0)
    leaves = np.flatnonzero(tree.left < 0)
    left = tree.left[inner]
    assert len(tree.left) == 2 * n - 1
    assert np.array_equal(np.sort(tree.order), np.arange(n))
    assert (left > inner).all()
    assert np.array_equal(np.sort(np.concatenate([[0], left, left + 1])), np.arange(2 * n - 1))
    assert np.array_equal(tree.count[inner], tree.count[left] + tree.count[left + 1])
    assert np.array_equal(tree.first[left], tree.first[inner])
    assert np.array_equal(tree.first[left + 1], tree.first[inner] + tree.count[left])
    assert (tree.count[leaves] == 1).all()
    primitive = tree.order[tree.first[leaves]]
    assert np.array_equal(tree.lo[leaves], lo[primitive])
    assert np.array_equal(tree.hi[leaves], hi[primitive])
    assert np.array_equal(tree.lo[inner], np.minimum(tree.lo[left], tree.lo[left + 1]))
    assert np.array_equal(tree.hi[inner], np.maximum(tree.hi[left], tree.hi[left + 1]))


def soup(n: int, size: float = 0.1, seed: int = 0, dtype: str = "float32") -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    middle = rng.uniform(-1, 1, size=(n, 3))
    half = rng.uniform(0, size, size=(n, 3))
    return (middle - half).astype(dtype), (middle + half).astype(dtype)


@st.composite
def boxes(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray]:
    """Boxes of any scale and offset, flat ones and equal ones among them."""
    n = draw(st.integers(1, 40))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    scale = 2.0 ** draw(st.integers(-100, 90))
    offset = draw(st.sampled_from([0.0, 1.0, -3.0, 1e7]))
    spread = 2.0 ** (rng.uniform(-draw(st.sampled_from([0, 20, 60])), 0, size=(n, 1)))
    middle = rng.uniform(-1, 1, size=(n, 3)) * spread
    if draw(st.booleans()):
        middle = np.round(middle * 4) / 4
    half = rng.uniform(0, draw(st.sampled_from([0.0, 1e-3, 1.0])), size=(n, 3)) * spread
    half[:, draw(st.integers(0, 2))] *= draw(st.sampled_from([0.0, 1.0]))
    dtype = draw(st.sampled_from(["float32", "float64"]))
    smallest = float(np.finfo(dtype).tiny)
    lo, hi = (((middle + s * half + offset) * scale).astype(dtype) for s in (-1, 1))
    return tuple(np.where(np.abs(x) < smallest, 0, x).astype(dtype) for x in (lo, hi))


@settings(max_examples=60, deadline=None)
@given(boxes())
def test_trees_hold_every_primitive_within_its_bounds(given_boxes: tuple[np.ndarray, np.ndarray]) -> None:
    lo, hi = given_boxes
    check_tree(build_binned_sah(lo, hi), lo, hi)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("n", [1, 2, TINY, TINY + 1, LARGE, LARGE + 1, 3 * LARGE + 7])
def test_every_way_of_splitting_keeps_the_contract(n: int, dtype: str) -> None:
    lo, hi = soup(n, dtype=dtype)
    check_tree(build_binned_sah(lo, hi), lo, hi)


def test_builds_are_repeatable() -> None:
    lo, hi = soup(9000)
    first, second = build_binned_sah(lo, hi), build_binned_sah(lo, hi)
    for name in ("lo", "hi", "left", "first", "count", "order"):
        assert np.array_equal(getattr(first, name), getattr(second, name))


def degenerate(name: str, n: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    k = np.arange(n)[:, None] * np.ones(3)
    points = rng.uniform(size=(n, 3))
    if name == "identical":
        return np.zeros((n, 3)), np.ones((n, 3))
    if name == "points on a line":
        return points * [1, 0, 0], points * [1, 0, 0]
    if name == "coplanar":
        return points * [1, 1, 0], (points + 0.01) * [1, 1, 0]
    if name == "concentric":
        return -k, k
    if name == "one corner":
        return 0 * k, k
    if name == "geometric":
        return 2.0 ** -(k % 120), 2.0 ** (1 - k % 120)
    if name == "growing":
        return 0 * k, 1.005 ** np.minimum(k, 13000)
    if name == "two scales":
        both = np.where(k % 2 == 0, points, points * 1e-20)
        return both, both
    raise KeyError(name)


@pytest.mark.parametrize(
    "name",
    ["identical", "points on a line", "coplanar", "concentric", "one corner", "geometric", "growing", "two scales"],
)
def test_degenerate_input_keeps_the_depth_bounded(name: str) -> None:
    n = 10_000
    lo, hi = (x.astype(np.float32) for x in degenerate(name, n))
    tree = build_binned_sah(lo, hi)
    check_tree(tree, lo, hi)
    assert len(tree.levels()) <= COST_LEVELS + np.log2(n) + 2
    if name in ("identical", "concentric", "points on a line", "coplanar"):
        assert len(tree.levels()) <= 2 * np.log2(n)


def test_levels_past_the_bound_are_halved(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("raytrace2.accel.binned_sah.COST_LEVELS", 0)
    for n in (100, LARGE + 100):
        lo, hi = soup(n)
        tree = build_binned_sah(lo, hi)
        check_tree(tree, lo, hi)
        assert len(tree.levels()) == np.ceil(np.log2(n)) + 1


def binary_cost(tree: BinaryTree) -> float:
    """The expected visits of a random ray through the root."""
    return float(surface_area(tree.lo, tree.hi).sum() / surface_area(tree.lo[0], tree.hi[0]))


def reference_split(lo: np.ndarray, hi: np.ndarray, bins: int) -> np.ndarray:
    """Which boxes go right by the cheapest plane, in float64: between bins, or with ``bins`` 0 between any two."""
    middle = (lo + hi) / 2
    best, right = np.inf, np.arange(len(lo)) >= len(lo) // 2
    for axis in range(3):
        c = middle[:, axis]
        extent = c.max() - c.min()
        if extent == 0:
            continue
        if bins:
            place = np.minimum(((c - c.min()) * (bins / extent)).astype(int), bins - 1)
        else:
            place = np.unique(c, return_inverse=True)[1]
        for k in np.unique(place)[1:]:
            r = place >= k
            cost = sum(
                surface_area(lo[s].min(axis=0), hi[s].max(axis=0)) * np.count_nonzero(s) for s in (r, ~r)
            )  # fmt: skip
            if cost < best:
                best, right = cost, r
    return right


def reference_cost(lo: np.ndarray, hi: np.ndarray) -> float:
    """``binary_cost`` of the tree that the definition gives, one node at a time."""
    total = 0.0
    pending = [np.arange(len(lo))]
    while pending:
        some = pending.pop()
        total += float(surface_area(lo[some].min(axis=0), hi[some].max(axis=0)))
        if len(some) > 1:
            right = reference_split(lo[some], hi[some], BINS if len(some) > TINY else 0)
            pending += [some[right], some[~right]]
    return total / float(surface_area(lo.min(axis=0), hi.max(axis=0)))


@pytest.mark.parametrize("size", [0.0, 0.02, 0.3])
def test_cost_is_that_of_the_definition(size: float) -> None:
    lo, hi = soup(400, size, dtype="float64")
    assert binary_cost(build_binned_sah(lo, hi)) == pytest.approx(reference_cost(lo, hi), rel=0.01)
    single = build_binned_sah(lo.astype(np.float32), hi.astype(np.float32))
    assert binary_cost(single) == pytest.approx(reference_cost(lo, hi), rel=0.02)


def test_shared_nodes_are_split_as_single_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    lo, hi = soup(LARGE)
    whole = binary_cost(build_binned_sah(lo, hi))
    monkeypatch.setattr("raytrace2.accel.binned_sah.LARGE", 100)
    assert binary_cost(build_binned_sah(lo, hi)) == pytest.approx(whole, rel=1e-5)


def leaves_of(tree: BinaryTree, wide: WideTree) -> list[int]:
    """The binary nodes that are leaves, found from the wide root."""
    found, pending = [], [0]
    while pending:
        k = pending.pop()
        for child, inner in zip(wide.children[k], wide.inner[k], strict=True):
            if inner >= 0:
                assert wide.binary[inner] == child
                pending.append(int(inner))
            elif child >= 0:
                found.append(int(child))
    return found


@pytest.mark.parametrize("width", [2, 4, 8])
@pytest.mark.parametrize("max_leaf_size", [1, 4])
def test_wide_trees_hold_every_primitive_once_and_cost_what_they_say(width: int, max_leaf_size: int) -> None:
    lo, hi = soup(500)
    tree = build_binned_sah(lo, hi)
    wide = collapse(tree, width, max_leaf_size=max_leaf_size, node_cost=1.5, primitive_cost=0.75)
    leaves = leaves_of(tree, wide)
    covered = np.concatenate([np.arange(tree.first[k], tree.first[k] + tree.count[k]) for k in leaves])
    assert np.array_equal(np.sort(covered), np.arange(500))
    assert tree.count[leaves].max() <= max_leaf_size
    area = surface_area(tree.lo, tree.hi) / surface_area(tree.lo[0], tree.hi[0])
    cost = 1.5 * area[wide.binary].sum() + 0.75 * (area[leaves] * tree.count[leaves]).sum()
    assert wide.cost == pytest.approx(cost, rel=1e-5)
    assert np.array_equal(np.sort(wide.inner[wide.inner >= 0]), np.arange(1, len(wide.binary)))


def least_cost(tree: BinaryTree, area: np.ndarray, node: int, roots: int, width: int) -> float:
    """The least cost of standing for ``node`` by at most ``roots`` roots, by trying everything."""
    left = tree.left[node]
    tests = area[node] * tree.count[node] if tree.count[node] <= COSTS["max_leaf_size"] else np.inf
    if left < 0:
        return tests

    def shared(n: int) -> float:
        return min(
            least_cost(tree, area, left, k, width) + least_cost(tree, area, left + 1, n - k, width)
            for k in range(1, n)
        )  # fmt: skip

    options = [tests, area[node] + shared(width)]
    return min(options + [shared(n) for n in range(2, roots + 1)])


@pytest.mark.parametrize("seed", range(4))
def test_no_collapse_costs_less(seed: int) -> None:
    tree = build_binned_sah(*soup(7, 0.5, seed))
    wide = collapse(tree, 3, **COSTS)
    area = surface_area(tree.lo, tree.hi) / surface_area(tree.lo[0], tree.hi[0])
    assert wide.cost == pytest.approx(least_cost(tree, area, 0, 1, 3), rel=1e-5)


def decoded_box(words: np.ndarray, slot: int, layout: wide_node.NodeFormat) -> tuple[list[Fraction], list[Fraction]]:
    """A child's box as its node's words define it, exactly."""
    real = np.float32 if layout.word == np.uint32 else np.float64
    corner = words[wide_node.CORNER : wide_node.CORNER + 3].view(real)
    lo, hi = [], []
    for axis in range(3):
        exponent = int(words[wide_node.EXPONENTS]) >> (axis * layout.exponent_bits) & ((1 << layout.exponent_bits) - 1)
        # As a float these bits are 256 steps: a normal, finite number.
        assert 0 < exponent < (1 << layout.exponent_bits) - 1
        step = Fraction(2) ** (exponent - layout.bias - 8)
        for planes, first in ((lo, wide_node.LOWER), (hi, wide_node.UPPER)):
            byte = int(words[first + axis]) >> (8 * slot) & 255
            planes.append(Fraction(float(corner[axis])) + byte * step)
    return lo, hi


def check_words(lo: np.ndarray, hi: np.ndarray) -> None:
    """Every child's box, decoded, encloses the child and hardly more."""
    kinds = types(str(lo.dtype))
    layout = wide_node.NodeFormat.of(kinds)
    tree = build_binned_sah(lo, hi)
    wide = collapse(tree, wide_node.WIDTH, max_leaf_size=1, node_cost=1.0, primitive_cost=1.0)
    words = encode_nodes(tree, wide, kinds)
    assert words.dtype == layout.word
    for node, children, row in zip(wide.binary, wide.children, words, strict=True):
        for slot, child in enumerate(children):
            box_lo, box_hi = decoded_box(row, slot, layout)
            for axis in range(3):
                if child < 0:
                    assert box_lo[axis] > box_hi[axis]
                    continue
                exact = [Fraction(float(x)) for x in (tree.lo[child, axis], tree.hi[child, axis])]
                assert box_lo[axis] <= exact[0] and exact[1] <= box_hi[axis]
                # And no more than a step beyond, except for nodes too small for their exponent.
                size = Fraction(float(tree.hi[node, axis])) - Fraction(float(tree.lo[node, axis]))
                slack = max(size * 2 / 255, Fraction(2) ** (9 - layout.bias))
                assert exact[0] - box_lo[axis] < slack and box_hi[axis] - exact[1] < slack


@settings(max_examples=60, deadline=None)
@given(boxes())
def test_decoded_boxes_enclose_what_they_should(given_boxes: tuple[np.ndarray, np.ndarray]) -> None:
    check_words(*given_boxes)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize(
    "points",
    [
        # A difference that rounds to a whole number of steps, from below and from above.
        [-1, -(2.0**-80), 1],
        [-1, 2.0**-80, 1],
        # A size that rounds to one fewer bit than it takes.
        [-(2.0**-80), 255],
        [-255, 2.0**-80],
        # A distance that vanishes when divided by the step.
        [0, 2.0**-120, 2.0**90],
        [0, 2.0**-1000, 2.0**90],
    ],
)
def test_rounding_goes_outwards(points: list[float], dtype: str) -> None:
    corners = np.array(points, dtype)[:, None] * np.ones(3, dtype)
    check_words(corners, corners)


def test_grid_aligned_boxes_are_exact() -> None:
    k = np.arange(255, dtype=np.float32)[:, None]
    lo, hi = k * np.float32([1, 0, 0]), (k + 1) * np.float32([1, 0, 0]) + np.float32([0, 1, 0])
    tree = build_binned_sah(lo, hi)
    wide = collapse(tree, wide_node.WIDTH, **COSTS)
    words = encode_nodes(tree, wide, types("float32"))
    for children, row in zip(wide.children, words, strict=True):
        for slot, child in enumerate(children):
            if child >= 0:
                box_lo, box_hi = decoded_box(row, slot, wide_node.NodeFormat.of(types("float32")))
                assert box_lo[0] == tree.lo[child, 0] and box_hi[0] == tree.hi[child, 0]


def test_statistics_are_complete() -> None:
    names = {"kind", "primitives", "references", "nodes", "leaves", "depth", "bytes", "sah_cost", "build_seconds"}
    rng = np.random.default_rng(0)
    mesh = rt.TriangleMesh(rng.uniform(size=(300, 3)), np.arange(300).reshape(-1, 3))
    found = rt.accel.build(mesh).statistics()
    assert names <= found.keys()
    assert found["primitives"] == 100 and found["nodes"] > 10 and found["sah_cost"] > 1
    assert names <= rt.accel.build([]).statistics().keys()


def test_structures_over_nothing_take_no_part() -> None:
    nothing = rt.accel.build([])
    mesh = rt.TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    ray = rt.Ray([[0.25, 0.25, 1.0]], [[0.0, 0.0, -1.0]])
    assert np.array(rt.accel.build([nothing, mesh]).intersect(ray).t)[0] == 1
    assert np.isinf(np.array(rt.accel.build([nothing]).intersect(ray).t)[0])


def test_trees_of_other_depth_run_other_kernels() -> None:
    """A kernel that is reused for a deeper tree would write past the end of its stack."""
    ray = rt.Ray([[0, 0, 9]], [[0, 0, -1]])
    hashes, sizes = set(), set()
    for triangles in (60, 200_000):
        tree = rt.accel.build(rt.scenes.bumpy_sphere(triangles), "bvh")
        sizes.add(tree._device.stack_size)
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            dr.eval(tree.intersect(ray))
            hashes |= {k["hash"] for k in dr.kernel_history([dr.KernelType.JIT])}
    assert len(hashes) == len(sizes) == 2
