"""Ray cones: a width and an angle, with the curvature of what is met (Akenine-Moeller et al., "Improved Shader and
Texture Level of Detail Using Ray Cones", Journal of Computer Graphics Techniques 10(1), 2021).

A footprint is the ellipse in which the cone cuts the tangent plane. At a mirror the angle grows by twice the turn of
the normal over the width, and at glass by what refraction makes of that (the article stops at mirrors); curvature is
the mean of that along and across the plane of incidence. Cones are round: astigmatism is what they do not know.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from ..ray import Ray
from .analytic import uv_of_steps
from .bending import Bending
from .distance import Beam, beam_of, spread_after
from .lobes import Lobe
from .state import Meeting
from .trust import finished

#: Slants beyond this are taken for this: the cosine of the article's epsilon.
LEAST_COSINE = 1e-3


@dataclass
class _Memory:
    d: Any
    width: Any
    curvature: Any


class Cone:
    """``step`` and ``spacing`` as for :class:`~raytrace2.rays.differentials.autodiff.Autodiff`. Widths beyond a focus
    are negative."""

    def __init__(self, step: tuple[Any, Any], spacing: float) -> None:
        self._step = step
        self._spacing = spacing

    def start(self, camera: Any, position: Any, aperture: Any) -> tuple[Ray, Beam]:
        """The ray through a place on the film, and its cone."""
        return beam_of(camera, position, aperture, self._step)

    def meet(self, structure: Any, ray: Ray, state: Beam, hit: Any) -> Meeting:
        """The interaction, with the footprint there."""
        si = structure.interact(ray, hit)
        width = dr.fma(state.spread, dr.select(si.valid, si.t, 0), state.width)
        cos = dr.dot(si.n, ray.d)
        along = dr.fma(si.n, -cos, ray.d)
        slanted = dr.squared_norm(along) > 0
        along = dr.select(slanted, dr.normalize(dr.select(slanted, along, si.dp_du)), dr.normalize(si.dp_du))
        across = dr.cross(si.n, along)
        bending, to_uv = Bending(structure, si), uv_of_steps(si)
        curvature = (dr.dot(bending.along(along), along) + dr.dot(bending.along(across), across)) / 2
        longer = along * (width / dr.fmax(abs(cos), LEAST_COSINE))
        si.footprint = finished(structure, si, to_uv(longer), to_uv(across * width), type(si.prim)(0))
        return Meeting(si, si, _Memory(ray.d, width, dr.select(si.valid, curvature, 0)))

    def leave(self, meeting: Meeting, sample: Any, ray: Ray, state: Beam) -> Beam:
        """The cone of ``ray``, which goes on from the meeting as ``sample`` says."""
        memory, n = meeting.memory, meeting.si.sh_frame.n
        lobe = Lobe.of(dr.detach(meeting.si), dr.detach(sample))
        # d' = r d + m n: what spread there was counts r times, the turn of the normal m times.
        r: Any = type(memory.width)(1)
        if lobe.ratio is not None:
            r = dr.select(lobe.transmitted, lobe.ratio, 1)
        m = dr.select(lobe.null, 0, dr.dot(ray.d, n) - r * dr.dot(memory.d, n))
        spread = dr.fma(m * memory.curvature, memory.width, state.spread * r)
        return Beam(memory.width, spread_after(sample, spread, self._spacing))
