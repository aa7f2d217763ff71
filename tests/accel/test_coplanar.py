"""Rays in the plane of the triangles that they meet: every structure finds the same one at the same place."""

import numpy as np
import pytest

from raytrace2 import accel
from raytrace2.rays.ray import Ray
from raytrace2.surfaces.mesh import TriangleMesh

CELLS = 12


def tilted_sheet(rng: np.random.Generator, scale: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertices of a plane sheet that no rounding leaves plane, and its faces."""
    axes, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    k = np.arange(CELLS + 1)
    flat = np.stack(np.meshgrid(k, k, indexing="ij"), axis=-1).reshape(-1, 2) / CELLS - 0.5
    corner = (np.arange(CELLS)[:, None] * (CELLS + 1) + np.arange(CELLS)).ravel()
    below = np.stack([corner, corner + 1, corner + CELLS + 1], axis=1)
    above = np.stack([corner + 1, corner + CELLS + 2, corner + CELLS + 1], axis=1)
    return scale * (flat @ axes[:2]) + rng.normal(size=3), np.concatenate([below, above])


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("scale", [1.0, 37.3])
def test_rays_in_the_plane_of_triangles(precision, scale):
    rng = np.random.default_rng(5)
    vertices, faces = tilted_sheet(rng, scale)
    mesh, n = TriangleMesh(vertices, faces), 20_000
    start, goal = vertices[rng.integers(0, len(vertices), (2, n))]
    within = (vertices[faces[rng.integers(0, len(faces), n)]] * rng.dirichlet([1, 1, 1], n)[:, :, None]).sum(axis=1)
    o = np.where(rng.random((n, 1)) < 0.5, start, within + (goal - within) * rng.choice([0, -1, 3], (n, 1)))
    d = np.where(np.any(goal != o, axis=1, keepdims=True), goal - o, [1, 0, 0])
    ray = Ray(o, d, precision=precision)
    wanted = accel.build(mesh, "brute_force", precision=precision).intersect(ray)
    assert wanted.valid.numpy().mean() > 0.3
    for kind in accel.names():
        found = accel.build(mesh, kind, precision=precision).intersect(ray)
        np.testing.assert_array_equal(found.t, wanted.t, err_msg=kind)
        np.testing.assert_array_equal(found.prim, wanted.prim, err_msg=kind)
