"""The boxes that structures show: they nest, hold everything, and no ray in their planes is led astray."""

import itertools

import agreement_cases as cases
import numpy as np
import pytest
from combinations import FIELDS, disagreements
from hypothesis import given, settings
from hypothesis import strategies as st

from raytrace2 import accel
from raytrace2.accel.level_boxes_planes import below
from raytrace2.surfaces.instance import Instance
from raytrace2.surfaces.mesh import TriangleMesh
from raytrace2.surfaces.quadrics import Sphere

FLAT = cases.leaves(np.random.default_rng(0))
STRUCTURES = (
    *accel.names(),
    *("bvh:width=2", "bvh:width=8", "bvh:volume=sphere", "bvh:volume=oriented_box,width=8", "bvh:builder=spatial"),
    *("bounding_volumes:volume=sphere", "bounding_volumes:volume=oriented_box"),
    *("kdtree:max_leaf_size=1,traversal_cost=0.1", "bsp:max_leaf_size=1,traversal_cost=0.1"),
    *("grid:density=0.5", "hierarchical_grid:levels=3"),
)
PRECISIONS = ("float32", "float64")


def assert_nested(levels):
    """Every box is one, within its parent, and below none that is a leaf (but for what is in no cell of a grid)."""
    for level in levels:
        assert (level.lo <= level.hi).all()
        assert level.lo.dtype == level.hi.dtype == np.float64
    assert levels[0].parent.tolist() == [-1]
    for k, (above, level) in enumerate(itertools.pairwise(levels)):
        inner = level.parent >= 0
        parent = level.parent[inner]
        assert (level.lo[inner] >= above.lo[parent]).all()
        assert (level.hi[inner] <= above.hi[parent]).all()
        assert k == 0 or not above.leaf[parent].any()
        # What is no leaf has children.
        assert k == 0 or np.isin(np.flatnonzero(~above.leaf), parent).all()


def covered(points, levels, slack=0.0):
    """Which ``points`` (n, 3) lie in a leaf's box."""
    found = np.zeros(len(points), bool)
    for level in levels:
        for lo, hi in zip(level.lo[level.leaf], level.hi[level.leaf], strict=True):
            found |= ((points >= lo - slack) & (points <= hi + slack)).all(axis=1)
    return found


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("kind", STRUCTURES)
def test_boxes_nest_and_leaves_hold_every_primitive(kind, precision):
    for name in ("closed mesh", "degenerate triangles", "flat grid", "all kinds"):
        items = FLAT[name]
        structure = accel.build(items, kind, precision=precision)
        levels = list(structure.levels())
        assert_nested(levels)
        mesh = items[0] if isinstance(items[0], TriangleMesh) else items[-1]
        corners = mesh.vertices.astype(precision).astype(float)[mesh.faces]
        weight = np.random.default_rng(1).dirichlet([0.5] * 3, (5, len(corners)))
        inside = (weight[..., None] * corners).sum(axis=2).reshape(-1, 3)
        # Planes of BSP trees put what is within their rounding on one side; these points are rounded themselves.
        slack = 1e-5 if "bsp" in kind else 0
        assert covered(corners.reshape(-1, 3), levels, slack).all()
        assert covered(inside, levels, max(slack, 1e-15)).all()


@pytest.mark.parametrize("scale", [1e-9, 1e9])
@pytest.mark.parametrize("kind", STRUCTURES)
def test_boxes_at_any_scale(kind, scale):
    (mesh,) = (cases.moved(item, scale, 0.0) for item in FLAT["closed mesh"])
    levels = list(accel.build(mesh, kind).levels())
    assert_nested(levels)
    vertices = mesh.vertices.astype(np.float32).astype(float)
    assert covered(vertices, levels, 1e-5 * scale if "bsp" in kind else 0).all()
    np.testing.assert_allclose(levels[0].hi - levels[0].lo, 2 * scale, rtol=0.1)


@pytest.mark.parametrize("kind", STRUCTURES)
def test_as_many_boxes_as_the_statistics_say(kind):
    structure = accel.build(FLAT["triangle soup"], kind)
    levels, found = list(structure.levels()), structure.statistics()
    leaves = sum(int(level.leaf.sum()) for level in levels)
    if "leaves" in found:
        assert leaves == found["leaves"]
    if "volumes" in found:
        assert leaves == found["volumes"]
    if kind.startswith(("kdtree", "bsp")):
        assert sum(map(len, levels)) == found["nodes"] and len(levels) == found["depth"] + 1


@pytest.mark.parametrize("precision", PRECISIONS)
def test_cells_of_kd_trees_end_in_their_planes(precision):
    structure = accel.build(FLAT["triangle soup"], "kdtree", precision=precision)
    for above, level in itertools.pairwise(structure.levels()):
        for corner in (level.lo, level.hi):
            np.testing.assert_array_equal(corner, corner.astype(precision))
        left, right, parent = slice(0, None, 2), slice(1, None, 2), level.parent[::2]
        np.testing.assert_array_equal(level.parent[::2], level.parent[1::2])
        np.testing.assert_array_equal(level.lo[left], above.lo[parent])
        np.testing.assert_array_equal(level.hi[right], above.hi[parent])
        # Side by side at one plane, and the same otherwise.
        cut = (level.hi[left] != above.hi[parent]) | (level.lo[right] != above.lo[parent])
        assert (cut.sum(axis=1) <= 1).all()
        np.testing.assert_array_equal(level.hi[left][cut], level.lo[right][cut])


@pytest.mark.parametrize("precision", PRECISIONS)
def test_cells_of_grids_share_their_walls(precision):
    structure = accel.build(FLAT["closed mesh"], "grid", precision=precision)
    _, cells = structure.levels()
    for axis, count in enumerate(structure.statistics()["resolution"]):
        walls = np.unique([cells.lo[:, axis], cells.hi[:, axis]])
        assert len(walls) <= count + 1
        np.testing.assert_array_equal(cells.hi[:, axis], walls[np.searchsorted(walls, cells.lo[:, axis]) + 1])
        np.testing.assert_allclose(np.diff(walls), walls[1] - walls[0], rtol=1e-12)


number = st.one_of(st.sampled_from([0.0, 1.0, -1.0, 0.5]), st.floats(-2, 2).filter(lambda x: x == 0 or abs(x) > 1e-6))
triple = st.tuples(number, number, number)


@settings(max_examples=200, deadline=None, derandomize=True)
@given(triple, triple, triple.filter(any), triple, st.lists(triple, min_size=1, max_size=20))
def test_half_of_a_box(a, b, normal, point, weights):
    a, b, normal, point = (np.array([v]) for v in (a, b, normal, point))
    lo, hi = np.minimum(a, b), np.maximum(a, b)
    low, high = below(lo, hi, normal, point)
    assert (low >= lo).all() and (high <= hi).all() and (low <= high).all()
    inside = np.clip(lo + np.abs(np.array(weights)) / 2 * (hi - lo), lo, hi)
    height = ((inside - point) * normal).sum(axis=1)
    held = ((inside >= low) & (inside <= high)).all(axis=1)
    assert held[height < -1e-9].all()
    # And no larger than it has to be: each new side touches the plane.
    for k in range(3):
        for corner, old in ((low, lo), (high, hi)):
            if corner[0, k] != old[0, k] and (low < high).all():
                at = np.where(normal > 0, lo, hi)
                at[0, k] = corner[0, k]
                assert abs(((at - point) * normal).sum()) < 1e-9


def test_levels_go_on_in_structures_inside():
    mesh = FLAT["closed mesh"]
    inner = accel.build(mesh, "bvh")
    places = [cases.matrix(np.random.default_rng(k), 0.3) for k in range(3)]
    outer = accel.build([Instance(inner, m) for m in places] + [accel.build(mesh, "grid"), Sphere()], "kdtree")
    levels = list(outer.levels())
    assert_nested(levels)
    own = len(list(outer.own_levels(outer.bounds())))
    assert (levels[own].parent == -1).all() and len(levels[own]) == 4
    inside = list(inner.levels())
    assert len(levels) == own + len(inside)
    assert len(levels[-1]) == 3 * len(inside[-1])
    vertices = mesh[0].vertices.astype(np.float32).astype(float)
    for m in places:
        assert covered(vertices @ m[:3, :3].T + m[:3, 3], levels[own:], 1e-12).all()
    assert covered(vertices, levels[own:]).all()


def test_first_levels_of_very_many_boxes_take_no_time():
    group = accel.build([cases.grid_mesh(100)], "bvh")
    row = accel.build([Instance(group, np.diag([1e-3, 1e-3, 1, 1])) for _ in range(300)], "bounding_volumes")
    levels = row.levels()
    assert [len(next(levels)) for _ in range(3)][::2] == [1, 300]


@pytest.mark.parametrize("kind", STRUCTURES)
def test_over_nothing_there_are_no_boxes(kind):
    nothing = accel.build([], kind)
    assert nothing.level_bounds() == []
    (lo, hi), *_ = accel.build([nothing, Sphere()], kind).level_bounds()
    assert (lo <= -1).all() and (hi >= 1).all() and len(lo) == 1


@pytest.mark.parametrize("kind", STRUCTURES)
def test_the_same_whenever_asked(kind):
    first, second = (accel.build(FLAT["all kinds"], kind).level_bounds() for _ in range(2))
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("volume", ["box", "sphere"])
def test_boxes_follow_a_refit(volume):
    mesh = FLAT["triangle soup"][0]
    moved = TriangleMesh(mesh.vertices * 2 + 5, mesh.faces)
    levels = list(accel.build(mesh, f"bvh:volume={volume}").refit(moved).levels())
    assert_nested(levels)
    assert covered(moved.vertices.astype(np.float32), levels).all()


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("kind", [kind for kind in STRUCTURES if kind != "brute_force"])
def test_rays_in_planes_agree_with_brute_force(kind, precision):
    items = FLAT["all kinds"]
    structure = accel.build(items, kind, precision=precision)
    ray = cases.rays_in_planes(np.random.default_rng(1), structure.level_bounds(), 5_000, precision)
    found = disagreements(structure, accel.build(items, "brute_force", precision=precision), ray)
    assert found.pop("hits") > 200
    assert found == dict.fromkeys(FIELDS, 0)
