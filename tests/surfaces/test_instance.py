"""Instances: several groups, and nothing but instances in the scene."""

from __future__ import annotations

import drjit as dr
import numpy as np
import pytest

import raytrace2 as rt


@pytest.mark.parametrize("kind", ["brute_force", "bvh"])
def test_instances_of_two_groups_lead_into_their_own(kind: str) -> None:
    near = rt.accel.build(rt.Sphere.at((0, 0, 0), 0.5), kind)
    far = rt.accel.build(rt.Rectangle(), kind)
    shift = np.eye(4)
    shift[0, 3] = 5
    both = rt.accel.build([rt.Instance(near), rt.Instance(far, shift)], kind)
    ray = rt.Ray([[0, 0, -2], [5.9, 0, -2], [9, 0, -2]], [[0, 0, 1]] * 3)
    hit = both.intersect(ray)
    assert np.array(hit.t).tolist() == [1.5, 2.0, np.inf]
    assert np.array(hit.surface).tolist() == [0, 1, 0xFFFFFFFF]
    assert np.array(hit.instance).tolist() == [0, 1, 0xFFFFFFFF]
    assert np.array(both.occluded(ray)).tolist() == [True, True, False]
    p = np.array(both.interact(ray, hit).p).T
    assert np.allclose(p, [[0, 0, -0.5], [5.9, 0, 0], [0, 0, 0]])


def test_an_instance_is_of_a_structure_and_instances_do_not_nest() -> None:
    group = rt.accel.build(rt.Sphere())
    with pytest.raises(rt.GeometryError, match="build one over the surfaces"):
        rt.Instance(rt.Sphere())  # type: ignore[arg-type]
    with pytest.raises(rt.GeometryError, match="instances do not nest"):
        rt.Instance(rt.accel.build(rt.Instance(group)))
    with pytest.raises(rt.GeometryError, match="singular"):
        rt.Instance(group, np.diag([1.0, 0.0, 1.0, 1.0]))
    assert dr.width(group.intersect(rt.Ray([0, 0, -2], [0, 0, 1])).t) == 1
