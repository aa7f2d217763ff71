"""The noise test: how often it cries wolf on noise of all kinds, and what it finds."""

from __future__ import annotations

import numpy as np
import pytest

from raytrace2.reference.ztest import NoiseTest, ztest

Shape = tuple[int, int]


def _filtered(samples: np.ndarray) -> np.ndarray:
    """Correlates pixels as Mitsuba's default reconstruction filter does (a Gaussian of standard deviation 0.5)."""
    kernel = np.exp(-(np.arange(-2, 3) ** 2) / 0.5)
    kernel /= kernel.sum()
    height, width = samples.shape[1] - 4, samples.shape[2] - 4
    rows = sum(k * samples[:, i : i + height] for i, k in enumerate(kernel))
    return np.asarray(sum(k * rows[:, :, i : i + width] for i, k in enumerate(kernel)), dtype=np.float32)


def _noise(
    rng: np.random.Generator, kind: str, batches: int, shape: Shape = (24, 32), relative: float = 0.3
) -> np.ndarray:
    """Batch means of mean 1 (fireflies add to it)."""
    size = (batches, shape[0] + 4, shape[1] + 4, 3)
    if kind == "lognormal":
        return _filtered(np.exp(rng.normal(0.0, 1.0, size) - 0.5))
    noise = 1.0 + relative * rng.normal(0.0, 1.0, size)
    if kind == "fireflies":
        noise += (rng.random((*size[:3], 1)) < 1e-3) * 50.0 * rng.pareto(1.2, (*size[:3], 1))
    return _filtered(noise)


@pytest.mark.parametrize("kind", ["gaussian", "lognormal", "fireflies"])
@pytest.mark.parametrize("batches", [(8, 8), (8, 24), (16, 16)])
def test_equal_distributions_fail_no_oftener_than_stated(kind: str, batches: tuple[int, int]) -> None:
    # At a rate of 10 % instead of 0.1 %, forty runs suffice to see a rate that is twice too high.
    rng = np.random.default_rng(3)
    alarms = sum(
        not ztest(_noise(rng, kind, batches[0]), _noise(rng, kind, batches[1]), false_alarm_rate=0.1, seed=i).consistent
        for i in range(40)
    )
    assert alarms <= 10  # P(X > 10) < 0.2 % for 40 runs at 10 %


def test_equal_means_with_unequal_noise_pass() -> None:
    rng = np.random.default_rng(4)
    for i in range(10):
        calm = _noise(rng, "gaussian", 8, relative=0.1)
        assert ztest(calm, _noise(rng, "gaussian", 8, relative=0.4), seed=i).consistent
        calm = 0.5 + 0.5 * _noise(rng, "lognormal", 16)
        result = ztest(calm, _noise(rng, "lognormal", 16), seed=i)
        assert result.consistent and result.noise_ratio == pytest.approx(0.25, rel=0.3)


def _detected(ours: np.ndarray, reference: np.ndarray) -> NoiseTest:
    result = ztest(ours, reference)
    assert not result.consistent and result.reasons
    return result


@pytest.mark.parametrize("batches", [8, 16])
def test_finds_an_object_that_is_one_per_cent_too_bright(batches: int) -> None:
    # 64 samples a pixel that deviate by 10 % each: a calm scene. What matters is the bias
    # over the standard error of a window's mean, which has to exceed 6 or so; noisier scenes need more samples.
    rng = np.random.default_rng(5)
    relative = 0.10 / np.sqrt(64 / batches)
    reference, ours = (_noise(rng, "gaussian", batches, (64, 80), relative) for _ in range(2))
    assert ztest(ours, reference).consistent
    ours[:, 21:41, 33:53] *= 1.01
    y0, x0, y1, x1 = _detected(ours, reference).worst_tile
    assert y0 < 41 and y1 > 21 and x0 < 53 and x1 > 33


def test_finds_an_edge_that_is_half_a_pixel_off() -> None:
    rng = np.random.default_rng(6)
    shape, batches, spp = (48, 48), 16, 4

    def render(edge: float) -> np.ndarray:
        x = np.arange(shape[1] + 4)[None, None, :, None] + rng.random((batches * spp, shape[0] + 4, shape[1] + 4, 1))
        values = np.where(x < edge, 0.2, 0.8) * (1.0 + 0.3 * rng.normal(size=x.shape))
        means = values.reshape(batches, spp, *values.shape[1:]).mean(axis=1)
        return _filtered(np.repeat(means, 3, axis=3))

    assert ztest(render(25.3), render(25.3)).consistent
    _detected(render(25.3), render(25.8))


@pytest.mark.parametrize("kind", ["gaussian", "lognormal", "fireflies"])
def test_finds_a_missing_object(kind: str) -> None:
    rng = np.random.default_rng(7)
    reference, ours = _noise(rng, kind, 16), _noise(rng, kind, 16)
    reference[:, 5:17, 6:18] *= 0.4
    _detected(ours, reference)


def test_finds_one_tinted_channel() -> None:
    rng = np.random.default_rng(8)
    reference, ours = _noise(rng, "gaussian", 16), _noise(rng, "gaussian", 16)
    ours[..., 2] *= 1.05
    result = _detected(ours, reference)
    assert result.mean_difference[2] == pytest.approx(0.05, abs=0.02) and abs(result.mean_difference[0]) < 0.02


def test_pixels_without_noise_must_be_equal_up_to_rounding() -> None:
    image = np.broadcast_to(np.random.default_rng(9).random((1, 24, 24, 3)), (8, 24, 24, 3)).astype(np.float32)
    assert ztest(image, image).consistent
    assert ztest(image * np.float32(1.00003), image).consistent
    off = image.copy()
    off[:, 4, 5] *= np.float32(1.001)
    result = _detected(off, image)
    assert result.mismatched_pixels == 1 and result.failing[4, 5] and result.failing.sum() == 1
    assert ztest(np.zeros_like(image), np.zeros_like(image)).consistent


def test_coverage_pixels_that_split_by_chance_are_no_alarm() -> None:
    # A pixel that is 0 or 1 in each batch splits just along the two sides once in 6435 times. Where thousands of such
    # pixels split in every way, one of them along the sides is no evidence; where none but that one does, it is.
    rng = np.random.default_rng(10)
    batches = np.zeros((16, 60, 60, 3), dtype=np.float32)
    batches[8:, 3, 3] = 1.0
    alone = ztest(batches[:8], batches[8:])
    assert alone.mismatched_pixels == 1 and alone.p_exact < 2.5e-4 and not alone.consistent
    for y, x in np.ndindex(40, 60):
        batches[:, 20 + y, x] = rng.permutation(np.arange(16) < 8)[:, None]
    among = ztest(batches[:8], batches[8:])
    assert among.mismatched_pixels >= 1 and among.p_exact > 0.01


def test_pixels_that_are_not_finite() -> None:
    rng = np.random.default_rng(11)
    reference, ours = _noise(rng, "gaussian", 8), _noise(rng, "gaussian", 8)
    reference[3, 2, 2, 0] = np.inf
    assert ztest(ours, reference).unjudged_pixels == 1 and ztest(ours, reference).consistent
    ours[1, 7, 7, 1] = np.nan
    result = _detected(ours, reference)
    assert result.nonfinite_pixels == 1 and result.failing[7, 7] and np.isfinite(result.z).all()


def test_the_same_question_has_the_same_answer() -> None:
    rng = np.random.default_rng(12)
    ours, reference = _noise(rng, "lognormal", 16), _noise(rng, "lognormal", 16)
    first, second = ztest(ours, reference), ztest(ours, reference)
    assert (first.p_pixels, first.p_tiles, first.p_mean) == (second.p_pixels, second.p_tiles, second.p_mean)


@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (7, 3)])
def test_tiny_images(shape: Shape) -> None:
    rng = np.random.default_rng(13)
    reference = _noise(rng, "gaussian", 16, shape)
    assert ztest(_noise(rng, "gaussian", 16, shape), reference).consistent
    _detected(_noise(rng, "gaussian", 16, shape) + 2.0, reference)


def test_scale_does_not_matter() -> None:
    rng = np.random.default_rng(14)
    ours, reference = _noise(rng, "gaussian", 16), _noise(rng, "gaussian", 16)
    p = [ztest(ours * np.float32(s), reference * np.float32(s)).p_tiles for s in (2.0**-60, 1.0, 2.0**60)]
    assert p[0] == pytest.approx(p[1], rel=0.2) and p[2] == pytest.approx(p[1], rel=0.2)


def test_too_few_batches_and_wrong_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match="too few"):
        ztest(np.ones((4, 8, 8, 3)), np.ones((4, 8, 8, 3)))
    with pytest.raises(ValueError, match="batch means"):
        ztest(np.ones((8, 8, 8, 3)), np.ones((8, 8, 9, 3)))
