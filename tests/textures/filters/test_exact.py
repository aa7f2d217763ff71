from __future__ import annotations

import math
from typing import Any

import drjit as dr
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from raytrace2.errors import SettingError
from raytrace2.rays.footprint import Footprint
from raytrace2.scene.description import BitmapTexture, ReconstructionFilter
from raytrace2.textures.bitmap import Bitmaps
from raytrace2.textures.filter_settings import FilterSettings
from raytrace2.textures.filters.exact import exact_with_reads
from raytrace2.types import Types, types

T32, T64 = types("float32"), types("float64")
WIDTH, HEIGHT = 7, 5
PIXELS = np.random.default_rng(0).random((HEIGHT, WIDTH, 1)).astype(np.float32)
FINEST = 10**9


def wrapped(i: np.ndarray, n: int, mode: str) -> np.ndarray:
    if mode == "repeat":
        return i % n
    if mode == "mirror":
        i = i % (2 * n)
        return np.where(i < n, i, 2 * n - 1 - i)
    return np.clip(i, 0, n - 1)


def reconstructed(pixels: np.ndarray, x: np.ndarray, y: np.ndarray, mode: str, nearest: bool = False) -> np.ndarray:
    """The texture at texel coordinates, in float64."""
    h, w = pixels.shape[:2]
    values = pixels[..., 0].astype(np.float64)
    if nearest:
        return values[wrapped(np.floor(y).astype(int), h, mode), wrapped(np.floor(x).astype(int), w, mode)]
    i, j = np.floor(x - 0.5).astype(int), np.floor(y - 0.5).astype(int)
    fx, fy = x - 0.5 - i, y - 0.5 - j

    def at(di: int, dj: int) -> np.ndarray:
        return values[wrapped(j + dj, h, mode), wrapped(i + di, w, mode)]

    return (1 - fy) * ((1 - fx) * at(0, 0) + fx * at(1, 0)) + fy * ((1 - fx) * at(0, 1) + fx * at(1, 1))


def clip(polygon: np.ndarray, axis: int, bound: float, sign: float) -> np.ndarray:
    kept = []
    for p, q in zip(polygon, np.roll(polygon, -1, 0), strict=True):
        dp, dq = sign * (p[axis] - bound), sign * (q[axis] - bound)
        if dp >= 0:
            kept.append(p)
        if dp * dq < 0:
            kept.append(p + (q - p) * (dp / (dp - dq)))
    return np.array(kept).reshape(-1, 2)


def clipped_mean(
    pixels: np.ndarray, centre: np.ndarray, a: np.ndarray, b: np.ndarray, mode: str, nearest: bool = False
) -> float:
    """The texture over a parallelogram (texels): polygons clipped to each cell, triangles integrated exactly."""
    corners = np.array([centre + (s * a + t * b) / 2 for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    shift = 0.0 if nearest else 0.5
    low, high = np.floor(corners.min(0) - shift).astype(int), np.floor(corners.max(0) - shift).astype(int)
    total = area = 0.0
    for j in range(low[1], high[1] + 1):
        band = clip(clip(corners, 1, j + shift, 1), 1, j + 1 + shift, -1)
        for i in range(low[0], high[0] + 1):
            polygon = clip(clip(band, 0, i + shift, 1), 0, i + 1 + shift, -1) if len(band) else band
            for k in range(1, len(polygon) - 1):
                p, q, r = polygon[0], polygon[k], polygon[k + 1]
                size = abs((q - p)[0] * (r - p)[1] - (q - p)[1] * (r - p)[0]) / 2
                middles = (np.array([p + q, q + r, r + p]) / 2 - [i + shift, j + shift]).clip(1e-12, 1 - 1e-12)
                at = middles + [i + shift, j + shift]
                total += size * reconstructed(pixels, at[:, 0], at[:, 1], mode, nearest).mean()
                area += size
    return total / area


def sampled_mean(
    pixels: np.ndarray, centre: np.ndarray, a: np.ndarray, b: np.ndarray, mode: str, weight: Any, radius: float
) -> float:
    """The texture weighted by ``weight(s) weight(t)``, by many points."""
    n = 400
    s = ((np.arange(n) + 0.5) / n * 2 - 1) * radius
    weights = weight(s)[:, None] * weight(s)[None, :]
    x, y = (centre[k] + s[:, None] * a[k] + s[None, :] * b[k] for k in range(2))
    return float((reconstructed(pixels, x, y, mode) * weights).sum() / weights.sum())


def look_up(
    t: Types, pixels: np.ndarray, centre: Any, a: Any, b: Any, *, mode: str = "repeat", budget: int = FINEST,
    pixel: str = "box", filter_type: str = "bilinear", filter_name: str = "exact", second: Any = (None,) * 3,
) -> np.ndarray:  # fmt: skip
    """(channels, n) for footprints in texels."""
    s = FilterSettings(filter_name, budget=budget, pixel=ReconstructionFilter(pixel))  # type: ignore[arg-type]
    bitmap = BitmapTexture(pixels, wrap_mode=mode, filter_type=filter_type, raw=True)  # type: ignore[arg-type]
    size = np.array(pixels.shape[1::-1], dtype=np.float64)[:, None]

    def in_uv(v: Any) -> Any:
        with np.errstate(all="ignore"):
            return None if v is None else t.Array2f((np.asarray(v).reshape(2, -1) / size).astype(t.numpy))

    footprint = Footprint(*(in_uv(v) for v in (a, b, *second)))
    value = Bitmaps([bitmap], t, s).eval(t.UInt(0), in_uv(centre), footprint, t.Bool(True))
    return np.array(value, dtype=np.float64).reshape(pixels.shape[2], -1)


VECTORS = st.tuples(st.floats(-6, 6), st.floats(-6, 6)).map(np.array)


@settings(max_examples=60, deadline=None)
@given(a=VECTORS, b=VECTORS, centre=VECTORS, mode=st.sampled_from(["repeat", "mirror", "clamp"]), nearest=st.booleans())
def test_finest_level_is_the_integral(
    a: np.ndarray, b: np.ndarray, centre: np.ndarray, mode: str, nearest: bool
) -> None:
    if abs(a[0] * b[1] - a[1] * b[0]) < 0.05 * max(np.hypot(*a), np.hypot(*b), 1):
        return
    filter_type = "nearest" if nearest else "bilinear"
    expected = clipped_mean(PIXELS, centre, a, b, mode, nearest)
    for t, tolerance in ((T64, 1e-7), (T32, 3e-4)):
        value = look_up(t, PIXELS, centre, a, b, mode=mode, filter_type=filter_type)
        assert abs(value[0, 0] - expected) < tolerance


@pytest.mark.parametrize("mode", ["repeat", "mirror", "clamp"])
@pytest.mark.parametrize("filter_type", ["bilinear", "nearest"])
def test_coarser_levels_come_close(mode: str, filter_type: str) -> None:
    """Budgets that force levels 1 to 4 of images whose sides are no powers of two."""
    rng = np.random.default_rng(1)
    pixels = rng.random((37, 53, 1)).astype(np.float32)
    a, b, centre = rng.uniform(-30, 30, (2, 60)), rng.uniform(-30, 30, (2, 60)), rng.uniform(-20, 70, (2, 60))
    truth = look_up(T64, pixels, centre, a, b, mode=mode, filter_type=filter_type)
    errors = []
    for budget in (40, 160, 640):
        value = look_up(T32, pixels, centre, a, b, mode=mode, filter_type=filter_type, budget=budget)
        errors.append(float(np.sqrt(np.mean((value - truth) ** 2))))
    assert errors[0] < 0.05 and errors[1] < 0.012 and errors[2] < 0.004


def test_blocks_wholly_inside_are_exact() -> None:
    pixels = np.random.default_rng(2).random((64, 64, 1))
    # 16 blocks of 8 x 8 texels from texel 8 on, reconstruction reaching half a texel out of them.
    value = look_up(T64, pixels, [24.0, 24.0], [32.0, 0.0], [0.0, 32.0], budget=4 * 25)
    s = (np.arange(512) + 0.5) / 512 * 32 + 8
    expected = reconstructed(pixels, s[:, None], s[None, :], "repeat").mean()
    assert value[0, 0] == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("angle", [0.0, 0.3, 1.1])
@pytest.mark.parametrize("pixel", ["tent", "gaussian"])
@pytest.mark.parametrize("mode", ["repeat", "clamp"])
def test_smooth_pixel_filters(pixel: str, angle: float, mode: str) -> None:
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    centre = np.array([3.3, 2.1])

    def gaussian(x: np.ndarray) -> np.ndarray:
        return np.maximum(np.exp(-2 * x**2) - math.exp(-8), 0)

    def tent(x: np.ndarray) -> np.ndarray:
        return np.maximum(1 - np.abs(x), 0)

    weight, radius = (tent, 1.0) if pixel == "tent" else (gaussian, 2.0)
    for scale in ((0.3, 0.2), (1.0, 1.0), (4.0, 1.0), (3.0, 5.0)):
        a, b = turn @ [scale[0], 0.2], turn @ [0.1, scale[1]]
        expected = sampled_mean(PIXELS, centre, a, b, mode, weight, radius)
        for t in (T32, T64):
            assert look_up(t, PIXELS, centre, a, b, pixel=pixel, mode=mode)[0, 0] == pytest.approx(expected, abs=6e-3)


@pytest.mark.parametrize("t", [T32, T64])
@pytest.mark.parametrize("pixel", ["box", "tent", "gaussian"])
@pytest.mark.parametrize("mode", ["repeat", "mirror", "clamp"])
def test_constants_stay_constant(t: Types, pixel: str, mode: str) -> None:
    rng = np.random.default_rng(3)
    pixels = np.full((13, 9, 3), 1 / 3, t.numpy) * np.array([1, 2, 0.7], t.numpy)
    a, b = (rng.normal(size=(2, 200)) * 10 ** rng.uniform(-5, 5, 200) for _ in range(2))
    a[:, :20] = 0
    b[:, 10:30] = 0
    value = look_up(t, pixels, rng.uniform(-30, 30, (2, 200)), a, b, pixel=pixel, mode=mode, budget=100)
    far = ~np.isin(np.arange(200), np.nonzero(np.abs(a).sum(0) + np.abs(b).sum(0) < 1e-3)[0])
    assert (value[:, far] == pixels[0, 0][:, None].astype(np.float64)).all()


@pytest.mark.parametrize("filter_type", ["bilinear", "nearest"])
def test_tiny_footprints_are_points(filter_type: str) -> None:
    rng = np.random.default_rng(4)
    centre = rng.uniform(-10, 20, (2, 300))
    plain = Bitmaps([BitmapTexture(PIXELS, filter_type=filter_type)], T32)  # type: ignore[arg-type]
    uv = T32.Array2f((centre / [[WIDTH], [HEIGHT]]).astype(np.float32))
    expected = np.array(plain.eval(T32.UInt(0), uv, None, T32.Bool(True)))
    for size in (0.0, 1e-30, 1e-4):
        a, b = rng.uniform(-size, size, (2, 2, 300))
        assert (look_up(T32, PIXELS, centre, a, b, filter_type=filter_type, budget=100)[0] == expected).all()


@pytest.mark.parametrize("mode", ["repeat", "mirror", "clamp"])
def test_segments(mode: str) -> None:
    """Footprints without an area: the mean along a line."""
    centre, a = np.array([2.7, 3.1]), np.array([5.0, 2.0])
    s = (np.arange(4000) + 0.5) / 4000 - 0.5
    expected = reconstructed(PIXELS, centre[0] + s * a[0], centre[1] + s * a[1], mode).mean()
    for b in (np.zeros(2), a * 1e-9):
        for t in (T32, T64):
            assert look_up(t, PIXELS, centre, a, b, mode=mode)[0, 0] == pytest.approx(expected, abs=2e-3)
            assert look_up(t, PIXELS, centre, b, a, mode=mode)[0, 0] == pytest.approx(expected, abs=2e-3)


@pytest.mark.parametrize("t", [T32, T64])
@pytest.mark.parametrize("pixel", ["box", "gaussian"])
@pytest.mark.parametrize("mode", ["repeat", "mirror", "clamp"])
def test_extremes_end_within_the_image(t: Types, pixel: str, mode: str) -> None:
    special = [0.0, 1e-38, -3.0, 1e4, 1e10, -1e20, 3e38, math.inf, -math.inf, math.nan]
    rng = np.random.default_rng(5)
    a, b, centre = rng.choice(special, (3, 2, 3000))
    value = look_up(t, PIXELS, centre, a, b, pixel=pixel, mode=mode, budget=100)[0]
    point = (np.abs(a).sum(0) + np.abs(b).sum(0) < 1e-3) | ~np.isfinite(centre).all(0)
    assert np.isfinite(value[~point]).all()
    assert (np.abs(value[~point] - 0.5) < 0.75).all()


@pytest.mark.parametrize("mode", ["repeat", "mirror"])
def test_many_periods_are_the_mean(mode: str) -> None:
    value = look_up(T64, PIXELS, [1.0, 2.0], [1e6, 3.0], [5.0, 2e6], mode=mode, budget=100)
    assert value[0, 0] == pytest.approx(PIXELS.mean(), abs=1e-6)


def test_clamped_edges_go_on_for_ever() -> None:
    pixels = np.zeros((4, 4, 1))
    pixels[:, 3] = 1
    # Three quarters of a footprint far wider than the image lie on the side of its last column.
    value = look_up(T64, pixels, [2.5e4, 2.0], [1e5, 0.0], [0.0, 1.0], mode="clamp", budget=100)
    assert value[0, 0] == pytest.approx(0.75, abs=1e-3)


@pytest.mark.parametrize("budget", [16, 100, 400])
def test_reads_keep_to_the_budget(budget: int) -> None:
    rng = np.random.default_rng(6)
    n = 4000
    length, ratio, angle = 10 ** rng.uniform(-2, 4, n), 10 ** rng.uniform(-3, 0, n), rng.uniform(0, 2 * np.pi, n)
    a = length * np.array([np.cos(angle), np.sin(angle)])
    b = length * ratio * np.array([-np.sin(angle), np.cos(angle)])
    s = FilterSettings("exact", budget=budget)
    bitmaps = Bitmaps([BitmapTexture(np.zeros((512, 300, 1), np.float32))], T32, s)
    image = bitmaps.image(T32.UInt(0), T32.Bool(True))
    footprint = Footprint(T32.Array2f(a.astype(np.float32)), T32.Array2f(b.astype(np.float32)))
    uv = T32.Array2f(rng.random((2, n)).astype(np.float32))
    reads = np.array(exact_with_reads(bitmaps, image, uv, footprint, s, T32.Bool(True))[1])
    assert reads[length > 100].mean() < 1.25 * budget
    assert reads.max() < 3 * budget + 60


def test_differing_images_keep_apart() -> None:
    rng = np.random.default_rng(7)
    kinds = [("repeat", "bilinear"), ("clamp", "nearest"), ("mirror", "bilinear"), ("clamp", "bilinear")]
    bitmaps = []
    for i, (mode, f) in enumerate(kinds):
        pixels = (rng.random((5 + 9 * i, 40 - 7 * i, 3)) * 255).astype(np.uint8)
        bitmaps.append(BitmapTexture(pixels, wrap_mode=mode, filter_type=f, raw=i % 2 == 0))  # type: ignore[arg-type]
    n = 500
    s = FilterSettings("exact")
    which = rng.integers(0, 4, n)
    uv = T32.Array2f(rng.uniform(-1, 2, (2, n)).astype(np.float32))
    footprint = Footprint(*(T32.Array2f((rng.normal(size=(2, n)) * 0.1).astype(np.float32)) for _ in range(2)))
    together = np.array(Bitmaps(bitmaps, T32, s).eval(T32.UInt(which), uv, footprint, T32.Bool(True)))
    for i, bitmap in enumerate(bitmaps):
        alone = np.array(Bitmaps([bitmap], T32, s).eval(T32.UInt(0), uv, footprint, T32.Bool(True)))
        assert np.allclose(alone[:, which == i], together[:, which == i], atol=2e-5)


def test_gradients_of_the_footprint_flow_forward() -> None:
    s = FilterSettings("exact")
    bitmaps = Bitmaps([BitmapTexture(PIXELS)], T64, s)
    uv = T64.Array2f(0.3, 0.4)
    x = T64.Float(0.7)
    dr.enable_grad(x)
    footprint = Footprint(T64.Array2f(x, 0.1), T64.Array2f(0.1, 0.5))
    value = bitmaps.eval(T64.UInt(0), uv, footprint, T64.Bool(True))
    dr.forward(x)
    h = 1e-5
    ends = [
        bitmaps.eval(
            T64.UInt(0), uv, Footprint(T64.Array2f(0.7 + d, 0.1), T64.Array2f(0.1, 0.5)), T64.Bool(True)
        )[0]
        for d in (-h, h)
    ]  # fmt: skip
    assert dr.grad(value)[0] == pytest.approx((ends[1] - ends[0]) / (2 * h), rel=1e-4)


def test_other_pixel_filters_are_refused() -> None:
    with pytest.raises(SettingError, match="mitchell"):
        FilterSettings("exact", pixel=ReconstructionFilter("mitchell"))
