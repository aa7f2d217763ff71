"""The orthographic camera: parallel rays."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np

from ..scene.description import OrthographicCamera
from ..types import Types
from .film_plane import checked_to_world, film_axes, opaque_vectors
from .ray import Ray


class Orthographic:
    """Rays along local z from the near plane, over [-1, 1] in local x; ``to_world`` may scale."""

    needs_aperture_sample = False

    def __init__(self, desc: OrthographicCamera, types: Types) -> None:
        to_world = checked_to_world(desc, rigid=False)
        linear = to_world[:3, :3]
        axes = np.column_stack([film_axes(desc.film), [desc.near_clip, 0.0, 0.0]]) @ linear.T
        axes[0] += to_world[:3, 3]
        direction = linear[:, 2] / np.linalg.norm(linear[:, 2])
        self._axes = opaque_vectors([*axes, direction], types.Array3f)
        self._range = dr.opaque(types.Float, desc.far_clip - desc.near_clip)

    @property
    def axes(self) -> tuple[Any, Any, Any, Any]:
        """The point of film position (0, 0), how it grows, and the unit direction of all rays."""
        corner, du, dv, direction = self._axes
        return corner, du, dv, direction

    def sample_ray(self, film_position: Any, aperture_sample: Any = None) -> Ray:
        """Rays of unit direction through ``film_position``: Array2f in [0, 1]^2 of the crop window, from the top left.

        They end ``far_clip - near_clip`` world units on. Differentiable in ``film_position``; ``aperture_sample`` is
        not used.
        """
        corner, du, dv, direction = self._axes
        origin = dr.fma(du, film_position.x, dr.fma(dv, film_position.y, corner))
        # One direction for all rays, at the full width that symbolic loops want of their state.
        first = dr.zeros(dr.uint32_array_t(type(self._range)), dr.width(film_position))
        return Ray(
            origin,
            dr.gather(type(origin), direction, first),
            tmax=dr.gather(type(self._range), self._range, first),
        )

    def sample_ray_differential(
        self, film_position: Any, aperture_sample: Any, step: tuple[Any, Any]
    ) -> tuple[Ray, tuple[Any, Any], tuple[Any, Any]]:
        """:meth:`sample_ray`, and how its origin and direction (Array3f) change for ``step`` to the right and down on
        the film: by formulas, that can be differentiated again."""
        ray = self.sample_ray(film_position, aperture_sample)
        still = dr.zeros(type(ray.d), dr.width(film_position))
        _, du, dv, _ = self._axes
        return ray, (du * step[0] + still, still), (dv * step[1] + still, still)
