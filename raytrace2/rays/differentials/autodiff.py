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

from ...surfaces.interaction import Grain
from ..ray import Ray
from .lobes import Lobe
from .state import Meeting, RayDifferential
from .tangents import Tangents
from .trust import Trust, trusted_footprint, trusted_ray


@dataclass
class _Memory:
    """How the point and the normal move, to the right and down, and the map of the direction in the moving frame."""

    p: tuple[Any, Any]
    n: tuple[Any, Any]
    scattering: Tangents
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
        found = tangents.of((moving.t, moving.sh_frame.n, moving.uv, moving.dp_du, moving.dp_dv))
        si = dr.detach(moving)
        t = dr.select(si.valid, si.t, 0)
        p, n, inputs = [], [], []
        for (t_moved, n_moved, *grain), (o_moved, d_moved) in zip(found, state.directions(), strict=True):
            p.append(dr.fma(ray.d, dr.select(si.valid, t_moved, 0), dr.fma(d_moved, t, o_moved)))
            n.append(n_moved)
            wi = si.to_local(_turn(si.sh_frame.n, n_moved, ray.d) - d_moved)
            tangent, other = (
                v - _turn(si.sh_frame.n, n_moved, w) for v, w in zip(grain[1:], (si.dp_du, si.dp_dv), strict=True)
            )
            inputs.append((wi, grain[0], tangent, other))
        changes = inputs[0][0].z, inputs[1][0].z
        uv_dx, uv_dy = found[0][2], found[1][2]
        si.footprint, trust = trusted_footprint(structure, si, ray, state, si.wi.z, changes, uv_dx, uv_dy)
        # What a surface does with a ray is a map of directions in its frame, which itself turns with the normal; and
        # where a texture bends normals, of the grain, as it moves in that frame.
        scattering = Tangents((si.wi, si.uv, si.dp_du, si.dp_dv), inputs)
        wi, *grain = scattering.inputs
        scatter = replace(si, wi=wi, grain=Grain(*grain))
        return Meeting(si, scatter, _Memory((p[0], p[1]), (n[0], n[1]), scattering, trust))

    def leave(self, meeting: Meeting, sample: Any, ray: Ray, state: RayDifferential) -> RayDifferential:
        """The differentials of ``ray``, which goes on from the meeting's ``scatter`` as ``sample`` says."""
        memory, si = meeting.memory, meeting.si
        (wo_dx,), (wo_dy,) = memory.scattering.of((sample.wo,))
        onward = dr.detach(ray)
        d_dx, d_dy = (
            si.to_world(wo) + _turn(si.sh_frame.n, n, onward.d)
            for wo, n in zip((wo_dx, wo_dy), memory.n, strict=True)
        )  # fmt: skip
        moved = RayDifferential(memory.p[0], d_dx, memory.p[1], d_dy, state.flags)
        changes = wo_dx.z, wo_dy.z
        sample = dr.detach(sample)
        return trusted_ray(
            memory.trust, Lobe.of(si, sample), sample, sample.wo.z, changes, moved, onward, self._spacing
        )


def _turn(n: Any, n_moved: Any, v: Any) -> Any:
    """How a vector ``v`` moves that turns with the unit normal ``n``: (n x n') x v. There is no twist about the normal:
    only a grain would show it."""
    return n_moved * dr.dot(n, v) - n * dr.dot(n_moved, v)


def moving_ray(camera: Any, position: Any, aperture: Any, step: tuple[Any, Any]) -> tuple[Ray, Tangents]:
    """The camera's ray through ``position``, computed so that its derivatives by ``step`` to the right and down can be
    asked for."""
    Vector = type(position)
    tangents = Tangents((position,), [(Vector(step[0], 0),), (Vector(0, step[1]),)])
    return camera.sample_ray(tangents.inputs[0], aperture), tangents
