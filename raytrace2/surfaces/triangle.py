"""The watertight ray-triangle test of Woop, Benthin and Wald (JCGT 2(1), 2013).

Vertices are moved to the ray's origin and sheared so that the ray becomes an axis; the triangle is hit when the origin
lies inside its shadow in the plane across that axis. Each vertex has one shadow, whichever triangle it is met
from, and an edge function is the difference of two *separately rounded* products: rounding is monotonic, so its sign is
never wrong, only zero at worst, and zero counts as inside. Hence no ray slips between triangles that share an edge or a
vertex. A fused multiply-add would break this, which is why the products are written out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from .ordered import greater, lesser


@dataclass
class Shear:
    """Per ray: the rows of the matrix that takes the ray to an axis.

    ``u`` and ``v`` span the shadow plane, ``w`` measures t.
    """

    u: Any
    v: Any
    w: Any


def shear_of(ray: Any) -> Shear:
    """The shear of each ray: along the largest component of its direction, so that no entry exceeds 1 in size."""
    d = ray.d
    size = abs(d)
    x = (size.x >= size.y) & (size.x >= size.z)
    y = ~x & (size.y >= size.z)
    z = ~(x | y)
    Vector, Float = type(d), type(d.x)
    inverse = dr.rcp(dr.select(x, d.x, dr.select(y, d.y, d.z)))
    sx, sy, sz = -d.x * inverse, -d.y * inverse, -d.z * inverse
    one, zero = Float(1), Float(0)
    return Shear(
        Vector(dr.select(x, sy, one), dr.select(x, one, dr.select(y, sx, zero)), dr.select(z, sx, zero)),
        Vector(dr.select(x, sz, zero), dr.select(z, one, dr.select(y, sz, zero)), dr.select(z, sy, one)),
        Vector(dr.select(x, inverse, zero), dr.select(y, inverse, zero), dr.select(z, inverse, zero)),
    )


def intersect_triangle(words: list[Any], ray: Any, shear: Shear) -> tuple[Any, Any, Any, Any]:
    """Whether the *line* of each ray meets its triangle, and t and the barycentric weights of vertices 1 and 2 there.

    ``words[0:9]`` are the three vertices. Both sides count. A triangle seen exactly edge-on is not met.
    """
    o = ray.o
    ax, ay, aw = _sheared(words[0] - o.x, words[1] - o.y, words[2] - o.z, shear)
    bx, by, bw = _sheared(words[3] - o.x, words[4] - o.y, words[5] - o.z, shear)
    cx, cy, cw = _sheared(words[6] - o.x, words[7] - o.y, words[8] - o.z, shear)
    u = cx * by - cy * bx
    v = ax * cy - ay * cx
    w = bx * ay - by * ax
    determinant = u + v + w
    inside = (lesser(lesser(u, v), w) >= 0) | (greater(greater(u, v), w) <= 0)
    # A triangle seen edge-on has edge functions of nothing but rounding: a ray in its plane must still pass between its
    # vertices. That costs no watertightness, for it follows from the origin lying inside the shadow.
    inside &= (lesser(lesser(ax, bx), cx) <= 0) & (greater(greater(ax, bx), cx) >= 0)
    inside &= (lesser(lesser(ay, by), cy) <= 0) & (greater(greater(ay, by), cy) >= 0)
    inverse = dr.rcp(determinant)
    t = (u * aw + v * bw + w * cw) * inverse
    return inside & (determinant != 0), t, v * inverse, w * inverse


def _sheared(x: Any, y: Any, z: Any, shear: Shear) -> tuple[Any, Any, Any]:
    u, v, w = shear.u, shear.v, shear.w
    return (
        dr.fma(x, u.x, dr.fma(y, u.y, z * u.z)),
        dr.fma(x, v.x, dr.fma(y, v.y, z * v.z)),
        dr.fma(x, w.x, dr.fma(y, w.y, z * w.z)),
    )
