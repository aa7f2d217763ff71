"""Ray differentials (Igehy 1999) without their formulas: the derivatives of each bounce's own map, by forward mode.

A bounce is a map from a ray to the point where it meets a surface, to the uv there and to the ray that goes on, written
once for rendering. Its derivative along the two directions in which the sample may move gives the footprint, and takes
the ray's differentials to the next bounce: transfer, reflection, refraction, curvature, interpolated normals, instances
and whatever else the map holds, without a line for any of them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import drjit as dr

from ...surfaces.frame import Frame
from ...surfaces.interaction import Grain
from ..ray import Ray
from .lobes import Lobe
from .state import Meeting, RayDifferential
from .tangents import Tangents
from .trust import Trust, trusted_footprint, trusted_ray


@dataclass
class _Memory:
    tangents: Tangents
    trust: Trust


class Autodiff:
    """``step`` (x, y) is the distance of samples on the film, in units of its width and height; ``spacing`` the same in
    pixels."""

    def __init__(self, step: tuple[Any, Any], spacing: float) -> None:
        self._step = step
        self._spacing = spacing

    def start(self, camera: Any, position: Any, aperture: Any) -> tuple[Ray, RayDifferential]:
        """The ray through a place on the film, and how it moves with that."""
        ray, tangents = moving_ray(camera, position, aperture, self._step)
        (o_dx, d_dx), (o_dy, d_dy) = tangents.of((ray.o, ray.d))
        return dr.detach(ray), RayDifferential.full(ray.o, o_dx, d_dx, o_dy, d_dy)

    def meet(self, structure: Any, ray: Ray, state: RayDifferential, hit: Any) -> Meeting:
        """The interaction, with the footprint there."""
        tangents = Tangents((ray.o, ray.d), state.directions())
        o, d = tangents.inputs
        moving = structure.interact(Ray.of(o, d, ray.tmin, ray.tmax), hit)
        what = (moving.uv, moving.p, moving.sh_frame.n, moving.dp_du, moving.dp_dv)
        (dx, *right), (dy, *down) = tangents.of(what)
        si = dr.detach(moving)
        steps = (state.d_dx, right[1]), (state.d_dy, down[1])
        cos_dx, cos_dy = (-dr.dot(d, si.sh_frame.n) - dr.dot(ray.d, n) for d, n in steps)
        si.footprint, trust = trusted_footprint(structure, si, ray, state, si.wi.z, (cos_dx, cos_dy), dx, dy)
        # What a surface does with a ray is a map of the ray's direction, the point, the normal and, where a texture
        # bends that, of the grain: the way by which these were found need not be gone again.
        turns = [(state.d_dx, *right, si.footprint.dx), (state.d_dy, *down, si.footprint.dy)]
        onward = Tangents((ray.d, si.p, si.sh_frame.n, si.dp_du, si.dp_dv, si.uv), turns)
        d, p, n, dp_du, dp_dv, uv = onward.inputs
        frame = _turning(si.sh_frame, n)
        scatter = replace(si, p=p, sh_frame=frame, wi=dr.replace_grad(si.wi, frame.to_local(-d)))
        scatter.grain = Grain(uv, dp_du, dp_dv)
        return Meeting(si, scatter, _Memory(onward, trust))

    def leave(self, meeting: Meeting, sample: Any, ray: Ray, state: RayDifferential) -> RayDifferential:
        """The differentials of ``ray``, which goes on from the meeting's ``scatter`` as ``sample`` says."""
        lobe = Lobe.of(meeting.si, sample)
        cos = sample.wo.z
        moving = (ray.o, ray.d) if lobe.ratio is None else (ray.o, ray.d, cos)
        (o_dx, d_dx, *cos_dx), (o_dy, d_dy, *cos_dy) = meeting.memory.tangents.of(moving)
        moved = RayDifferential(o_dx, d_dx, o_dy, d_dy, state.flags)
        changes = (cos_dx[0], cos_dy[0]) if cos_dx else (None, None)
        return trusted_ray(meeting.memory.trust, lobe, sample, dr.detach(cos), changes, moved, ray, self._spacing)


def _turning(frame: Frame, n: Any) -> Frame:
    """``frame`` with derivatives that follow those of its normal ``n``, without a twist: few have a grain."""
    s, t = (dr.replace_grad(v, v - n * dr.dot(n, v)) for v in (frame.s, frame.t))
    return Frame(s, t, n)


def moving_ray(camera: Any, position: Any, aperture: Any, step: tuple[Any, Any]) -> tuple[Ray, Tangents]:
    """The camera's ray through ``position``, computed so that its derivatives by ``step`` to the right and down can be
    asked for."""
    Vector = type(position)
    tangents = Tangents((position,), [(Vector(step[0], 0),), (Vector(0, step[1]),)])
    return camera.sample_ray(tangents.inputs[0], aperture), tangents
