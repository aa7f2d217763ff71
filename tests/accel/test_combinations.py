"""Structures in structures give what brute force gives, to the bit. All of them: experiments/combinations.py."""

import agreement_cases as cases
import numpy as np
import pytest
from combinations import FIELDS, combinations, disagreements, hard_rays
from hypothesis import given, settings
from hypothesis import strategies as st

from raytrace2 import accel
from raytrace2.surfaces.mesh import TriangleMesh

NONE = dict.fromkeys(FIELDS, 0)
COMBINATIONS = combinations()
FLAT = cases.leaves(np.random.default_rng(0))

#: Each kind over all of them, and what a user would write.
SOME = [n for n in COMBINATIONS if "every kind" in n or "(" not in n and " " in n]


def assert_agreement(name, items, precision, n):
    combination = COMBINATIONS[name]
    structure = combination.structure(items, precision)
    ray = hard_rays(combination, structure, cases.points_of(items), n)
    found = disagreements(structure, combination.reference(structure, items), ray)
    assert found.pop("hits") > n // 20
    assert found == NONE


def test_every_kind_takes_part():
    assert len(COMBINATIONS) >= 40
    for kind in accel.names():
        assert {kind, f"{kind}({kind})", f"bvh({kind})", f"{kind}(bvh)", f"bvh(instances of {kind})"} <= set(
            COMBINATIONS
        )


@pytest.mark.parametrize("name", SOME)
def test_combinations_of_triangles_agree_with_brute_force(name):
    assert_agreement(name, FLAT["degenerate triangles"], "float32", 6_000)


@pytest.mark.parametrize("name", ["bvh(every kind)", "instances of two kinds and what is loose"])
@pytest.mark.parametrize(("scene", "precision"), [("flat grid", "float64"), ("all kinds", "float32")])
def test_combinations_agree_with_brute_force(name, scene, precision):
    assert_agreement(name, FLAT[scene], precision, 6_000)


coordinate = st.sampled_from([0.0, -0.0, 1.0, -1.0, 0.5, 1 / 3, 1e-3])
vertex = st.tuples(coordinate, coordinate, coordinate)


@settings(max_examples=5, deadline=None, derandomize=True)
@given(st.lists(vertex, min_size=4, max_size=8), st.randoms(use_true_random=False))
def test_small_meshes_in_combinations(vertices, random):
    faces = [[random.randrange(len(vertices)) for _ in range(3)] for _ in range(2 * len(accel.names()))]
    items = [TriangleMesh(np.array(vertices), np.array(faces))]
    for name in ("bvh(every kind)", "grid(bvh)"):
        combination = COMBINATIONS[name]
        structure = combination.structure(items, "float32")
        ray = hard_rays(combination, structure, cases.points_of(items), 500)
        found = disagreements(structure, combination.reference(structure, items), ray)
        found.pop("hits")
        assert found == NONE
