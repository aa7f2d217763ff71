"""What holds for every filter that heeds a footprint."""

from __future__ import annotations

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
from raytrace2.textures.wrap import MODES
from raytrace2.types import Types, types

T32, T64 = types("float32"), types("float64")
PIXELS = [ReconstructionFilter(n) for n in ("box", "tent", "gaussian", "mitchell")]  # type: ignore[arg-type]
NAMES = ["mip_distance", "trilinear", "trilinear_shorter", "ewa", "probes"]
SETTINGS = [FilterSettings(n, pixel=p) for n in NAMES for p in PIXELS] + [
    FilterSettings(n, max_anisotropy=a, pyramid="lanczos") for n in ("ewa", "probes") for a in (0, 3.5)
]
STOCHASTIC = [
    FilterSettings("stochastic", of=of, pixel=p) for of in [*NAMES, "bilinear", "bicubic", "exact"] for p in PIXELS[:3]
]
RNG = np.random.default_rng(0)
IMAGE = RNG.random((37, 50, 1)).astype(np.float32)


def look_up(
    setting: FilterSettings, t: Types, b: BitmapTexture, uv: Any, jacobian: Any, random: Any = None
) -> np.ndarray:
    """Values at uv (2, n) over footprints of texels (2, 2, n): [:, 0] is dx."""

    def array(v: Any) -> Any:
        v = np.asarray(v, dtype=t.numpy)
        return t.Array2f(t.Float(np.ascontiguousarray(v[0])), t.Float(np.ascontiguousarray(v[1])))

    height, width = b.pixels.shape[:2]
    with np.errstate(all="ignore"):
        j = np.asarray(jacobian, dtype=t.numpy) / np.array([width, height], dtype=t.numpy)[:, None, None]
    footprint = Footprint(array(j[:, 0]), array(j[:, 1]), random=None if random is None else array(random))
    table = Bitmaps([b], t, setting)
    return np.atleast_2d(np.array(table.eval(t.UInt(0), array(uv), footprint, t.Bool(True))))


def footprints(n: int, low: float, high: float, seed: int) -> np.ndarray:
    """(2, 2, n) with random directions and axes between the bounds."""
    rng = np.random.default_rng(seed)
    a = np.exp(rng.uniform(np.log(low), np.log(high), (2, n)))
    turn, p = rng.uniform(0, 7, n), rng.uniform(0, 7, n)
    r = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    q = np.array([[np.cos(p), -np.sin(p)], [np.sin(p), np.cos(p)]])
    return np.einsum("ijn,jn,jkn->ikn", r, a, q)


@pytest.mark.parametrize("setting", [s for s in SETTINGS if s.pixel.name in ("box", "gaussian")], ids=str)
def test_magnification_is_bilinear_to_the_bit(setting: FilterSettings) -> None:
    t = T64 if setting.max_anisotropy == 0 else T32
    uv = np.random.default_rng(1).uniform(-2, 3, (2, 500))
    jacobian = footprints(500, 1e-6, 0.999, 2)
    jacobian[:, :, :20] = 0
    for mode, dtype in (("repeat", np.float32), ("clamp", np.uint8)):
        pixels = np.repeat(IMAGE if dtype is np.float32 else (IMAGE * 255).astype(np.uint8), 3, axis=2)
        b = BitmapTexture(pixels, wrap_mode=mode)  # type: ignore[arg-type]
        expected = look_up(FilterSettings("bilinear"), t, b, uv, jacobian)
        assert np.array_equal(look_up(setting, t, b, uv, jacobian), expected)


@settings(max_examples=40, deadline=None)
@given(
    st.sampled_from(SETTINGS + STOCHASTIC),
    st.sampled_from(["uint8", "float16", "float32"]),
    st.sampled_from([1, 3]),
    st.sampled_from([(1, 1), (1, 300), (37, 20)]),
    st.sampled_from(list(MODES)),
    st.integers(0, 255),
)
def test_constants_stay_constant_to_the_bit(
    setting: Any, dtype: Any, channels: int, shape: Any, mode: Any, c: int
) -> None:
    values = np.array([c, 255 - c, 77])[:channels]
    pixels = np.ascontiguousarray(np.broadcast_to(values if dtype == "uint8" else values / 91, (*shape, channels)))
    b = BitmapTexture(pixels.astype(dtype), wrap_mode=mode)
    uv = np.random.default_rng(3).uniform(-2, 3, (2, 200))
    jacobian = footprints(200, 1e-3, 1e5, 4)
    got = look_up(setting, T32, b, uv, jacobian, np.random.default_rng(5).random((2, 200)) * 0.9999)
    assert np.array_equal(got, np.repeat(look_up(FilterSettings("nearest"), T32, b, uv, jacobian)[:, :1], 200, axis=1))


EXTREMES = st.one_of(st.floats(width=32), st.sampled_from([0.0, 1e-38, 1e38, np.inf, -np.inf, np.nan, 1e9, 2.0**30]))


@settings(max_examples=60, deadline=None)
@given(
    st.sampled_from(SETTINGS + STOCHASTIC),
    st.lists(EXTREMES, min_size=24, max_size=24),
    st.sampled_from([(1, 1), (1, 700), (5, 3), (64, 64)]),
    st.sampled_from(list(MODES)),
    st.booleans(),
)
def test_any_footprint_ends_and_stays_within_the_texels(
    setting: FilterSettings, numbers: list[float], shape: tuple[int, int], mode: Any, anywhere: bool
) -> None:
    pixels = np.random.default_rng(6).random((*shape, 1)).astype(np.float32)
    b = BitmapTexture(pixels, wrap_mode=mode)
    values = np.array(numbers, dtype=np.float32).reshape(6, 4)
    uv = values[4:] if anywhere else np.random.default_rng(7).random((2, 4))
    got = look_up(setting, T32, b, uv, values[:4].reshape(2, 2, 4), np.full((2, 4), 0.3))[0]
    if not anywhere and setting.pyramid == "box" and setting.of not in ("bicubic", "exact"):
        assert (got >= pixels.min() - 1e-5).all()
        assert (got <= pixels.max() + 1e-5).all()


@pytest.mark.parametrize("setting", [s for s in SETTINGS if s.pyramid == "box"], ids=str)
def test_footprints_that_are_no_numbers_give_the_mean(setting: FilterSettings) -> None:
    bad = np.array([[[np.nan, np.inf, 1.0, 1e30], [0, 0, 1, 0]], [[0, 0, np.nan, 0], [0, 1, 0, 1e30]]])
    got = look_up(setting, T32, BitmapTexture(IMAGE), np.full((2, 4), 0.4), bad)[0]
    expected = np.full(4, IMAGE.mean())
    if setting.name == "trilinear_shorter":
        got, expected = got[:2], expected[:2]
    assert np.allclose(got, expected, atol=2e-3)


@pytest.mark.parametrize("setting", SETTINGS[::2], ids=str)
def test_a_ramp_keeps_its_value_in_the_middle(setting: FilterSettings) -> None:
    # Whatever the rotation, shear and scale, a symmetric filter finds the ramp's value at the point.
    x, y = np.meshgrid((np.arange(256) + 0.5) / 256, (np.arange(256) + 0.5) / 256)
    b = BitmapTexture((0.3 * x + 0.6 * y)[..., None].astype(np.float32), wrap_mode="clamp")
    uv = np.random.default_rng(8).uniform(0.45, 0.55, (2, 400))
    got = look_up(setting, T32, b, uv, footprints(400, 0.1, 12, 9))[0]
    assert np.abs(got - 0.3 * uv[0] - 0.6 * uv[1]).max() < (2e-3 if setting.name == "ewa" else 1e-3)


@pytest.mark.parametrize("name", ["ewa", "probes", "trilinear"])
def test_quarter_turns_and_mirrors_of_texture_and_footprint_change_nothing(name: str) -> None:
    pixels = np.random.default_rng(10).random((64, 64, 1)).astype(np.float32)
    uv, jacobian = np.random.default_rng(11).random((2, 300)), footprints(300, 0.2, 60, 12)
    expected = look_up(FilterSettings(name), T64, BitmapTexture(pixels), uv, jacobian)
    turned = look_up(
        FilterSettings(name), T64, BitmapTexture(pixels.transpose(1, 0, 2).copy()), uv[::-1], jacobian[::-1]
    )
    mirrored = look_up(
        FilterSettings(name), T64, BitmapTexture(pixels[:, ::-1].copy()), [1 - uv[0], uv[1]],
        [-jacobian[0], jacobian[1]],
    )  # fmt: skip
    assert np.allclose(turned, expected, atol=1e-9)
    assert np.allclose(mirrored, expected, atol=1e-9)


def test_stochastic_needs_random_numbers() -> None:
    for of in (*NAMES, "bilinear"):
        with pytest.raises(SettingError, match="random numbers"):
            look_up(
                FilterSettings("stochastic", of=of), T32, BitmapTexture(IMAGE), [[0.5], [0.5]], np.eye(2)[..., None]
            )


@pytest.mark.parametrize("name", NAMES)
def test_derivatives_by_uv_and_footprint(name: str) -> None:
    t, n = T64, 60
    table = Bitmaps([BitmapTexture(IMAGE)], t, FilterSettings(name))
    rng = np.random.default_rng(13)
    start = [*rng.random((2, n)), *(footprints(n, 1.7, 9, 14) / 50).reshape(4, n)]

    def value(p: list[Any]) -> Any:
        a = [t.Float(v) if isinstance(v, np.ndarray) else v for v in p]
        footprint = Footprint(t.Array2f(a[2], a[3]), t.Array2f(a[4], a[5]))
        return table.eval(t.UInt(0), t.Array2f(a[0], a[1]), footprint, t.Bool(True))

    for k in range(6):
        inputs = [t.Float(v) for v in start]
        dr.enable_grad(inputs[k])
        dr.set_grad(inputs[k], 1)
        got = np.array(dr.forward_to(value(inputs)))
        near = [[v + (s * 1e-7 if i == k else 0) for i, v in enumerate(start)] for s in (-1, 1)]
        expected = (np.array(value(near[1])) - np.array(value(near[0]))) / 2e-7
        # Where a texel enters the sum there is a step, of which derivatives do not know.
        assert np.mean(np.abs(got - expected) <= 1e-4 * (1 + np.abs(expected))) >= 0.9


@pytest.mark.parametrize("setting", [*SETTINGS[::5], *STOCHASTIC[::4]], ids=str)
def test_look_ups_in_a_symbolic_loop_are_those_outside(setting: FilterSettings) -> None:
    t, n = T32, 100
    table = Bitmaps(
        [BitmapTexture((IMAGE * 255).astype(np.uint8)), BitmapTexture(np.zeros((3, 8, 1), np.uint8))], t, setting
    )
    place = t.UInt(np.arange(n) % 2)
    u = t.Array2f(np.random.default_rng(15).random((2, n)))
    j = footprints(n, 0.1, 30, 16) / 40
    footprint = Footprint(t.Array2f(j[:, 0]), t.Array2f(j[:, 1]), random=t.Array2f(0.3, 0.6))
    expected = table.eval(place, u, footprint, t.Bool(True))

    def step(k: Any, total: Any) -> tuple[Any, Any]:
        return k + 1, total + table.eval(place, u, footprint, k < 2)

    _, total = dr.while_loop((dr.zeros(t.UInt, n), dr.zeros(t.Float, n)), lambda k, _: k < 2, step)
    assert np.array_equal(total, 2 * expected)


@pytest.mark.parametrize("pixel", PIXELS[:3], ids=lambda p: p.name)
def test_ellipses_read_no_more_texels_than_they_say(
    pixel: ReconstructionFilter, monkeypatch: pytest.MonkeyPatch
) -> None:
    n, a = 20000, 16
    table = Bitmaps([BitmapTexture(np.zeros((512, 256, 1), np.float32))], T32, FilterSettings("ewa", pixel=pixel))
    count, lane, read = dr.zeros(T32.UInt, n), dr.arange(T32.UInt, n), table.texel

    def texel(image: Any, column: Any, row: Any, active: Any) -> Any:
        dr.scatter_add(count, T32.UInt(1), lane, active)
        return read(image, column, row, active)

    monkeypatch.setattr(table, "texel", texel)
    uv = T32.Array2f(np.random.default_rng(17).random((2, n)))
    j = footprints(n, 1.6, 3000, 18) / np.array([256, 512])[:, None, None]
    value = table.eval(T32.UInt(0), uv, Footprint(T32.Array2f(j[:, 0]), T32.Array2f(j[:, 1])), T32.Bool(True))
    dr.eval(value, count)
    reach = 2 if pixel.name == "box" else 2.5
    assert np.array(count).max() <= 5.2 * reach**2 * a + 2.4 * reach * (a + 1) + 2
