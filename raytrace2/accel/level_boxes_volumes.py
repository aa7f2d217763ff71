"""Axis-aligned boxes around bounding volumes of any shape."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Boxes = tuple[np.ndarray, np.ndarray]

#: What the sums below may lose to rounding, relative to their terms.
_ROUNDING = 16 * 2.0**-53


def volume_boxes(words: np.ndarray, volume: str) -> Boxes:
    """The boxes (n, 3), (n, 3) float64 around volumes of the shape of that name, whose ``words`` (n, width) these
    are."""
    return _BOXES[volume](words.astype(np.float64))


def _around(center: np.ndarray, half: np.ndarray) -> Boxes:
    slack = _ROUNDING * (np.abs(center) + half)
    return center - half - slack, center + half + slack


def _sphere(words: np.ndarray) -> Boxes:
    return _around(words[:, :3], words[:, 3:4])


def _box(words: np.ndarray) -> Boxes:
    # Exact wherever float64 can tell the sums of two float32 numbers.
    center, half = words[:, :3], words[:, 3:6]
    return center - half, center + half


def _oriented_box(words: np.ndarray) -> Boxes:
    # The slabs are those of the axes as they are rounded, which are not quite at right angles.
    axes = np.linalg.inv(words[:, :9].reshape(-1, 3, 3))
    return _around(words[:, 9:12], np.einsum("nij,nj->ni", np.abs(axes), words[:, 12:15]) * (1 + _ROUNDING))


_BOXES: dict[str, Callable[[np.ndarray], Boxes]] = {"sphere": _sphere, "box": _box, "oriented_box": _oriented_box}
