"""What ``to_world`` does to geometry, in float64."""

from __future__ import annotations

import numpy as np


def transform_points(matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(n, 3) points under an affine 4x4 matrix."""
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def transform_normals(matrix: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(n, 3) normals under the inverse transpose of a 4x4 matrix, not made unit; zero stays zero."""
    return normals @ np.linalg.inv(matrix[:3, :3])


def translation(offset: np.ndarray) -> np.ndarray:
    """The 4x4 matrix that adds ``offset`` (3,)."""
    matrix = np.eye(4)
    matrix[:3, 3] = offset
    return matrix


def scaling(factors: tuple[float, float, float]) -> np.ndarray:
    """The 4x4 matrix that multiplies coordinates by ``factors``."""
    return np.diag([*factors, 1.0])


def frame_towards(direction: np.ndarray) -> np.ndarray:
    """The 4x4 rotation that takes z to the unit vector ``direction``, with x and y as Mitsuba's frames have them.

    Source: Duff et al., "Building an Orthonormal Basis, Revisited", JCGT 6(1), 2017.
    """
    x, y, z = direction
    sign = np.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    matrix = np.eye(4)
    matrix[:3, 0] = (1.0 + sign * x * x * a, sign * b, -sign * x)
    matrix[:3, 1] = (b, sign + y * y * a, -y)
    matrix[:3, 2] = direction
    return matrix


def reverses_orientation(matrix: np.ndarray) -> bool:
    """Whether a 4x4 matrix mirrors."""
    return bool(np.linalg.det(matrix[:3, :3] / np.abs(matrix[:3, :3]).max()) < 0.0)


def column_lengths_differ(matrix: np.ndarray, columns: tuple[int, ...]) -> bool:
    """Whether these columns of the linear part differ in length, relatively by more than 1e-5."""
    lengths = np.linalg.norm(matrix[:3, list(columns)], axis=0)
    return bool(lengths.max() - lengths.min() > 1e-5 * lengths.max())


def is_sheared(matrix: np.ndarray) -> bool:
    """Whether the columns of the linear part are not at right angles, by more than 1e-5."""
    unit = matrix[:3, :3] / np.linalg.norm(matrix[:3, :3], axis=0)
    return bool(np.abs(unit.T @ unit - np.eye(3)).max() > 1e-5)
