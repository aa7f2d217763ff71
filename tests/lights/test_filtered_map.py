"""Environment maps over footprints of directions: points as without a filter, means as those of many directions."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest
from render_cases import ball, camera, mitsuba, ours, scene

from raytrace2.lights.envmap import EnvironmentMap
from raytrace2.lights.infinite import BoundingSphere
from raytrace2.scene.description import EnvironmentLight
from raytrace2.surfaces.frame import coordinate_system
from raytrace2.textures.filter_settings import FilterSettings
from raytrace2.types import types

T = types("float64")


def directions(n: int) -> Any:
    d = np.random.default_rng(1).normal(size=(3, n))
    d /= np.linalg.norm(d, axis=0)
    # Poles, the seam and what is next to them.
    d[:, :6] = np.array([[0, 1, 0], [0, -1, 0], [1e-9, 1, 0], [0, 0, -1], [-1e-9, 0, -1], [1e-9, 0, -1]]).T
    return T.Array3f(d)


def built(pixels: np.ndarray, name: str) -> EnvironmentMap:
    return EnvironmentMap.build(
        EnvironmentLight(pixels), BoundingSphere.of_box(-np.ones(3), np.ones(3), T), T, FilterSettings(name)
    )


@pytest.mark.parametrize("shape", [(33, 64), (20, 31), (1, 1), (3, 2)])
@pytest.mark.parametrize("name", ["trilinear", "ewa", "probes"])
def test_a_point_is_what_it_was(shape: tuple[int, int], name: str) -> None:
    light = built(np.random.default_rng(0).random((*shape, 3)).astype(np.float32), name)
    d = directions(5000)
    zero = dr.zeros(T.Array3f, 5000)
    expected = np.array(light.eval_pdf(d, T.Bool(True))[0])
    assert np.allclose(np.array(light.eval_over(d, (zero, zero), T.Bool(True))), expected, atol=1e-9)


def test_means_over_directions() -> None:
    theta = (np.arange(128) * np.pi / 127)[:, None]
    phi = ((np.arange(256) + 0.5) * 2 * np.pi / 256)[None]
    waves = 0.5 + 0.5 * np.cos(20 * theta) * np.cos(14 * phi) * np.sin(theta)
    light = built(np.repeat(waves[..., None], 3, axis=2).astype(np.float32), "probes")
    d = directions(5000)
    s, t = coordinate_system(d)
    s, t = s * 0.12, t * 0.03
    mean, steps = 0, (np.arange(9) + 0.5) / 9 - 0.5
    for a in steps:
        for b in steps:
            mean = mean + np.array(light.eval_pdf(dr.normalize(d + s * a + t * b), T.Bool(True))[0].x) / 81
    found = np.array(light.eval_over(d, (s, t), T.Bool(True)).x)
    point = np.array(light.eval_pdf(d, T.Bool(True))[0].x)
    near_pole = np.abs(np.array(d.y)) > 0.95
    for lanes in (near_pole, ~near_pole):
        error, without = (np.sqrt(np.mean((x - mean)[lanes] ** 2)) for x in (found, point))
        assert error < 0.2 * without


def test_constants_stay() -> None:
    light = built(np.full((16, 32, 3), 0.75, np.float32), "ewa")
    d = directions(2000)
    s, t = coordinate_system(d)
    for size in (1e-6, 0.1, 3.0):
        assert np.allclose(np.array(light.eval_over(d, (s * size, t * size), T.Bool(True))), 0.75, rtol=1e-6)


@pytest.mark.parametrize("differentials", ["autodiff", "finite", "cone"])
def test_a_mirror_ball_reflects_a_filtered_sky(differentials: str) -> None:
    mi = mitsuba()
    checks = (np.indices((64, 128)).sum(axis=0) % 2).astype(np.float32)
    sky = {"type": "envmap", "bitmap": mi.Bitmap(np.repeat(checks[..., None], 3, axis=2))}
    source = scene(thing=ball({"type": "conductor"}), sky=sky, sensor=camera((32, 32)))
    truth = ours(source, spp=256)
    found = ours(source, spp=1, filter="trilinear", differentials=differentials)
    without = ours(source, spp=1)
    error, before = (np.sqrt(np.mean((x - truth)[4:-4, 4:-4] ** 2)) for x in (found, without))
    assert error < 0.45 * before
