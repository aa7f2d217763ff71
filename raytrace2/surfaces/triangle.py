"""The watertight ray-triangle test of Woop, Benthin and Wald (JCGT 2(1), 2013), with exact signs.

Vertices are moved to the ray's origin and sheared so that the ray becomes an axis; the triangle is hit when the origin
lies inside its shadow in the plane across that axis. Each vertex has one shadow, whichever triangle it is met
from, and an edge function is a difference of two products that is never wrong in its sign, nor in more than its last
bits (:func:`_cross`). Hence the shadows of a closed mesh cover the plane without a gap, and no ray slips between
triangles that share an edge or a vertex; and where a triangle is seen all but edge-on, the weights of its vertices are
still those of a point on the ray, so that every structure finds it where its box lies. The published test has edge
functions of nothing but rounding there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from .ordered import greater, lesser


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

    ``words[0:9]`` are the three vertices. Both sides count. A triangle seen exactly edge-on is not met. The error of t
    is two units of round-off, and a few units of how far the triangle reaches along the ray.
    """
    ax, ay = _shadow(words[0:3], ray.o, shear)
    bx, by = _shadow(words[3:6], ray.o, shear)
    cx, cy = _shadow(words[6:9], ray.o, shear)
    u = _cross(cx, cy, bx, by)
    v = _cross(ax, ay, cx, cy)
    w = _cross(bx, by, ax, ay)
    determinant = u + v + w
    inside = (lesser(lesser(u, v), w) >= 0) | (greater(greater(u, v), w) <= 0)
    per_area = dr.rcp(determinant)
    v, w = v * per_area, w * per_area
    a, b, c = (_dot(words[k : k + 3], shear.along) for k in (0, 3, 6))
    # What the subtraction of the origin rounds off (Knuth's two-sum) would else be all of the error from afar.
    distance = a - shear.o
    back = distance - a
    lost = (a - (distance - back)) - (shear.o + back)
    distance += lost + dr.fma(v, b - a, w * (c - a))
    # One step of Newton's makes the product with the reciprocal as good as a division.
    t = distance * shear.inverse
    t = dr.fma(dr.fma(-t, shear.d, distance), shear.inverse, t)
    return inside & (determinant != 0), t, v, w


def _shadow(vertex: list[Any], o: Any, shear: Shear) -> tuple[Any, Any]:
    moved = [vertex[0] - o.x, vertex[1] - o.y, vertex[2] - o.z]
    return _dot(moved, shear.u), _dot(moved, shear.v)


def _dot(a: list[Any], b: Any) -> Any:
    return dr.fma(a[0], b.x, dr.fma(a[1], b.y, a[2] * b.z))


def _cross(ax: Any, ay: Any, bx: Any, by: Any) -> Any:
    """``ax by - ay bx`` with a relative error of two units of round-off, so with the right sign, and zero only where it
    is (Jeannerod, Louvet and Muller, "Further analysis of Kahan's algorithm", Math. Comp. 82, 2013)."""
    product = ay * bx
    lost = dr.fma(-ay, bx, product)
    return dr.fma(ax, by, -product) + lost
