from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from raytrace2.scene.description import BitmapTexture
from raytrace2.textures.bitmap import Bitmaps
from raytrace2.textures.block_means import BlockMeans
from raytrace2.textures.filter_settings import FilterSettings
from raytrace2.types import Types, types

T32, T64 = types("float32"), types("float64")
NODES, WEIGHTS = np.polynomial.legendre.leggauss(3)


def reconstructed(line: np.ndarray, x: np.ndarray, mode: str, nearest: bool) -> np.ndarray:
    """Along the last axis, at texel coordinates."""
    n = line.shape[-1]

    def at(i: np.ndarray) -> np.ndarray:
        if mode == "repeat":
            return line[..., i % n]
        if mode == "mirror":
            i = i % (2 * n)
            return line[..., np.where(i < n, i, 2 * n - 1 - i)]
        return line[..., np.clip(i, 0, n - 1)]

    if nearest:
        return at(np.floor(x).astype(int))
    i = np.floor(x - 0.5).astype(int)
    return at(i) + (at(i + 1) - at(i)) * (x - 0.5 - i)


def nodes(start: float, size: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places, weights and coordinates (-1/2 to 1/2) of a quadrature that is exact for squares of what is linear
    between halves of texels."""
    cuts = np.arange(np.floor(2 * start) + 1, np.ceil(2 * (start + size))) / 2
    ends = np.concatenate([[start], cuts, [start + size]])
    middle, half = (ends[1:] + ends[:-1]) / 2, np.diff(ends) / 2
    x = (middle[:, None] + half[:, None] * NODES).ravel()
    return x, (half[:, None] * WEIGHTS).ravel() / size, (x - start) / size - 0.5


def integrated(pixels: np.ndarray, at: tuple[float, float], size: tuple[float, float], mode: str, nearest: bool,
               flat: tuple[bool, bool]) -> np.ndarray:  # fmt: skip
    """Mean, slopes, mixed slope and root mean square of the rest, over one block."""
    (x, wx, u), (y, wy, v) = (nodes(at[k], size[k]) for k in range(2))
    values = reconstructed(reconstructed(pixels, x, mode, nearest).T, y, mode, nearest).T
    weights = wy[:, None] * wx
    bases = [np.ones_like(weights), u[None] + 0 * weights, v[:, None] + 0 * weights, v[:, None] * u]
    kept = [True, not flat[0], not flat[1], not (flat[0] or flat[1])]
    fit = [k * (weights * values * b).sum() / (weights * b * b).sum() for k, b in zip(kept, bases, strict=True)]
    rest = values - sum(f * b for f, b in zip(fit, bases, strict=True))
    return np.array([*fit, np.sqrt((weights * rest**2).sum())])


def built(t: Types, pixels: np.ndarray, mode: Any, nearest: bool) -> tuple[Bitmaps, BlockMeans]:
    kind = "nearest" if nearest else "bilinear"
    bitmaps = Bitmaps([BitmapTexture(pixels, wrap_mode=mode, filter_type=kind, raw=True)], t, FilterSettings("exact"))  # type: ignore[arg-type]
    assert bitmaps.blocks is not None
    bitmaps.blocks.build_deviations()
    return bitmaps, bitmaps.blocks


SIDES = st.integers(1, 40)


@settings(max_examples=10, deadline=None)
@given(
    w=SIDES, h=SIDES, mode=st.sampled_from(["repeat", "mirror", "clamp"]), nearest=st.booleans(), colour=st.booleans()
)
def test_blocks_are_the_nearest_bilinear_functions(w: int, h: int, mode: str, nearest: bool, colour: bool) -> None:
    pixels = np.random.default_rng(w + 64 * h).random((h, w, 3 if colour else 1))
    rng = np.random.default_rng(1)
    for t, tolerance in ((T64, 1e-7), (T32, 1e-3)):
        bitmaps, blocks = built(t, pixels, mode, nearest)
        image = bitmaps.image(t.UInt(0), t.Bool(True))
        top, reference, mean = blocks.ends(image, t.Bool(True))
        assert np.array(mean).ravel() == pytest.approx(pixels.mean((0, 1)), abs=tolerance)
        for number in range(1, int(top[0]) + 1):
            level = blocks.level(image, t.UInt(number), t.Bool(True))
            flat = tuple(bool(f[0]) for f in blocks.is_flat(level))
            size = tuple(float(s[0]) for s in level.size)
            column, row = int(rng.integers(int(level.columns[0]))), int(rng.integers(int(level.rows[0])))
            where = t.Float(column), t.Float(row), t.Bool(True)
            found = [np.array(v).ravel() for v in blocks.block(bitmaps, image, level, reference, *where)]
            found[0] = found[0] + np.array(reference).ravel()
            found.append(np.array(blocks.deviation(image, level, *where)).ravel())
            for c in range(pixels.shape[2]):
                expected = integrated(
                    pixels[..., c].astype(t.numpy), (column * size[0], row * size[1]), size, mode, nearest, flat
                )
                assert [f[c] for f in found] == pytest.approx(expected, abs=tolerance)


def test_clamped_edges_are_lines() -> None:
    """Blocks beyond the edges: the edge's own mean and slope, and nothing across."""
    pixels = np.random.default_rng(2).random((13, 9, 1))
    bitmaps, blocks = built(T64, pixels, "clamp", False)
    image = bitmaps.image(T64.UInt(0), T64.Bool(True))
    _, reference, _ = blocks.ends(image, T64.Bool(True))
    for number in range(1, 5):
        level = blocks.level(image, T64.UInt(number), T64.Bool(True))
        size = float(level.size.y[0])
        rows = int(level.rows[0])
        for row in range(rows):
            where = T64.Float(-1), T64.Float(row), T64.Bool(True)
            found = [float(v[0]) for v in blocks.block(bitmaps, image, level, reference, *where)]
            edge = np.repeat(pixels[:, :1, 0], 2, 1)
            expected = integrated(edge, (0.0, row * size), (1.0, size), "clamp", False, (False, False))
            found[0] += float(reference[0])
            assert found == pytest.approx(expected[:4], abs=1e-9)
            assert float(blocks.deviation(image, level, *where)[0]) == pytest.approx(expected[4], abs=1e-7)
        corner = T64.Float(-1), T64.Float(rows), T64.Bool(True)
        found = [float(v[0]) for v in blocks.block(bitmaps, image, level, reference, *corner)]
        assert found == pytest.approx([pixels[-1, 0, 0] - float(reference[0]), 0, 0, 0], abs=1e-12)


def test_bands_of_large_images_join() -> None:
    """More sums along u than are kept at a time."""
    pixels = np.random.default_rng(3).random((1200, 2500, 1)).astype(np.float32)
    bitmaps, blocks = built(T32, pixels, "repeat", False)
    image = bitmaps.image(T32.UInt(0), T32.Bool(True))
    level = blocks.level(image, T32.UInt(1), T32.Bool(True))
    _, reference, mean = blocks.ends(image, T32.Bool(True))
    row = T32.Float(np.arange(600))
    found = np.array(blocks.block(bitmaps, image, level, reference, T32.Float(700), row, T32.Bool(True))[0])
    padded = np.pad(pixels[..., 0].astype(np.float64), 1, "wrap")
    kernel = np.array([0.125, 0.875, 0.875, 0.125]) / 2
    rows = np.stack([padded[2 * np.arange(600) + k] for k in range(4)], -1) @ kernel
    expected = rows[:, 1400:1404] @ kernel
    assert np.allclose(found + reference[0], expected, atol=1e-6)
    assert mean[0] == pytest.approx(pixels.mean(dtype=np.float64), abs=1e-6)
