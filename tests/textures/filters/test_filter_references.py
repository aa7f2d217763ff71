"""Filters against straightforward sums in NumPy, double precision."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from raytrace2.rays.footprint import Footprint
from raytrace2.scene.description import BitmapTexture, ReconstructionFilter
from raytrace2.textures.bitmap import Bitmaps
from raytrace2.textures.filter_settings import FilterSettings
from raytrace2.types import types

T = types("float64")
BOX, GAUSSIAN = ReconstructionFilter("box"), ReconstructionFilter("gaussian", stddev=0.5)
TENT = ReconstructionFilter("tent")
IMAGE = np.random.default_rng(0).random((64, 128))
N = 150


def points(high: float = 40.0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    return rng.uniform(-1, 2, (N, 2)), rng.normal(size=(N, 2, 2)) * np.exp(rng.uniform(-1, np.log(high), (N, 1, 2)))


def look_up(setting: FilterSettings, uv: np.ndarray, j: np.ndarray, random: np.ndarray | None = None) -> np.ndarray:
    """Values at uv (n, 2) under Jacobians (n, 2, 2) in texels, columns dx and dy."""

    def array(v: Any) -> Any:
        return T.Array2f(T.Float(v[:, 0].copy()), T.Float(v[:, 1].copy()))

    j = j / np.array([128, 64])[:, None]
    footprint = Footprint(array(j[:, :, 0]), array(j[:, :, 1]), random=None if random is None else array(random))
    table = Bitmaps([BitmapTexture(IMAGE[..., None])], T, setting)
    return np.array(table.eval(T.UInt(0), array(uv), footprint, T.Bool(True)))


def level(k: int) -> np.ndarray:
    # Powers of two: means of blocks.
    y, x = min(2**k, 64), min(2**k, 128)
    return IMAGE.reshape(64 // y, y, 128 // x, x).mean(axis=(1, 3))


def bilinear(image: np.ndarray, u: float, v: float) -> float:
    h, w = image.shape
    x, y = u * w - 0.5, v * h - 0.5
    i, j = math.floor(x), math.floor(y)
    a, b = x - i, y - j
    p = image[np.ix_(np.arange(j, j + 2) % h, np.arange(i, i + 2) % w)]
    return float(np.array([1 - b, b]) @ p @ np.array([1 - a, a]))


def trilinear(u: float, v: float, texels: float) -> float:
    number = min(math.log2(max(texels, 1)), 7)
    k = min(math.floor(number), 6)
    return (1 - number + k) * bilinear(level(k), u, v) + (number - k) * bilinear(level(k + 1), u, v)


def widened(length: float, pixel: ReconstructionFilter) -> float:
    factor = {"box": 1, "tent": math.sqrt(2), "gaussian": math.sqrt(3)}[pixel.name]
    return length * (1 + (factor - 1) * min(max(length - 1, 0), 1))


@pytest.mark.parametrize("pixel", [BOX, TENT, GAUSSIAN], ids=lambda p: p.name)
def test_trilinear(pixel: ReconstructionFilter) -> None:
    uv, j = points()
    for name, axis in (("mip_distance", 0), ("trilinear", 0), ("trilinear_shorter", 1)):
        lengths = np.linalg.svd(j, compute_uv=False)[:, axis]
        expected = [trilinear(*p, widened(s, pixel)) for p, s in zip(uv, lengths, strict=True)]
        assert np.allclose(look_up(FilterSettings(name, pixel=pixel), uv, j), expected, atol=1e-10)


@pytest.mark.parametrize("pixel", [BOX, TENT, GAUSSIAN], ids=lambda p: p.name)
def test_probes(pixel: ReconstructionFilter) -> None:
    uv, j = points()
    expected = []
    for p, matrix in zip(uv, j, strict=True):
        left, s, _ = np.linalg.svd(matrix)
        major, minor = widened(s[0], pixel), widened(s[1], pixel)
        n = min(max(math.ceil(major / max(minor, 1)), 1), 16)
        deviation = n / math.sqrt(12) if n > 1 else 0
        spacing = major / n
        if pixel is BOX:
            spacing *= n / math.sqrt(n * n - 1) if n > 1 else 1
            k = np.arange(n) - (n - 1) / 2
            w = np.ones(n)
        elif pixel is TENT:
            half = math.sqrt(6 * deviation**2 + 1)
            count = math.ceil(2 * half - 1e-3) - 1
            k = np.arange(count) - (count - 1) / 2
            w = 1 - np.abs(k) / half
        else:
            k = np.arange(1 + math.ceil(5 * deviation)) - math.ceil(5 * deviation) / 2
            w = np.exp(-0.5 * (k / max(deviation, 1e-3)) ** 2)
        at = p + k[:, None] * left[:, 0] * spacing / np.array([128, 64])
        expected.append(np.average([trilinear(*a, major / n) for a in at], weights=w))
    assert np.allclose(look_up(FilterSettings("probes", pixel=pixel), uv, j), expected, atol=1e-9)


@pytest.mark.parametrize("pixel", [BOX, GAUSSIAN], ids=lambda p: p.name)
@pytest.mark.parametrize("most", [16.0, 2.0])
def test_ewa(pixel: ReconstructionFilter, most: float) -> None:
    uv, j = points(12.0)
    # Beyond this the ellipse would be longer than the image, where it is cut.
    keep = np.linalg.norm(j, axis=(1, 2)) < 50
    reach, variance = (2.0, 1.08 / 12) if pixel is BOX else (2.5, 0.94 * 0.25)
    edge = math.exp(-(reach**2) / 2)
    variance /= 1 - reach**2 / 2 * edge / (1 - edge)
    expected = []
    for p, matrix in zip(uv, j, strict=True):
        left, s, _ = np.linalg.svd(matrix)
        v = variance * s**2 + 1 / 6
        v[1] = max(v[1], v[0] / most**2)
        k = max(math.floor(0.5 * math.log2((v[1] + 1 / 12) / (0.25 + 1 / 12))), 0)
        covariance = (left @ np.diag(v) @ left.T + np.eye(2) / 12) / 4**k - np.eye(2) / 12
        covariance += np.eye(2) * max(0.25 - np.linalg.eigvalsh(covariance)[0], 0)
        image = level(k)
        h, w = image.shape
        x, y = p * [w, h] - 0.5
        dj, di = np.mgrid[-60:61, -60:61]
        d = np.stack([di - (x - round(x)), dj - (y - round(y))], axis=-1)
        q = np.einsum("abi,ij,abj->ab", d, np.linalg.inv(covariance), d)
        weights = np.where(q <= reach**2, np.exp(-q / 2), 0)
        value = np.average(image[(dj + round(y)) % h, (di + round(x)) % w], weights=weights)
        mix = min(max(2 * (s[0] - 1), 0), 1)
        expected.append((1 - mix) * bilinear(IMAGE, *p) + mix * value)
    got = look_up(FilterSettings("ewa", pixel=pixel, max_anisotropy=most), uv, j)
    assert np.allclose(got[keep], np.array(expected)[keep], atol=1e-9)


def test_bicubic_is_catmull_rom() -> None:
    uv, j = points()

    def weights(t: float) -> np.ndarray:
        return np.array([[0, 2, 0, 0], [-1, 0, 1, 0], [2, -5, 4, -1], [-1, 3, -3, 1]]).T @ t ** np.arange(4) / 2

    expected = []
    for u, v in uv:
        x, y = u * 128 - 0.5, v * 64 - 0.5
        left, top = math.floor(x), math.floor(y)
        p = IMAGE[np.ix_(np.arange(top - 1, top + 3) % 64, np.arange(left - 1, left + 3) % 128)]
        expected.append(weights(y - top) @ p @ weights(x - left))
    assert np.allclose(look_up(FilterSettings("bicubic"), uv, j), expected, atol=1e-12)


@pytest.mark.parametrize("of", ["bilinear", "bicubic", "trilinear", "trilinear_shorter", "probes", "ewa"])
@pytest.mark.parametrize("pixel", [BOX, TENT, GAUSSIAN], ids=lambda p: p.name)
def test_the_mean_of_random_texels_is_the_filter(of: str, pixel: ReconstructionFilter) -> None:
    uv, j = (v[:40] for v in points(10.0))
    side = 60
    cells = np.stack(np.meshgrid(np.arange(side), np.arange(side)), axis=-1).reshape(-1, 2)
    random = (cells + np.random.default_rng(2).random(cells.shape)) / side
    n = len(random)
    values = look_up(
        FilterSettings("stochastic", of=of, pixel=pixel), np.repeat(uv, n, axis=0), np.repeat(j, n, axis=0),
        np.tile(random, (40, 1)),
    ).reshape(40, n)  # fmt: skip
    error = values.mean(axis=1) - look_up(FilterSettings(of, pixel=pixel), uv, j)
    deviation = values.std(axis=1) / math.sqrt(n)
    assert (np.abs(error) <= 4.5 * deviation + 1e-9).all()
    assert abs(error.mean()) <= 4 * math.sqrt((deviation**2).sum()) / 40 + 1e-9


@pytest.mark.parametrize("pixel", [BOX, TENT, GAUSSIAN], ids=lambda p: p.name)
def test_random_places_of_the_pixel_integrate_the_bilinear_texture(pixel: ReconstructionFilter) -> None:
    uv, j = (v[:10] for v in points(3.0))
    reach = {"box": 0.5, "tent": 1.0, "gaussian": 2.5}[pixel.name]
    x = (np.arange(160) + 0.5) / 160 * 2 * reach - reach
    w = {"box": np.ones(160), "tent": 1 - np.abs(x), "gaussian": np.exp(-2 * x * x)}[pixel.name]
    a, b = np.meshgrid(x, x)
    at = uv[:, None] + np.einsum("nij,kj->nki", j, np.stack([a.ravel(), b.ravel()], axis=1)) / [128, 64]
    flat = look_up(FilterSettings("bilinear"), at.reshape(-1, 2), np.zeros((at.shape[0] * at.shape[1], 2, 2)))
    truth = np.average(flat.reshape(len(uv), -1), weights=np.outer(w, w).ravel(), axis=1)
    n = 40000
    random = np.random.default_rng(3).random((n, 2))
    values = look_up(
        FilterSettings("stochastic", of="exact", pixel=pixel), np.repeat(uv, n, axis=0), np.repeat(j, n, axis=0),
        np.tile(random, (len(uv), 1)),
    ).reshape(len(uv), n)  # fmt: skip
    assert (np.abs(values.mean(axis=1) - truth) <= 4.5 * values.std(axis=1) / math.sqrt(n) + 2e-4).all()
