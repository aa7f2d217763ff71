"""Noise: its range, mean and smoothness, means over footprints, and scenes that name it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from render_cases import camera, mitsuba, ours, rgb, scene

import raytrace2 as rt
from raytrace2.rays.footprint import Footprint
from raytrace2.scene.description import FbmTexture
from raytrace2.textures.filter_settings import FilterSettings
from raytrace2.textures.noise import ROUGHNESS, Fbms
from raytrace2.types import types

T = types("float64")
N = 100_000
AT = np.random.default_rng(0).uniform(-40, 40, (2, N))


def values(table: Fbms, at: np.ndarray, footprint: Any = None) -> np.ndarray:
    return np.array(table.eval(T.UInt(0), T.Array2f(at), footprint, T.Bool(True)).x)


def test_range_and_mean() -> None:
    for octaves in (1, 8, 32):
        v = values(Fbms([FbmTexture(octaves=octaves)], T), AT)
        assert 0 <= v.min() < v.max() <= 1
        assert v.mean() == pytest.approx(0.5, abs=5e-3)


def test_it_is_smooth_and_as_rough_as_said() -> None:
    one, h = Fbms([FbmTexture(octaves=1)], T), 1e-4
    slope = (values(one, AT + [[h], [0]]) - values(one, AT - [[h], [0]])) / (2 * h)
    assert np.abs(slope).max() < 3
    assert (slope**2).mean() / values(one, AT).var() == pytest.approx(ROUGHNESS, rel=0.03)


@pytest.mark.parametrize("edges", [((0.3, 0.0), (0.0, 0.3)), ((1.0, 0.4), (-0.1, 0.2)), ((0.05, 0), (0, 0.02))])
def test_footprints_fade_what_they_average(edges: Any) -> None:
    a, b = np.array(edges)[..., None]
    points, filtered = (Fbms([FbmTexture(octaves=6)], T, s) for s in (None, FilterSettings("ewa")))
    at = AT[:, :20_000]
    steps = (np.arange(10) + 0.5) / 10 - 0.5
    mean = sum(values(points, at + a * s + b * t) for s in steps for t in steps) / 100
    found = values(filtered, at, Footprint(T.Array2f(list(edges[0])), T.Array2f(list(edges[1]))))
    point = values(points, at)
    assert np.std(found - mean) < 0.75 * np.std(point - mean)
    assert found.mean() == pytest.approx(mean.mean(), abs=2e-3)


def test_points_and_distance() -> None:
    texture = FbmTexture((0.1, 0.2, 0.3), (0.9, 0.8, 0.7), seed=3)
    points, filtered = (Fbms([texture, FbmTexture()], T, s) for s in (None, FilterSettings("trilinear")))
    zero = Footprint(T.Array2f(0), T.Array2f(0))
    assert np.array_equal(values(filtered, AT, zero), values(points, AT))
    for far in (1e3, np.inf):
        assert np.allclose(values(filtered, AT, Footprint(T.Array2f(far), T.Array2f(0))), 0.5)
    odd = np.array([[np.nan, np.inf, 1e300, -1e12], [0, 0, 0, 0]])
    assert np.isfinite(values(points, odd)).all()
    assert np.isfinite(values(filtered, AT, Footprint(T.Array2f(np.nan), T.Array2f(0)))).all()


def fbm(**more: Any) -> dict[str, Any]:
    return {"type": "raytrace2_fbm", **more}


def lit(texture: dict[str, Any]) -> dict[str, Any]:
    panel = {"type": "rectangle", "emitter": {"type": "area", "radiance": texture}}
    return scene(panel=panel, sensor=camera((32, 32)))


def test_scenes_name_it() -> None:
    to_uv = mitsuba().ScalarTransform4f().scale(200)
    source = lit(
        fbm(color0=rgb(0.2, 0.1, 0.0), color1=rgb(0.8, 0.9, 1.0), octaves=4, persistence=0.6, seed=2, to_uv=to_uv)
    )
    plain, filtered = ours(source, spp=1), ours(source, spp=1, filter="trilinear")
    assert filtered[12:20, 12:20].std() < 0.3 * plain[12:20, 12:20].std()
    assert plain[12:20, 12:20].mean() == pytest.approx(filtered[12:20, 12:20].mean(), abs=0.05)
    xml = (
        '<scene version="3.0.0"><sensor type="perspective"/><shape type="sphere"><bsdf type="diffuse">'
        '<texture type="raytrace2_fbm" name="reflectance"><integer name="octaves" value="4"/></texture>'
        "</bsdf></shape></scene>"
    )
    assert rt.load_string(xml).description.shapes[0].bsdf.reflectance.octaves == 4  # type: ignore[union-attr]


def test_what_cannot_be_is_refused_by_name() -> None:
    for more, message in (
        ({"octaves": 0}, "between 1 and 32"),
        ({"persistence": 0.0}, "persistence"),
        ({"x": 1}, "'x'"),
    ):
        with pytest.raises(rt.SceneError, match=message):
            rt.load_dict(lit(fbm(**more)))
    with pytest.raises(ValueError, match="octaves"):
        Fbms([FbmTexture(octaves=0)], T)
    loaded = rt.load_dict(lit(fbm()))
    with pytest.raises(rt.SceneError, match="raytrace2_fbm"):
        rt.compare(loaded, reference_spp=1, spp=1)
