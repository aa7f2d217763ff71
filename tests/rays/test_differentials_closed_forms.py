"""Ray differentials against closed forms: float64 to 1e-9 at worst, float32 to 1e-6 in the median."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from differential_chain import Stop, chain, derivatives, error, perspective

import raytrace2 as rt
from raytrace2.rays.film_plane import perspective_axes
from raytrace2.scene.description import DielectricBsdf

STEP = 1 / 64
EXACT = ("analytic", "autodiff", "autodiff2")
ETA = 1.5


def plane(z: float, half: float = 60.0, *, down: bool = False) -> rt.Rectangle:
    """The plane at height ``z``: u = x / (2 half) + 1/2 and so v of y; turned over, x and all, if ``down``."""
    matrix = np.diag([-half if down else half, half, -half if down else half, 1.0])
    matrix[2, 3] = z
    return rt.Rectangle(matrix)


def meet(o: np.ndarray, d: np.ndarray, z: float) -> np.ndarray:
    return o + d * ((z - o[2]) / d[2])


def uv_of(p: np.ndarray, half: float = 60.0) -> np.ndarray:
    return p[:2] / (2 * half) + 0.5


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return (a * b).sum(axis=0)


def unit(v: np.ndarray) -> np.ndarray:
    return v / np.sqrt(dot(v, v))


def snell(d: np.ndarray, n: np.ndarray, ratio: float) -> np.ndarray:
    """The refracted direction in its simplest form, for a unit ``n`` that faces ``d``."""
    across = ratio * (d - n * dot(d, n))
    return across - n * np.sqrt(1 - dot(across, across))


def check(name: str, where: int, target: int, truth: Any, **setting: Any) -> None:
    """The footprints on surface ``target``, met after ``where`` others."""
    for precision in ("float64", "float32"):
        stop: Stop = chain(name=name, stops=where + 1, precision=precision, step=STEP, **setting)[where]
        stop.valid = stop.valid & (stop.met[:, 0] == target)
        off = error(stop, truth)
        if precision == "float64":
            assert off.max() <= 1e-9, name
        else:
            assert np.median(off) <= 1e-6, name


@pytest.mark.parametrize("name", EXACT)
def test_plane_is_a_homography(name: str) -> None:
    camera = perspective((0.3, -19, 1), (1.5, 0, -0.6), 45)
    truth = derivatives(lambda o, d: uv_of(meet(o, d, 0)), camera, STEP)
    check(name, 0, 0, truth, surfaces=[plane(0)], camera=camera)


@pytest.mark.parametrize("name", EXACT)
def test_two_mirrors(name: str) -> None:
    camera = perspective((0, -4, 2), (0.2, 0, 0), 30)
    truth = derivatives(lambda o, d: uv_of(meet(*mirrored(*mirrored(o, d, 0), 3), 0)), camera, STEP)
    check(name, 2, 0, truth, surfaces=[plane(0), plane(3)], camera=camera)


def mirrored(o: np.ndarray, d: np.ndarray, z: float) -> tuple[np.ndarray, np.ndarray]:
    return meet(o, d, z), d * np.array([[1], [1], [-1]])


@pytest.mark.parametrize("name", EXACT)
def test_slab_of_glass(name: str) -> None:
    camera = perspective((0, -3, 3), (0, 0, 0), 40)

    def through_slab(o: np.ndarray, d: np.ndarray) -> np.ndarray:
        d, up = unit(d), np.array([[0.0], [0.0], [1.0]])
        inside = snell(d, up, 1 / ETA)
        return uv_of(meet(meet(meet(o, d, 1), inside, 0.6), d, 0))

    # The lower face's normal points out of the glass: down.
    surfaces = [plane(1), plane(0.6, down=True), plane(0)]
    truth = derivatives(through_slab, camera, STEP)
    check(name, 2, 2, truth, surfaces=surfaces, camera=camera, bsdf=DielectricBsdf(ETA, 1.0))


@pytest.mark.parametrize("name", EXACT)
def test_refracting_sphere(name: str) -> None:
    camera = perspective((0, -4, 1.5), (0, 0, 1.5), 24)
    center = np.array([[0.0], [0.0], [1.5]])

    def onto(o: np.ndarray, d: np.ndarray, far: bool) -> np.ndarray:
        b = dot(center - o, d)
        root = np.sqrt(1 - dot(center - o, center - o) + b * b)
        return o + d * (b + root if far else b - root)

    def through_ball(o: np.ndarray, d: np.ndarray) -> np.ndarray:
        d = unit(d)
        first = onto(o, d, False)
        inside = snell(d, first - center, 1 / ETA)
        second = onto(first, inside, True)
        return wall_uv(second, snell(inside, center - second, ETA))

    def wall_uv(o: np.ndarray, d: np.ndarray) -> np.ndarray:
        p = o + d * ((9 - o[1]) / d[1])
        return np.stack([p[0], p[2]]) / 120 + 0.5

    wall = np.eye(4)
    wall[:3, :3] = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]) * 60.0
    wall[:3, 3] = 0, 9, 0
    with np.errstate(invalid="ignore"):
        truth = derivatives(through_ball, camera, STEP)
    surfaces = [rt.Sphere.at(center[:, 0], 1.0), rt.Rectangle(wall)]
    check(name, 2, 1, truth, surfaces=surfaces, camera=camera, bsdf=DielectricBsdf(ETA, 1.0))


@pytest.mark.parametrize("name", EXACT)
@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_sphere_mirror_is_coddingtons(name: str, precision: str) -> None:
    """1 / t' = 1 / s + 2 / (R cos) in the plane of incidence, and 1 / s' = 1 / s + 2 cos / R across it."""
    camera = perspective((0, -4, 0.5), (0, 0, 0), 20)
    radius = 1.3
    first, second = chain([rt.Sphere.at((0, 0, 0), radius)], camera, name, precision=precision, lobe=0.0)
    p, d = (np.array(v, dtype=float) for v in (first.si.p, first.ray.d))
    n = p / radius
    eye = camera.to_world[:3, 3:]
    cos = -dot(n, d)
    s = np.sqrt(dot(p - eye, p - eye))
    out = d + 2 * cos * n
    across = unit(np.cross(d, n, axis=0))
    along = np.cross(out, across, axis=0)
    worst = []
    for moved_p, moved_d in ((second.state.o_dx, second.state.d_dx), (second.state.o_dy, second.state.d_dy)):
        w, got = np.array(moved_p, dtype=float), np.array(moved_d, dtype=float)
        tangential, sagittal = 1 / s + 2 / (radius * cos), 1 / s + 2 * cos / radius
        expected = along * dot(w, along) * tangential + across * dot(w, across) * sagittal
        worst.append(np.linalg.norm(got - expected, axis=0) / np.linalg.norm(expected, axis=0))
    plain = first.valid & (first.flags & 7 == 0)
    off = np.max(worst, axis=0)[plain]
    assert plain.sum() > 100
    assert off.max() <= 1e-9 if precision == "float64" else np.median(off) <= 1e-6


@pytest.mark.parametrize(("precision", "most"), [("float64", 1e-6), ("float32", 1e-3)])
def test_second_derivatives_of_the_homography(precision: str, most: float) -> None:
    camera = perspective((0.3, -19, 1), (1.5, 0, -0.6), 45)
    stop = chain([plane(0)], camera, "autodiff2", precision=precision, stops=1, step=STEP)[0]

    axes = perspective_axes(camera) @ camera.to_world[:3, :3].T
    h = 1e-5

    def second(of: int, by: int) -> np.ndarray:
        def moved(by_how_much: float) -> np.ndarray:
            slope = by_how_much * axes[1 + by][:, None]
            return derivatives(lambda o, d: uv_of(meet(o, d + slope, 0)), camera, STEP)[of]

        return (moved(h) - moved(-h)) / (2 * h) * STEP

    plain = stop.valid & (stop.flags == 0)
    truth = np.concatenate([second(0, 0), second(0, 1), second(1, 1)], axis=1)[plain]
    found = np.concatenate(stop.second, axis=1)[plain]
    off = np.linalg.norm(found - truth, axis=1) / np.linalg.norm(truth, axis=1)
    assert plain.sum() > 100 and off.max() <= most
