"""The watertight ray-triangle test of Woop, Benthin and Wald (JCGT 2(1), 2013), with exact signs.

Vertices are moved to the ray's origin and sheared so that the ray becomes an axis; the triangle is hit when the origin
lies inside its shadow in the plane across that axis. An edge function is a difference of two products; where it is so
near zero that the rounding of shadows and products might have turned its sign, more digits decide: in float32 those of
the exact determinant, so that a ray meets a triangle if and only if it does so in exact arithmetic; in float64 Kahan's
algorithm, never wrong in its sign for the shadows as rounded. Each vertex has one shadow, whichever triangle it is met
from: hence shadows of a closed mesh cover the plane without a gap, and no ray slips between triangles that share an
edge or a vertex. Where a triangle is seen all but edge-on, the weights of its vertices are still those of a point on
the ray, so that every structure finds it where its box lies. The published test has edge functions of nothing but
rounding there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from ..types import types_of
from .compensated import difference_of_products, sum_of, two_product, two_sum
from .exact_edges import meeting_in_float64, weights
from .ordered import greater, lesser

#: In units of round-off of how far the triangle is, how far off it t may put a hit; boxes are widened by more.
ASIDE = 8

#: In units of round-off: how far off the shadow of a vertex may be, times the sum of its coordinates there, and times
#: the product of its distance and the slope of the ray; for the two vertices of an edge, and with their products'.
BLUR = 7, 9


@dataclass
class Shear:
    """Per ray: whether its direction's largest component is ``x``, or else ``z``; the two slopes that take points along
    the ray to the shadow plane; that component of the direction, and its reciprocal; the origin's components across it
    and along it; and how far off the slopes and the distance along them may put a shadow, for each unit of that."""

    x: Any
    z: Any
    slope_u: Any
    slope_v: Any
    d: Any
    inverse: Any
    o: Any
    blur: Any

    def axes(self, v: Any) -> tuple[Any, Any, Any]:
        """The components of ``v`` across the largest one of the direction, and that one."""
        return dr.select(self.x, v[1], v[0]), dr.select(self.z, v[1], v[2]), self.along(v)

    def along(self, v: Any) -> Any:
        """The component of ``v`` that is the direction's largest."""
        return dr.select(self.x, v[0], dr.select(self.z, v[2], v[1]))


def shear_of(ray: Any) -> Shear:
    """The shear of each ray: along the largest component of its direction, so that no slope exceeds 1 in size."""
    size = abs(ray.d)
    x = (size.x >= size.y) & (size.x >= size.z)
    z = ~x & (size.y < size.z)
    shear = Shear(x, z, None, None, None, None, None, None)
    u, v, component = shear.axes(ray.d)
    inverse = dr.rcp(component)
    u, v = -u * inverse, -v * inverse
    blur = greater(abs(u), abs(v)) * (BLUR[1] * types_of(u).epsilon)
    return Shear(x, z, u, v, component, inverse, shear.axes(ray.o), blur)


def intersect_triangle(words: list[Any], ray: Any, shear: Shear) -> tuple[Any, Any, Any, Any]:
    """Whether the *line* of each ray meets its triangle, and t and the barycentric weights of vertices 1 and 2 there.

    ``words[0:9]`` are the three vertices. Both sides count. A triangle seen exactly edge-on is not met. t is the
    nearest number to that of the exact plane, or one of its neighbours, where the ray meets that inside the triangle;
    else it is that of a point of the triangle that rounding has put on the ray.
    """
    o = shear.o
    shadows, size, reach = [], None, None
    for k in (0, 3, 6):
        u, v, along = shear.axes(words[k : k + 3])
        along = along - o[2]
        shadow = dr.fma(shear.slope_u, along, u - o[0]), dr.fma(shear.slope_v, along, v - o[1])
        shadows.append(shadow)
        wide, far = abs(shadow[0]) + abs(shadow[1]), abs(along)
        size, reach = (wide, far) if size is None else (greater(size, wide), greater(reach, far))
    (ax, ay), (bx, by), (cx, cy) = shadows
    u = dr.fma(cx, by, -(cy * bx))
    v = dr.fma(ax, cy, -(ay * cx))
    w = dr.fma(bx, ay, -(by * ax))
    types = types_of(u)
    blur = dr.fma(size, BLUR[0] * types.epsilon, reach * shear.blur)
    margin = blur * (size + blur)
    # How far the ray passes outside: beyond the margin that is sure, and within it the digits decide.
    outside = lesser(greater(greater(u, v), w), -lesser(lesser(u, v), w))
    width = dr.width(outside)
    zero = dr.zeros(type(u), width)

    def meeting(*_: Any) -> tuple[Any, Any, Any, Any]:
        if types.precision == "float32":
            return meeting_in_float64(words, ray, abs(outside) <= margin)
        return _meeting_by_shadows(words, ray, shear, shadows)

    # Few tests end in a hit, so its digits cost little.
    nothing = dr.full(types.Bool, False, width), zero, zero, zero
    return dr.if_stmt(nothing, outside <= margin, meeting, lambda *nothing: nothing)


def _meeting_by_shadows(
    words: list[Any], ray: Any, shear: Shear, shadows: list[tuple[Any, Any]]
) -> tuple[Any, Any, Any, Any]:
    (ax, ay), (bx, by), (cx, cy) = shadows
    met, v, w = weights(
        difference_of_products(cx, by, cy, bx),
        difference_of_products(ax, cy, ay, cx),
        difference_of_products(bx, ay, by, ax),
    )
    a, b, c = (shear.along(words[k : k + 3]) for k in (0, 3, 6))
    # What the subtraction of the origin rounds off would else be all of the error from afar.
    distance, lost = two_sum(a, -shear.o[2])
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
    t = t + greater(lesser(_step_to_plane(words, ray, t, v, w), most), least)
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
