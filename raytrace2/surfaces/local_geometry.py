"""Differential geometry of each kind of surface at a point, with Mitsuba's parameterisations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr

from ..types import types_of
from . import record
from .compensated import difference_of_products, point_on_ray, two_sum
from .frame import coordinate_system
from .magnitude import powers_of_two, unit
from .ordered import lesser

#: How far from the edges of its triangle a ray starts, in units of its rounding and of the way off the surface: room
#: between faces that meet at more than 1 / INSET.
INSET = 16

#: So many steps between floating-point numbers wide, a triangle is coarse: there may be none above its middle.
COARSE = 4


@dataclass
class LocalGeometry:
    """Position; what to add to it for the point that rays leave, and a bound on the error (per component) of that
    point and of the ray tests there; geometric and shading normal (both of unit length), uv and the derivatives of
    position by u and v."""

    p: Any
    rest: Any
    error: Any
    n: Any
    sh_n: Any
    uv: Any
    dp_du: Any
    dp_dv: Any
    span: Any = 0.0

    def fields(self) -> tuple[Any, ...]:
        """The fields in order."""
        return self.p, self.rest, self.error, self.n, self.sh_n, self.uv, self.dp_du, self.dp_dv, self.span

    def transformed(self, to_world: Any, to_local: Any) -> LocalGeometry:
        """The same under an affine map, given with its inverse."""
        return LocalGeometry(
            to_world.point(self.p),
            dr.detach(to_world.vector(self.rest)),
            to_world.error(self.p, self.error),
            unit(to_local.transposed(self.n)),
            unit(to_local.transposed(self.sh_n)),
            self.uv,
            to_world.vector(self.dp_du),
            to_world.vector(self.dp_dv),
            self.span if isinstance(self.span, float) else dr.detach(to_world.vector(self.span)),
        )


@dataclass
class RayPoint:
    """A point ``p`` of a ray from ``o`` of direction ``d`` at ``t``, off the surface by the rounding of its t, which
    ``slack`` bounds."""

    p: Any
    o: Any
    d: Any
    t: Any
    slack: Any

    def polished(self, to_world: Any, to_local: Any, *, round_axis: bool) -> Any:
        """The way from the centre to the point, moved along the ray onto the image of the unit sphere, or of the
        cylinder about z if ``round_axis``. The centre may be so far off that the world has no digits for it."""
        d = dr.detach(self.d)
        center = to_world.translation
        o, o_lost = zip(*(two_sum(dr.detach(self.o[k]), -center[k]) for k in range(3)), strict=True)
        arm = type(d)(point_on_ray(o, o_lost, d, dr.detach(self.t))[0])
        local, along = to_local.vector(arm), to_local.vector(d)
        if round_axis:
            local.z, along.z = 0, 0
        a, b, c = dr.squared_norm(along), dr.dot(local, along), dr.squared_norm(local) - 1
        # The root of a t^2 + 2 b t + c that is nearer to zero.
        q = -(b + dr.copysign(dr.sqrt(dr.fmax(b * b - a * c, 0)), b))
        step = dr.select(q != 0, c / dr.select(q != 0, q, 1), 0)
        step = dr.fmax(dr.fmin(step, self.slack), -self.slack)
        return dr.replace_grad(dr.fma(d, step, arm), self.p - type(d)(*center))


def on_triangle(
    p: Any,
    positions: list[Any],
    normals: list[Any] | None,
    uvs: list[Any] | None,
    smooth: Any,
    textured: Any,
    prim_uv: Any,
) -> LocalGeometry:
    """A point on a triangle by its barycentric weights ``prim_uv`` of vertices 1 and 2, whose derivatives are those
    of ``p``.

    ``smooth`` and ``textured`` say which lanes have normals and uv; without uv the parameterisation is barycentric.
    """
    p0, p1, p2 = positions
    (e1, lost_1), (e2, lost_2) = two_sum(p1, -p0), two_sum(p2, -p0)
    per_size = powers_of_two(dr.fmax(abs(e1), abs(e2)))[1]
    unit_1, unit_2 = e1 * per_size, e2 * per_size
    # To the last digits for slivers too: on which side of a surface a ray leaves is for its normal to say.
    across = _cross(unit_1, unit_2)
    across += dr.cross(unit_1, lost_2 * per_size) + dr.cross(lost_1 * per_size, unit_2)
    area = dr.squared_norm(across)
    thick = area > 0
    if dr.grad_enabled(p):
        inverse_area = dr.rcp(dr.select(thick, area, 1))
        arm = (p - p0) * per_size
        moving = dr.dot(arm, dr.cross(unit_2, across)), dr.dot(arm, dr.cross(across, unit_1))
        prim_uv = dr.replace_grad(prim_uv, type(prim_uv)(*moving) * inverse_area)
    b1, b2 = prim_uv.x, prim_uv.y
    p, rest = two_sum(p0, dr.fma(e1, b1, dr.fma(e2, b2, lost_1 * b1 + lost_2 * b2)))
    n = across * dr.rsqrt(dr.select(thick, area, 1))
    sh_n = n
    if normals is not None:
        n0, n1, n2 = normals
        blend = dr.fma(n1 - n0, b1, dr.fma(n2 - n0, b2, n0))
        length = dr.squared_norm(blend)
        usable = (length > 0) & smooth
        sh_n = dr.select(usable, blend * dr.rsqrt(dr.select(usable, length, 1)), n)
    uv, dp_du, dp_dv = type(prim_uv)(b1, b2), e1, e2
    if uvs is not None:
        uv0, uv1, uv2 = uvs
        d1, d2 = uv1 - uv0, uv2 - uv0
        determinant = d1.x * d2.y - d1.y * d2.x
        regular = determinant != 0
        inverse = dr.rcp(dr.select(regular, determinant, 1))
        # Where uv does not span the triangle, any basis of its plane will do.
        any_u, any_v = coordinate_system(n)
        uv = dr.select(textured, dr.fma(d1, b1, dr.fma(d2, b2, uv0)), uv)
        dp_du = dr.select(textured, dr.select(regular, (e1 * d2.y - e2 * d1.y) * inverse, any_u), dp_du)
        dp_dv = dr.select(textured, dr.select(regular, (e2 * d1.x - e1 * d2.x) * inverse, any_v), dp_dv)
    reach = abs(e1) + abs(e2)
    wide = dr.fmax(dr.fmax(reach.x, reach.y), reach.z)
    error = wide * (4 * types_of(p).epsilon)
    size = abs(p)
    grain = dr.fmax(dr.fmax(size.x, size.y), size.z) * types_of(p).epsilon
    lengths = dr.norm(unit_2 - unit_1), dr.norm(unit_2), dr.norm(unit_1)
    m1, m2 = _from_edges((grain + error) * per_size, lengths, area, prim_uv)
    coarse = wide <= grain * (2 * COARSE)
    half_1, half_2, span = _along_longest(lengths, e1, e2)
    rest += e1 * dr.select(coarse, half_1 - b1, m1) + e2 * dr.select(coarse, half_2 - b2, m2)
    span = dr.detach(dr.select(coarse, span, 0))
    return LocalGeometry(p, dr.detach(rest), error, n, sh_n, uv, dp_du, dp_dv, span)


def _from_edges(width: Any, lengths: tuple[Any, Any, Any], area: Any, prim_uv: Any) -> tuple[Any, Any]:
    """The step, in weights of vertices 1 and 2, from a point of a triangle to where it is farther from every edge than
    rounding and the way off the surface, of a ``width``, could move it: else rays from beside an edge would start
    behind the neighbour. At most to the centroid."""
    # Weights at that distance from each edge: over the heights of the triangle.
    per_area = width * INSET * dr.rsqrt(area)
    m0, m1, m2 = (lesser(length * per_area, 1 / 3) for length in lengths)
    total = m0 + m1 + m2
    return dr.fma(-total, prim_uv.x, m1), dr.fma(-total, prim_uv.y, m2)


def _along_longest(lengths: tuple[Any, Any, Any], e1: Any, e2: Any) -> tuple[Any, Any, Any]:
    """The weights of vertices 1 and 2 in the middle of the longest side, and half of that side.

    Where no number lies above the middle of a triangle, rays leave from above a corner, which is one: from that end of
    the longest side that is farther back along them, so that they pass above most of what they leave.
    """
    across, second, first = lengths
    is_across = (across >= second) & (across >= first)
    is_second = ~is_across & (second >= first)
    half_1 = dr.select(is_second, 0, 0.5)
    half_2 = dr.select(is_across | is_second, 0.5, 0)
    return half_1, half_2, e1 * dr.select(is_across, -0.5, half_1) + e2 * half_2


def _cross(a: Any, b: Any) -> Any:
    return type(a)(
        difference_of_products(a.y, b.z, a.z, b.y),
        difference_of_products(a.z, b.x, a.x, b.z),
        difference_of_products(a.x, b.y, a.y, b.x),
    )


def on_sphere(at: RayPoint, _: Any, to_world: Any, to_local: Any, side: Any) -> LocalGeometry:
    """u is the azimuth over 2 pi, v the angle from the local z axis over pi."""
    met = at.polished(to_world, to_local, round_axis=False)
    Vector = type(met)
    local = unit(to_local.vector(met))
    outwards = unit(to_world.vector(local))
    # No matrix is all even: where it makes the sphere shorter than its ray test does, rays would start inside.
    arm = outwards * to_world.even_scale
    n = outwards * side
    axis_2 = dr.fma(local.x, local.x, local.y * local.y)
    off_axis = axis_2 > 0
    axis = dr.sqrt(dr.select(off_axis, axis_2, 1))
    phi = dr.atan2(local.y, dr.select(off_axis, local.x, 1))
    u = dr.select(phi < 0, phi + dr.two_pi, phi) * dr.inv_two_pi
    v = dr.atan2(dr.select(off_axis, axis, 0), local.z) * dr.inv_pi
    dp_du = Vector(-local.y, local.x, 0) * dr.two_pi
    cos_phi, sin_phi = local.x / axis, local.y / axis
    dp_dv = dr.select(off_axis, Vector(local.z * cos_phi, local.z * sin_phi, -axis), Vector(1, 0, 0)) * dr.pi
    p, rest = two_sum(Vector(*to_world.translation), arm)
    return LocalGeometry(
        p,
        dr.detach(rest),
        to_world.spread(local, 4),
        n,
        n,
        _pair(p, u, v),
        to_world.vector(dp_du),
        to_world.vector(dp_dv),
    )


def on_rectangle(met: RayPoint, local: Any, to_world: Any, to_local: Any, side: Any) -> LocalGeometry:
    """u and v run from 0 to 1 with local x and y."""
    p = met.p
    at = _on_plane(p, local, to_local)
    dp_du, dp_dv = to_world.vector(type(p)(2, 0, 0)), to_world.vector(type(p)(0, 2, 0))
    # Where to_world mirrors, the shading normal is opposite, as in Mitsuba: there a rectangle is a mesh with normals.
    n = unit(dr.cross(dp_du * powers_of_two(dp_du)[1], dp_dv * powers_of_two(dp_dv)[1])) * side
    uv = _pair(p, dr.fma(at.x, 0.5, 0.5), dr.fma(at.y, 0.5, 0.5))
    error = to_world.spread(at)
    p, rest = _placed(at, to_world)
    return LocalGeometry(p, rest, error, n, _plane_normal(to_local, side, type(p)), uv, dp_du, dp_dv)


def on_disk(met: RayPoint, local: Any, to_world: Any, to_local: Any, side: Any) -> LocalGeometry:
    """u is the distance from the centre, v the azimuth over 2 pi."""
    p = met.p
    Vector = type(p)
    at = _on_plane(p, local, to_local)
    n = _plane_normal(to_local, side, Vector)
    radius_2 = dr.fma(at.x, at.x, at.y * at.y)
    off_center = radius_2 > 0
    inverse = dr.select(off_center, dr.rsqrt(dr.select(off_center, radius_2, 1)), 0)
    cos_phi, sin_phi = dr.select(off_center, at.x * inverse, 1), at.y * inverse
    turns = dr.atan2(at.y, dr.select(off_center, at.x, 1)) * dr.inv_two_pi
    uv = _pair(p, radius_2 * inverse, dr.select(turns < 0, turns + 1, turns))
    dp_du = to_world.vector(Vector(cos_phi, sin_phi, 0))
    dp_dv = to_world.vector(Vector(-at.y, at.x, 0) * dr.two_pi)
    p, rest = _placed(at, to_world)
    return LocalGeometry(p, rest, to_world.spread(at), n, n, uv, dp_du, dp_dv)


def on_cylinder(at: RayPoint, _: Any, to_world: Any, to_local: Any, side: Any) -> LocalGeometry:
    """u is the azimuth over 2 pi, v the position along the axis from 0 to 1."""
    met = at.polished(to_world, to_local, round_axis=True)
    Vector = type(met)
    local = to_local.vector(met)
    radius_2 = dr.fma(local.x, local.x, local.y * local.y)
    inverse = dr.rsqrt(dr.select(radius_2 > 0, radius_2, 1))
    local = Vector(local.x * inverse, local.y * inverse, local.z)
    phi = dr.atan2(local.y, local.x)
    uv = _pair(phi, dr.select(phi < 0, phi + dr.two_pi, phi) * dr.inv_two_pi, local.z)
    dp_du = to_world.vector(Vector(-local.y, local.x, 0) * dr.two_pi)
    dp_dv = to_world.vector(Vector(0, 0, 1))
    n = unit(to_local.transposed(Vector(local.x, local.y, 0))) * side
    p, rest = _placed(local, to_world)
    return LocalGeometry(p, rest, to_world.spread(local), n, n, uv, dp_du, dp_dv)


def _placed(local: Any, to_world: Any) -> tuple[Any, Any]:
    p, rest = two_sum(type(local)(*to_world.translation), to_world.vector(local))
    return p, dr.detach(rest)


def _on_plane(p: Any, local: Any, to_local: Any) -> Any:
    """The point ``local`` (Array2f) of the local plane z = 0, whose derivatives are those of the world's ``p``."""
    if dr.grad_enabled(p):
        moving = to_local.point(p)
        local = dr.replace_grad(local, type(local)(moving.x, moving.y))
    return type(p)(local.x, local.y, 0)


def _plane_normal(to_local: Any, side: Any, Vector: Any) -> Any:
    return unit(to_local.transposed(Vector(0, 0, 1))) * side


def _pair(like: Any, x: Any, y: Any) -> Any:
    return types_of(like).Array2f(x, y)


QUADRICS: dict[int, Callable[[RayPoint, Any, Any, Any, Any], LocalGeometry]] = {
    record.SPHERE: on_sphere,
    record.RECTANGLE: on_rectangle,
    record.DISK: on_disk,
    record.CYLINDER: on_cylinder,
}
