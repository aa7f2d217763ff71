"""Differential geometry of each kind of surface at a point, with Mitsuba's parameterisations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr

from ..types import types_of
from . import record
from .frame import coordinate_system
from .magnitude import powers_of_two, unit


@dataclass
class LocalGeometry:
    """Position and a bound on its rounding error (per component), geometric and shading normal (both of unit length),
    uv and the derivatives of position by u and v."""

    p: Any
    error: Any
    n: Any
    sh_n: Any
    uv: Any
    dp_du: Any
    dp_dv: Any

    def fields(self) -> tuple[Any, ...]:
        """The fields in order."""
        return self.p, self.error, self.n, self.sh_n, self.uv, self.dp_du, self.dp_dv

    def transformed(self, to_world: Any, to_local: Any) -> LocalGeometry:
        """The same under an affine map, given with its inverse."""
        return LocalGeometry(
            to_world.point(self.p),
            to_world.error(self.p, self.error),
            unit(to_local.transposed(self.n)),
            unit(to_local.transposed(self.sh_n)),
            self.uv,
            to_world.vector(self.dp_du),
            to_world.vector(self.dp_dv),
        )


@dataclass
class RayPoint:
    """A point ``p`` of a ray of direction ``d``, off the surface by the rounding of its t, which ``slack`` bounds."""

    p: Any
    d: Any
    slack: Any

    def polished(self, to_local: Any, *, round_axis: bool) -> Any:
        """The point moved along the ray onto the local unit sphere, or the cylinder about z if ``round_axis``."""
        p, d = to_local.point(dr.detach(self.p)), to_local.vector(dr.detach(self.d))
        if round_axis:
            p.z, d.z = 0, 0
        a, b, c = dr.squared_norm(d), dr.dot(p, d), dr.squared_norm(p) - 1
        # The root of a t^2 + 2 b t + c that is nearer to zero.
        q = -(b + dr.copysign(dr.sqrt(dr.fmax(b * b - a * c, 0)), b))
        step = dr.select(q != 0, c / dr.select(q != 0, q, 1), 0)
        step = dr.fmax(dr.fmin(step, self.slack), -self.slack)
        return dr.fma(dr.detach(self.d), step, self.p)


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
    e1, e2 = p1 - p0, p2 - p0
    per_size = powers_of_two(dr.fmax(abs(e1), abs(e2)))[1]
    unit_1, unit_2 = e1 * per_size, e2 * per_size
    across = dr.cross(unit_1, unit_2)
    area = dr.squared_norm(across)
    thick = area > 0
    if dr.grad_enabled(p):
        inverse_area = dr.rcp(dr.select(thick, area, 1))
        arm = (p - p0) * per_size
        moving = dr.dot(arm, dr.cross(unit_2, across)), dr.dot(arm, dr.cross(across, unit_1))
        prim_uv = dr.replace_grad(prim_uv, type(prim_uv)(*moving) * inverse_area)
    b1, b2 = prim_uv.x, prim_uv.y
    p = dr.fma(e1, b1, dr.fma(e2, b2, p0))
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
    # What interpolation adds up, and the shear and the edge functions of the test when the next ray meets this again.
    sizes = abs(p0) + 2 * (abs(e1) + abs(e2))
    error = dr.fmax(dr.fmax(sizes.x, sizes.y), sizes.z) * (8 * types_of(p).epsilon)
    return LocalGeometry(p, error, n, sh_n, uv, dp_du, dp_dv)


def on_sphere(at: RayPoint, _: Any, to_world: Any, to_local: Any, side: Any) -> LocalGeometry:
    """u is the azimuth over 2 pi, v the angle from the local z axis over pi."""
    p = at.polished(to_local, round_axis=False)
    Vector = type(p)
    local = unit(to_local.point(p))
    center = Vector(*to_world.translation)
    arm = to_world.vector(local)
    n = unit(arm) * side
    axis_2 = dr.fma(local.x, local.x, local.y * local.y)
    off_axis = axis_2 > 0
    axis = dr.sqrt(dr.select(off_axis, axis_2, 1))
    phi = dr.atan2(local.y, dr.select(off_axis, local.x, 1))
    u = dr.select(phi < 0, phi + dr.two_pi, phi) * dr.inv_two_pi
    v = dr.atan2(dr.select(off_axis, axis, 0), local.z) * dr.inv_pi
    dp_du = Vector(-local.y, local.x, 0) * dr.two_pi
    cos_phi, sin_phi = local.x / axis, local.y / axis
    dp_dv = dr.select(off_axis, Vector(local.z * cos_phi, local.z * sin_phi, -axis), Vector(1, 0, 0)) * dr.pi
    uv = _pair(p, u, v)
    error = to_world.error(local, 0)
    return LocalGeometry(center + arm, error, n, n, uv, to_world.vector(dp_du), to_world.vector(dp_dv))


def on_rectangle(met: RayPoint, local: Any, to_world: Any, to_local: Any, side: Any) -> LocalGeometry:
    """u and v run from 0 to 1 with local x and y."""
    p = met.p
    at = _on_plane(p, local, to_local)
    dp_du, dp_dv = to_world.vector(type(p)(2, 0, 0)), to_world.vector(type(p)(0, 2, 0))
    # Where to_world mirrors, the shading normal is opposite, as in Mitsuba: there a rectangle is a mesh with normals.
    n = unit(dr.cross(dp_du, dp_dv)) * side
    uv = _pair(p, dr.fma(at.x, 0.5, 0.5), dr.fma(at.y, 0.5, 0.5))
    error = to_world.error(at, 0)
    return LocalGeometry(to_world.point(at), error, n, _plane_normal(to_local, side, type(p)), uv, dp_du, dp_dv)


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
    return LocalGeometry(to_world.point(at), to_world.error(at, 0), n, n, uv, dp_du, dp_dv)


def on_cylinder(at: RayPoint, _: Any, to_world: Any, to_local: Any, side: Any) -> LocalGeometry:
    """u is the azimuth over 2 pi, v the position along the axis from 0 to 1."""
    p = at.polished(to_local, round_axis=True)
    Vector = type(p)
    local = to_local.point(p)
    radius_2 = dr.fma(local.x, local.x, local.y * local.y)
    inverse = dr.rsqrt(dr.select(radius_2 > 0, radius_2, 1))
    local = Vector(local.x * inverse, local.y * inverse, local.z)
    phi = dr.atan2(local.y, local.x)
    uv = _pair(p, dr.select(phi < 0, phi + dr.two_pi, phi) * dr.inv_two_pi, local.z)
    dp_du = to_world.vector(Vector(-local.y, local.x, 0) * dr.two_pi)
    dp_dv = to_world.vector(Vector(0, 0, 1))
    n = unit(to_local.transposed(Vector(local.x, local.y, 0))) * side
    return LocalGeometry(to_world.point(local), to_world.error(local, 0), n, n, uv, dp_du, dp_dv)


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
