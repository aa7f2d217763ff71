"""The thin-lens camera: a disk for an aperture, and one distance that is in focus."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr

from ..scene.description import ThinLensCamera
from ..types import Types
from ..warp import square_to_uniform_disk_concentric
from .film_plane import camera_error, checked_to_world, opaque_vectors, perspective_axes, turned
from .ray import Ray


class ThinLens:
    """Rays from a disk: those of one film position meet on the plane at ``focus_distance`` (Mitsuba's ``thinlens``)."""

    needs_aperture_sample = True

    def __init__(self, desc: ThinLensCamera, types: Types) -> None:
        if not (math.isfinite(desc.aperture_radius) and desc.aperture_radius >= 0):
            raise camera_error(
                desc, f"the aperture radius is {desc.aperture_radius!r}", "choose a number that is not negative"
            )
        if not (math.isfinite(desc.focus_distance) and desc.focus_distance > 0):
            raise camera_error(desc, f"the focus distance is {desc.focus_distance!r}", "choose a positive number")
        to_world = checked_to_world(desc, rigid=True)
        rotation = to_world[:3, :3]
        axes = perspective_axes(desc) @ rotation.T
        aperture = desc.aperture_radius * rotation.T[:2]
        self._axes = opaque_vectors([*axes, to_world[:3, 3], *aperture], types.Array3f)
        self._near, self._range = (
            dr.opaque(types.Float, desc.near_clip),
            dr.opaque(types.Float, desc.far_clip - desc.near_clip),
        )
        self._power = dr.opaque(types.Float, 1 / desc.focus_distance)

    def pinhole(self, aperture_sample: Any = None) -> tuple[Any, Any, Any, Any]:
        """Where rays through a point of the lens (None: its middle) come from, their direction of depth 1 through film
        position (0, 0), and how that grows."""
        corner, du, dv, origin, lens_x, lens_y = self._axes
        if aperture_sample is None:
            return origin, corner, du, dv
        disk = square_to_uniform_disk_concentric(aperture_sample)
        lens = dr.fma(lens_x, disk.x, lens_y * disk.y)
        return origin + lens, dr.fma(lens, -self._power, corner), du, dv

    def sample_ray(self, film_position: Any, aperture_sample: Any = None) -> Ray:
        """Rays of unit direction through ``film_position``: Array2f in [0, 1]^2 of the crop window, from the top left.

        ``aperture_sample`` (Array2f in [0, 1)^2) chooses the point of the lens. Rays run from the near to the far
        plane. Differentiable in both.
        """
        if aperture_sample is None:
            raise ValueError("a thin-lens camera needs aperture_sample, an Array2f in [0, 1)^2")
        disk = square_to_uniform_disk_concentric(aperture_sample)
        corner, du, dv, origin, lens_x, lens_y = self._axes
        lens = dr.fma(lens_x, disk.x, lens_y * disk.y)
        pinhole = dr.fma(du, film_position.x, dr.fma(dv, film_position.y, corner))
        # From the lens to the point in focus, scaled to depth 1 along the optical axis.
        through = dr.fma(lens, -self._power, pinhole)
        length = dr.norm(through)
        return Ray(dr.fma(through, self._near, origin + lens), through / length, tmax=self._range * length)

    def sample_ray_differential(
        self, film_position: Any, aperture_sample: Any, step: tuple[Any, Any]
    ) -> tuple[Ray, tuple[Any, Any], tuple[Any, Any]]:
        """:meth:`sample_ray`, and how its origin and direction (Array3f) change for ``step`` to the right and down on
        the film: by formulas, that can be differentiated again."""
        ray = self.sample_ray(film_position, aperture_sample)
        disk = square_to_uniform_disk_concentric(aperture_sample)
        corner, du, dv, _, lens_x, lens_y = self._axes
        pinhole = dr.fma(du, film_position.x, dr.fma(dv, film_position.y, corner))
        through = dr.fma(dr.fma(lens_x, disk.x, lens_y * disk.y), -self._power, pinhole)
        right, down = du * step[0], dv * step[1]
        moved = [(v * self._near, turned(ray.d, through, v)) for v in (right, down)]
        return ray, moved[0], moved[1]
