"""The pinhole camera."""

from __future__ import annotations

from typing import Any

import drjit as dr

from ..scene.description import PerspectiveCamera
from ..types import Types
from .film_plane import checked_to_world, opaque_vectors, perspective_axes, turned
from .ray import Ray


class Perspective:
    """Rays from one point through the film; their origins lie on the near plane, as in Mitsuba."""

    needs_aperture_sample = False

    def __init__(self, desc: PerspectiveCamera, types: Types) -> None:
        to_world = checked_to_world(desc, rigid=True)
        axes = perspective_axes(desc) @ to_world[:3, :3].T
        self._axes = opaque_vectors([*axes, to_world[:3, 3]], types.Array3f)
        self._near, self._range = (
            dr.opaque(types.Float, desc.near_clip),
            dr.opaque(types.Float, desc.far_clip - desc.near_clip),
        )

    def pinhole(self, aperture_sample: Any = None) -> tuple[Any, Any, Any, Any]:
        """Where rays come from, their direction of depth 1 through film position (0, 0), and how that grows."""
        corner, du, dv, origin = self._axes
        return origin, corner, du, dv

    def sample_ray(self, film_position: Any, aperture_sample: Any = None) -> Ray:
        """Rays of unit direction through ``film_position``: Array2f in [0, 1]^2 of the crop window, from the top left.

        They run from the near to the far plane. Differentiable in ``film_position``; ``aperture_sample`` is not used.
        """
        corner, du, dv, origin = self._axes
        through = dr.fma(du, film_position.x, dr.fma(dv, film_position.y, corner))
        # `through` has depth 1 along the optical axis, so its length turns depths into distances along the ray.
        length = dr.norm(through)
        return Ray(dr.fma(through, self._near, origin), through / length, tmax=self._range * length)

    def sample_ray_differential(
        self, film_position: Any, aperture_sample: Any, step: tuple[Any, Any]
    ) -> tuple[Ray, tuple[Any, Any], tuple[Any, Any]]:
        """:meth:`sample_ray`, and how its origin and direction (Array3f) change for ``step`` to the right and down on
        the film: by formulas, that can be differentiated again."""
        ray = self.sample_ray(film_position, aperture_sample)
        corner, du, dv, _ = self._axes
        through = dr.fma(du, film_position.x, dr.fma(dv, film_position.y, corner))
        right, down = du * step[0], dv * step[1]
        moved = [(v * self._near, turned(ray.d, through, v)) for v in (right, down)]
        return ray, moved[0], moved[1]
