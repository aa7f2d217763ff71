"""Affine maps on the host: checked, inverted, applied to bounds."""

from __future__ import annotations

import itertools

import numpy as np

from ..arguments import real_array
from ..errors import GeometryError

#: Coordinates beyond this have squares that nothing can hold; meshes have the same bound.
LARGEST = 1e30
SMALLEST = 1e-30


def checked_transform(matrix: np.ndarray, what: str) -> np.ndarray:
    """``matrix`` as a read-only float64 (4, 4) map, affine and invertible; ``GeometryError`` naming ``what`` if not."""
    result = np.array(real_array(matrix, f"{what}: to_world"), dtype=np.float64)
    if result.shape != (4, 4):
        raise GeometryError(f"{what}: to_world must have shape (4, 4), not {result.shape}")
    if not np.isfinite(result).all():
        raise GeometryError(f"{what}: to_world has entries that are NaN or infinite")
    if not np.array_equal(result[3], (0.0, 0.0, 0.0, 1.0)):
        raise GeometryError(f"{what}: to_world must be affine (last row 0 0 0 1), not {result[3].tolist()}")
    if np.abs(result).max() > LARGEST:
        reach = f"{np.abs(result).max():g}"
        raise GeometryError(f"{what}: to_world has an entry of {reach}; scale everything down to {LARGEST:g} or less")
    scale = np.abs(result[:3, :3]).max()
    if 0 < scale < SMALLEST:
        raise GeometryError(f"{what}: to_world scales by {scale:g}; scale everything up to {SMALLEST:g} or more")
    if scale == 0 or abs(np.linalg.det(result[:3, :3] / scale)) < 1e-30:
        raise GeometryError(f"{what}: to_world is singular; every axis needs a scale other than zero")
    result.setflags(write=False)
    return result


def transform_points(matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    """``points`` (n, 3) under the affine ``matrix``."""
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def transform_box(matrix: np.ndarray, lo: np.ndarray, hi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The axis-aligned box (3,), (3,) around the image of a box."""
    corners = np.array(list(itertools.product(*zip(lo, hi, strict=True))), dtype=np.float64)
    image = transform_points(matrix, corners)
    return image.min(axis=0), image.max(axis=0)
