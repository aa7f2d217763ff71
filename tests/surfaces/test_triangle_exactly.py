"""In float32 a ray meets a triangle if and only if it does so in exact arithmetic."""

from __future__ import annotations

import numpy as np
import pytest

from raytrace2 import accel
from raytrace2.rays.ray import Ray
from raytrace2.stability.exact import exactly_meets, really_meets
from raytrace2.stability.meshes import icosphere
from raytrace2.surfaces.mesh import TriangleMesh

#: Origins and directions that pass the silhouette of an icosphere at a vertex or an edge: one face is met, at a cosine
#: of 1e-5 or less, and shadows rounded to float32 are on the wrong side of it.
GRAZING = """
0.8497038 1.6733714 2.3404768 -0.10150246 -0.322441 -0.9411318
0.43815207 -2.537453 1.539271 -0.12718879 0.62603897 -0.7693492
0.25716576 -0.1412854 -2.9856162 -0.41016772 0.08545461 0.9079978
0.16404055 -1.9971923 -2.2325578 -0.36655992 0.53615683 0.76037467
1.1576768 -2.547891 1.0807573 -0.6467501 0.64085025 -0.41355202
-0.5723544 -2.9424984 -0.11879896 0.50316906 0.8599173 0.08580885
1.0212724 -2.5353022 -1.2366267 -0.589572 0.63414484 0.50026506
-1.9633714 -0.90336674 2.0806491 0.38011232 0.26145288 -0.8872187
0.22164075 -2.1590707 -2.07106 0.2566023 0.74013954 0.6215696
-2.077755 0.42435935 -2.1219928 0.49982673 -0.4141193 0.76070917
2.4031265 1.472799 1.027544 -0.6652367 -0.7318239 -0.14796595
1.0585967 -2.7442513 0.5903035 -0.118956216 0.890234 -0.43969634
1.4786216 -1.4977186 -2.1378767 -0.19348368 0.6554861 0.7300014
0.7285334 2.6886203 -1.1138041 -0.2996125 -0.70412874 0.64376634
-1.0417744 -0.5515973 -2.7587037 0.34471452 0.49840277 0.79546624
0.79274523 -2.8485408 0.50731725 -0.5214459 0.8528241 0.028021548
1.057306 2.749185 -0.569285 -0.3708971 -0.7827007 0.49981493
-2.7100925 1.2415044 -0.33773527 0.72043073 -0.62243515 0.30586603
0.4902678 1.7173226 2.4104855 -0.48181197 -0.5300739 -0.6977671
1.9693391 1.4337128 1.7510484 -0.4692065 -0.7402858 -0.48147914
2.2481556 -1.9781579 0.18079661 -0.9053728 0.38441336 -0.18035084
2.2632098 -0.30944458 -1.9447687 -0.5305095 -0.05557776 0.84585506
2.538742 -1.3711605 -0.8214056 -0.6217374 0.69277674 0.3653806
-1.1572865 0.23616806 2.7577007 0.3557134 -0.40644702 -0.84158707
-0.45667943 2.868834 -0.7491565 0.15542607 -0.9839862 -0.08725773
-0.6040334 -1.6772933 2.412847 0.096218266 0.8002736 -0.59186506
-0.44039333 2.9417496 -0.39008114 -0.039176807 -0.9137355 0.40441638
2.8456542 -0.93421096 -0.17176057 -0.82833457 0.44097427 0.3455481
1.4051178 -0.9009551 -2.4927745 -0.14713782 0.34085405 0.9285306
"""


def grazing() -> tuple[np.ndarray, np.ndarray]:
    rays = np.array(GRAZING.split(), np.float32).reshape(-1, 6)
    return rays[:, :3], rays[:, 3:]


@pytest.mark.parametrize("kind", accel.names())
def test_rays_that_graze_one_face_of_a_silhouette_meet_it(kind: str) -> None:
    closed = icosphere(5, "float32")
    o, d = grazing()
    hit = accel.build(closed.mesh, kind).intersect(Ray(o, d))
    assert hit.valid.numpy().all()
    assert really_meets(closed.vertices, closed.faces[hit.prim.numpy()][:, None], o, d).all()
    assert accel.build(closed.mesh, kind).occluded(Ray(o, d)).numpy().all()


@pytest.mark.parametrize("aspect", [1.0, 1e-3, 1e-6])
def test_a_triangle_is_met_where_exact_arithmetic_meets_it(aspect: float) -> None:
    rng = np.random.default_rng(0)
    met = 0
    for _ in range(10):
        corners = (rng.normal(size=(3, 3)) * [1, 1, aspect]).astype(np.float32)
        corners = corners[:, rng.permutation(3)]
        n = 200
        # On edges and corners, and next to them; across the triangle and, for small aspects, almost in its plane.
        weights = rng.dirichlet([1, 1, 1], n) * (rng.integers(0, 3, (n, 3)) > 0)
        target = weights @ corners / np.maximum(weights.sum(axis=1, keepdims=True), 1e-9)
        o = (target + rng.normal(size=(n, 3)) * 10.0 ** rng.integers(-3, 1, (n, 1))).astype(np.float32)
        along = np.where(
            rng.integers(0, 2, (n, 1)) > 0, target - o, (corners[1] - corners[0]) * rng.normal(size=(n, 1))
        )
        d = along.astype(np.float32)
        mesh = accel.build(TriangleMesh(corners, [[0, 1, 2]]), "brute_force")
        wanted = [exactly_meets(corners, *pair) for pair in zip(o, d, strict=True)]
        np.testing.assert_array_equal(mesh.intersect(Ray(o, d)).valid, wanted)
        met += sum(wanted)
    assert 100 < met < 1900


def test_rays_through_lattice_points_meet_edges_and_corners_exactly() -> None:
    rng = np.random.default_rng(1)
    corners = np.array([[0, 0, 0], [8, 0, 0], [0, 8, 8]])
    mesh = accel.build(TriangleMesh(corners, [[0, 1, 2]]), "brute_force")
    o = rng.integers(-3, 12, (2000, 3)).astype(np.float32)
    d = rng.integers(-3, 4, (2000, 3)).astype(np.float32)
    d[(d == 0).all(axis=1)] = 1
    wanted = [exactly_meets(corners, *pair) for pair in zip(o, d, strict=True)]
    assert 100 < sum(wanted) < 1000
    np.testing.assert_array_equal(mesh.intersect(Ray(o, d)).valid, wanted)
