"""What is known about the point where a ray met a surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from ..rays.ray import Ray
from ..types import types_of
from .compensated import next_toward, two_sum
from .frame import Frame


@dataclass
class Grain:
    """``uv`` (Array2f), ``dp_du`` and ``dp_dv`` (Array3f) of an interaction, with derivatives by the ray."""

    uv: Any
    dp_du: Any
    dp_dv: Any


@dataclass
class SurfaceInteraction:
    """The local geometry at a hit, in world coordinates unless said otherwise; the names are Mitsuba's.

    Fields (one lane a ray): ``valid`` Bool; ``t`` Float (inf on a miss); ``p`` Array3f; ``n`` the geometric normal;
    ``sh_frame`` the shading frame; ``uv`` Array2f; ``dp_du``, ``dp_dv`` Array3f; ``prim_uv`` Array2f barycentric
    coordinates of triangles (weights of vertices 1 and 2); ``wi`` the direction back along the ray *in the shading
    frame*; ``p_rest`` what to add to ``p`` for the point that rays leave: what rounding took from it, and
    a step away from the edges of a triangle of a few times that; ``p_span`` the way from there to either of two places
    of which rays leave from the one farther back along them, where a triangle is so small that numbers are far apart on
    it (0.0 elsewhere); ``p_error`` a bound on the error of each component of
    ``p + p_rest`` and of ray tests there; ``prim`` UInt index within the
    surface; ``surface`` UInt index of the surface in the scene; ``instance`` UInt index of the instance surface, or
    0xFFFFFFFF; ``footprint`` the :class:`~raytrace2.rays.footprint.Footprint` of the sample here, where it is known;
    ``grain`` what normals that a texture bends move with, where rays are differentiated (None: nothing moves).
    """

    valid: Any
    t: Any
    p: Any
    n: Any
    sh_frame: Frame
    uv: Any
    dp_du: Any
    dp_dv: Any
    prim_uv: Any
    wi: Any
    prim: Any
    surface: Any
    instance: Any
    p_error: Any = 0.0
    p_rest: Any = 0.0
    p_span: Any = 0.0
    footprint: Any = None
    grain: Grain | None = None

    def to_local(self, v: Any) -> Any:
        """The world vector ``v`` in the shading frame."""
        return self.sh_frame.to_local(v)

    def to_world(self, v: Any) -> Any:
        """The vector ``v`` of the shading frame in world coordinates."""
        return self.sh_frame.to_world(v)

    def spawn_ray(self, d: Any, tmax: Any = float("inf")) -> Ray:
        """A ray from here along ``d`` (world coordinates), on the side of the surface that ``d`` points to.

        Its origin is moved off the surface by no more than the rounding error of ``p`` and of the ray tests demands
        (Pharr, Jakob and Humphreys 2023, section 6.8), at whatever scale.
        """
        return Ray.of(self._moved_off(d), d, 0.0, tmax)

    def spawn_ray_to(self, p: Any) -> Ray:
        """A ray from here that ends just short of the point ``p``: t runs from 0 to nearly 1 of the distance."""
        types = types_of(self.p)
        o = self._moved_off(p - self.p)
        d = p - o
        distance = dr.norm(d)
        apart = distance > 0
        # Half the digits: far more than rounding, far less than any blocker that could be told from the light.
        short = 1 - types.epsilon**0.5 / 2
        return Ray.of(o, d * dr.rcp(dr.select(apart, distance, 1)), 0.0, dr.select(apart, distance * short, -1))

    def _moved_off(self, d: Any) -> Any:
        n, p = dr.detach(self.n), dr.detach(self.p)
        size = abs(n)
        margin = self.p_error * (size.x + size.y + size.z)
        d = dr.detach(d)
        n = n * dr.mulsign(type(margin)(1), dr.dot(n, d))
        rest = dr.detach(self.p_rest)
        if not isinstance(self.p_span, float):
            rest = rest + dr.select(dr.dot(self.p_span, d) > 0, -self.p_span, self.p_span)
        o, lost = two_sum(p, dr.fma(n, dr.detach(margin), rest))
        # The origin is a triple of floating-point numbers on that side of the surface too, not the nearest ones.
        for k in range(3):
            o[k] = dr.select(lost[k] * n[k] > 0, next_toward(o[k], n[k] > 0), o[k])
        return dr.replace_grad(o, self.p)
