"""The watertight ray-triangle test of Woop, Benthin and Wald (JCGT 2(1), 2013), with exact signs.

Vertices are moved to the ray's origin and sheared so that the ray becomes an axis; the triangle is hit when the origin
lies inside its shadow in the plane across that axis. Each vertex has one shadow, whichever triangle it is met
from, and an edge function is a difference of two products that is never wrong in its sign, nor in more than its last
bits (Kahan's algorithm). Hence the shadows of a closed mesh cover the plane without a gap, and no ray slips between
triangles that share an edge or a vertex; and where a triangle is seen all but edge-on, the weights of its vertices are
still those of a point on the ray, so that every structure finds it where its box lies. The published test has edge
functions of nothing but rounding there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from ..types import types_of
from .compensated import difference_of_products, sum_of, two_product, two_sum
from .ordered import greater, lesser

#: In units of round-off of how far the triangle is, how far off it t may put a hit; boxes are widened by more.
ASIDE = 8


@dataclass
class Shear:
    """Per ray: the rows ``u`` and ``v`` that span the shadow plane; the unit vector ``along`` of the direction's
    largest component; that component of the direction, its reciprocal, and that of the origin."""

    u: Any
    v: Any
    along: Any
    d: Any
    inverse: Any
    o: Any


def shear_of(ray: Any) -> Shear:
    """The shear of each ray: along the largest component of its direction, so that no entry exceeds 1 in size."""
    d = ray.d
    size = abs(d)
    x = (size.x >= size.y) & (size.x >= size.z)
    y = ~x & (size.y >= size.z)
    z = ~(x | y)
    Vector, Float = type(d), type(d.x)
    component = dr.select(x, d.x, dr.select(y, d.y, d.z))
    inverse = dr.rcp(component)
    sx, sy, sz = -d.x * inverse, -d.y * inverse, -d.z * inverse
    one, zero = Float(1), Float(0)
    return Shear(
        Vector(dr.select(x, sy, one), dr.select(x, one, dr.select(y, sx, zero)), dr.select(z, sx, zero)),
        Vector(dr.select(x, sz, zero), dr.select(z, one, dr.select(y, sz, zero)), dr.select(z, sy, one)),
        Vector(dr.select(x, one, zero), dr.select(y, one, zero), dr.select(z, one, zero)),
        component,
        inverse,
        dr.select(x, ray.o.x, dr.select(y, ray.o.y, ray.o.z)),
    )


def intersect_triangle(words: list[Any], ray: Any, shear: Shear) -> tuple[Any, Any, Any, Any]:
    """Whether the *line* of each ray meets its triangle, and t and the barycentric weights of vertices 1 and 2 there.

    ``words[0:9]`` are the three vertices. Both sides count. A triangle seen exactly edge-on is not met. t is the
    nearest number to that of the exact plane, or one of its neighbours, where the ray meets that inside the triangle;
    else it is that of a point of the triangle that rounding has put on the ray.
    """
    ax, ay = _shadow(words[0:3], ray.o, shear)
    bx, by = _shadow(words[3:6], ray.o, shear)
    cx, cy = _shadow(words[6:9], ray.o, shear)
    u = difference_of_products(cx, by, cy, bx)
    v = difference_of_products(ax, cy, ay, cx)
    w = difference_of_products(bx, ay, by, ax)
    determinant = u + v + w
    inside = (lesser(lesser(u, v), w) >= 0) | (greater(greater(u, v), w) <= 0)
    per_area = dr.rcp(determinant)
    v, w = v * per_area, w * per_area
    met = inside & (determinant != 0)
    a, b, c = (_dot(words[k : k + 3], shear.along) for k in (0, 3, 6))
    # What the subtraction of the origin rounds off would else be all of the error from afar.
    distance, lost = two_sum(a, -shear.o)
    beyond = dr.fma(v, b - a, w * (c - a))
    rest = lost + beyond
    # One step of Newton's makes the product with the reciprocal as good as a division, and takes up the rest, whose
    # sum with the distance would be rounded.
    t = distance * shear.inverse
    t = dr.fma(dr.fma(-t, shear.d, distance) + rest, shear.inverse, t)
    # No farther than the triangle reaches along the ray, else a box around it might not have the hit.
    before = (lesser(lesser(a, b), c) - a - beyond) * shear.inverse
    after = (greater(greater(a, b), c) - a - beyond) * shear.inverse
    least, most = lesser(before, after), greater(before, after)
    # Few tests end in a hit, so the digits of grazing ones cost little.
    (t,) = dr.if_stmt(
        (t,),
        met,
        lambda t: (t + greater(lesser(_step_to_plane(words, ray, t, v, w), most), least),),
        lambda t: (t,),
    )
    return met, t, v, w


def _step_to_plane(words: list[Any], ray: Any, t: Any, v: Any, w: Any) -> Any:
    """What to add to ``t`` to come from the point there to the plane of the triangle, near its point ``v``, ``w``.

    Shadows are off by the rounding of how far the triangle is, which a grazing ray makes an error of t. The gap between
    the two points is all but that, so it is formed in twice the digits; its projection needs few. Zero where that point
    of the plane is no longer in the triangle, give or take the rounding of shadows.
    """
    Vector = type(ray.d)
    gap, side_1, side_2, reach = Vector(0), Vector(0), Vector(0), type(t)(0)
    for k in range(3):
        arm, lost = two_sum(words[k], -ray.o[k])
        side_1[k], lost_1 = two_sum(words[3 + k], -words[k])
        side_2[k], lost_2 = two_sum(words[6 + k], -words[k])
        along, lost_along = two_product(-t, ray.d[k])
        part_1, lost_part_1 = two_product(v, side_1[k])
        part_2, lost_part_2 = two_product(w, side_2[k])
        rest = (lost + lost_along) + (dr.fma(v, lost_1, lost_part_1) + dr.fma(w, lost_2, lost_part_2))
        gap[k] = sum_of([arm, along, part_1, part_2], rest)
        reach = reach + abs(arm)
    normal = dr.cross(side_1, side_2)
    slope = dr.dot(normal, ray.d)
    step = dr.select(slope != 0, dr.dot(normal, gap) / slope, 0)
    # Of a ray that all but lies in the plane the step may lead out of the triangle, where no structure looks for it.
    aside = dr.fma(ray.d, step, -gap)
    per_area = dr.rcp(dr.squared_norm(normal))
    v = v + dr.dot(dr.cross(aside, side_2), normal) * per_area
    w = w + dr.dot(dr.cross(side_1, aside), normal) * per_area
    stays = (lesser(v, w) >= 0) & (v + w <= 1)
    stays = stays | (abs(aside.x) + abs(aside.y) + abs(aside.z) <= reach * (ASIDE * types_of(t).epsilon))
    return dr.select(stays, step, 0)


def _shadow(vertex: list[Any], o: Any, shear: Shear) -> tuple[Any, Any]:
    moved = [vertex[0] - o.x, vertex[1] - o.y, vertex[2] - o.z]
    return _dot(moved, shear.u), _dot(moved, shear.v)


def _dot(a: list[Any], b: Any) -> Any:
    return dr.fma(a[0], b.x, dr.fma(a[1], b.y, a[2] * b.z))
