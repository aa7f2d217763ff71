from __future__ import annotations

from functools import cache
from typing import Any

import drjit as dr
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from raytrace2.rays.footprint import Footprint
from raytrace2.scene.description import BitmapTexture, ReconstructionFilter
from raytrace2.textures.bitmap import Bitmaps
from raytrace2.textures.filter_settings import FilterSettings
from raytrace2.textures.filters.exact import exact_with_error, exact_with_reads
from raytrace2.types import Types, types

T32, T64 = types("float32"), types("float64")
WIDTH, HEIGHT = 75, 48
FINEST = 10**9
MODES = ("repeat", "mirror", "clamp")
TEXTURES = ("checks", "pink", "noise")


@cache
def picture(name: str) -> np.ndarray:
    rng = np.random.default_rng(1)
    j, i = np.mgrid[:HEIGHT, :WIDTH]
    if name == "checks":
        return ((i // 8 + j // 8) % 2).astype(float)
    if name == "noise":
        return rng.random((HEIGHT, WIDTH))
    frequency = np.hypot(np.fft.fftfreq(HEIGHT)[:, None], np.fft.fftfreq(WIDTH))
    frequency[0, 0] = 1
    values = np.fft.ifft2(np.fft.fft2(rng.normal(size=(HEIGHT, WIDTH))) / frequency).real
    return (values - values.min()) / np.ptp(values)


@cache
def bitmaps(t: Types, name: str, mode: Any, nearest: bool = False) -> Bitmaps:
    kind: Any = "nearest" if nearest else "bilinear"
    return Bitmaps(
        [BitmapTexture(picture(name)[..., None], wrap_mode=mode, filter_type=kind, raw=True)],
        t,
        FilterSettings("exact"),
    )


def look_up(t: Types, of: Bitmaps, function: Any, budget: int, centre: Any, a: Any, b: Any, pixel: Any = "box") -> Any:
    """The function's two results, of footprints in texels."""
    s = FilterSettings("exact", budget=budget, pixel=ReconstructionFilter(pixel))
    size = np.array([[WIDTH], [HEIGHT]])
    image = of.image(t.UInt(0), t.Bool(True))
    uv, dx, dy = (t.Array2f(v.reshape(2, -1).astype(t.numpy)) for v in (np.reshape(centre, (2, -1)) / size, a, b))
    found = function(of, image, uv, Footprint(dx, dy), s, t.Bool(True))
    dr.eval(found)
    return [np.array(v, dtype=np.float64) for v in found]


def sampled_mean(name: str, mode: str, centre: np.ndarray, a: np.ndarray, b: np.ndarray, n: int = 600) -> float:
    """The texture over a parallelogram, by brute force."""
    s = (np.arange(n) + 0.5) / n - 0.5
    x, y = (centre[k] + s[:, None] * a[k] + s[None, :] * b[k] - 0.5 for k in range(2))
    pixels = picture(name)

    def place(i: np.ndarray, size: int) -> np.ndarray:
        if mode == "repeat":
            return i % size
        if mode == "mirror":
            i = i % (2 * size)
            return np.where(i < size, i, 2 * size - 1 - i)
        return np.clip(i, 0, size - 1)

    i, j = np.floor(x).astype(int), np.floor(y).astype(int)
    rows, columns = [place(j + k, HEIGHT) for k in range(2)], [place(i + k, WIDTH) for k in range(2)]
    fx, fy = x - i, y - j
    low = (1 - fx) * pixels[rows[0], columns[0]] + fx * pixels[rows[0], columns[1]]
    high = (1 - fx) * pixels[rows[1], columns[0]] + fx * pixels[rows[1], columns[1]]
    return float(((1 - fy) * low + fy * high).mean())


VECTORS = st.tuples(st.floats(-60, 60), st.floats(-60, 60)).map(np.array)
BUDGETS = st.sampled_from([16, 40, 100, 400])


@settings(max_examples=30, deadline=None)
@given(
    a=VECTORS, b=VECTORS, centre=VECTORS, name=st.sampled_from(TEXTURES), mode=st.sampled_from(MODES), budget=BUDGETS
)
def test_the_bound_holds_against_brute_force(
    a: np.ndarray, b: np.ndarray, centre: np.ndarray, name: str, mode: str, budget: int
) -> None:
    if abs(a[0] * b[1] - a[1] * b[0]) < 0.05 * max(np.hypot(*a), np.hypot(*b), 1):
        return
    value, bound = look_up(T64, bitmaps(T64, name, mode), exact_with_error, budget, centre, a, b)
    # The brute force's own error, by taking another number of points.
    expected, again = (sampled_mean(name, mode, centre, a, b, n) for n in (600, 431))
    assert abs(value[0] - expected) <= bound[0] + 3 * abs(expected - again) + 2e-3


@pytest.mark.parametrize("t", [T32, T64])
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("nearest", [False, True])
@pytest.mark.parametrize("name", TEXTURES)
def test_the_bound_holds_against_the_finest_level(t: Types, mode: str, nearest: bool, name: str) -> None:
    rng = np.random.default_rng(3)
    n = 2000
    length, ratio, angle = 10 ** rng.uniform(-0.5, 2, n), 10 ** rng.uniform(-2, 0, n), rng.uniform(0, 2 * np.pi, n)
    a = length * np.array([np.cos(angle), np.sin(angle)])
    b = length * ratio * np.array([-np.sin(angle + 0.3), np.cos(angle + 0.3)])
    centre = rng.uniform(-40, 120, (2, n))
    of = bitmaps(t, name, mode, nearest)
    truth = look_up(t, of, exact_with_reads, FINEST, centre, a, b)[0]
    for budget in (40, 400):
        value, bound = look_up(t, of, exact_with_error, budget, centre, a, b)
        assert (value == look_up(t, of, exact_with_reads, budget, centre, a, b)[0]).all()
        error = np.abs(value - truth)
        assert (error <= bound + (1e-12 if t is T64 else 1e-5)).all()
        # It tells something: an order of magnitude or two above what it bounds.
        assert bound.mean() < 150 * np.sqrt(np.mean(error**2)) + 1e-3
        assert (bound[error > 1e-3] > 0).all()


def test_whole_blocks_and_the_finest_level_have_no_error() -> None:
    of = bitmaps(T64, "noise", "repeat")
    _, bound = look_up(T64, of, exact_with_error, FINEST, [20.3, 30.2], np.array([20.0, 1.0]), np.array([3.0, 9.0]))
    assert bound[0] == 0
    # Blocks of level 3 are 7.5 x 8 texels.
    value, bound = look_up(T64, of, exact_with_error, 100, [37.5, 24.0], np.array([45.0, 0.0]), np.array([0.0, 32.0]))
    assert bound[0] < 1e-7
    assert value[0] == pytest.approx(
        sampled_mean("noise", "repeat", np.array([37.5, 24.0]), *np.diag([45.0, 32.0])), abs=1e-4
    )


@pytest.mark.parametrize("pixel", ["tent", "gaussian"])
@pytest.mark.parametrize("name", TEXTURES)
@pytest.mark.parametrize("mode", ["repeat", "clamp"])
def test_smooth_filters(name: str, mode: str, pixel: str) -> None:
    """Quadrature and cut-off come on top, which are small, needles and edges that go on for ever included."""
    rng = np.random.default_rng(5)
    n = 1000
    length, angle = 10 ** rng.uniform(0, 1.7, n), rng.uniform(0, 2 * np.pi, n)
    a = length * np.array([np.cos(angle), np.sin(angle)])
    b = length * 10 ** rng.uniform(-2, 0, n) * np.array([-np.sin(angle), np.cos(angle)])
    centre = rng.uniform(-20, 90, (2, n))
    of = bitmaps(T64, name, mode)
    truth = look_up(T64, of, exact_with_reads, FINEST, centre, a, b, pixel)[0]
    value, bound = look_up(T64, of, exact_with_error, 100, centre, a, b, pixel)
    assert (np.abs(value - truth) <= bound + 0.01).all()


def test_many_periods_and_points() -> None:
    of = bitmaps(T64, "noise", "repeat")
    most = np.abs(picture("noise") - picture("noise").mean()).max()
    for a, expected in (([1e7, 0.0], most), ([np.nan, 0.0], most), ([np.inf, 0.0], most), ([1e-6, 0.0], 0.0)):
        bound = look_up(T64, of, exact_with_error, 100, [3.0, 4.0], np.array(a), np.array(a[::-1]))[1]
        assert bound[0] == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("pixel", ["box", "gaussian"])
def test_values_alone_cost_what_they_did(pixel: Any) -> None:
    """The same operations before and after the bounds' numbers are there, and fewer than with bounds."""
    of = Bitmaps([BitmapTexture(picture("pink")[..., None], raw=True)], T32, FilterSettings("exact"))
    one = np.ones((2, 50))

    def operations(function: Any) -> int:
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            look_up(T32, of, function, 100, one, one * [[5.0], [1.0]], one * [[1.0], [7.0]], pixel)
            return max(k["operation_count"] for k in dr.kernel_history([dr.KernelType.JIT]))

    before = operations(lambda *arguments: exact_with_reads(*arguments)[:1])
    assert of.blocks is not None
    of.blocks.build_deviations()
    assert operations(lambda *arguments: exact_with_reads(*arguments)[:1]) == before < operations(exact_with_error)
