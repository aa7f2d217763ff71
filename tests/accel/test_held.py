"""Copies of primitives cost what one does, and rays from afar what near ones do; neither changes an answer."""

import numpy as np
import pytest

from raytrace2 import accel
from raytrace2.rays.ray import Ray
from raytrace2.surfaces.mesh import TriangleMesh
from raytrace2.surfaces.quadrics import Sphere

RNG = np.random.default_rng(3)
VERTICES = RNG.normal(size=(60, 3))
FACES = np.sort(RNG.integers(0, 60, (80, 3)), axis=1)
FACES = FACES[(FACES[:, 0] < FACES[:, 1]) & (FACES[:, 1] < FACES[:, 2])]
KINDS = [k for k in accel.names() if k != "brute_force"]


def same(found, wanted) -> None:
    for field in ("t", "prim", "surface", "instance"):
        np.testing.assert_array_equal(getattr(found, field), getattr(wanted, field), err_msg=field)


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("kind", KINDS)
def test_copies_lose_every_tie(kind, precision):
    order = RNG.integers(0, len(FACES), 400)
    mesh = TriangleMesh(VERTICES, FACES[order])
    items = [mesh, Sphere.at((2, 0, 0), 0.5), TriangleMesh(VERTICES, FACES), Sphere.at((2, 0, 0), 0.5)]
    structure = accel.build(items, kind, precision=precision)
    o = 4 * RNG.normal(size=(2000, 3))
    ray = Ray(o, VERTICES[FACES[RNG.integers(0, len(FACES), 2000)]].mean(axis=1) - o, precision=precision)
    same(structure.intersect(ray), accel.build(items, "brute_force", precision=precision).intersect(ray))
    assert structure.statistics()["primitives"] <= len(FACES) + 1


@pytest.mark.parametrize("kind", KINDS)
def test_a_heap_of_copies_is_met_once(kind):
    mesh = TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.tile([[0, 1, 2]], (100_000, 1)))
    structure = accel.build(mesh, kind)
    hit, counts = structure.count(Ray(np.tile([[0.2, 0.2, 1.0]], (64, 1)), np.tile([[0.0, 0.0, -1.0]], (64, 1))))
    assert (hit.prim.numpy() == 0).all()
    assert counts.primitives.numpy().max() <= 4


def test_copies_that_part_are_met_apart():
    faces = np.array([[0, 1, 2], [3, 4, 5]])
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    structure = accel.build(TriangleMesh(np.concatenate([corners, corners]), faces), "bvh")
    moved = structure.refit(TriangleMesh(np.concatenate([corners, corners + [5, 0, 0]]), faces))
    hit = moved.intersect(Ray([[0.2, 0.2, 1], [5.2, 0.2, 1]], [[0, 0, -1], [0, 0, -1]]))
    np.testing.assert_array_equal(hit.prim, [0, 1])


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("kind", KINDS)
def test_rays_from_afar(kind, precision):
    mesh = TriangleMesh(VERTICES, FACES)
    structure = accel.build(mesh, kind, precision=precision)
    direction = RNG.normal(size=(1000, 3)).astype(np.float32)
    goal = VERTICES[FACES[RNG.integers(0, len(FACES), 1000)]].mean(axis=1)
    for distance in (1e3, 1e6, 1e9):
        # Powers of two of short directions, so that the origin as rounded lies on the line that is meant.
        d = np.round(direction * 64) / 64
        o = (np.round(goal * 64) / 64 - d * 2.0 ** np.round(np.log2(distance))).astype(np.float32)
        ray = Ray(o, d, precision=precision)
        found, counts = structure.count(ray)
        same(found, accel.build(mesh, "brute_force", precision=precision).intersect(ray))
        near = Ray(o + d * 2.0 ** np.round(np.log2(distance)) - 64 * d, d, precision=precision)
        if distance < 1e6:
            again = structure.intersect(near)
            assert (again.prim.numpy() == found.prim.numpy()).mean() > 0.998
        assert counts.nodes.numpy().mean() < 3 * structure.count(near)[1].nodes.numpy().mean() + 8
