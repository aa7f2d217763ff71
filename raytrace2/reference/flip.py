"""The FLIP difference of two images as a person would see it who flips between them on a screen.

Andersson, Nilsson, Akenine-Moller, Oskarsson, Astrom and Fairchild, "FLIP: A Difference Evaluator for Alternating
Images", Proc. ACM Comput. Graph. Interact. Tech. 3(2), 2020; section and constant names below are those of the paper.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from .metrics import pair

_RGB_TO_XYZ = np.array(
    [
        [10135552 / 24577794, 8788810 / 24577794, 4435075 / 24577794],
        [2613072 / 12288897, 8788810 / 12288897, 887015 / 12288897],
        [1425312 / 73733382, 8788810 / 73733382, 70074185 / 73733382],
    ]
)
_WHITE = _RGB_TO_XYZ.sum(axis=1)
_XYZ_TO_RGB = np.linalg.inv(_RGB_TO_XYZ)
# Contrast sensitivity of the achromatic, red-green and blue-yellow channels: sums of Gaussians, (a, b) of section
# 4.1.1.
_CONTRAST_SENSITIVITY = (((1.0, 0.0047),), ((1.0, 0.0053),), ((34.1, 0.04), (13.5, 0.025)))
_Q_COLOR, _Q_FEATURE, _P_COLOR, _P_THRESHOLD, _FEATURE_WIDTH = 0.7, 0.5, 0.4, 0.95, 0.082


def flip(image: npt.ArrayLike, reference: npt.ArrayLike, pixels_per_degree: float = 67.0) -> tuple[float, np.ndarray]:
    """The low-dynamic-range FLIP error: its mean and the (H, W) map, from 0 (the same) to 1 (could not differ more).

    ``image`` and ``reference`` are (H, W, 3) linear Rec. 709; what a screen cannot show (below 0, above 1) is cut off,
    as a screen would. ``pixels_per_degree`` of visual angle: 67 is a 4K monitor of 0.7 m width seen from 0.7 m. A pixel
    that is not finite in either image has error 1 and counts as black in its neighbours' filters."""
    a, b = pair(image, reference)
    broken = ~(np.isfinite(a) & np.isfinite(b)).all(axis=2)
    if broken.any():
        a, b = np.where(broken[..., None], 0.0, a), np.where(broken[..., None], 0.0, b)
    a, b = np.clip(a, 0.0, 1.0), np.clip(b, 0.0, 1.0)
    opponent_a, opponent_b = _opponent(a), _opponent(b)

    lab_a, lab_b = (_hunt(_lab(_filter_contrast(o, pixels_per_degree))) for o in (opponent_a, opponent_b))
    color = _redistribute(_hyab(lab_a, lab_b) ** _Q_COLOR)

    grey_a, grey_b = ((o[..., 0] + 16.0) / 116.0 for o in (opponent_a, opponent_b))
    edges = np.abs(_features(grey_a, pixels_per_degree, 1) - _features(grey_b, pixels_per_degree, 1))
    points = np.abs(_features(grey_a, pixels_per_degree, 2) - _features(grey_b, pixels_per_degree, 2))
    feature = np.clip(np.maximum(edges, points) / np.sqrt(2.0), 0.0, 1.0) ** _Q_FEATURE

    error = np.where(broken, 1.0, color ** (1.0 - feature))
    return float(error.mean()), error


def _opponent(rgb: np.ndarray) -> np.ndarray:
    """Linear RGB to YCxCz, the linearised CIELAB in which the eye's contrast sensitivity is given."""
    x, y, z = np.moveaxis(rgb @ _RGB_TO_XYZ.T / _WHITE, -1, 0)
    return np.stack([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)], axis=-1)


def _filter_contrast(opponent: np.ndarray, ppd: float) -> np.ndarray:
    """Blurs what the eye cannot resolve at this distance (section 4.1.1); returns linear RGB in [0, 1]."""
    widest = max(b for gaussians in _CONTRAST_SENSITIVITY for _, b in gaussians)
    radius = int(np.ceil(3.0 * np.sqrt(widest / (2.0 * np.pi**2)) * ppd))
    offsets = np.arange(-radius, radius + 1) / ppd
    filtered = np.empty_like(opponent)
    for channel, gaussians in enumerate(_CONTRAST_SENSITIVITY):
        total, weight = np.zeros(opponent.shape[:2]), 0.0
        for a, b in gaussians:
            kernel = np.exp(-(np.pi**2) / b * offsets**2)
            amplitude = a * np.sqrt(np.pi / b)
            total += amplitude * _separable(opponent[..., channel], kernel, kernel)
            weight += amplitude * kernel.sum() ** 2
        filtered[..., channel] = total / weight
    y = (filtered[..., 0] + 16.0) / 116.0
    xyz = np.stack([y + filtered[..., 1] / 500.0, y, y - filtered[..., 2] / 200.0], axis=-1) * _WHITE
    return np.clip(xyz @ _XYZ_TO_RGB.T, 0.0, 1.0)


def _lab(rgb: np.ndarray) -> np.ndarray:
    ratio = rgb @ _RGB_TO_XYZ.T / _WHITE
    delta = 6.0 / 29.0
    x, y, z = np.moveaxis(np.where(ratio > delta**3, np.cbrt(ratio), ratio / (3.0 * delta**2) + 4.0 / 29.0), -1, 0)
    return np.stack([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)], axis=-1)


def _hunt(lab: np.ndarray) -> np.ndarray:
    """Colours look less colourful in the dark (the Hunt effect)."""
    lightness = lab[..., :1]
    return np.concatenate([lightness, 0.01 * lightness * lab[..., 1:]], axis=-1)


def _hyab(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    d = a - b
    return np.abs(d[..., 0]) + np.hypot(d[..., 1], d[..., 2])


def _redistribute(power: np.ndarray) -> np.ndarray:
    """Maps powered colour distances to [0, 1], most of it for the differences below 0.4 of the greatest (section
    4.1.3)."""
    green, blue = (_hunt(_lab(np.array(c))) for c in ([0.0, 1.0, 0.0], [0.0, 0.0, 1.0]))
    greatest = float(_hyab(green, blue)) ** _Q_COLOR
    knee = _P_COLOR * greatest
    above = _P_THRESHOLD + (power - knee) / (greatest - knee) * (1.0 - _P_THRESHOLD)
    return np.where(power < knee, _P_THRESHOLD / knee * power, above)


def _features(grey: np.ndarray, ppd: float, order: int) -> np.ndarray:
    """Magnitude of the first (edges) or second (points) derivative at the width of the eye's detectors (section
    4.2)."""
    sd = 0.5 * _FEATURE_WIDTH * ppd
    radius = int(np.ceil(3.0 * sd))
    x = np.arange(-radius, radius + 1, dtype=np.float64)
    gaussian = np.exp(-(x**2) / (2.0 * sd**2))
    derivative = -x * gaussian if order == 1 else (x**2 / sd**2 - 1.0) * gaussian
    positive, negative = derivative.clip(min=0.0).sum(), -derivative.clip(max=0.0).sum()
    derivative = np.where(derivative > 0.0, derivative / positive, derivative / negative)
    gaussian /= gaussian.sum()
    return np.hypot(_separable(grey, derivative, gaussian), _separable(grey, gaussian, derivative))


def _separable(plane: np.ndarray, across: np.ndarray, down: np.ndarray) -> np.ndarray:
    """Correlates (H, W) with ``across`` along rows and ``down`` along columns; the border repeats."""
    for axis, kernel in ((1, across), (0, down)):
        radius = len(kernel) // 2
        padding = [(radius, radius) if a == axis else (0, 0) for a in (0, 1)]
        padded = np.pad(plane, padding, mode="edge")
        n = plane.shape[axis]
        result = np.zeros_like(plane)
        for i, weight in enumerate(kernel):
            window = padded[:, i : i + n] if axis == 1 else padded[i : i + n]
            result += weight * window
        plane = result
    return plane
