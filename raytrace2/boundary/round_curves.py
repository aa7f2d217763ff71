"""Rims and outlines of canonical shapes: the square [-1, 1]^2, the unit disk, sphere and cylinder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr

from ..surfaces.frame import coordinate_system
from ..types import types_of

#: Sides of the square (four codes); the unit circle at z = 0, and at z = 1; the outline of the sphere; the two lines
#: along the cylinder where it turns away.
CODES = {"side": 0, "rim": 4, "top": 5, "outline": 6, "line": 8}


@dataclass
class Eye:
    """Where something is seen from: the point ``at`` (Array3f), or all along the direction ``at`` if ``parallel``."""

    at: Any
    parallel: bool

    def way_from(self, x: Any) -> Any:
        """A vector from ``x`` to the eye, without derivatives."""
        at = dr.detach(self.at)
        return at if self.parallel else at - x


def round_curve(codes: Sequence[int], code: Any, s: Any, eye: Eye) -> tuple[Any, Any, Any, Any]:
    """The point at ``s`` of the curve of each ``code`` (UInt, one of ``codes``), its derivative by ``s``, a point
    inside, and if there is such a curve as seen from ``eye`` (Bool), in the shape's own coordinates.

    Of outlines, the point stays on the outline when the eye moves.
    """
    Vector, t = type(eye.at), types_of(s)
    sine, cosine = dr.sincos(s * dr.two_pi)
    x, along, inner = Vector(cosine, sine, 0), Vector(-sine, cosine, 0) * dr.two_pi, Vector(0)
    there = t.Bool(True)
    if CODES["top"] in codes:
        tall = code == CODES["top"]
        x, inner = dr.select(tall, Vector(x.x, x.y, 1), x), dr.select(tall, Vector(0, 0, 1), inner)
    if any(c < CODES["rim"] for c in codes):
        side, at = code < CODES["rim"], 2 * s - 1
        turned = (code & 1) != 0
        sign = dr.select((code & 2) != 0, t.Float(-1), 1)
        x = dr.select(side, dr.select(turned, Vector(sign, at, 0), Vector(at, sign, 0)), x)
        along = dr.select(side, dr.select(turned, Vector(0, 2, 0), Vector(2, 0, 0)), along)
    if CODES["outline"] in codes:
        mine = code == CODES["outline"]
        point, tangent, outside = _sphere_outline(sine, cosine, eye, mine)
        x, along, there = dr.select(mine, point, x), dr.select(mine, tangent, along), there & (~mine | outside)
    if any(c >= CODES["line"] for c in codes):
        mine = code >= CODES["line"]
        point, outside = _cylinder_line(code, s, eye, mine)
        x, along = dr.select(mine, point, x), dr.select(mine, Vector(0, 0, 1), along)
        inner, there = dr.select(mine, Vector(0, 0, 0.5), inner), there & (~mine | outside)
    return x, along, inner, there


def _sphere_outline(sine: Any, cosine: Any, eye: Eye, active: Any) -> tuple[Any, Any, Any]:
    """The circle where tangents from the eye touch the unit sphere."""
    Vector = type(eye.at)
    square = dr.squared_norm(eye.at)
    outside = active & (square > (0 if eye.parallel else 1))
    square = dr.select(outside, square, 4)
    towards = dr.select(outside, eye.at, Vector(0, 0, 2)) * dr.rsqrt(square)
    # Any basis will do that turns with the eye; one that does not spin.
    first = dr.detach(coordinate_system(dr.detach(towards))[0])
    first = first - towards * dr.dot(towards, first)
    first = first * dr.rsqrt(dr.squared_norm(first))
    second = dr.cross(towards, first)
    height, radius = (0, 1) if eye.parallel else (dr.rsqrt(square), dr.sqrt(1 - 1 / square))
    point = towards * height + (first * cosine + second * sine) * radius
    return point, (second * cosine - first * sine) * (radius * dr.two_pi), outside


def _cylinder_line(code: Any, s: Any, eye: Eye, active: Any) -> tuple[Any, Any]:
    """A line where tangent planes through the eye touch the unit cylinder about z: one of two, by ``code``."""
    Vector = type(eye.at)
    x, y = eye.at.x, eye.at.y
    square = x * x + y * y
    outside = active & (square > (0 if eye.parallel else 1))
    square = dr.select(outside, square, 4)
    x, y = dr.select(outside, x, 2), dr.select(outside, y, 0)
    sign = dr.select(code == CODES["line"], type(s)(1), -1)
    inverse = dr.rsqrt(square)
    x, y = x * inverse, y * inverse
    near, across = (0, sign) if eye.parallel else (inverse, sign * dr.sqrt(1 - 1 / square))
    return Vector(x * near - y * across, y * near + x * across, s), outside
