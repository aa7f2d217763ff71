from __future__ import annotations

import itertools
from typing import Any

import drjit as dr
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from raytrace2.scene.description import BitmapTexture
from raytrace2.textures.bitmap import Bitmaps
from raytrace2.textures.filter_settings import FilterSettings
from raytrace2.textures.halving import half, taps
from raytrace2.textures.wrap import CLAMP, MODES
from raytrace2.types import Types, types

T32, T64 = types("float32"), types("float64")
BOX, LANCZOS = FilterSettings("trilinear"), FilterSettings("trilinear", pyramid="lanczos")
FORMATS = list(itertools.product(["uint8", "float16", "float32"], [1, 3]))


def pixels(dtype: str, channels: int, height: int, width: int, seed: int = 0) -> np.ndarray:
    values = np.random.default_rng(seed).random((height, width, channels))
    return (values * 255).astype(np.uint8) if dtype == "uint8" else values.astype(dtype)


def linear(image: np.ndarray, raw: bool) -> np.ndarray:
    if image.dtype != np.uint8:
        return image.astype(np.float64)
    x = image / 255
    return x if raw else np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


def level_of(bitmaps: Bitmaps, t: Types, place: int, level: int) -> np.ndarray:
    """All texels of a level, (height, width, channels)."""
    image = bitmaps.level(bitmaps.image(t.UInt(place), True), t.UInt(level), True)
    width, height = int(image.width[0]), int(image.height[0])
    j, i = np.mgrid[:height, :width].astype(t.numpy)
    value = bitmaps.texel(image, t.Float(i.ravel()), t.Float(j.ravel()), t.Bool(True))
    return np.atleast_2d(np.array(value)).reshape(-1, height, width).transpose(1, 2, 0)


def matrix(size: int, kernel: str, mode: int) -> np.ndarray:
    index, weights = taps(size, kernel, mode)
    result = np.zeros((len(index), size))
    np.add.at(result, (np.arange(len(index))[:, None], index), weights)
    return result


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize(("dtype", "channels"), FORMATS)
def test_levels_against_numpy(precision: str, dtype: str, channels: int) -> None:
    t = types(precision)
    shapes = [(8, 16), (7, 5), (1, 9), (33, 20), (1, 1)]
    bitmaps = [
        BitmapTexture(pixels(dtype, channels, *s, seed=i), raw=i % 2 == 0, wrap_mode=list(MODES)[i % 3])  # type: ignore[arg-type]
        for i, s in enumerate(shapes)
    ]
    error = 2.0**-11 if dtype != "float32" else 1e-6 if precision == "float32" else 1e-14
    for which, setting in itertools.product(([0, 1, 2, 3, 4], [1], [3]), (BOX, LANCZOS)):
        some = [bitmaps[i] for i in which]
        table = Bitmaps(some, t, setting)
        assert table.pyramid is not None
        for place, b in enumerate(some):
            expected = linear(b.pixels, b.raw)
            for level in range(table.pyramid.levels):
                got = level_of(table, t, place, level)
                assert got.shape == expected.shape
                size = np.abs(expected).max() if setting is LANCZOS else np.abs(expected)
                assert (np.abs(got - expected) <= (error * size if level else 4e-7)).all()
                height, width = expected.shape[:2]
                mode = MODES[b.wrap_mode]
                if max(height, width) > 1:
                    along = np.einsum("ij,hjc->hic", matrix(width, setting.pyramid, mode), expected)
                    expected = np.einsum("ij,jwc->iwc", matrix(height, setting.pyramid, mode), along)
            assert expected.shape[:2] == (1, 1)


@pytest.mark.parametrize("kernel", ["box", "lanczos"])
def test_weights_keep_means_and_constants(kernel: str) -> None:
    for size, mode in itertools.product((2, 3, 4, 5, 9, 30, 31, 127, 1000, 1001), MODES.values()):
        m = matrix(size, kernel, mode)
        assert m.shape == (half(size), size)
        assert np.allclose(m.sum(axis=1), 1, atol=1e-14)
        if kernel == "box" or mode != CLAMP:
            assert np.allclose(m.sum(axis=0), half(size) / size, rtol=1e-12 if kernel == "box" else 1.2e-4)


@settings(max_examples=40, deadline=None)
@given(
    st.tuples(st.integers(1, 9), st.integers(1, 9)),
    st.sampled_from(FORMATS),
    st.lists(st.integers(0, 255), min_size=3, max_size=3),
    st.sampled_from([BOX, LANCZOS]),
    st.sampled_from(list(MODES)),
    st.sampled_from([T32, T64]),
)
def test_constants_are_kept_to_the_last_bit(
    shape: tuple[int, int], form: tuple[str, int], colour: list[int], setting: FilterSettings, mode: Any, t: Types
) -> None:
    dtype, channels = form
    value = np.array(colour[:channels])
    image = np.broadcast_to(value if dtype == "uint8" else np.exp(value / 12 - 12), (*shape, channels)).astype(dtype)
    table = Bitmaps([BitmapTexture(image, wrap_mode=mode)], t, setting)
    assert table.pyramid is not None
    first = level_of(table, t, 0, 0)
    for level in range(table.pyramid.levels):
        assert (level_of(table, t, 0, level) == first[:1, :1]).all()


def test_halves_that_overflow_stay_finite() -> None:
    image = np.full((16, 16, 1), 65504, np.float16)
    image[::3] = 0
    table = Bitmaps([BitmapTexture(image)], T32, LANCZOS)
    values = np.concatenate([level_of(table, T32, 0, level).ravel() for level in range(5)])
    assert np.isfinite(values).all()
    assert np.abs(values).max() <= 65504


def test_point_filters_build_none() -> None:
    for name in ("nearest", "bilinear", "bicubic"):
        assert Bitmaps([BitmapTexture(pixels("uint8", 3, 4, 4))], T32, FilterSettings(name)).pyramid is None
    assert Bitmaps([BitmapTexture(pixels("uint8", 3, 4, 4))], T32).pyramid is None


def test_gradients_reach_texels_of_level_0() -> None:
    table = Bitmaps([BitmapTexture(pixels("float32", 1, 4, 4))], T32, BOX)
    image = table.level(table.image(T32.UInt(0), True), T32.UInt(0), True)
    x = T32.Float(0.5)
    dr.enable_grad(x)
    value = table.texel(image, T32.Float(1), T32.Float(2), True) * x
    dr.backward(value)
    assert np.allclose(dr.grad(x), table.texels.fetch(T32.UInt(9), None, True))
