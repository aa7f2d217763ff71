"""Second order: how footprints change from pixel to pixel.

Dr.Jit's forward mode cannot be applied to itself, so the first of the two derivatives is taken by the formulas of
:mod:`.analytic`, which stand for the same map, and the second is forward mode's, of those formulas. Nothing is a
difference of nearby values, so what is lost to rounding is as little as in the first order.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from ..ray import Ray
from .analytic import transferred, uv_of_steps
from .autodiff import moving_ray
from .bending import Bending
from .lobes import Lobe
from .state import Meeting, RayDifferential
from .tangents import Tangents
from .trust import Trust, trusted_footprint, trusted_ray


@dataclass
class SecondDifferential(RayDifferential):
    """The second derivatives (Array3f) of a ray's origin and direction beside the first."""

    o_dxx: Any
    d_dxx: Any
    o_dxy: Any
    d_dxy: Any
    o_dyy: Any
    d_dyy: Any


@dataclass
class _Memory:
    """The map's inputs, which carry derivatives, and how position and shading normal move."""

    tangents: Tangents
    p: tuple[Any, Any]
    n: tuple[Any, Any]
    trust: Trust


class Autodiff2:
    """``step`` and ``spacing`` as for :class:`~raytrace2.rays.differentials.autodiff.Autodiff`."""

    def __init__(self, step: tuple[Any, Any], spacing: float) -> None:
        self._step = step
        self._spacing = spacing

    def start(self, camera: Any, position: Any, aperture: Any) -> tuple[Ray, SecondDifferential]:
        """The ray through a place on the film, and how it moves with that.

        A camera's clip planes are flat, and film positions map to them by affine maps: the second derivatives of o and
        of o + tmax d vanish, which with |d| = 1 gives those of d.
        """
        moving, tangents = moving_ray(camera, position, aperture, self._step)
        (o_dx, d_dx, far_dx), (o_dy, d_dy, far_dy) = tangents.of((moving.o, moving.d, moving.tmax))
        ray = dr.detach(moving)
        first = RayDifferential.full(ray.o, o_dx, d_dx, o_dy, d_dy)
        x, y = (d_dx, far_dx / ray.tmax), (d_dy, far_dy / ray.tmax)
        zero = dr.zeros(type(ray.o), dr.width(ray.o))

        def second(a: Any, b: Any) -> Any:
            (d_a, far_a), (d_b, far_b) = a, b
            return zero - (d_b * far_a + d_a * far_b) - ray.d * dr.dot(d_a, d_b)

        return ray, SecondDifferential(
            **vars(first), o_dxx=zero, d_dxx=second(x, x), o_dxy=zero + 0, d_dxy=second(x, y), o_dyy=zero + 0,
            d_dyy=second(y, y),
        )  # fmt: skip

    def meet(self, structure: Any, ray: Ray, state: SecondDifferential, hit: Any) -> Meeting:
        """The interaction, with the footprint there and how it changes."""
        s = state
        tangents = Tangents(
            (ray.o, ray.d, s.o_dx, s.d_dx, s.o_dy, s.d_dy),
            [
                (s.o_dx, s.d_dx, s.o_dxx, s.d_dxx, s.o_dxy, s.d_dxy),
                (s.o_dy, s.d_dy, s.o_dxy, s.d_dxy, s.o_dyy, s.d_dyy),
            ],
        )
        o, d, o_dx, d_dx, o_dy, d_dy = tangents.inputs
        moving = Ray.of(o, d, ray.tmin, ray.tmax)
        scatter = structure.interact(moving, hit)
        p = transferred(scatter, moving, o_dx, d_dx), transferred(scatter, moving, o_dy, d_dy)
        bending, to_uv = Bending(structure, scatter), uv_of_steps(scatter)
        n = bending.along(p[0]), bending.along(p[1])
        dx, dy = to_uv(p[0]), to_uv(p[1])
        (dxx, dxy, cos_dx), (_, dyy, cos_dy) = tangents.of((dx, dy, scatter.wi.z))
        si = dr.detach(scatter)
        first = dr.detach(dx), dr.detach(dy)
        si.footprint, trust = trusted_footprint(structure, si, ray, state, si.wi.z, (cos_dx, cos_dy), *first)
        calm = si.valid & (si.footprint.flags == 0)
        for name, value in (("dxx", dxx), ("dxy", dxy), ("dyy", dyy)):
            setattr(si.footprint, name, dr.select(calm & dr.all(dr.isfinite(value)), value, 0))
        scatter.uv, scatter.prim_uv, scatter.footprint = si.uv, si.prim_uv, si.footprint
        return Meeting(si, scatter, _Memory(tangents, p, n, trust))

    def leave(self, meeting: Meeting, sample: Any, ray: Ray, state: SecondDifferential) -> SecondDifferential:
        """The differentials of ``ray``, which goes on from the meeting's ``scatter`` as ``sample`` says."""
        memory = meeting.memory
        _, d, _, d_x, _, d_y = memory.tangents.inputs
        n = meeting.scatter.sh_frame.n
        lobe = Lobe.of(meeting.si, dr.detach(sample))
        d_dx, d_dy = (lobe.moved(d, n, v, turn) for v, turn in zip((d_x, d_y), memory.n, strict=True))
        (o_dxx, o_dxy, d_dxx, d_dxy, cos_dx), (_, o_dyy, _, d_dyy, cos_dy) = memory.tangents.of(
            (*memory.p, d_dx, d_dy, type(ray.d.x)(sample.wo.z))
        )
        o_dx, d_dx, o_dy, d_dy = (dr.detach(v) for v in (memory.p[0], d_dx, memory.p[1], d_dy))
        moved = RayDifferential(o_dx, d_dx, o_dy, d_dy, state.flags)
        changes = cos_dx, cos_dy
        sample = dr.detach(sample)
        first = trusted_ray(memory.trust, lobe, sample, sample.wo.z, changes, moved, dr.detach(ray), self._spacing)
        smooth = sample.delta & (first.flags == 0)

        def kept(v: Any) -> Any:
            return dr.select(smooth & dr.all(dr.isfinite(v)), v, 0)

        return SecondDifferential(
            **vars(first), o_dxx=kept(o_dxx), d_dxx=kept(d_dxx), o_dxy=kept(o_dxy), d_dxy=kept(d_dxy),
            o_dyy=kept(o_dyy), d_dyy=kept(d_dyy),
        )  # fmt: skip
