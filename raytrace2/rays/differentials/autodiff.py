"""Ray differentials (Igehy 1999) without their formulas: the derivatives of each bounce's own map, by forward mode.

A bounce is a map from a ray to the point where it meets a surface, to the uv there and to the ray that goes on, written
once for rendering. Its derivative along the two directions in which the sample may move gives the footprint, and takes
the ray's differentials to the next bounce: transfer, reflection, refraction, curvature, interpolated normals, instances
and whatever else the map holds, without a line for any of them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import drjit as dr

from ..footprint import Footprint
from ..ray import Ray
from .state import Meeting, RayDifferential
from .tangents import Tangents
from .widening import widened


class Autodiff:
    """``step`` (x, y) is the distance of samples on the film, in units of its width and height; ``spacing`` the same in
    pixels."""

    def __init__(self, step: tuple[Any, Any], spacing: float) -> None:
        self._step = step
        self._spacing = spacing

    def start(self, camera: Any, position: Any, aperture: Any) -> tuple[Ray, RayDifferential]:
        """The ray through a place on the film, and how it moves with that."""
        Vector = type(position)
        x, y = self._step
        tangents = Tangents((position,), [(Vector(x, 0),), (Vector(0, y),)])
        ray = camera.sample_ray(tangents.inputs[0], aperture)
        (o_dx, d_dx), (o_dy, d_dy) = tangents.of((ray.o, ray.d))
        return dr.detach(ray), RayDifferential(o_dx, d_dx, o_dy, d_dy)

    def meet(self, structure: Any, ray: Ray, state: RayDifferential, hit: Any) -> Meeting:
        """The interaction, with the footprint there."""
        tangents = Tangents((ray.o, ray.d), state.directions())
        o, d = tangents.inputs
        scatter = structure.interact(Ray.of(o, d, ray.tmin, ray.tmax), hit)
        (dx,), (dy,) = tangents.of((scatter.uv,))
        si = dr.detach(scatter)
        si.footprint = Footprint(dr.select(si.valid, dx, 0), dr.select(si.valid, dy, 0))
        # Look-ups are not part of the ray's map, so what they read does not move.
        scatter = replace(scatter, uv=si.uv, prim_uv=si.prim_uv, footprint=si.footprint)
        return Meeting(si, scatter, tangents)

    def leave(self, meeting: Meeting, sample: Any, ray: Ray, state: RayDifferential) -> RayDifferential:
        """The differentials of ``ray``, which goes on from the meeting's ``scatter`` as ``sample`` says."""
        (o_dx, d_dx), (o_dy, d_dy) = meeting.memory.of((ray.o, ray.d))
        wide_x, wide_y = widened(dr.detach(ray.d), dr.detach(sample.pdf), self._spacing)
        o_dx, d_dx, o_dy, d_dy = (_finite(v) for v in (o_dx, d_dx, o_dy, d_dy))
        delta = dr.detach(sample.delta)
        return RayDifferential(o_dx, dr.select(delta, d_dx, wide_x), o_dy, dr.select(delta, d_dy, wide_y))


def _finite(v: Any) -> Any:
    return dr.select(dr.all(dr.isfinite(v)), v, 0)
