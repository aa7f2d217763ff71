"""How far an image is from a reference: one number each. Arrays are (H, W, 3) linear radiance.

A pixel that is not finite makes the number not finite: a broken image never scores well by having its broken pixels
left out."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

LUMINANCE = np.array([0.212671, 0.715160, 0.072169])
"""Rec. 709 luminance of a linear RGB triple, with the digits that Mitsuba uses."""


def rmse(image: npt.ArrayLike, reference: npt.ArrayLike) -> float:
    """Root of the mean squared difference over pixels and channels, in units of radiance."""
    a, b = pair(image, reference)
    return math.sqrt(float(np.mean((a - b) ** 2)))


def mae(image: npt.ArrayLike, reference: npt.ArrayLike) -> float:
    """Mean absolute difference over pixels and channels, in units of radiance."""
    a, b = pair(image, reference)
    return float(np.mean(np.abs(a - b)))


def relmse(image: npt.ArrayLike, reference: npt.ArrayLike, epsilon: float = 1e-2) -> float:
    """Mean of (image - reference)^2 / (reference^2 + epsilon), which weighs dark pixels like bright ones.

    ``epsilon`` keeps black reference pixels from dominating; its value is that of Rousselle et al., "Adaptive rendering
    with non-local means filtering" (2012)."""
    a, b = pair(image, reference)
    return float(np.mean((a - b) ** 2 / (b**2 + epsilon)))


def psnr(image: npt.ArrayLike, reference: npt.ArrayLike, peak: float = 1.0) -> float:
    """Peak signal-to-noise ratio in decibels against ``peak`` radiance; ``inf`` for equal images."""
    error = rmse(image, reference)
    return math.inf if error == 0.0 else 20.0 * math.log10(peak / error)


def pair(image: npt.ArrayLike, reference: npt.ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """Both images as float64, checked to be of one (H, W, 3) shape with at least one pixel; ``ValueError``
    otherwise."""
    a, b = np.asarray(image, dtype=np.float64), np.asarray(reference, dtype=np.float64)
    if a.shape != b.shape:
        raise ValueError(f"images of different shapes cannot be compared: {a.shape} and {b.shape}")
    if a.ndim != 3 or a.shape[2] != 3 or a.size == 0:
        raise ValueError(f"an image must be of shape (H, W, 3) with at least one pixel, not {a.shape}")
    return a, b
