from __future__ import annotations

import itertools
from typing import Any

import drjit as dr
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from raytrace2.scene.description import BitmapTexture
from raytrace2.textures import TextureTable
from raytrace2.types import types

T32 = types("float32")
FORMATS = list(itertools.product(["uint8", "float16", "float32"], [1, 3]))
MODES = ["repeat", "mirror", "clamp"]
TO_UV = np.array([[1.3, 0.2, 0.1], [-0.4, 0.8, 0.3], [0, 0, 1]])


def image(dtype: str, channels: int, height: int = 7, width: int = 5, seed: int = 0) -> np.ndarray:
    values = np.random.default_rng(seed).random((height, width, channels))
    return (values * 255).astype(np.uint8) if dtype == "uint8" else values.astype(dtype)


def mitsuba_bitmap(mi: Any, b: BitmapTexture) -> Any:
    bitmap = mi.Bitmap(b.pixels)
    bitmap.set_srgb_gamma(b.pixels.dtype == np.uint8)
    to_uv = np.eye(4)
    to_uv[:2, [0, 1, 3]] = b.to_uv[:2]
    return mi.load_dict(
        {
            "type": "bitmap", "bitmap": bitmap, "filter_type": b.filter_type, "wrap_mode": b.wrap_mode, "raw": b.raw,
            "to_uv": mi.ScalarTransform4f(to_uv),
        }
    )  # fmt: skip


@pytest.fixture(scope="module")
def mi() -> Any:
    module = pytest.importorskip("mitsuba")
    module.set_variant("llvm_ad_rgb")
    return module


@pytest.mark.parametrize(("dtype", "channels"), FORMATS)
def test_agrees_with_mitsuba(mi: Any, interaction: Any, dtype: str, channels: int) -> None:
    uv = np.random.default_rng(1).uniform(-3, 4, (2, 4000)).astype(np.float32)
    theirs = dr.zeros(mi.SurfaceInteraction3f, uv.shape[1])
    theirs.uv = mi.Point2f(uv)
    si = interaction(T32, uv)
    for filter_type, wrap_mode in itertools.product(["nearest", "bilinear"], MODES):
        raw = wrap_mode == "mirror"
        b = BitmapTexture(
            image(dtype, channels), filter_type=filter_type, wrap_mode=wrap_mode, raw=raw, to_uv=TO_UV  # type: ignore[arg-type]
        )  # fmt: skip
        reference = mitsuba_bitmap(mi, b)
        table = TextureTable.build([b], T32)
        index = table.add(b)
        assert np.allclose(table.eval(T32.UInt(index), si), reference.eval(theirs), atol=1e-5)
        assert np.allclose(table.eval_1(index, si), reference.eval_1(theirs), atol=1e-5)
        assert np.allclose(table.eval_uv(index, T32.Array2f(uv)), reference.eval(theirs), atol=1e-5)


def test_differing_bitmaps_in_one_table_keep_apart(interaction: Any) -> None:
    rng = np.random.default_rng(2)
    bitmaps = [
        BitmapTexture(
            image(dtype, channels, 3 + i, 9 - i, seed=i), filter_type=f, wrap_mode=w, raw=i % 2 == 0,
            to_uv=TO_UV if i % 3 else np.eye(3),
        )
        for i, ((dtype, channels), f, w) in enumerate(
            itertools.islice(itertools.product(FORMATS, ["nearest", "bilinear"], MODES), 0, 36, 5)
        )
    ]  # fmt: skip
    uv = rng.uniform(-2, 3, (2, 3000))
    si = interaction(T32, uv)
    table = TextureTable.build(bitmaps, T32)
    which = rng.integers(0, len(bitmaps), uv.shape[1])
    index = np.array([table.add(b) for b in bitmaps], dtype=np.uint32)[which]
    together = np.array(table.eval(T32.UInt(index), si))
    for i, b in enumerate(bitmaps):
        alone = TextureTable.build([b], T32)
        assert np.array_equal(together[:, which == i], np.array(alone.eval(alone.add(b), si))[:, which == i])


@pytest.mark.parametrize("mode", MODES)
def test_wrapping_is_exact(mode: str) -> None:
    for size in (1, 2, 3, 7, 640, 1023):
        cells = np.concatenate([np.arange(-3 * size - 2, 3 * size + 2), [-(10**6), 10**6, 10**6 + 1]])
        b = BitmapTexture(
            np.arange(size, dtype=np.float32).reshape(1, size, 1), filter_type="nearest", wrap_mode=mode  # type: ignore[arg-type]
        )  # fmt: skip
        t = types("float64")
        table = TextureTable.build([b], t)
        uv = t.Array2f(t.Float((cells + 0.5) / size), 0.5)
        if mode == "repeat":
            expected = cells % size
        elif mode == "mirror":
            expected = np.where((cells // size) % 2 == 0, cells % size, size - 1 - cells % size)
        else:
            expected = np.clip(cells, 0, size - 1)
        assert np.array_equal(np.array(table.eval_uv(table.add(b), uv))[0], expected)


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.tuples(*2 * [st.floats(width=32)]), min_size=1, max_size=20),
    st.sampled_from(MODES),
    st.sampled_from(["nearest", "bilinear"]),
    st.sampled_from([(1, 1), (1, 4), (5, 3)]),
)
def test_any_uv_at_all_stays_inside(points: list[tuple[float, float]], mode: Any, kind: Any, shape: Any) -> None:
    pixels = image("float32", 1, *shape)
    b = BitmapTexture(pixels, filter_type=kind, wrap_mode=mode)
    table = TextureTable.build([b], T32)
    uv = np.array(points, dtype=np.float32).T
    value = np.array(table.eval_uv(table.add(b), T32.Array2f(np.ascontiguousarray(uv))))[0]
    with np.errstate(over="ignore"):
        sane = np.isfinite(uv * np.float32(8)).all(axis=0)
    if kind == "nearest":
        assert np.isin(value, pixels).all()
    else:
        assert ((value >= pixels.min() - 1e-6) & (value <= pixels.max() + 1e-6))[sane].all()


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_srgb_decoding_of_every_byte(precision: str) -> None:
    t = types(precision)
    pixels = np.arange(256, dtype=np.uint8).reshape(1, 256, 1)
    b = BitmapTexture(np.repeat(pixels, 3, axis=2), filter_type="nearest")
    table = TextureTable.build([b], t)
    uv = t.Array2f(t.Float((np.arange(256) + 0.5) / 256), 0.5)
    x = np.arange(256) / 255
    expected = np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)
    limit = 4e-7 if precision == "float32" else 1e-14
    assert np.allclose(np.array(table.eval_uv(table.add(b), uv)), expected, rtol=limit, atol=0)


def test_bilinear_in_double_precision_against_numpy() -> None:
    t = types("float64")
    pixels = image("float32", 3)
    b = BitmapTexture(pixels)
    u, v = np.random.default_rng(3).uniform(0.3, 0.7, (2, 500))
    x, y = u * 5 - 0.5, v * 7 - 0.5
    i, j = np.floor(x).astype(int), np.floor(y).astype(int)
    wx, wy = (x - i)[:, None], (y - j)[:, None]
    p = pixels.astype(np.float64)
    top, bottom = p[j, i] * (1 - wx) + p[j, i + 1] * wx, p[j + 1, i] * (1 - wx) + p[j + 1, i + 1] * wx
    table = TextureTable.build([b], t)
    value = np.array(table.eval_uv(table.add(b), t.Array2f(t.Float(u), t.Float(v)))).T
    assert np.allclose(value, top * (1 - wy) + bottom * wy, atol=1e-14)


def test_derivative_by_uv_is_the_texel_difference() -> None:
    t = types("float64")
    b = BitmapTexture(np.array([[[0.0], [1.0], [4.0]]], dtype=np.float32))
    table = TextureTable.build([b], t)
    u = t.Float([0.4, 0.6])
    dr.enable_grad(u)
    value = table.eval_uv(table.add(b), t.Array2f(u, 0.5)).x
    dr.backward(value)
    assert np.allclose(dr.grad(u), [3 * 1, 3 * 3])


@pytest.mark.parametrize(
    "pixels",
    [
        np.zeros((0, 4, 3), np.uint8),
        np.zeros((4, 4), np.uint8),
        np.zeros((4, 4, 2), np.float32),
        np.zeros((2, 2, 1), int),
    ],
)
def test_pixels_that_no_table_holds_are_refused(pixels: np.ndarray) -> None:
    with pytest.raises(ValueError, match=r"wall\.png"):
        TextureTable.build([BitmapTexture(pixels, filename="wall.png")], T32)
