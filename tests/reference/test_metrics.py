"""Metrics against closed forms, FLIP against its authors' implementation."""

from __future__ import annotations

import math

import numpy as np
import pytest

from raytrace2.reference.flip import flip
from raytrace2.reference.metrics import mae, psnr, relmse, rmse


def _images() -> list[tuple[np.ndarray, np.ndarray]]:
    rng = np.random.default_rng(0)
    noise = rng.uniform(0.0, 1.0, (48, 64, 3))
    box = np.zeros((48, 64, 3))
    box[10:30, 20:40] = [0.8, 0.2, 0.1]
    noisier = np.clip(noise + rng.normal(0, 0.1, noise.shape), 0, 1)
    return [(noisier, noise), (np.roll(box, 3, axis=1), box), (1.0 - box, box)]


def test_metrics_of_a_constant_offset() -> None:
    reference = np.full((4, 5, 3), 0.5)
    image = reference + 0.1
    assert rmse(image, reference) == pytest.approx(0.1)
    assert mae(image, reference) == pytest.approx(0.1)
    assert relmse(image, reference) == pytest.approx(0.01 / 0.26)
    assert psnr(image, reference) == pytest.approx(20.0)


def test_metrics_of_equal_images() -> None:
    image = np.random.default_rng(1).random((4, 5, 3))
    assert rmse(image, image) == mae(image, image) == relmse(image, image) == 0.0
    assert psnr(image, image) == math.inf
    assert flip(image, image)[0] == 0.0


def test_a_broken_pixel_is_never_left_out() -> None:
    reference = np.full((8, 8, 3), 0.5)
    image = reference.copy()
    image[2, 3, 1] = np.nan
    assert all(math.isnan(metric(image, reference)) for metric in (rmse, mae, relmse, psnr))
    mean, error = flip(image, reference)
    assert error[2, 3] == 1.0 and 0.0 < mean < 1.0


@pytest.mark.parametrize(
    "shapes", [((4, 5, 3), (5, 4, 3)), ((4, 5), (4, 5)), ((4, 5, 4), (4, 5, 4)), ((0, 5, 3), (0, 5, 3))]
)
def test_wrong_shapes_are_refused(shapes: tuple[tuple[int, ...], tuple[int, ...]]) -> None:
    for metric in (rmse, mae, relmse, psnr, flip):
        with pytest.raises(ValueError, match="shape"):
            metric(np.zeros(shapes[0]), np.zeros(shapes[1]))


@pytest.mark.parametrize("case", range(3))
@pytest.mark.parametrize("pixels_per_degree", [67.0, 30.0])
def test_flip_is_that_of_its_authors(case: int, pixels_per_degree: float) -> None:
    evaluator = pytest.importorskip("flip_evaluator")
    image, reference = _images()[case]
    theirs, mean, _ = evaluator.evaluate(
        reference.astype(np.float32),
        image.astype(np.float32),
        "LDR",
        inputsRGB=False,
        applyMagma=False,
        parameters={"ppd": pixels_per_degree},
    )
    ours, error = flip(image, reference, pixels_per_degree)
    assert ours == pytest.approx(mean, abs=2e-4)
    np.testing.assert_allclose(error, np.squeeze(theirs), atol=2e-3)


def test_flip_stays_between_0_and_1() -> None:
    white, black = np.full((20, 20, 3), 1e6), np.full((20, 20, 3), -1.0)
    mean, error = flip(white, black)
    assert 0.9 < mean <= 1.0 and error.min() >= 0.0 and error.max() <= 1.0
