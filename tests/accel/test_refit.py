"""Hierarchies that follow their surfaces: the same hits as if built anew, and what that costs."""

from __future__ import annotations

import agreement_cases as cases
import drjit as dr
import numpy as np
import pytest

from raytrace2 import accel
from raytrace2.surfaces.mesh import TriangleMesh
from raytrace2.surfaces.surface import Surface

LEAVES = cases.leaves(np.random.default_rng(0))


def bent(item: Surface) -> Surface:
    if isinstance(item, TriangleMesh):
        v = item.vertices
        return TriangleMesh(v + 0.3 * np.sin(3 * v[:, [1, 2, 0]]), item.faces)
    return cases.moved(item, 0.8, 0.1)


def assert_same_hits(items: list[Surface], refitted: accel.Bvh, precision: str) -> None:
    ray = cases.rays(np.random.default_rng(1), cases.points_of(items), 6000, precision)
    slow = accel.build(items, "brute_force", precision=precision)
    a, b, shadow_a, shadow_b = slow.intersect(ray), refitted.intersect(ray), slow.occluded(ray), refitted.occluded(ray)
    dr.eval(a, b, shadow_a, shadow_b)
    for field in ("t", "prim", "surface", "instance", "uv"):
        np.testing.assert_array_equal(getattr(a, field).numpy(), getattr(b, field).numpy(), err_msg=field)
    np.testing.assert_array_equal(shadow_a.numpy(), shadow_b.numpy())
    p, q = (s.interact(ray, h).p.numpy() for s, h in ((slow, a), (refitted, b)))
    np.testing.assert_array_equal(p, q)


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("name", LEAVES)
def test_refitted_hierarchies_meet_what_brute_force_meets(name: str, precision: str) -> None:
    items = [bent(item) for item in LEAVES[name]]
    refitted = accel.build(LEAVES[name], precision=precision).refit(items)
    assert_same_hits(items, refitted, precision)


@pytest.mark.parametrize(
    "options", ["width=2", "width=8", "builder=spatial", "builder=morton", "volume=sphere", "volume=oriented_box"]
)
def test_every_kind_of_hierarchy_can_be_refitted(options: str) -> None:
    for name in ("triangle soup", "all kinds"):
        items = [bent(item) for item in LEAVES[name]]
        assert_same_hits(items, accel.build(LEAVES[name], f"bvh:{options}").refit(items), "float32")


def test_standing_still_costs_nothing_and_wild_motion_much() -> None:
    mesh = cases.grid_mesh(30, lambda x, y: 0.1 * np.sin(4 * x + y))
    built = accel.build(mesh)
    still = built.refit(mesh).statistics()
    assert still["refit"]["sah_cost_ratio"] == pytest.approx(1, rel=1e-5)
    for name in ("nodes", "leaves", "depth", "references", "bytes", "expected_nodes", "expected_primitives"):
        assert still[name] == pytest.approx(built.statistics()[name], rel=1e-5)
    shuffled = TriangleMesh(np.random.default_rng(0).permutation(mesh.vertices), mesh.faces)
    wild = built.refit(mesh).refit(shuffled).statistics()
    assert wild["refit"]["refits"] == 2
    assert wild["refit"]["sah_cost_built"] == pytest.approx(built.statistics()["sah_cost"])
    assert wild["refit"]["sah_cost_ratio"] > 3
    assert "refit" not in built.statistics()


def test_the_hierarchy_itself_stays_as_it_was() -> None:
    mesh = cases.grid_mesh(8)
    built = accel.build(mesh)
    assert_same_hits([bent(mesh)], built.refit(bent(mesh)), "float32")
    assert_same_hits([mesh], built, "float32")


def test_several_meshes_and_new_faces() -> None:
    rng = np.random.default_rng(3)
    before = [cases.soup(rng, 40), cases.soup(rng, 7)]
    # As many triangles, but between other vertices, and of another number.
    after: list[Surface] = [TriangleMesh(m.vertices[::-1], m.faces[:, ::-1]) for m in before]
    built = accel.build(before)
    assert_same_hits(after, built.refit(after), "float32")
    assert_same_hits(list(before), built.refit(after).refit(before), "float32")


def test_refitted_structures_nest() -> None:
    mesh = cases.grid_mesh(8)
    refitted = accel.build(mesh).refit(bent(mesh))
    np.testing.assert_allclose(refitted.bounds(), accel.build(bent(mesh)).bounds())
    items = [bent(mesh)]
    ray = cases.rays(np.random.default_rng(1), cases.points_of(items), 2000, "float32")
    fast, slow = accel.build([refitted], "bvh"), accel.build(items, "brute_force")
    np.testing.assert_array_equal(fast.intersect(ray).t.numpy(), slow.intersect(ray).t.numpy())


def test_other_surfaces_are_refused() -> None:
    built = accel.build([cases.grid_mesh(4), *LEAVES["disks"][:2]])
    with pytest.raises(ValueError, match="34 primitives, not 32"):
        built.refit(cases.grid_mesh(4))
    with pytest.raises(ValueError, match="same kinds"):
        built.refit([cases.grid_mesh(4), *LEAVES["spheres"][:2]])
    assert accel.build([]).refit([]).statistics()["nodes"] == 0
