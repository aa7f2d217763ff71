"""Where rays meet the surface that another ray met, continued beyond its edges, without a traversal."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import drjit as dr

from ...surfaces import record
from ...surfaces.hit import Hit
from ...surfaces.shading import Rows
from ...types import types_of
from ..ray import Ray
from .bending import instance_maps, kind_code, quadric_words

#: A surface that a ray meets behind itself or beyond this many times the other's distance counts as met there.
FARTHEST = 16


def extended_hit(structure: Any, si: Any, hit: Hit, ray: Ray) -> tuple[Hit, Any]:
    """``hit`` for ``ray``, and whether it meets the surface at all (Bool).

    ``si`` is where the other ray met it: the plane of a triangle, a rectangle or a disk, or the same side of a sphere
    or a cylinder. Where a ball is missed, its nearest point stands for the hit.
    """
    shading, types = structure.geometry.shading, structure.types
    o, d = ray.o, ray.d
    if shading.has_instances:
        _, to_local = instance_maps(shading, si)
        o, d = to_local.point(o), to_local.vector(d)
    limit = dr.select(si.valid, si.t, 0) * FARTHEST
    t, uv, meets = si.t, hit.uv, si.valid
    on_mesh: Any = si.valid
    if shading.quadric_kinds:
        code = kind_code(shading, si)
        on_mesh = si.valid & (code == record.TRIANGLE)
        local = Rows(quadric_words(shading, si, 1))
        a, b = local.point(o), local.vector(d)
        entering = dr.dot(si.n, ray.d) * _turned_in(shading, si) < 0
        for kind in shading.quadric_kinds:
            here = si.valid & (code == kind)
            if kind in (record.RECTANGLE, record.DISK):
                found, at, met = _plane(a, b, limit)
                uv = dr.select(here, at, uv)
            else:
                found, met = _ball(a, b, entering, flat=kind == record.CYLINDER)
            t, meets = dr.select(here, found, t), dr.select(here, met, meets)
    if shading.has_meshes:
        found, at, met = _triangle(shading, types, si, on_mesh, o, d, limit)
        t, uv, meets = (dr.select(on_mesh, x, y) for x, y in ((found, t), (at, uv), (met, meets)))
    return replace(hit, t=t, uv=uv), meets


def _turned_in(shading: Any, si: Any) -> Any:
    """-1 where normals point inwards, 1 elsewhere."""
    return dr.select(quadric_words(shading, si, 0)[12] < 0, type(si.t)(-1), 1)


def _plane(o: Any, d: Any, limit: Any) -> tuple[Any, Any, Any]:
    t, met = _clamped(-o.z / dr.select(d.z != 0, d.z, 1), d.z, limit)
    return t, types_of(o).Array2f(dr.fma(d.x, t, o.x), dr.fma(d.y, t, o.y)), met


def _ball(o: Any, d: Any, entering: Any, *, flat: bool) -> tuple[Any, Any]:
    if flat:
        o, d = type(o)(o.x, o.y, 0), type(d)(d.x, d.y, 0)
    a = dr.squared_norm(d)
    a = dr.select(a > 0, a, 1)
    nearest = -dr.dot(o, d) / a
    room = 1 - dr.squared_norm(dr.fma(d, nearest, o))
    half_chord = dr.sqrt(dr.fmax(room, 0) / a)
    return nearest + dr.select(entering, -half_chord, half_chord), room > 0


def _triangle(shading: Any, types: Any, si: Any, active: Any, o: Any, d: Any, limit: Any) -> tuple[Any, Any, Any]:
    face = si.prim
    if shading.many_surfaces:
        face = face + dr.gather(types.UInt, shading.first_face, si.surface, active)
    *corners, _ = dr.gather(types.Array4u, shading.faces, face, active & (face < shading.face_count))
    packets = [dr.gather(types.Array4f, shading.vertices, i, active) for i in corners]
    p0, p1, p2 = (types.Array3f(q.x, q.y, q.z) for q in packets)
    e1, e2 = p1 - p0, p2 - p0
    across = dr.cross(e1, e2)
    area = dr.squared_norm(across)
    slope = dr.dot(across, d)
    arm = o - p0
    t, met = _clamped(-dr.dot(across, arm) / dr.select(slope != 0, slope, 1), slope, limit)
    at = dr.fma(d, t, arm)
    inverse = dr.rcp(dr.select(area > 0, area, 1))
    weights = dr.dot(at, dr.cross(e2, across)) * inverse, dr.dot(at, dr.cross(across, e1)) * inverse
    return t, types.Array2f(*weights), met


def _clamped(t: Any, slope: Any, limit: Any) -> tuple[Any, Any]:
    met = (slope != 0) & (t >= 0) & (t < limit)
    return dr.select(met, t, limit), met
