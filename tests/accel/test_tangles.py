"""Where triangles overlap however they are grouped, the default hierarchy cuts them; nowhere else."""

from __future__ import annotations

import agreement_cases as cases
import drjit as dr
import numpy as np
import pytest

from raytrace2 import accel, scenes
from raytrace2.accel import spatial_split
from raytrace2.accel.binary_tree import BinaryTree
from raytrace2.accel.binned_sah import build_binned_sah
from raytrace2.accel.collapse import collapse
from raytrace2.accel.spatial import build_spatial
from raytrace2.accel.tangles import BUDGET, find_tangles, untangled
from raytrace2.surfaces.mesh import TriangleMesh
from raytrace2.surfaces.quadrics import Sphere
from raytrace2.types import types

COSTS = {"max_leaf_size": 4, "node_cost": 1.0, "primitive_cost": 1.0}


def nested(count: int, at: tuple[float, float, float] = (0.0, 0.0, 0.0), seed: int = 0) -> TriangleMesh:
    """Triangles of all sizes and turns about one point."""
    rng = np.random.default_rng(seed)
    corner = rng.normal(size=(count, 2, 3))
    corner = np.concatenate([corner, -corner.sum(axis=1, keepdims=True)], axis=1)
    corner *= 10.0 ** rng.uniform(-2, 0, (count, 1, 1))
    return TriangleMesh((corner + at).reshape(-1, 3), np.arange(3 * count).reshape(-1, 3))


def both(*meshes: TriangleMesh) -> TriangleMesh:
    ends = np.cumsum([0, *(len(m.vertices) for m in meshes)])
    faces = [m.faces + begin for m, begin in zip(meshes, ends, strict=False)]
    return TriangleMesh(np.concatenate([m.vertices for m in meshes]), np.concatenate(faces))


def ball_of_triangles(count: int) -> TriangleMesh:
    soup = scenes.make("soup", count).surfaces[0]
    assert isinstance(soup, TriangleMesh)
    return soup


@pytest.mark.parametrize("tangles", [1, 3])
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_only_tangles_are_built_anew(precision: str, tangles: int) -> None:
    soup = ball_of_triangles(3000)
    mesh = both(soup, *(nested(8000, (40.0 * k, 100, 7 * k), k) for k in range(1, tangles + 1)))
    parts = mesh.primitives(types(precision))
    tree = build_binned_sah(parts.lo, parts.hi)
    found = find_tangles(tree, collapse(tree, 4, **COSTS))
    # A few of the smallest or largest may stand beside.
    assert len(found) == tangles and (tree.count[found] > 7000).all() and (tree.count[found] <= 8000).all()
    cut = untangled(parts, tree, collapse(tree, 4, **COSTS))
    assert cut is not None
    assert len(tree.order) < len(cut.order) <= len(tree.order) + 8000 * tangles * BUDGET
    check_cut(cut, parts.lo, parts.hi)
    assert (np.bincount(cut.order)[: len(soup.faces)] == 1).all()
    assert collapse(cut, 4, **COSTS).cost < 0.85 * collapse(tree, 4, **COSTS).cost


def check_cut(tree: BinaryTree, lo: np.ndarray, hi: np.ndarray) -> None:
    """The contract of a tree whose primitives may be in several leaves, and whose boxes may have room to spare."""
    inner, leaf = np.flatnonzero(tree.left >= 0), np.flatnonzero(tree.left < 0)
    left = tree.left[inner]
    assert set(tree.order) == set(range(len(lo)))
    assert (left > inner).all()
    assert np.array_equal(np.sort(np.concatenate([[0], left, left + 1])), np.arange(len(tree.left)))
    assert tree.count[0] == len(tree.order) and (tree.count[leaf] == 1).all()
    assert np.array_equal(tree.count[inner], tree.count[left] + tree.count[left + 1])
    assert np.array_equal(tree.first[left], tree.first[inner])
    assert np.array_equal(tree.first[left + 1], tree.first[inner] + tree.count[left])
    for child in (left, left + 1):
        assert (tree.lo[inner] <= tree.lo[child]).all() and (tree.hi[inner] >= tree.hi[child]).all()
    of = tree.order[tree.first[leaf]]
    assert (tree.lo[leaf] >= lo[of]).all() and (tree.hi[leaf] <= hi[of]).all()
    assert tree.lo.dtype == lo.dtype


@pytest.mark.parametrize("name", ["soup", "bumpy_sphere", "terrain", "lattice", "architecture", "teapot"])
def test_ordinary_scenes_keep_their_trees(name: str) -> None:
    found = accel.build(scenes.make(name, 20_000)).statistics()
    assert found["references"] == found["primitives"]


def test_what_cannot_be_cut_stays_as_it_is() -> None:
    spheres = [Sphere.at((0, 0, 1e-3 * k), 1 + k) for k in range(300)]
    found = accel.build(spheres).statistics()
    assert found["references"] == found["primitives"] == 300


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("scale", [1.0, 1e-6])
def test_agreement_to_the_bit(precision: str, scale: float) -> None:
    mesh = both(ball_of_triangles(300), nested(5000, (0.5, 3, 0)))
    items = [cases.moved(mesh, scale, 0.0)]
    points = cases.points_of(items)
    ray = cases.rays(np.random.default_rng(1), points, 3000, precision)
    slow, fast = (accel.build(items, kind, precision=precision) for kind in ("brute_force", "bvh"))
    assert fast.statistics()["references"] > fast.statistics()["primitives"]
    a, b, shadow_a, shadow_b = slow.intersect(ray), fast.intersect(ray), slow.occluded(ray), fast.occluded(ray)
    dr.eval(a, b, shadow_a, shadow_b)
    assert np.isfinite(a.t.numpy()).sum() > 300
    for field in ("t", "prim", "surface", "uv"):
        np.testing.assert_array_equal(getattr(a, field).numpy(), getattr(b, field).numpy(), err_msg=field)
    np.testing.assert_array_equal(shadow_a.numpy(), shadow_b.numpy())


def test_refitted_tangles_meet_what_brute_force_meets() -> None:
    before, after = nested(5000), nested(5000, seed=1)
    moved = TriangleMesh(0.9 * before.vertices + 0.1 * after.vertices, before.faces)
    built = accel.build(before)
    assert isinstance(built, accel.Bvh) and built.statistics()["references"] > 5000
    ray = cases.rays(np.random.default_rng(2), cases.points_of([moved]), 2000, "float32")
    a, b = accel.build(moved, "brute_force").intersect(ray), built.refit(moved).intersect(ray)
    for field in ("t", "prim", "uv"):
        np.testing.assert_array_equal(getattr(a, field).numpy(), getattr(b, field).numpy(), err_msg=field)


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_cuts_do_not_depend_on_how_many_lanes_look_for_them(precision: str, monkeypatch: pytest.MonkeyPatch) -> None:
    parts = nested(1500).primitives(types(precision))
    trees = []
    for large, chunk in ((10**9, 1), (100, 7)):
        monkeypatch.setattr(spatial_split, "LARGE", large)
        monkeypatch.setattr(spatial_split, "CHUNK", chunk)
        trees.append(build_spatial(parts, 1.0))
    for field in ("lo", "hi", "left", "first", "count", "order"):
        np.testing.assert_array_equal(getattr(trees[0], field), getattr(trees[1], field))
