from __future__ import annotations

import math
from typing import Any

import drjit as dr
import numpy as np
import pytest

from raytrace2.rays.footprint import Footprint
from raytrace2.scene.description import BitmapTexture, ReconstructionFilter
from raytrace2.textures.bitmap import Bitmaps
from raytrace2.textures.filter_settings import FilterSettings
from raytrace2.textures.filters.exact2 import exact2_with_error, exact2_with_reads
from raytrace2.types import Types, types

T32, T64 = types("float32"), types("float64")
SIDE = 64
_V, _U = np.mgrid[0:SIDE, 0:SIDE] / SIDE
_WAVES = 0.5 + 0.3 * np.sin(2 * np.pi * (3 * _V + 2 * _U))
PIXELS = (_WAVES + 0.2 * np.random.default_rng(0).random((SIDE, SIDE)))[..., None].astype(np.float32)
FINEST = 10**9
# A footprint as at a grazing angle (texels): its far end is wider and longer than the near one.
FIRST = np.array([[3.0, 0.4], [0.6, 9.0]])
SECOND = np.array([[0.05, 0.1], [0.5, 0.2], [0.1, 2.4]])
CENTRE = np.array([5.3, 9.1])


def in_uv(t: Types, v: Any) -> Any:
    return t.Array2f((np.asarray(v, dtype=np.float64).reshape(2, -1) / SIDE).astype(t.numpy))


def look_up(
    t: Types, second: Any, name: str = "exact2", pixel: str = "box", budget: int = FINEST, first: Any = FIRST,
    centre: Any = CENTRE,
) -> np.ndarray:  # fmt: skip
    s = FilterSettings(name, budget=budget, pixel=ReconstructionFilter(pixel))  # type: ignore[arg-type]
    vectors = [in_uv(t, v) for v in first] + ([in_uv(t, v) for v in second] if second is not None else [])
    bitmaps = Bitmaps([BitmapTexture(PIXELS)], t, s)
    return np.array(bitmaps.eval(t.UInt(0), in_uv(t, centre), Footprint(*vectors), t.Bool(True)))


def sampled(second: np.ndarray, weight: Any, radius: float, n: int = 700) -> float:
    s = ((np.arange(n) + 0.5) / n * 2 - 1) * radius
    weights = weight(s)[:, None] * weight(s)[None, :]
    s, t = s[:, None], s[None, :]
    x, y = (
        CENTRE[k] + s * FIRST[0, k] + t * FIRST[1, k]
        + s * s / 2 * second[0, k] + s * t * second[1, k] + t * t / 2 * second[2, k]
        for k in range(2)
    )  # fmt: skip
    i, j = np.floor(x - 0.5).astype(int), np.floor(y - 0.5).astype(int)
    fx, fy = x - 0.5 - i, y - 0.5 - j
    values = PIXELS[..., 0].astype(np.float64)

    def at(di: int, dj: int) -> np.ndarray:
        return values[(j + dj) % SIDE, (i + di) % SIDE]

    value = (1 - fy) * ((1 - fx) * at(0, 0) + fx * at(1, 0)) + fy * ((1 - fx) * at(0, 1) + fx * at(1, 1))
    return float((value * weights).sum() / weights.sum())


WEIGHTS = {
    "box": (np.ones_like, 0.5),
    "tent": (lambda x: np.maximum(1 - np.abs(x), 0), 1.0),
    "gaussian": (lambda x: np.maximum(np.exp(-2 * x**2) - math.exp(-8), 0), 2.0),
}


@pytest.mark.parametrize("t", [T32, T64])
@pytest.mark.parametrize("pixel", list(WEIGHTS))
def test_curved_footprints(t: Types, pixel: str) -> None:
    second = SECOND * (0.3 if pixel == "gaussian" else 0.7 if pixel == "tent" else 1)
    expected = sampled(second, *WEIGHTS[pixel])
    curved = look_up(t, second, pixel=pixel)[0]
    assert curved == pytest.approx(expected, abs=1.5e-3)
    assert abs(curved - expected) < 0.3 * abs(look_up(t, None, pixel=pixel)[0] - expected)


@pytest.mark.parametrize("t", [T32, T64])
@pytest.mark.parametrize("pixel", list(WEIGHTS))
@pytest.mark.parametrize("budget", [40, 160])
def test_without_curvature_it_is_exact(t: Types, pixel: str, budget: int) -> None:
    rng = np.random.default_rng(1)
    first, centre = rng.uniform(-20, 20, (2, 2, 100)), rng.uniform(0, 16, (2, 100))
    affine = look_up(t, None, "exact", pixel, budget, first, centre)
    assert (look_up(t, None, "exact2", pixel, budget, first, centre) == affine).all()
    flat = look_up(t, np.zeros((3, 2, 100)), "exact2", pixel, budget, first, centre)
    if pixel == "box":
        assert (flat == affine).all()
    assert np.allclose(flat, affine, atol=2e-4)


def test_error_estimate_is_what_curvature_changes() -> None:
    s = FilterSettings("exact2", budget=FINEST)
    bitmaps = Bitmaps([BitmapTexture(PIXELS)], T64, s)
    image = bitmaps.image(T64.UInt(0), T64.Bool(True))
    texels = [T64.Array2f(v.reshape(2, 1)) for v in (*FIRST, *SECOND)]
    arguments = bitmaps, image, in_uv(T64, CENTRE), Footprint(*texels), s
    value, error = exact2_with_error(*arguments, T64.Bool(True))
    assert value[0] == pytest.approx(look_up(T64, SECOND)[0], abs=1e-12)
    assert error[0] == pytest.approx(abs(look_up(T64, SECOND)[0] - look_up(T64, None, "exact")[0]), abs=1e-12)
    assert error[0] > 0


@pytest.mark.parametrize("t", [T32, T64])
@pytest.mark.parametrize("pixel", ["box", "gaussian"])
def test_extremes_end(t: Types, pixel: str) -> None:
    special = [0.0, 1e-38, 1.0, -30.0, 1e4, 1e10, -1e20, 3e38, math.inf, -math.inf, math.nan]
    n = 2000
    vectors = np.random.default_rng(2).choice(special, (5, 2, n))
    value = look_up(t, vectors[2:], pixel=pixel, budget=100, first=vectors[:2], centre=np.zeros((2, n)))
    assert np.isfinite(value).all()
    assert (np.abs(value - 0.5) < 0.75).all()


def test_reads_are_bounded() -> None:
    s = FilterSettings("exact2", budget=100)
    bitmaps = Bitmaps([BitmapTexture(PIXELS)], T32, s)
    image = bitmaps.image(T32.UInt(0), T32.Bool(True))
    vectors = np.random.default_rng(3).normal(size=(5, 2, 3000)) * 10 ** np.random.default_rng(4).uniform(
        -2, 3, (5, 1, 3000)
    )
    footprint = Footprint(*(T32.Array2f(v.astype(np.float32)) for v in vectors))
    reads = np.array(exact2_with_reads(bitmaps, image, T32.Array2f(0.3, 0.2), footprint, s, T32.Bool(True))[1])
    assert reads.max() < 2000 and reads.mean() < 200


def test_constants_stay() -> None:
    pixels = np.full((5, 9, 3), 1 / 3, np.float32)
    rng = np.random.default_rng(5)
    vectors = [T32.Array2f(rng.normal(size=(2, 300)).astype(np.float32)) for _ in range(5)]
    bitmaps = Bitmaps([BitmapTexture(pixels)], T32, FilterSettings("exact2"))
    value = np.array(bitmaps.eval(T32.UInt(0), T32.Array2f(0.1, 0.2), Footprint(*vectors), T32.Bool(True)))
    assert (value == np.float32(1 / 3)).all()


@pytest.mark.parametrize("name", ["exact", "exact2"])
@pytest.mark.parametrize("pixel", ["box", "gaussian"])
def test_within_a_symbolic_loop(name: str, pixel: str) -> None:
    s = FilterSettings(name, pixel=ReconstructionFilter(pixel))  # type: ignore[arg-type]
    bitmaps = Bitmaps([BitmapTexture(PIXELS), BitmapTexture(PIXELS[:20], wrap_mode="clamp")], T32, s)
    rng = np.random.default_rng(6)
    which = T32.UInt(rng.integers(0, 2, 200))
    uv, *vectors = (T32.Array2f((rng.normal(size=(2, 200)) * scale).astype(np.float32)) for scale in (1, *[0.1] * 5))
    active = T32.Bool(True)
    expected = bitmaps.eval(which, uv, Footprint(*vectors), active)

    def body(i: Any, total: Any) -> tuple[Any, Any]:
        return i + 1, total + bitmaps.eval(which, uv, Footprint(*vectors), active)

    _, total = dr.while_loop((dr.zeros(T32.UInt, 200), dr.zeros(T32.Float, 200)), lambda i, total: i < 2, body)
    assert np.allclose(np.array(total), 2 * np.array(expected), rtol=1e-5)
