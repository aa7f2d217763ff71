"""A scene and its rays times a power of two: the same hits, and the same bits of everything that has a length."""

import numpy as np
import pytest

from raytrace2 import accel
from raytrace2.rays.ray import Ray
from raytrace2.surfaces.instance import Instance
from raytrace2.surfaces.mesh import TriangleMesh
from raytrace2.surfaces.quadrics import Cylinder, Disk, Rectangle, Sphere

RNG = np.random.default_rng(1)
VERTICES = RNG.normal(size=(300, 3)).astype(np.float32)
FACES = np.sort(RNG.integers(0, 300, (400, 3)), axis=1)
FACES = FACES[(FACES[:, 0] < FACES[:, 1]) & (FACES[:, 1] < FACES[:, 2])]
ORIGINS = (3 * RNG.normal(size=(1000, 3))).astype(np.float32)
DIRECTIONS = (VERTICES[RNG.integers(0, 300, 1000)] - ORIGINS).astype(np.float32)


def placed(scale: float, at: tuple[float, float, float], sides: tuple[float, float, float]) -> np.ndarray:
    matrix = np.diag([*(scale * s for s in sides), 1.0])
    matrix[:3, 3] = scale * np.array(at)
    return matrix


def everything(exponent: int, kind: str, precision: str) -> list:
    scale = 2.0**exponent
    mesh = TriangleMesh(VERTICES * scale, FACES)
    tilted = placed(scale, (0, 2, 0), (0.7, 0.5, 0.3))
    quadrics = [Sphere(placed(scale, (1.5, 0, 0), (0.3, 0.3, 0.3))), Rectangle(tilted), Disk(tilted), Cylinder(tilted)]
    if kind != "bvh":
        return [mesh, *quadrics]
    # Of another size than what it stands in: each structure has its own unit.
    inner = accel.build(TriangleMesh(VERTICES * 2.0**20, FACES), kind, precision=precision)
    small = placed(scale * 2.0**-22, (0, 0, 0), (1, 1, 1))
    small[:3, 3] = scale * np.array([-2.0, 0, 0])
    return [mesh, *quadrics, Instance(inner, small), accel.build(quadrics[0], kind, precision=precision)]


def answers(exponent: int, kind: str, precision: str) -> list[np.ndarray]:
    structure = accel.build(everything(exponent, kind, precision), kind, precision=precision)
    scale = 2.0**exponent
    hit = structure.intersect(ray := Ray(ORIGINS * scale, DIRECTIONS * scale, precision=precision))
    si = structure.interact(ray, hit)
    assert hit.valid.numpy().mean() > 0.9
    lengths = [si.p, si.p_error, si.dp_du, si.dp_dv]
    alike = [hit.t, hit.prim, hit.surface, hit.instance, hit.uv, si.n, si.sh_frame.s, si.sh_frame.n, si.uv]
    plain = structure.intersect(Ray(ORIGINS * scale, DIRECTIONS, precision=precision))
    np.testing.assert_array_equal(plain.t.numpy() / scale, hit.t)
    short = structure.intersect(Ray(ORIGINS * scale, DIRECTIONS * (scale * 2.0**-40), precision=precision))
    np.testing.assert_array_equal(short.t.numpy() * 2.0**-40, hit.t)
    return [x.numpy() for x in alike] + [x.numpy() / scale for x in lengths]


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("kind", accel.names())
def test_powers_of_two_change_nothing(kind, precision):
    wanted = answers(0, kind, precision)
    for exponent in (-60, 60):
        for a, b in zip(answers(exponent, kind, precision), wanted, strict=True):
            np.testing.assert_array_equal(a, b, err_msg=f"2^{exponent}")
