"""Ray differentials by hand-derived formulas (Igehy, "Tracing Ray Differentials", 1999): a check and a baseline.

Section 3.1's transfer, reflection and refraction, with the normal derivatives that each kind of surface needs. (Where
the paper refracts, its direction is divided by the ratio of indices; programs that multiply have a fault.)
Normals that a bump or normal map bends are not in these formulas: rays leave along the mapped normal, but their
differentials along that of the surface.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from ...surfaces.magnitude import powers_of_two
from ..ray import Ray
from .autodiff import moving_ray
from .bending import Bending
from .lobes import Lobe
from .state import Meeting, RayDifferential
from .trust import Trust, trusted_footprint, trusted_ray


@dataclass
class _Memory:
    """How position and shading normal move, to the right and down."""

    ray: Ray
    p: tuple[Any, Any]
    n: tuple[Any, Any]
    trust: Trust


class Analytic:
    """``step`` and ``spacing`` as for :class:`~raytrace2.rays.differentials.autodiff.Autodiff`."""

    def __init__(self, step: tuple[Any, Any], spacing: float) -> None:
        self._step = step
        self._spacing = spacing

    def start(self, camera: Any, position: Any, aperture: Any) -> tuple[Ray, RayDifferential]:
        """The ray through a place on the film, and how it moves with that (the cameras' own map, by forward mode)."""
        ray, tangents = moving_ray(camera, position, aperture, self._step)
        (o_dx, d_dx), (o_dy, d_dy) = tangents.of((ray.o, ray.d))
        return dr.detach(ray), RayDifferential.full(ray.o, o_dx, d_dx, o_dy, d_dy)

    def meet(self, structure: Any, ray: Ray, state: RayDifferential, hit: Any) -> Meeting:
        """The interaction, with the footprint there."""
        si = structure.interact(ray, hit)
        p = tuple(transferred(si, ray, o, d) for o, d in state.directions())
        bending = Bending(structure, si)
        n = tuple(bending.along(v) for v in p)
        pairs = zip(state.directions(), n, strict=True)
        changes = [-dr.dot(d, si.sh_frame.n) - dr.dot(ray.d, turn) for (_, d), turn in pairs]
        to_uv = uv_of_steps(si)
        footprint, trust = trusted_footprint(
            structure, si, ray, state, si.wi.z, (changes[0], changes[1]), to_uv(p[0]), to_uv(p[1])
        )
        si.footprint = footprint
        return Meeting(si, si, _Memory(ray, (p[0], p[1]), (n[0], n[1]), trust))

    def leave(self, meeting: Meeting, sample: Any, ray: Ray, state: RayDifferential) -> RayDifferential:
        """The differentials of ``ray``, which goes on from the meeting as ``sample`` says."""
        memory, n = meeting.memory, meeting.si.sh_frame.n
        lobe = Lobe.of(meeting.si, sample)
        pairs = list(zip(state.directions(), memory.n, strict=True))
        d_dx, d_dy = (lobe.moved(memory.ray.d, n, d, turn) for (_, d), turn in pairs)
        moved = RayDifferential(memory.p[0], d_dx, memory.p[1], d_dy, state.flags)
        changes = [dr.dot(d, n) + dr.dot(ray.d, turn) for d, turn in zip((d_dx, d_dy), memory.n, strict=True)]
        return trusted_ray(
            memory.trust, lobe, sample, sample.wo.z, (changes[0], changes[1]), moved, ray, self._spacing
        )  # fmt: skip


def transferred(si: Any, ray: Ray, o_moved: Any, d_moved: Any) -> Any:
    """How the point where ``ray`` met the surface moves, for derivatives of the ray (the paper's equation 10)."""
    moved = dr.fma(d_moved, dr.select(si.valid, si.t, 0), o_moved)
    slope = dr.dot(si.n, ray.d)
    return dr.fma(ray.d, -dr.dot(si.n, moved) / dr.select(slope != 0, slope, 1), moved)


def uv_of_steps(si: Any) -> Any:
    """What turns a step in the tangent plane into one in uv; zero where the parameterisation is singular."""
    sizes = [powers_of_two(dr.detach(v))[1] for v in (si.dp_du, si.dp_dv)]
    a, b = si.dp_du * sizes[0], si.dp_dv * sizes[1]
    across = dr.cross(a, b)
    area = dr.squared_norm(across)
    regular = area > 0
    inverse = dr.select(regular, dr.rcp(dr.select(regular, area, 1)), 0)
    to_u, to_v = dr.cross(b, across) * (inverse * sizes[0]), dr.cross(across, a) * (inverse * sizes[1])
    return lambda step: type(si.uv)(dr.dot(step, to_u), dr.dot(step, to_v))
