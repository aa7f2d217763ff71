"""Every structure gives what brute force gives, to the bit."""

import agreement_cases as cases
import drjit as dr
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from raytrace2 import accel
from raytrace2.rays.ray import Ray
from raytrace2.surfaces.mesh import TriangleMesh
from raytrace2.surfaces.surface import Surface

NONE = {"t": 0, "prim": 0, "surface": 0, "instance": 0, "uv": 0, "occluded": 0, "shadow": 0}
CASES = cases.cases(np.random.default_rng(0))
FLAT = cases.leaves(np.random.default_rng(0))


def assert_agreement(items: list[Surface], points: np.ndarray, precision: str, n: int, seed: int = 1) -> None:
    ray = cases.rays(np.random.default_rng(seed), points, n, precision)
    found = cases.disagreements(items, ray, precision)
    assert found.pop("hits") > n // 20
    assert found == NONE


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("name", CASES)
def test_agreement_to_the_bit(name, precision):
    case = CASES[name]
    assert_agreement(case.items(precision), case.points, precision, 20_000)


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize(("scale", "shift"), [(1e-6, 0.0), (1e6, 0.0), (1.0, 1e4)])
@pytest.mark.parametrize("name", ["triangle soup", "flat grid", "closed mesh", "all kinds"])
def test_agreement_at_any_scale_and_offset(name, scale, shift, precision):
    items = [cases.moved(item, scale, shift) for item in FLAT[name]]
    assert_agreement(items, cases.points_of(items), precision, 8_000)


@pytest.mark.parametrize("leaf_size", [1, 31])
def test_agreement_whatever_the_size_of_leaves(leaf_size):
    items = FLAT["all kinds"]
    ray = cases.rays(np.random.default_rng(2), cases.points_of(items), 8_000, "float32")
    slow = accel.build(items, "brute_force").intersect(ray)
    fast = accel.build(items, f"bvh:max_leaf_size={leaf_size}").intersect(ray)
    np.testing.assert_array_equal(slow.t, fast.t)
    np.testing.assert_array_equal(slow.prim, fast.prim)


coordinate = st.one_of(
    st.sampled_from([0.0, -0.0, 1.0, -1.0, 0.5]), st.floats(-2, 2, width=32).filter(lambda x: x == 0 or abs(x) > 1e-6)
)
direction = st.tuples(coordinate, coordinate, coordinate).filter(lambda d: any(x != 0 for x in d))


@st.composite
def small_meshes(draw):
    """Up to seven vertices, some of them equal, and up to eight triangles, some of them equal or without area."""
    vertices = draw(st.lists(st.tuples(coordinate, coordinate, coordinate), min_size=1, max_size=7))
    index = st.integers(0, len(vertices) - 1)
    faces = draw(st.lists(st.tuples(index, index, index), min_size=1, max_size=8))
    return np.array(vertices), np.array(faces + faces[: draw(st.integers(0, 2))])


@settings(max_examples=30, deadline=None, derandomize=True)
@given(small_meshes(), st.lists(st.tuples(st.tuples(*[coordinate] * 3), direction), min_size=1, max_size=8))
def test_agreement_on_any_small_mesh(mesh, rays):
    vertices, faces = mesh
    items = [TriangleMesh(vertices, faces), TriangleMesh(vertices[::-1], faces)]
    o, d = (np.array(v) for v in zip(*rays, strict=True))
    # Towards every vertex, too, from every origin: the rays that edges have to share.
    at = np.repeat(o, len(vertices), axis=0)
    towards = np.tile(vertices, (len(o), 1)) - at
    real = (towards != 0).any(axis=1)
    for precision in ("float32", "float64"):
        ray = Ray(np.concatenate([o, at[real]]), np.concatenate([d, towards[real]]), precision=precision)
        found = cases.disagreements(items, ray, precision)
        found.pop("hits")
        assert found == NONE


def test_hits_are_where_the_ray_is():
    for name, case in CASES.items():
        structure = accel.build(case.items("float64"), precision="float64")
        # The sixth group is aimed from nearby.
        all_rays = cases.rays(np.random.default_rng(5), case.points, 4_000, "float64")
        keep = dr.arange(structure.types.UInt, 500) + 2_500
        ray = Ray(*(dr.gather(type(v), v, keep) for v in (all_rays.o, all_rays.d)), precision="float64")
        hit = structure.intersect(ray)
        si = structure.interact(ray, hit)
        off = np.abs(si.p.numpy() - ray(dr.select(si.valid, hit.t, 0)).numpy())[:, si.valid.numpy()]
        assert off.size and off.max() < 1e-9, name


def test_two_nested_structures_with_instances_keep_their_numbers_apart():
    from raytrace2.surfaces.instance import Instance
    from raytrace2.surfaces.quadrics import Sphere

    group = accel.build(Sphere())
    places = [np.eye(4) for _ in range(4)]
    for k, m in enumerate(places):
        m[0, 3] = 4.0 * k
    inner = [accel.build([Instance(group, m)]) for m in places[:2]]
    structure = accel.build([inner[1], Instance(group, places[2]), inner[0], Instance(group, places[3])])
    ray = Ray([[4.0 * k, 0, -5] for k in range(4)], [[0, 0, 1]] * 4)
    hit = structure.intersect(ray)
    np.testing.assert_allclose(structure.interact(ray, hit).p.numpy(), [[0, 4, 8, 12], [0] * 4, [-1] * 4], atol=1e-6)
    assert len(set(hit.instance.numpy())) == 4
