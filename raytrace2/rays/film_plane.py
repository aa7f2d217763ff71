"""Where on its film plane a camera looks: what the three cameras share when they are built."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import drjit as dr
import numpy as np

from ..errors import Problem, SceneError
from ..scene.description import Camera, Film, PerspectiveCamera


def camera_error(camera: Camera, message: str, remedy: str) -> SceneError:
    """A :class:`SceneError` that names the sensor."""
    name = f"sensor {camera.id!r}: " if camera.id else "sensor: "
    return SceneError([Problem(name + message, remedy=remedy)])


def film_axes(film: Film, offset: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """The film plane that spans [-1, 1] in x over the *whole* image, as seen through the crop window.

    Rows of the (3, 2) float64 result: the plane's (x, y) at film position (0, 0), and how they grow along each of its
    axes. Film positions are in [0, 1]^2 of the crop window, from the top left; x points left. ``offset`` moves the
    principal point, in fractions of the whole image.
    """
    aspect = film.width / film.height
    start = np.array([film.crop_offset_x / film.width + offset[0], film.crop_offset_y / film.height + offset[1]])
    extent = np.array([film.crop_width / film.width, film.crop_height / film.height])
    half = np.array([1.0, 1.0 / aspect])
    origin = half * (1 - 2 * start)
    return np.array([origin, [-2 * half[0] * extent[0], 0.0], [0.0, -2 * half[1] * extent[1]]])


def perspective_axes(camera: PerspectiveCamera) -> np.ndarray:
    """Camera-space rows (3, 3), float64: the direction with z = 1 through film position (0, 0), and how it grows."""
    if not 0 < camera.x_fov < 180:
        raise camera_error(
            camera, f"the horizontal field of view is {camera.x_fov!r} degrees", "choose one between 0 and 180"
        )
    offset = (camera.principal_point_offset_x, camera.principal_point_offset_y)
    plane = film_axes(camera.film, offset) * math.tan(math.radians(camera.x_fov) / 2)
    return np.column_stack([plane, [1.0, 0.0, 0.0]])


def checked_to_world(camera: Camera, rigid: bool) -> np.ndarray:
    """``camera.to_world``, found to be finite, affine and, if ``rigid``, free of scale; clip planes are checked too."""
    matrix = np.asarray(camera.to_world, dtype=np.float64)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise camera_error(camera, "to_world is not a finite 4x4 matrix", "correct its transform")
    if not np.allclose(matrix[3], [0, 0, 0, 1], rtol=0, atol=1e-6):
        raise camera_error(camera, "to_world is not affine", "make its last row 0 0 0 1")
    linear = matrix[:3, :3]
    if rigid and np.abs(linear @ linear.T - np.eye(3)).max() > 1e-3:
        raise camera_error(
            camera, "to_world scales or shears, which this camera cannot", "use rotation and translation only"
        )
    if not np.linalg.norm(linear[:, 2]) > 0:
        raise camera_error(camera, "to_world flattens the direction of view", "remove the scale by zero")
    if not (math.isfinite(camera.near_clip) and 0 < camera.near_clip < camera.far_clip):
        raise camera_error(
            camera,
            f"near_clip {camera.near_clip!r} and far_clip {camera.far_clip!r} leave no space",
            "need 0 < near < far",
        )
    return matrix


def opaque_vectors(rows: Iterable[np.ndarray], array: Any) -> list[Any]:
    """Each row of ``rows`` as an ``array`` (Array2f or Array3f) of width 1 that kernels read from memory."""
    vectors = [array(*(float(x) for x in row)) for row in rows]
    dr.make_opaque(vectors)
    return vectors


def turned(d: Any, through: Any, moved: Any) -> Any:
    """How the unit direction ``d`` of ``through`` changes where that changes by ``moved`` (Array3f)."""
    return (moved - d * dr.dot(d, moved)) * dr.rcp(dr.norm(through))
