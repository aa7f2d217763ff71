from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from raytrace2.rays.footprint import Footprint
from raytrace2.scene.description import BitmapTexture, CheckerboardTexture, ConstantTexture
from raytrace2.textures import TextureTable
from raytrace2.textures.checker_coverage import odd_fraction
from raytrace2.textures.filter_settings import FilterSettings
from raytrace2.types import Types, types

T32, T64 = types("float32"), types("float64")
A, B = ConstantTexture((0.1, 0.2, 0.6)), ConstantTexture((0.7, 0.8, 0.9))
VECTORS = st.tuples(st.floats(-5, 5), st.floats(-5, 5)).map(np.array)


def sampled(centre: np.ndarray, a: np.ndarray, b: np.ndarray, n: int = 1000) -> float:
    s = (np.arange(n) + 0.5) / n - 0.5
    x, y = (centre[k] + s[:, None] * a[k] + s[None, :] * b[k] for k in range(2))
    return float(((np.floor(x) + np.floor(y)) % 2).mean())


def covered(t: Types, centre: Any, a: Any, b: Any) -> np.ndarray:
    vectors = (t.Array2f(np.asarray(v, dtype=np.float64).reshape(2, -1).astype(t.numpy)) for v in (centre, a, b))
    return np.array(odd_fraction(*vectors, t.Bool(True)), dtype=np.float64)


@settings(max_examples=60, deadline=None)
@given(centre=VECTORS, a=VECTORS, b=VECTORS)
def test_coverage_is_the_integral(centre: np.ndarray, a: np.ndarray, b: np.ndarray) -> None:
    longest = max(np.hypot(*a), np.hypot(*b))
    if abs(a[0] * b[1] - a[1] * b[0]) < 0.02 * longest or longest < 0.02:
        return
    expected = sampled(centre, a, b)
    assert covered(T64, centre, a, b)[0] == pytest.approx(expected, abs=8e-3)
    assert covered(T32, centre, a, b)[0] == pytest.approx(covered(T64, centre, a, b)[0], abs=2e-4)


@pytest.mark.parametrize("t", [T32, T64])
def test_axis_aligned_footprints_separate(t: Types) -> None:
    """Along the axes the mean of a product is the product of means of square waves."""
    rng = np.random.default_rng(0)
    centre, size = rng.uniform(-20, 20, (2, 500)), 10 ** rng.uniform(-2, 1.5, (2, 500))

    def triangle(x: np.ndarray) -> np.ndarray:
        return 1 - np.abs(x % 2 - 1)

    waves = (triangle(centre + size / 2) - triangle(centre - size / 2)) / size
    zero = np.zeros(500)
    value = covered(t, centre, [size[0], zero], [zero, size[1]])
    assert np.abs(value - (0.5 - 0.5 * waves[0] * waves[1])).max() < (2e-4 if t is T32 else 1e-9)


def test_segments_and_points() -> None:
    # A quarter of the way lies in the next field.
    assert covered(T64, [0.75, 0.5], [1.0, 0.0], [0.0, 0.0])[0] == pytest.approx(0.25, abs=1e-6)
    for centre in ([0.3, 0.4], [1.3, 0.4], [-0.2, 5.4]):
        odd = (math.floor(centre[0]) + math.floor(centre[1])) % 2
        assert covered(T32, centre, [0.0, 0.0], [0.0, 0.0])[0] == odd
        assert covered(T32, centre, [1e-6, 1e-30], [0.0, 1e-6])[0] == odd
        assert covered(T64, centre, [1e-2, 0.0], [0.0, 1e-2])[0] == pytest.approx(odd, abs=1e-9)


@pytest.mark.parametrize("t", [T32, T64])
def test_extremes_end(t: Types) -> None:
    special = [0.0, 1e-38, 1.0, -3.5, 1e4, 1e10, -3e38, math.inf, -math.inf, math.nan]
    a, b, centre = np.random.default_rng(1).choice(special, (3, 2, 3000))
    value = covered(t, centre, a, b)
    assert ((value >= 0) & (value <= 1)).all()
    assert covered(t, [0.3, 0.4], [1e5, 3e4], [-2e3, 1e6])[0] == pytest.approx(0.5, abs=1e-2)


def evaluated(interaction: Any, texture: Any, uv: np.ndarray, size: float | None, name: str = "ewa") -> tuple[Any, Any]:
    table = TextureTable(T32, settings=FilterSettings(name))
    index = table.add(texture)
    table.finish()
    si = interaction(T32, uv)
    if size is not None:
        si.footprint = Footprint(T32.Array2f(size, 0), T32.Array2f(0, size))
    return np.array(table.eval(index, si)), np.array(table.eval_1(index, si))


def test_tables_blend_by_coverage(interaction: Any) -> None:
    uv = np.random.default_rng(2).uniform(-2, 2, (2, 200)).astype(np.float32)
    to_uv = np.diag([3.0, 2.0, 1.0])
    colours, single = evaluated(interaction, CheckerboardTexture(A, B, to_uv=to_uv), uv, 0.07)
    zero = np.zeros(200)
    share = covered(T64, uv * [[6.0], [4.0]], [zero + 0.42, zero], [zero, zero + 0.28])
    a, b = (np.array(c.value)[:, None] for c in (A, B))
    assert np.abs(colours - (a + share * (b - a))).max() < 1e-4
    # Mitsuba exchanges the colours where one channel is asked for.
    assert np.abs(single - (b.mean() + share * (a.mean() - b.mean()))).max() < 1e-4


def test_zero_footprints_give_points(interaction: Any) -> None:
    uv = np.random.default_rng(3).uniform(-2, 2, (2, 500)).astype(np.float32)
    inner = CheckerboardTexture(A, B, to_uv=np.diag([5.0, 4.0, 1.0]))
    board = CheckerboardTexture(inner, BitmapTexture(np.random.default_rng(4).random((4, 4, 3)).astype(np.float32)))
    without, with_none = evaluated(interaction, board, uv, None), evaluated(interaction, board, uv, 0.0)
    assert np.allclose(without[0], with_none[0], atol=1e-6) and np.allclose(without[1], with_none[1], atol=1e-6)


def test_equal_colours_stay(interaction: Any) -> None:
    same = ConstantTexture((0.3, 0.3000001, 1 / 3))
    uv = np.random.default_rng(5).uniform(-2, 2, (2, 500)).astype(np.float32)
    colours, _ = evaluated(interaction, CheckerboardTexture(same, ConstantTexture(same.value)), uv, 0.3)
    assert (colours == np.array(same.value, np.float32)[:, None]).all()
