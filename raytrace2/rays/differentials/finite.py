"""Ray differentials as differences: two more rays are carried along, through the next samples to the right and down."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from ..ray import Ray
from .extended import extended_hit
from .lobes import Lobe
from .state import Meeting, RayDifferential
from .trust import FOLDED, SILHOUETTE, TOTAL_REFLECTION, angles, finished, flag, folding
from .widening import widened


@dataclass
class OffsetRays:
    """Origins and unit directions (Array3f) of the rays to the right (``x``) and down (``y``), and the ``flags`` (UInt)
    of :mod:`.trust` that were met on the way."""

    o_x: Any
    d_x: Any
    o_y: Any
    d_y: Any
    flags: Any

    def rays(self) -> list[tuple[Any, Any]]:
        """(origin, direction) of the one to the right, and of the one down."""
        return [(self.o_x, self.d_x), (self.o_y, self.d_y)]


@dataclass
class _Memory:
    met: list[Any]
    flags: Any


class Finite:
    """``step`` and ``spacing`` as for :class:`~raytrace2.rays.differentials.autodiff.Autodiff`.

    The offset rays meet the surface that the ray itself met (see :mod:`.extended`), and leave it as it did: by the same
    lobe. Differences are those over a whole pixel, curvature included, of which the half is forward."""

    def __init__(self, step: tuple[Any, Any], spacing: float) -> None:
        self._step = step
        self._spacing = spacing

    def start(self, camera: Any, position: Any, aperture: Any) -> tuple[Ray, OffsetRays]:
        """The ray through a place on the film, and the two beside it."""
        Vector = type(position)
        steps = Vector(self._step[0], 0), Vector(0, self._step[1])
        ray = camera.sample_ray(position, aperture)
        right, down = (camera.sample_ray(position + step, aperture) for step in steps)
        zero = dr.zeros(type(ray.o), dr.width(ray.o))
        none = dr.zeros(dr.uint32_array_t(type(ray.o.x)), dr.width(ray.o))
        return ray, OffsetRays(right.o + zero, right.d + zero, down.o + zero, down.d + zero, none)

    def meet(self, structure: Any, ray: Ray, state: OffsetRays, hit: Any) -> Meeting:
        """The interaction, with the footprint there."""
        si = structure.interact(ray, hit)
        flags = state.flags
        met, steps, apart = [], [], []
        for o, d in state.rays():
            beside = Ray.of(o, d, 0.0, ray.tmax)
            there, meets = extended_hit(structure, si, hit, beside)
            other = structure.interact(beside, there)
            missed = ~meets | (abs(other.wi.z - si.wi.z) >= abs(si.wi.z))
            flags = flags | flag(missed & si.valid, SILHOUETTE)
            met.append(other)
            steps.append(other.uv - si.uv)
            apart += [o - ray.o, d - ray.d]
        turns = angles(structure, si)
        if turns is not None:
            _, around_u, around_v = turns(*steps)
            steps = [_shorter_way(v, around_u, around_v) for v in steps]
        folded, _, _ = folding(ray, RayDifferential(apart[0], apart[1], apart[2], apart[3], flags), si)
        si.footprint = finished(structure, si, steps[0], steps[1], flags | flag(folded & si.valid, FOLDED))
        return Meeting(si, si, _Memory(met, flags))

    def leave(self, meeting: Meeting, sample: Any, ray: Ray, state: OffsetRays) -> OffsetRays:
        """The rays beside ``ray``, which goes on from the meeting as ``sample`` says."""
        si, memory = meeting.si, meeting.memory
        lobe = Lobe.of(dr.detach(si), dr.detach(sample))
        flags = memory.flags
        cos = dr.dot(ray.d, si.sh_frame.n)
        delta = dr.detach(sample.delta)
        directions = []
        for (_, d), other, wide in zip(
            state.rays(), memory.met, widened(ray.d, sample.pdf, self._spacing), strict=True
        ):
            n = other.sh_frame.n
            onward = lobe.onward(d, n)
            if lobe.ratio is not None:
                total = lobe.transmitted & (abs(dr.dot(onward, n) - cos) >= abs(cos))
                flags = flags | flag(total, TOTAL_REFLECTION)
            directions.append(dr.select(delta, onward, dr.normalize(ray.d + wide)))
        right, down = memory.met
        # Where nothing was met there is nothing to go on from; what is not finite would stay so.
        o_x, d_x, o_y, d_y = (_finite(v) for v in (right.p, directions[0], down.p, directions[1]))
        return OffsetRays(o_x, d_x, o_y, d_y, flags)


def _shorter_way(v: Any, around_u: Any, around_v: Any) -> Any:
    """A difference of uv, where an angle turns by half a turn at most."""
    return type(v)(
        dr.select(around_u, v.x - dr.round(v.x), v.x),
        dr.select(around_v, v.y - dr.round(v.y), v.y),
    )


def _finite(v: Any) -> Any:
    return dr.select(dr.all(dr.isfinite(v)), v, 0)
