"""Nodes of two, four and eight children, in boxes, balls and oriented boxes."""

from __future__ import annotations

from fractions import Fraction

import agreement_cases as cases
import drjit as dr
import numpy as np
import pytest

from raytrace2 import accel
from raytrace2.accel import wide_node
from raytrace2.accel.binned_sah import build_binned_sah
from raytrace2.accel.collapse import collapse
from raytrace2.accel.octant_slots import by_octant
from raytrace2.accel.wide_encode import encode_nodes
from raytrace2.rays.ray import Ray
from raytrace2.surfaces.mesh import TriangleMesh
from raytrace2.types import types

CASES = cases.cases(np.random.default_rng(0))
SHAPES = ["width=2", "width=8", "volume=sphere", "volume=oriented_box", "width=2,volume=oriented_box"]
SHAPES += ["width=8,volume=sphere"]


@pytest.mark.parametrize("options", SHAPES)
@pytest.mark.parametrize(
    "name", ["all kinds", "closed mesh", "degenerate triangles", "flat grid", "instances inside", "triangle soup"]
)
def test_agreement_to_the_bit(name: str, options: str) -> None:
    case = CASES[name]
    for precision in ("float32", "float64") if name == "all kinds" else ("float32",):
        check_agreement(case.items(precision), case.points, options, precision)


@pytest.mark.parametrize("options", ["width=8", "volume=sphere", "volume=oriented_box"])
@pytest.mark.parametrize(("scale", "shift"), [(1e-6, 0.0), (1e6, 0.0), (1.0, 1e4)])
def test_agreement_at_any_scale_and_offset(options: str, scale: float, shift: float) -> None:
    items = [cases.moved(item, scale, shift) for item in cases.leaves(np.random.default_rng(0))["all kinds"]]
    for precision in ("float32", "float64"):
        check_agreement(items, cases.points_of(items), options, precision)


def check_agreement(items: list, points: np.ndarray, options: str, precision: str, n: int = 6000) -> None:
    ray = cases.rays(np.random.default_rng(1), points, n, precision)
    slow, fast = (accel.build(items, k, precision=precision) for k in ("brute_force", f"bvh:{options}"))
    a, b, shadow_a, shadow_b = slow.intersect(ray), fast.intersect(ray), slow.occluded(ray), fast.occluded(ray)
    dr.eval(a, b, shadow_a, shadow_b)
    assert np.isfinite(a.t.numpy()).sum() > n // 20
    for field in ("t", "prim", "surface", "instance", "uv"):
        np.testing.assert_array_equal(getattr(a, field).numpy(), getattr(b, field).numpy(), err_msg=field)
    np.testing.assert_array_equal(shadow_a.numpy(), shadow_b.numpy())


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("width", [2, 8])
def test_decoded_boxes_enclose_children_and_hardly_more(width: int, dtype: str) -> None:
    rng = np.random.default_rng(0)
    lo = rng.uniform(-1, 1, (200, 3)).astype(dtype)
    hi = lo + (rng.uniform(0, 0.1, (200, 3)) * rng.integers(0, 2, (200, 3))).astype(dtype)
    kinds, tree = types(dtype), build_binned_sah(lo, hi)
    layout, form = wide_node.LAYOUTS[width], wide_node.NodeFormat.of(kinds)
    wide = collapse(tree, width, max_leaf_size=1, node_cost=1.0, primitive_cost=1.0)
    words = encode_nodes(tree, wide, kinds)
    for node, children, row in zip(wide.binary, wide.children, words, strict=True):
        corner = row[:3].view(dtype)
        for slot, child in enumerate(children):
            for axis in range(3):
                exponents = int(row[wide_node.EXPONENTS]) >> (axis * form.exponent_bits)
                exponent = exponents & ((1 << form.exponent_bits) - 1)
                step = Fraction(2) ** (exponent - form.bias - 8)
                place = axis * layout.per_axis + slot // 4
                low, high = (
                    Fraction(float(corner[axis])) + (int(row[first + place]) >> 8 * (slot % 4) & 255) * step
                    for first in (layout.lower, layout.upper)
                )
                if child < 0:
                    assert low > high
                    continue
                exact = [Fraction(float(x)) for x in (tree.lo[child, axis], tree.hi[child, axis])]
                assert low <= exact[0] and exact[1] <= high
                slack = Fraction(float(tree.hi[node, axis] - tree.lo[node, axis])) * 2 / 254
                assert max(exact[0] - low, high - exact[1]) <= max(slack, Fraction(2) ** (9 - form.bias))


def test_children_stand_by_octant() -> None:
    corner = np.array([[k & 1, k >> 1 & 1, k >> 2 & 1] for k in (5, 3, 0, 7, 6, 1, 4, 2)], np.float32)
    tree = build_binned_sah(corner * 2, corner * 2 + 1)
    wide = by_octant(collapse(tree, 8, max_leaf_size=1, node_cost=1.0, primitive_cost=10.0), tree)
    assert len(wide.binary) == 1
    middle = (tree.lo + tree.hi)[wide.children[0]] / 2
    assert np.array_equal(middle > 1.5, np.arange(8)[:, None] >> np.arange(3) & 1 == 1)


def test_near_children_are_asked_first() -> None:
    rng = np.random.default_rng(0)
    corners = rng.uniform(-1, 1, (20_000, 1, 3)) + rng.normal(size=(20_000, 3, 3)) * 0.03
    mesh = TriangleMesh(corners.reshape(-1, 3), np.arange(60_000).reshape(-1, 3))
    ray = Ray(rng.normal(size=(2000, 3)) * 2, rng.normal(size=(2000, 3)))
    tested = {w: accel.build(mesh, f"bvh:width={w}").count(ray)[1] for w in (2, 4, 8)}
    primitives = {w: c.primitives.numpy().mean() for w, c in tested.items()}
    nodes = {w: c.nodes.numpy().mean() for w, c in tested.items()}
    assert max(primitives.values()) < 1.2 * min(primitives.values())
    assert nodes[8] < nodes[4] < nodes[2]


@pytest.mark.parametrize("volume", ["sphere", "oriented_box"])
def test_volumes_of_large_nodes_stay_tight(volume: str) -> None:
    rng = np.random.default_rng(0)
    corners = rng.uniform(-1, 1, (3000, 1, 3)) * [4, 1, 0.1] + rng.normal(size=(3000, 3, 3)) * 0.02
    turned = corners @ cases.rotation(rng)
    mesh = TriangleMesh(turned.reshape(-1, 3), np.arange(9000).reshape(-1, 3))
    ray = Ray(rng.normal(size=(2000, 3)) * 4, rng.normal(size=(2000, 3)))
    counted = {v: accel.build(mesh, f"bvh:volume={v}").count(ray)[1].nodes.numpy().mean() for v in ("box", volume)}
    assert counted[volume] < (1.0 if volume == "oriented_box" else 2.0) * counted["box"]


def test_expected_visits_are_those_of_random_lines() -> None:
    rng = np.random.default_rng(0)
    corners = rng.uniform(-1, 1, (500, 1, 3)) + rng.normal(size=(500, 3, 3)) * 0.05
    structure = accel.build(TriangleMesh(corners.reshape(-1, 3), np.arange(1500).reshape(-1, 3)), "bvh")
    # Chords of a sphere around everything, between points uniform on it, are uniform lines.
    ends = rng.normal(size=(2, 20_000, 3))
    ends *= 3 / np.linalg.norm(ends, axis=2, keepdims=True)
    _, counts = structure.count(Ray(ends[0], ends[1] - ends[0]))
    nodes = counts.nodes.numpy()
    lo, hi = structure.bounds()
    d = ends[1] - ends[0]
    near, far = np.sort([(lo - ends[0]) / d, (hi - ends[0]) / d], axis=0)
    meets = near.max(axis=1) <= far.min(axis=1)
    # Rays stop at what they hit, so that they visit fewer.
    assert 0.6 < nodes[meets].mean() / structure.statistics()["expected_nodes"] <= 1.02
