"""Footprints by distance alone: what a pixel's angle covers at the length of the way, whatever the angle of incidence.

The rule of thumb before ray differentials: isotropic, blind to curvature and to slant.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from ..ray import Ray
from .autodiff import moving_ray
from .state import Meeting
from .trust import finished
from .widening import WIDEST


@dataclass
class Beam:
    """The ``width`` of the beam of a sample where its ray starts, and the angle ``spread`` by which it grows, in
    radians (Floats)."""

    width: Any
    spread: Any


class Distance:
    """``step`` and ``spacing`` as for :class:`~raytrace2.rays.differentials.autodiff.Autodiff`."""

    def __init__(self, step: tuple[Any, Any], spacing: float) -> None:
        self._step = step
        self._spacing = spacing

    def start(self, camera: Any, position: Any, aperture: Any) -> tuple[Ray, Beam]:
        """The ray through a place on the film, and its beam."""
        return beam_of(camera, position, aperture, self._step)

    def meet(self, structure: Any, ray: Ray, state: Beam, hit: Any) -> Meeting:
        """The interaction, with the footprint there."""
        si = structure.interact(ray, hit)
        width = dr.fma(state.spread, dr.select(si.valid, si.t, 0), state.width)
        u, v = _over(width, si.dp_du), _over(width, si.dp_dv)
        Array2 = type(si.uv)
        si.footprint = finished(structure, si, Array2(u, 0), Array2(0, v), type(si.prim)(0))
        return Meeting(si, si, width)

    def leave(self, meeting: Meeting, sample: Any, ray: Ray, state: Beam) -> Beam:
        """The beam of ``ray``: as wide as it was, and growing as it did, or as the lobe is wide."""
        return Beam(meeting.memory, spread_after(sample, state.spread, self._spacing))


def beam_of(camera: Any, position: Any, aperture: Any, step: tuple[Any, Any]) -> tuple[Ray, Beam]:
    """The camera's ray, and its beam of the mean width and spread of both directions."""
    ray, tangents = moving_ray(camera, position, aperture, step)
    (o_dx, d_dx), (o_dy, d_dy) = tangents.of((ray.o, ray.d))
    zero = dr.zeros(type(ray.o.x), dr.width(ray.o))
    width, spread = ((dr.norm(x) + dr.norm(y)) / 2 + zero for x, y in ((o_dx, o_dy), (d_dx, d_dy)))
    return dr.detach(ray), Beam(width, spread)


def spread_after(sample: Any, spread: Any, spacing: float) -> Any:
    """The spread of a beam: ``spread`` after a mirror or glass, else the angle that the sample stands for."""
    wide = dr.fmin(dr.rsqrt(dr.select(sample.pdf > 0, sample.pdf, 1)) * spacing, WIDEST)
    return dr.select(sample.delta, spread, wide)


def _over(width: Any, tangent: Any) -> Any:
    length = dr.norm(tangent)
    return dr.select(length > 0, width / dr.select(length > 0, length, 1), 0)
